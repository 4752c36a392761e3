"""The diagnosis of this package as a contender."""

from __future__ import annotations

import numpy as np

from benchmarks.naming.problem import Answer, Problem


def ours(problem: Problem) -> Answer:
    """Decide and name as ``stickslip-fit diagnose`` does, without the gain and the next experiment."""
    from stickslip_fit.diagnosis import diagnose
    from stickslip_fit.logs import read_log

    decided = diagnose(read_log(problem.log), seed=0, gain=False)
    told = {cause: float(value) for cause, value in decided.inclusion.items() if value is not None}
    # Alarms go by the p-value of anything at all: digits by which it is below 1 %.
    loud = -2.0 - float(np.log10(decided.p_value))
    found = [(each.cause, loud) for each in decided.findings]
    if not found:
        found = [(max(told, key=lambda cause: told[cause], default="unknown"), loud)]
    departure = np.zeros(len(problem.y))
    kept = np.setdiff1d(np.arange(len(problem.y)), decided.search.outliers)
    departure[kept] = problem.y[kept] - decided.search.fit.residual
    first = decided.findings[0] if decided.findings else None
    return Answer(
        found,
        0.0,
        told,
        departure[None],
        rivals=first.equivalent if first else (),
        interval=(100 * first.effect.low, 100 * first.effect.high) if first else None,
        quiet=told,
    )
