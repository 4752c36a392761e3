"""What use does to a stage: heat and wear, acting on the friction coefficient, the preload and the travel.

The stage warms up by W with the time constant tau, W [1 - exp(-t / tau)], and friction, preload and travel
change by a share for each kelvin (Li et al. 2008, 2009: heat of the piezo and of the friction). Wear is
Archard's: the depth grows with preload times sliding distance, and a preload spring gives way by that depth,
so that dN / ds = -N / L and N = N0 exp(-s / L). Running in takes the friction coefficient from (1 + x) mu to
mu, likewise over a sliding distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, isfinite
from typing import NamedTuple

from stickslip_fit.errors import InputError


class DriftFactors(NamedTuple):
    """Of friction coefficient, preload, and travel for each volt."""

    friction: float
    preload: float
    gain: float


@dataclass(frozen=True)
class StageDrift:
    """Thermal and wear laws.

    Attributes
    ----------
    warm_up : float
        W, K.
    warm_up_time : float
        tau, s.
    friction_per_kelvin, preload_per_kelvin, gain_per_kelvin : float
        Relative change for each kelvin, 1/K.
    wear_length : float
        L, m: sliding distance over which the preload falls to 1/e; infinite without wear.
    run_in : float
        x: excess of the friction coefficient of new surfaces, a share.
    run_in_length : float
        Sliding distance over which it falls to 1/e, m.

    Raises
    ------
    InputError
        For a time or length that is not above 0, or a value that is not finite.
    """

    warm_up: float = 0.0
    warm_up_time: float = 600.0
    friction_per_kelvin: float = 0.0
    preload_per_kelvin: float = 0.0
    gain_per_kelvin: float = 0.0
    wear_length: float = inf
    run_in: float = 0.0
    run_in_length: float = 1.0

    def __post_init__(self) -> None:
        shares = (self.friction_per_kelvin, self.preload_per_kelvin, self.gain_per_kelvin)
        if not all(isfinite(value) for value in (self.warm_up, self.run_in, *shares)) or self.run_in <= -1:
            raise InputError("warm-up, run-in and changes for each kelvin must be finite, run-in above -1")
        if not (self.warm_up_time > 0 and self.wear_length > 0 and self.run_in_length > 0):
            raise InputError("warm-up time, wear length and run-in length must be above 0")

    def factors(self, time: float, distance: float) -> DriftFactors:
        """What friction coefficient, preload and travel are multiplied by after some use.

        Parameters
        ----------
        time : float
            Since the stage was cold, s.
        distance : float
            That slider and foot have slid on each other, m.

        Raises
        ------
        InputError
            If heat would leave no friction, preload or travel.

        Examples
        --------
        >>> float(round(StageDrift(wear_length=100.0).factors(0.0, 50.0).preload, 4))
        0.6065
        """
        heat = self.warm_up * (1 - exp(-time / self.warm_up_time))
        shares = (self.friction_per_kelvin, self.preload_per_kelvin, self.gain_per_kelvin)
        friction, preload, gain = (1 + share * heat for share in shares)
        if min(friction, preload, gain) <= 0:
            raise InputError(f"a warm-up by {heat:.3g} K leaves no friction, preload or travel")
        surface = 1 + self.run_in * exp(-distance / self.run_in_length)
        return DriftFactors(friction * surface, preload * exp(-distance / self.wear_length), gain)
