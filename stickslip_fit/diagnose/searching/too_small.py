"""A log with too few traverses to be judged: why, and what would suffice."""

from __future__ import annotations

import numpy as np

from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.searching.misfit import Misfit
from stickslip_fit.diagnose.searching.search import Search

FEWEST = 10  # degrees of freedom


def too_small(study: Study) -> str | None:
    """Why a log cannot be tested at all, and what would suffice; None where it can.

    Parameters
    ----------
    study : Study
        The log under its baseline.
    """
    if study.freedom >= FEWEST:
        return None
    rows, parameters = len(study), study.basis.shape[1]
    return (
        f"too few traverses to test: {rows} for the baseline's {parameters} parameters, and {FEWEST} more "
        f"than those are needed; add {FEWEST - study.freedom} in the same sessions and directions, "
        "replicates or new configurations"
    )


def not_searched(bench: Bench) -> Search:
    """A search that found nothing because there is nothing to search."""
    looked = Misfit(np.zeros(0), (), np.zeros(0), {}, 1.0, np.zeros(0))
    return Search(bench, np.zeros(0, dtype=np.intp), (), looked, looked, 1.0, bench.fitted(), bench.study())
