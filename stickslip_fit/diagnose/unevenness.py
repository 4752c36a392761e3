"""How much worse than elsewhere traverses of some configurations repeat.

Some configurations may repeat up to twice as badly as others, and nobody says which. Each is taken for one
of the quiet or of the noisy ones, by the likelihood of its residuals under either; how many are noisy, and
how much, is what makes the whole log likeliest (H. Robbins, Proc. Third Berkeley Symp. 1:157, 1956, on priors
that the data themselves give).
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student_t

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TAILS = (5.0, 200.0)  # degrees of freedom that noise may have
UNITS = 0.55 * 2 ** (np.arange(9) / 4)  # sizes of the quiet or noisy noise, in that of all
TIMES = (2, 3, 4)  # places in UNITS between quiet and noisy: 1.4 to 2 times
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the configurations that are noisy
WILD_SHARE, WILD_SIZE = 0.01, 5.0  # of rows that are off by anything: one does not make a configuration noisy
CERTAIN = 3.0  # nats by which that must be likelier than even noise


def unevenness(off: Array, kind: Indices) -> Array:
    """Noise of each row's configuration over that of the quiet ones, shape (n,); 1 where noise is even.

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
    >>> found = unevenness(noise * rng.standard_normal(600), kind)
    >>> bool(np.corrcoef(found, noise)[0, 1] > 0.9)
    True
    >>> np.unique(unevenness(rng.standard_normal(600), kind))
    array([1.])
    """
    even, best, found = -np.inf, -np.inf, np.ones(int(kind.max()) + 1)
    for freedom in TAILS:
        fits = [_fit(off, unit, freedom, kind) for unit in UNITS]
        even = max(even, *(float(fit.sum()) for fit in fits))
        for times, share in product(TIMES, SHARES):
            for quiet, noisy in zip(fits, fits[times:], strict=False):
                as_noisy = np.log(share) + noisy
                either = np.logaddexp(np.log1p(-share) + quiet, as_noisy)
                if (likelihood := float(either.sum())) > best:
                    best, odds = likelihood, np.exp(as_noisy - either)
                    found = 1.0 / np.sqrt(1.0 - odds + odds * (UNITS[0] / UNITS[times]) ** 2)
    return found[kind] if best > even + CERTAIN else np.ones(len(off))


def _fit(off: Array, unit: float, freedom: float, kind: Indices) -> Array:
    """Log likelihood of each configuration's residuals under noise of a size."""
    scale = unit * np.sqrt((freedom - 2.0) / freedom)  # makes `unit` the standard deviation
    noise = student_t.logpdf(off / scale, freedom) - np.log(scale)
    wild = student_t.logpdf(off / WILD_SIZE, 1.0) - np.log(WILD_SIZE)
    return np.bincount(kind, np.logaddexp(np.log1p(-WILD_SHARE) + noise, np.log(WILD_SHARE) + wild))
