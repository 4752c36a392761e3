"""How large memory is: what each departure carries on to the next.

Recalibration takes out part of it, and more of what is slow, so that the correlation that is left is smaller
than that of the noise. What correlation would be left of noise that carries on some share is simulated, and
the shares under which the log's own would be usual are its interval.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.shapes.memory import Memory
from stickslip_fit.units import Interval

Array = npt.NDArray[np.float64]

SHARES = np.arange(0.0, 0.96, 0.05)
DRAWS = 200
TAILS = (0.975, 0.5, 0.025)  # of the correlations left: the lowest share makes the log's own unusually large


def carried(study: Study, memory: Memory) -> Interval:
    """Rms of what is carried on to each departure, in units of what is new in it.

    Parameters
    ----------
    study : Study
    memory : Memory
        As it was found.
    """
    sign = np.sign(memory.carried)
    own = sign * _correlation(study.residual[:, None], memory)[0]
    noise = np.random.default_rng(0).standard_normal((len(study), DRAWS))
    left = [sign * _correlation(study.project(_carrying(noise, memory, sign * k)), memory) for k in SHARES]
    limits = np.maximum.accumulate(np.quantile(left, [1 - tail for tail in TAILS], axis=1), axis=1)
    low, middle, high = (float(np.interp(own, limit, SHARES)) for limit in limits[::-1])
    return Interval(*(share / np.sqrt(1.0 - share**2) for share in (middle, low, high)))


def _carrying(noise: Array, memory: Memory, share: float) -> Array:
    """Noise of which each row keeps a share of the row before, a first one being as large as any other."""
    found = noise.copy()
    for row, before in enumerate(memory.before):
        found[row] = (
            found[row] + share * found[before] if before >= 0 else found[row] / np.sqrt(1.0 - share**2)
        )
    return found


def _correlation(residuals: Array, memory: Memory) -> Array:
    """Of each row with the one before, (n, k) -> (k,)."""
    follows = memory.before >= 0
    products = residuals[follows] * residuals[memory.before[follows]]
    return np.asarray(products.sum(axis=0) / np.sum(residuals**2, axis=0))
