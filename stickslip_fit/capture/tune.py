"""Choose what to listen for, from a short listen to the moving joint and one to the joint at its stop."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.capture import spectra
from stickslip_fit.capture.faults import fault_of
from stickslip_fit.capture.limits import exceeded
from stickslip_fit.capture.source import Samples, Sound
from stickslip_fit.capture.tuning import HIGHEST, LOWEST, Tuning, in_band, in_reference
from stickslip_fit.errors import InputError

Array = npt.NDArray[np.float64]

WIDTHS = (500.0, 1000.0, 2000.0)  # Hz
APART = 1 / 8  # of the width, from the middle of one band that is tried to that of the next
FEWEST = 20  # checks
SURPRISING = 0.01  # chance at which the scatter that was heard is believed rather than the theory


def tune(moving: Sound, at_stop: Sound, rate: int, seconds: float) -> Tuning:
    """Find the band in which the stop differs most from the moving joint, as seen against the scatter.

    Parameters
    ----------
    moving, at_stop : array of float32, shape (n,)
        The joint stepping freely, and stepping against its stop; a few seconds each.
    rate : int
        Samples per second.
    seconds : float
        Of a check, the steps between two looks for the stop: 5 steps of 10 ms make 0.05 s.

    Returns
    -------
    Tuning
        Also where the two cannot be told apart: see `Tuning.separates`.

    Raises
    ------
    InputError
        If a listen is too short, clipped or dead.

    Notes
    -----
    The band that is chosen has the largest log(rise) sqrt(n / 2): the rise of its power in units of the
    scatter, n being its degrees of freedom.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> quiet, loud = rng.normal(0, 0.01, (2, 48000)).astype("float32")
    >>> at = np.arange(48000) / 48000
    >>> loud = loud + (0.01 * np.sin(2 * np.pi * 5000 * at)).astype("float32")
    >>> tune(quiet, loud, 48000, 0.05).separates
    True
    """
    number = round(seconds * rate)
    freely = spectra.densities(_checks(moving, number, "moving"), rate)
    pushing = spectra.densities(_checks(at_stop, number, "at the stop"), rate)
    typical, stop = _typical(freely), _typical(pushing)
    frequency, width = _best_band(stop / typical, number, rate)
    bins = spectra.frequencies(number, rate)
    band, reference = in_band(bins, frequency, width), in_reference(bins, rate, frequency, width)
    inside, outside = ((freely / typical)[:, part].mean(axis=1) for part in (band, reference))
    inside_stop, outside_stop = ((pushing / typical)[:, part].mean(axis=1) for part in (band, reference))
    in_theory = spectra.freedom_of(int(band.sum()), number)
    outside_in_theory = spectra.freedom_of(int(reference.sum()), number)
    return Tuning(
        rate=rate,
        seconds=seconds,
        frequency=frequency,
        width=width,
        rise=float(np.median(inside_stop) / np.median(inside)),
        reference_rise=max(1.0, float(np.median(outside_stop) / np.median(outside))),
        colour=float(np.median(inside / outside)),
        freedom=_freedom(inside / outside, in_theory, 2 / outside_in_theory),
        stop_freedom=_freedom(inside_stop, in_theory),
        reference_freedom=_freedom(outside, outside_in_theory),
        moving=typical,
        at_stop=stop,
    )


def _checks(sound: Sound, number: int, which: str) -> npt.NDArray[np.float32]:
    fault = fault_of(Samples(sound), len(sound))
    if fault:
        raise InputError(f"listening to the joint {which}: {fault}")
    whole = len(sound) // number
    if whole < FEWEST:
        raise InputError(
            f"listening to the joint {which}: {whole} checks were heard and at least {FEWEST} are needed; "
            "listen for a few seconds"
        )
    return sound[: whole * number].reshape(whole, number)


def _typical(densities: Array) -> Array:
    """The median over checks, which a bang does not change, scaled to be the mean for noise."""
    return np.maximum(np.median(densities, axis=0) / np.log(2), np.finfo(float).tiny)


def _best_band(ratio: Array, number: int, rate: int) -> tuple[float, float]:
    bins = spectra.frequencies(number, rate)
    best, chosen = -np.inf, (0.0, 0.0)
    for width in WIDTHS:
        for frequency in np.arange(LOWEST + width / 2, HIGHEST * rate - width / 2, APART * width):
            band = in_band(bins, frequency, width)
            contrast = np.log(ratio[band].mean()) * np.sqrt(spectra.freedom_of(int(band.sum()), number) / 2)
            if contrast > best:
                best, chosen = contrast, (float(frequency), width)
    return chosen


def _freedom(powers: Array, in_theory: float, added: float = 0.0) -> float:
    """Degrees of freedom; the theory's, unless the powers scatter more than chance would let them.

    `added` is what else the variance of the logarithms of `powers` holds: that of what they are divided by.
    """
    scatter, times = float(np.var(np.log(powers), ddof=1)), len(powers) - 1
    surprising = (2 / in_theory + added) * exceeded(SURPRISING, times)
    return 2 / (scatter - added) if scatter > surprising else in_theory
