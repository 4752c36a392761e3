"""Interval, and confidence intervals of effect strengths that remain valid after selection.

The length z of an estimated effect, in standard deviations of the noise, is noncentral chi distributed.
It is seen only if it exceeds the detection threshold, so the interval inverts the distribution of z
conditional on detection (J. D. Lee et al., Ann. Stat. 44:907, 2016, for the normal case).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import ncx2

from stickslip_fit._typing import Array
from stickslip_fit.units import Interval

COVERAGE = 0.95
MAX_CONDITIONAL_STRENGTH = 12.0  # strength beyond which the alarm was certain


def strength_interval(z: float, dimensions: int, threshold: float) -> Interval:
    """Strength of an effect that was seen with length `z`, because it exceeded `threshold`.

    Parameters
    ----------
    z : float
        Length of the estimated effect, in repeatabilities.
    dimensions : int
        Numbers that were estimated with it.
    threshold : float
        Least length that raises the alarm.

    Examples
    --------
    A strong effect has the ordinary interval; one just above the threshold may well be nothing much.

    >>> strong, weak = strength_interval(20.0, 1, 4.0), strength_interval(4.2, 1, 4.0)
    >>> round(strong.low, 1), round(strong.high, 1), round(weak.low, 1)
    (18.0, 22.0, 0.0)
    >>> round(strength_interval(11.8, 1, 9.3).low, 1)
    9.7
    """
    if z > MAX_CONDITIONAL_STRENGTH:
        middle = np.sqrt(max(z**2 - dimensions, 0.0))
        return Interval(middle, max(z - 1.96, 0.0), float(np.sqrt((z + 1.96) ** 2 - dimensions + 1)))
    threshold = min(threshold, z * (1 - 1e-9))

    def below(strength: float) -> float:
        """Chance of less than `z`, given the alarm."""
        # Upper tails: far below the threshold an alarm is so rare that 1 less the lower one would be 0.
        alarm = max(float(ncx2.sf(threshold**2, dimensions, strength**2)), 1e-300)
        return 1.0 - float(ncx2.sf(z**2, dimensions, strength**2)) / alarm

    def where(chance: float) -> float:
        if below(1e-6) < chance:
            return 0.0
        return float(brentq(lambda s: below(s) - chance, 1e-6, z + 10.0, xtol=1e-4))

    tail = (1.0 - COVERAGE) / 2
    return Interval(where(0.5), where(1.0 - tail), where(tail))


def threshold_length(critical: float, shapes: int, df: int, strengths: Array) -> float:
    """Length at which one shape alone would raise the alarm.

    Parameters
    ----------
    critical : float
        Log evidence, over everything, that raises it.
    shapes : int
        Of the cause; its evidence is their mean.
    freedom : int
    strengths : array
        Over which evidence is averaged.
    """

    def evidence(z: float) -> float:
        signal = strengths**2
        log = -0.5 * np.log1p(signal) - 0.5 * df * np.log1p(
            -np.minimum(z**2 * signal / (1 + signal) / (df + z**2), 1 - 1e-12)
        )
        return float(np.log(np.mean(np.exp(log - log.max()))) + log.max() - np.log(shapes))

    if not np.isfinite(critical) or evidence(0.0) > critical:
        return 0.0
    return float(brentq(lambda z: evidence(z) - critical, 0.0, 60.0, xtol=1e-3))
