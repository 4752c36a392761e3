"""The diagnosis of this package as a contender."""

import numpy as np

from benchmarks.naming.problem import Answer, Problem


def ours(problem: Problem) -> Answer:
    """Name causes as ``stickslip-fit diagnose`` does, without the gain and the next experiment."""
    from stickslip_fit.diagnosis import diagnose
    from stickslip_fit.logs import read_log

    diagnosis = diagnose(read_log(problem.log), seed=0, gain=False)
    inclusion = {cause: float(value) for cause, value in diagnosis.inclusion.items() if value is not None}
    # Powers of ten by which the p-value of the whole search is below 1 %.
    score = -2.0 - float(np.log10(diagnosis.p_value))
    ranked = [(finding.cause, score) for finding in diagnosis.findings]
    if not ranked:
        ranked = [(max(inclusion, key=lambda cause: inclusion[cause], default="unknown"), score)]
    departure = np.zeros(len(problem.y))
    kept = np.setdiff1d(np.arange(len(problem.y)), diagnosis.selection.outliers)
    departure[kept] = problem.y[kept] - diagnosis.selection.fit.residual
    first = diagnosis.findings[0] if diagnosis.findings else None
    return Answer(
        ranked,
        0.0,
        inclusion,
        departure[None],
        rivals=first.equivalent if first else (),
        interval=(100 * first.effect.low, 100 * first.effect.high) if first else None,
        quiet=inclusion,
    )
