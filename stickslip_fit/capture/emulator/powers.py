"""The powers of checks without their sound: what thousands of traverses are simulated with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.spectra import freedom_of
from stickslip_fit.capture.tuning import Tuning, in_band, in_reference

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """The power of some bins, over that of the moving joint: `mean` times chi2(n) / n.

    Attributes
    ----------
    mean, freedom : float
        While moving, where `mean` is 1, or at the stop.
    """

    mean: float
    freedom: float

    def draw(self, number: int, rng: np.random.Generator) -> Array:
        """So many independent checks, shape (number,)."""
        return self.mean * rng.gamma(self.freedom / 2, 2 / self.freedom, number)


@dataclass(frozen=True)
class Powers:
    """What the ear makes of an emulated manipulator: the band and the reference, moving and at the stop."""

    band: Part
    reference: Part
    band_at_stop: Part
    reference_at_stop: Part


def powers_of(acoustics: Acoustics, tuning: Tuning) -> Powers:
    """How the powers of checks are distributed that `Tuning.powers` would find in the sound.

    Parameters
    ----------
    acoustics : Acoustics
    tuning : Tuning
        The choice of the band; how loud things are is taken from the acoustics.

    Returns
    -------
    Powers

    Notes
    -----
    A sum of powers of Gaussian noise with means m_k over bins is very nearly sum(m) chi2(n) / n, where
    n = 2 (sum m)^2 / sum(m^2) before the window takes its part. Bangs, speech and drift come on top.
    """
    bins = tuning.frequencies[1:]
    moving = acoustics.room_density(bins) + acoustics.click_density(bins)
    rise = 1 + acoustics.stop_density(bins) / moving
    band = in_band(bins, tuning.frequency, tuning.width)
    reference = in_reference(bins, tuning.rate, tuning.frequency, tuning.width)
    return Powers(
        *(_part(means, tuning.samples) for means in (np.ones(band.sum()), np.ones(reference.sum()))),
        *(_part(rise[part], tuning.samples) for part in (band, reference)),
    )


def _part(means: Array, samples: int) -> Part:
    even = means.sum() ** 2 / (len(means) * np.sum(means**2))
    return Part(float(means.mean()), float(even * freedom_of(len(means), samples)))
