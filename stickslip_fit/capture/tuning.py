"""What to listen for on a day: the band in which the stop is loudest, and what moving and stop sound like."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stickslip_fit._summary import Summarized, Summary
from stickslip_fit.capture import spectra
from stickslip_fit.capture.limits import CHECKS, Limits, limits_for, pair_chance
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically

Array = npt.NDArray[np.float64]

LOWEST, HIGHEST = 500.0, 0.45  # Hz, share of the rate: what is listened to
GAP, REACH = 500.0, 2000.0  # Hz; from the band's edges to the reference, and its width either side
SPECTRA = ("moving", "at_stop")
WELL, POORLY = 1e-3, 5e-2  # share of stops not found at the second check


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Summarized):
    """How to hear the stop.

    Attributes
    ----------
    rate : int
        Samples per second.
    seconds : float
        Of a check; longer sounds are cut into such.
    frequency, width : float
        The tuned band's middle and width, Hz.
    rise, reference_rise : float
        By what factor the power in the band, and in its neighbours, is greater at the stop.
    colour : float
        The band's power over the reference's while moving, both over `moving`: close to 1.
    freedom, stop_freedom, reference_freedom : float
        The power in the band scatters from check to check as chi2(n) / n: n while moving and at the stop,
        and n of the reference.
    moving, at_stop : array, shape (bins,)
        Typical power per Hz of a check, full scale being 1.
    """

    rate: int
    seconds: float
    frequency: float
    width: float
    rise: float
    reference_rise: float
    colour: float
    freedom: float
    stop_freedom: float
    reference_freedom: float
    moving: Array
    at_stop: Array

    @property
    def samples(self) -> int:
        """Of a check."""
        return round(self.seconds * self.rate)

    @cached_property
    def frequencies(self) -> Array:
        """Of the bins, Hz, shape (bins,)."""
        return spectra.frequencies(self.samples, self.rate)

    @cached_property
    def limits(self) -> Limits:
        """What two running checks must reach."""
        return limits_for(self.freedom, self.reference_freedom, self.rise, self.reference_rise)

    @cached_property
    def _weights(self) -> Array:
        band = in_band(self.frequencies, self.frequency, self.width)
        reference = in_reference(self.frequencies, self.rate, self.frequency, self.width)
        chosen = np.stack([band / (self.colour * band.sum()), reference / reference.sum()])
        return chosen / np.maximum(self.moving, np.finfo(float).tiny)

    def powers(self, values: npt.NDArray[np.floating]) -> Array:
        """Power of each check in the band and in the reference, over those of the moving joint.

        Every frequency counts for how much louder it is than while moving, so that neither a hum nor the
        clicks of the steps drown the others.

        Parameters
        ----------
        values : array, shape (checks, samples)

        Returns
        -------
        array, shape (2, checks)
        """
        return self._weights @ spectra.densities(values, self.rate).T

    @property
    def missed(self) -> float:
        """Expected share of stops that are not found at the second check.

        A check counts for its rise over that of its neighbours, where they rise: with a scatter s of theirs
        that takes the mean of max(1, 1 + s z), 1 + s / sqrt(2 pi), from it, and adds the variance,
        s^2 (1/2 - 1/(2 pi)).
        """
        neighbours = 2 / self.reference_freedom
        held_back = 1 + np.sqrt(neighbours / (2 * np.pi))
        scatter = 2 / self.stop_freedom + neighbours * (1 / 2 - 1 / (2 * np.pi))
        return 1 - pair_chance(*self._at_last, 2 / scatter, self.rise / held_back)

    @property
    def false_stops(self) -> float:
        """Expected number of stops imagined in a traverse of 2,400 checks: 12,000 steps, 5 each."""
        return CHECKS * pair_chance(*self._at_last, self.freedom)

    @property
    def separates(self) -> bool:
        """Whether the stop can be told from the moving joint."""
        return self.missed <= POORLY

    @property
    def _at_last(self) -> tuple[float, float]:
        return float(self.limits.pair[-1]), float(self.limits.least[-1])

    def plot_spectrum(self) -> npt.NDArray[np.object_]:
        """Both spectra with the tuned band; see `report.figures.spectrum`."""
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.spectrum import plot_spectrum

        return panels(plot_spectrum(self))

    def summary(self) -> Summary:
        """What to listen for, and how well it is told from other noise."""
        return Summary("Tuning of the ear", (self.conclusion,))

    @property
    def conclusion(self) -> str:
        """What was found, in two sentences."""
        rise, limit = (10 * np.log10(value) for value in (self.rise, self._at_last[0]))
        found = (
            f"Listen at {self.frequency:,.0f} Hz, {self.width:,.0f} Hz wide: at the stop it is {rise:.1f} dB "
            f"louder than moving; two checks running that are {limit:.1f} dB louder make a stop."
        )
        if not self.separates:
            return (
                f"{found} The two cannot be told apart: {100 * self.missed:.0f} % of the stops would not be "
                "found at the second check. Put the microphone nearer to the manipulator, or make the room "
                "quieter, and listen again."
            )
        how = "well" if self.missed <= WELL else "poorly"
        return (
            f"{found} They can be told apart {how}: not found at the second check {_one_in(self.missed)} "
            f"stops, imagined {_one_in(self.false_stops)} traverses of 12,000 steps."
        )


def in_band(frequencies: Array, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of a band."""
    return np.abs(frequencies - frequency) <= width / 2


def in_reference(frequencies: Array, rate: int, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of the band's neighbours, by which a change of the gain and a noise of the room are known."""
    beside = np.abs(frequencies - frequency) - width / 2
    audible = (frequencies > LOWEST) & (frequencies < HIGHEST * rate)
    return audible & (beside > GAP) & (beside <= GAP + REACH)


def save_tuning(tuning: Tuning, path: str | Path) -> None:
    """Write a tuning to a JSON file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    content = {field.name: getattr(tuning, field.name) for field in fields(tuning)}
    content |= {name: [float(f"{value:.5g}") for value in content[name]] for name in SPECTRA}
    write_atomically(path, json.dumps(content, allow_nan=False) + "\n")


def load_tuning(path: str | Path) -> Tuning:
    """Read a tuning that `save_tuning` wrote.

    Raises
    ------
    InputError
        If there is no such file, or it holds something else.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        content |= {name: np.array(content[name], float) for name in SPECTRA}
        tuning = Tuning(**content)
        whole = _is_whole(tuning)
    except OSError as error:
        raise InputError(
            Problem(f"cannot be read ({error.strerror}); tune the ear first", str(path))
        ) from None
    except (ValueError, TypeError, AttributeError, KeyError):
        raise InputError(Problem("is no tuning; tune the ear again to write one", str(path))) from None
    if not whole:
        raise InputError(Problem("is damaged; tune the ear again to write it anew", str(path)))
    return tuning


def _is_whole(tuning: Tuning) -> bool:
    numbers = [getattr(tuning, field.name) for field in fields(tuning) if field.name not in SPECTRA]
    return all(np.isfinite(number) and number > 0 for number in numbers) and all(
        spectrum.shape == tuning.frequencies.shape and np.all(np.isfinite(spectrum))
        for spectrum in (tuning.moving, tuning.at_stop)
    )


def _one_in(share: float) -> str:
    if share < 1e-5:
        return "in fewer than 1 of 100,000"
    number = 1 / share
    digits = 10 ** max(int(np.log10(number)) - 1, 0)
    return f"in 1 of {round(number / digits) * digits:,.0f}"
