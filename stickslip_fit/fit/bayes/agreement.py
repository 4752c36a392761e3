"""Whether the ensembles agree, and how many independent draws they are worth; both by ArviZ.

An ensemble is one chain: the walkers of one know of each other, so that their agreement shows nothing. What
is correlated in time is each walker, so the effective sizes come from the walkers' own autocorrelations: in
the draws of an ensemble put into one line it would hide at multiples of the number of walkers.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def r_hat(draws: Array) -> Array:
    """Rank-normalised split R-hat between ensembles (Vehtari et al., Bayesian Analysis 16:667, 2021).

    Parameters
    ----------
    draws : array, shape (quantities, ensembles, steps, walkers)

    Returns
    -------
    array, shape (quantities,)
    """
    from arviz_stats.base import array_stats

    return np.asarray(array_stats.rhat(draws.reshape(*draws.shape[:2], -1)))


def effective_sizes(draws: Array, kind: Literal["bulk", "tail"] = "bulk") -> Array:
    """Effective number of draws, (quantities, ensembles, steps, walkers) -> (quantities,)."""
    from arviz_stats.base import array_stats

    walks = draws.swapaxes(2, 3).reshape(len(draws), -1, draws.shape[2])
    prob = {"tail": (0.05, 0.95)}.get(kind)
    return np.asarray(array_stats.ess(walks, method=kind, prob=prob))
