"""How loud is loud: limits from the chances that are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

CHECKS = 2400  # of a traverse of 12,000 steps
FALSE_STOPS = 3e-4  # in such a traverse, on average
LONE = 0.01  # chance of a check that would make a stop of a bang beside it
DROWNED = 2e-5  # chance of a check that is thought to be drowned by the room
MISSED = 1e-5  # a check at the stop that stays below the limit, where the limit may be chosen
COLOUR_MEMORY = 60  # checks over which the tuned band's share of the sound is averaged
GAIN_MEMORY = 8  # checks over which the reference is: short, to follow a gain that drifts
NODES = 80  # of Gauss and Legendre
TABLE = (1, 2, 3, 4, 6, 8, 12, 16, 24, 40, COLOUR_MEMORY)  # checks in a baseline


@dataclass(frozen=True, eq=False)
class Limits:
    """What the rises of two running checks must reach to be a stop.

    A rise is the power in the tuned band over its baseline, about chi2(n) / n while the joint moves freely.

    Attributes
    ----------
    pair : array, shape (61,)
        The mean of the two must reach it; by the number of checks in the baseline, 0 to 60.
    least : array, shape (61,)
        Either must reach it.
    drowned : array, shape (61,)
        The rise of the reference beyond which a check says nothing.
    reference_rise : float
        What the stop itself adds to the reference.
    """

    pair: Array
    least: Array
    drowned: Array
    reference_rise: float

    @property
    def cap(self) -> Array:
        """The most that one check can count, so that it needs another beside it, shape (61,)."""
        return 2 * self.pair - self.least


def limits_for(freedom: float, reference_freedom: float, rise: float, reference_rise: float) -> Limits:
    """Limits for sounds that have been listened to.

    Parameters
    ----------
    freedom, reference_freedom : float
        Degrees of freedom of a check's power in the band and in the reference.
    rise, reference_rise : float
        By what factor both are louder at the stop.

    Returns
    -------
    Limits

    Notes
    -----
    The two checks of a pair share the baseline's error: with m checks in it the variance of their mean is
    1 + 2 / m times that of the power itself, and the gain, a mean of g checks of a reference with k degrees
    of freedom, adds 2 n / (g k). While there are few checks the limits are therefore wider. Where the stop is
    much louder than it need be they lie halfway to it, in dB, and more is forgiven the room.
    """
    checks = np.array(TABLE, float)
    gain = np.minimum(checks, 2 * GAIN_MEMORY - 1)
    free = freedom / (1 + 2 / checks + 2 * freedom / (gain * reference_freedom))
    pair = np.array([pair_limit(float(each)) for each in free])
    pair = np.maximum(pair, min(np.sqrt(rise), rise * exceeded(1 - MISSED, freedom)))
    least = np.maximum([exceeded(LONE, float(each)) for each in free], np.sqrt(pair))
    reference = reference_freedom / (1 + 1 / gain)
    drowned = reference_rise * np.array([exceeded(DROWNED, float(each)) for each in reference])
    every = np.arange(COLOUR_MEMORY + 1)
    pair, least, drowned = (np.interp(every, checks, each) for each in (pair, least, drowned))
    return Limits(pair, least, drowned, reference_rise)


def pair_limit(freedom: float, chance: float = FALSE_STOPS / CHECKS) -> float:
    """What the mean of two running checks exceeds by so small a chance, either counting no more than its cap.

    Examples
    --------
    >>> round(pair_limit(200.0), 2)
    1.41
    """
    from scipy import optimize

    least = exceeded(LONE, freedom)

    def excess(limit: float) -> float:
        return float(np.log(pair_chance(limit, least, freedom) / chance))

    return float(optimize.brentq(excess, least * 1.0001, exceeded(chance, freedom), xtol=1e-6))


def pair_chance(limit: float, least: float, freedom: float, rise: float = 1.0) -> float:
    """Chance that two running checks make a stop, their powers `rise` times chi2(n) / n each.

    P = int_least^cap f(r) S(2 limit - r) dr + S(cap) S(least), f the density of a check's rise, S the chance
    that another exceeds it and cap = 2 limit - least.
    """
    from scipy import special

    cap, half = 2 * limit - least, freedom / 2

    def beyond(value: float | Array) -> Array:
        return np.asarray(special.gammaincc(half, half * value / rise))

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    first = least + (cap - least) * (nodes + 1) / 2
    scaled = half * first / rise
    density = np.exp(half * np.log(scaled) - scaled - special.gammaln(half)) / first
    return float(
        (cap - least) / 2 * weights @ (density * beyond(2 * limit - first)) + beyond(cap) * beyond(least)
    )


def exceeded(chance: float, freedom: float) -> float:
    """What chi2(n) / n exceeds by so much chance."""
    from scipy import special

    return float(special.gammainccinv(freedom / 2, chance)) * 2 / freedom
