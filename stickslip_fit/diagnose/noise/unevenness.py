"""How much worse than elsewhere traverses of some configurations repeat.

Some configurations may repeat up to twice as badly as others, and nobody says which. Each is taken for one
of the quiet or of the noisy ones, by the likelihood of its residuals under either; how many are noisy, and
how much, is what makes the whole log likeliest (H. Robbins, Proc. Third Berkeley Symp. 1:157, 1956, on priors
that the data themselves give).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student_t

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TAILS = (5.0, 200.0)  # degrees of freedom that noise may have
UNITS = 0.55 * 2 ** (np.arange(9) / 4)  # sizes of the quiet or noisy noise, in that of all
APART = (2, 3, 4)  # places in UNITS between quiet and noisy: 1.4 to 2 times
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the configurations that are noisy
WILD_SHARE, WILD_SIZE = 0.01, 5.0  # of rows that are off by anything: one does not make a configuration noisy
BEYOND_TAILS = 10.0  # nats by which it must be, so that no heavy tails look like it
PLAINLY_NOT = 0.02  # odds of being noisy, below which a configuration is a quiet one
CERTAIN = 3.0  # nats by which that must be likelier than even noise


@dataclass(frozen=True, eq=False)
class Unevenness:
    """Noise of each row's configuration over that of the quiet ones, shape (n,); 1 where noise is even.

    Attributes
    ----------
    likely : array, shape (n,)
    at_most : array, shape (n,)
        That of the noisy ones, unless the configuration is plainly a quiet one; 1 also where heavy tails
        alone might look like some noisy configurations.
    """

    likely: Array
    at_most: Array


def unevenness(off: Array, kind: Indices) -> Unevenness:
    """Find out which configurations are the noisy ones, if there are any.

    Parameters
    ----------
    off : array, shape (n,)
        Residuals in units of the noise of all.
    kind : array of int, shape (n,)
        Configuration of each row.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> kind = np.repeat(np.arange(40), 15)
    >>> noise = np.where(kind < 12, 2.0, 1.0)
    >>> found = unevenness(noise * rng.standard_normal(600), kind).likely
    >>> bool(np.corrcoef(found, noise)[0, 1] > 0.9)
    True
    >>> np.unique(unevenness(rng.standard_normal(600), kind).at_most)
    array([1.])
    """
    even, best, odds, times = -np.inf, -np.inf, np.zeros(int(kind.max()) + 1), 1.0
    for freedom in TAILS:
        fits = [_fit(off, unit, freedom, kind) for unit in UNITS]
        even = max(even, *(float(fit.sum()) for fit in fits))
        for apart, share in product(APART, SHARES):
            for quiet, noisy in zip(fits, fits[apart:], strict=False):
                as_noisy = np.log(share) + noisy
                either = np.logaddexp(np.log1p(-share) + quiet, as_noisy)
                if (likelihood := float(either.sum())) > best:
                    best, odds, times = likelihood, np.exp(as_noisy - either), UNITS[apart] / UNITS[0]
    if best < even + CERTAIN:
        return Unevenness(np.ones(len(off)), np.ones(len(off)))
    likely = 1.0 / np.sqrt(1.0 - odds + odds / times**2)
    doubtful = (odds > PLAINLY_NOT) if best > even + BEYOND_TAILS else np.zeros(len(odds), dtype=bool)
    return Unevenness(likely[kind], np.where(doubtful, times, 1.0)[kind])


def _fit(off: Array, unit: float, freedom: float, kind: Indices) -> Array:
    """Log likelihood of each configuration's residuals under noise of a size."""
    scale = unit * np.sqrt((freedom - 2.0) / freedom)  # makes `unit` the standard deviation
    noise = student_t.logpdf(off / scale, freedom) - np.log(scale)
    wild = student_t.logpdf(off / WILD_SIZE, 1.0) - np.log(WILD_SIZE)
    return np.bincount(kind, np.logaddexp(np.log1p(-WILD_SHARE) + noise, np.log(WILD_SHARE) + wild))
