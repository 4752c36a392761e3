"""Variances of many small samples that borrow from each other.

After G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3:3 (2004): variances are drawn from a scaled inverse
chi-square distribution, whose size and degrees of freedom follow from how their logarithms scatter. A lab has
few sessions, and many pairs of strategies to compare over them: a variance from three sessions says next to
nothing, but that of the other pairs says about how large it can be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

Array = npt.NDArray[np.float64]

FEWEST = 3  # variances that say anything about how variances spread
FARTHEST = 12.0  # log of the most and of the fewest degrees of freedom that others may add


@dataclass(frozen=True, eq=False)
class Moderated:
    """Variances drawn together.

    Attributes
    ----------
    variance : array, shape (m,)
    freedom : float
        Degrees of freedom of each.
    """

    variance: Array
    freedom: float


def moderate(variance: Array, freedom: int, most: int) -> Moderated:
    """Draw variances towards what they have in common, the more alike they are.

    Parameters
    ----------
    variance : array, shape (m,)
        Above 0.
    freedom : int
        Degrees of freedom of each.
    most : int
        Degrees of freedom in all of them together, which none can have more than.

    Examples
    --------
    Three variances that differ by no more than chance become one:

    >>> found = moderate(np.array([1.0, 0.5, 2.0]), freedom=2, most=6)
    >>> found.variance.round(2), found.freedom
    (array([1.78, 1.78, 1.78]), 6.0)
    """
    if len(variance) < FEWEST:
        return Moderated(variance, float(freedom))
    half = freedom / 2.0
    log = np.log(variance) - digamma(half) + np.log(half)
    beyond = float(np.var(log, ddof=1) - polygamma(1, half))
    if beyond <= polygamma(1, np.exp(FARTHEST)):
        return Moderated(np.full(len(variance), np.exp(log.mean())), float(most))
    prior = np.exp(brentq(lambda size: float(polygamma(1, np.exp(size))) - beyond, -FARTHEST, FARTHEST))
    usual = np.exp(log.mean() + digamma(prior) - np.log(prior))
    drawn = (2.0 * prior * usual + freedom * variance) / (2.0 * prior + freedom)
    return Moderated(drawn, float(min(2.0 * prior + freedom, most)))
