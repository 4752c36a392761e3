"""Tuning of the end-stop detector: the frequency band, its powers, and the thresholds.

The band is the one in which the joint at its stop and the moving joint differ most relative to the
scatter. The thresholds of the sequential test follow from a rate of false stops per traverse; powers
are taken as chi2(df) / df. `record_joint` drives a joint to record the sound for `choose_tuning`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Summarized, Summary
from stickslip_fit._typing import Array
from stickslip_fit.capture.audio import bin_frequencies, find_fault, power_densities, power_df
from stickslip_fit.capture.protocols import AudioSource, Clock, Controller, Samples, Sound
from stickslip_fit.errors import InputError, InputIssue

CHECKS_PER_TRAVERSE = 2400  # 12,000 steps, 5 each
FALSE_STOPS_PER_TRAVERSE = 3e-4  # in such a traverse, on average
SINGLE_CHECK_ALPHA = 0.01  # false-alarm rate of each check of a pair, so that one bang makes no stop
MASKED_ALPHA = 2e-5  # chance that a check counts as masked by room noise
MISSED_ALPHA = 1e-5  # chance that a check at the stop stays below the highest admissible threshold
COLOUR_MEMORY = 60  # checks over which the ratio of the band to the reference is averaged
GAIN_MEMORY = 8  # checks over which the reference is averaged: few, to follow a drifting gain
NODES = 80  # of Gauss-Legendre quadrature
TABLE_CHECKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 40, COLOUR_MEMORY)  # checks in a baseline


@dataclass(frozen=True, eq=False)
class DetectionLimits:
    """Thresholds of the sequential test, by the number of checks in the baseline, 0 to 60.

    The rise of a check is the power in the tuned band over its baseline, about chi2(df) / df while the joint
    moves freely.

    Attributes
    ----------
    pair_threshold : array, shape (61,)
        Of the mean rise of two consecutive checks.
    min_rise : array, shape (61,)
        Of the rise of each of them.
    masked : array, shape (61,)
        Rise of the reference beyond which a check is masked by room noise.
    reference_rise : float
        Rise of the reference at the stop.
    """

    pair_threshold: Array
    min_rise: Array
    masked: Array
    reference_rise: float

    @property
    def max_rise(self) -> Array:
        """Cap on the rise of one check, so that a stop takes two, shape (61,)."""
        return 2 * self.pair_threshold - self.min_rise


def compute_limits(df: float, reference_df: float, rise: float, reference_rise: float) -> DetectionLimits:
    """Thresholds for given sounds.

    Parameters
    ----------
    df, reference_df : float
        Degrees of freedom of a check's power in the band and in the reference.
    rise, reference_rise : float
        Factors by which both are louder at the stop.

    Notes
    -----
    The two checks of a pair share the baseline's error: with m checks in it the variance of their mean is
    1 + 2 / m times that of the power itself, and the gain, a mean of g checks of a reference with k degrees
    of freedom, adds 2 n / (g k). The thresholds are therefore higher while there are few checks. Where the
    stop is much louder than necessary, they lie halfway to it, in dB, which tolerates more room noise.
    """
    checks = np.array(TABLE_CHECKS, float)
    gain = np.minimum(checks, 2 * GAIN_MEMORY - 1)
    free = df / (1 + 2 / checks + 2 * df / (gain * reference_df))
    pair = np.array([pair_limit(value) for value in free.tolist()])
    pair = np.maximum(pair, min(np.sqrt(rise), rise * power_quantile(1 - MISSED_ALPHA, df)))
    single = np.maximum([power_quantile(SINGLE_CHECK_ALPHA, value) for value in free.tolist()], np.sqrt(pair))
    reference = (reference_df / (1 + 1 / gain)).tolist()
    masked = reference_rise * np.array([power_quantile(MASKED_ALPHA, value) for value in reference])
    numbers = np.arange(COLOUR_MEMORY + 1)
    pair, single, masked = (np.interp(numbers, checks, table) for table in (pair, single, masked))
    return DetectionLimits(pair, single, masked, reference_rise)


def pair_limit(df: float) -> float:
    """Threshold of the mean of two consecutive checks, each capped, for the rate of false stops.

    Examples
    --------
    >>> round(pair_limit(200.0), 2)
    1.41
    """
    from scipy import optimize

    alpha, min_rise = FALSE_STOPS_PER_TRAVERSE / CHECKS_PER_TRAVERSE, power_quantile(SINGLE_CHECK_ALPHA, df)

    def excess(limit: float) -> float:
        return float(np.log(pair_chance(limit, min_rise, df) / alpha))

    return float(optimize.brentq(excess, min_rise * 1.0001, power_quantile(alpha, df), xtol=1e-6))


def pair_chance(limit: float, min_rise: float, df: float, rise: float = 1.0) -> float:
    """Probability that two consecutive checks make a stop, their powers `rise` times chi2(n) / n each.

    P = int_min_rise^cap f(r) S(2 limit - r) dr + S(cap) S(min_rise), f the density of a check's rise, S its
    survival function and cap = 2 limit - min_rise.
    """
    from scipy import special

    cap, half = 2 * limit - min_rise, df / 2

    def survival(value: float | Array) -> Array:
        return np.asarray(special.gammaincc(half, half * value / rise))

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    first = min_rise + (cap - min_rise) * (nodes + 1) / 2
    scaled = half * first / rise
    density = np.exp(half * np.log(scaled) - scaled - special.gammaln(half)) / first
    integral = (cap - min_rise) / 2 * weights @ (density * survival(2 * limit - first))
    return float(integral + survival(cap) * survival(min_rise))


def power_quantile(alpha: float, df: float) -> float:
    """Value that chi2(df) / df exceeds with probability `alpha`."""
    from scipy import special

    return float(special.gammainccinv(df / 2, alpha)) * 2 / df


MIN_FREQUENCY, MAX_RELATIVE_FREQUENCY = 500.0, 0.45  # Hz, share of the sample rate
REFERENCE_GAP, REFERENCE_WIDTH = 500.0, 2000.0  # Hz; between band and reference, and width on either side
SPECTRUM_FIELDS = ("moving", "at_stop")
ROUNDING = 1.0001  # of numbers in a file
MAX_RISE_RATIO = 3.0  # of the rises by the typical spectra and by the median of the checks
MAX_MISSED_WELL, MAX_MISSED = 1e-3, 5e-2  # share of stops missed at the second check


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Summarized):
    """Frequency band and spectra by which the end stop is detected.

    Attributes
    ----------
    rate : int
        Samples per second.
    seconds : float
        Of a check; longer sounds are cut into such.
    frequency, width : float
        The tuned band's middle and width, Hz.
    rise, reference_rise : float
        Factors by which the band and its neighbours, the reference, are louder at the stop.
    colour : float
        The band's power over the reference's while moving, both over `moving`: close to 1.
    df, stop_df, reference_df : float
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
    df: float
    stop_df: float
    reference_df: float
    moving: Array
    at_stop: Array

    @property
    def samples(self) -> int:
        """Of a check."""
        return round(self.seconds * self.rate)

    @cached_property
    def frequencies(self) -> Array:
        """Of the bins, Hz, shape (bins,)."""
        return bin_frequencies(self.samples, self.rate)

    @cached_property
    def limits(self) -> DetectionLimits:
        """Thresholds of the sequential test."""
        return compute_limits(self.df, self.reference_df, self.rise, self.reference_rise)

    @cached_property
    def _weights(self) -> Array:
        band = select_band(self.frequencies, self.frequency, self.width)
        reference = select_reference(self.frequencies, self.rate, self.frequency, self.width)
        chosen = np.stack([band / (self.colour * band.sum()), reference / reference.sum()])
        return chosen / np.maximum(self.moving, np.finfo(float).tiny)

    def powers(self, values: npt.NDArray[np.floating]) -> Array:
        """Power of each check in the band and in the reference, over those of the moving joint.

        Each frequency is weighted by the inverse of its power while moving, so that neither hum nor clicks of
        the steps dominate.

        Parameters
        ----------
        values : array, shape (checks, samples)

        Returns
        -------
        array, shape (2, checks)
        """
        return self._weights @ power_densities(values, self.rate).T

    @property
    def missed(self) -> float:
        """Expected share of stops that are missed at the second check.

        A check counts for its rise over that of its neighbours, where they rise: with a scatter s of theirs
        that takes the mean of max(1, 1 + s z), 1 + s / sqrt(2 pi), from it, and adds the variance,
        s^2 (1/2 - 1/(2 pi)).
        """
        neighbours = 2 / self.reference_df
        held_back = 1 + np.sqrt(neighbours / (2 * np.pi))
        scatter = 2 / self.stop_df + neighbours * (1 / 2 - 1 / (2 * np.pi))
        return 1 - pair_chance(*self._at_last, 2 / scatter, self.rise / held_back)

    @property
    def false_stops(self) -> float:
        """Expected number of false stops in a traverse of 2,400 checks: 12,000 steps, 5 each."""
        return CHECKS_PER_TRAVERSE * pair_chance(*self._at_last, self.df)

    @property
    def separates(self) -> bool:
        """Whether the stop can be distinguished from the moving joint."""
        return self.missed <= MAX_MISSED

    @property
    def _at_last(self) -> tuple[float, float]:
        return float(self.limits.pair_threshold[-1]), float(self.limits.min_rise[-1])

    def plot_spectrum(self) -> npt.NDArray[np.object_]:
        """Both spectra with the tuned band; see `plotting.strategies.plot_spectrum`."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.strategies import plot_spectrum

        return collect_axes(plot_spectrum(self))

    def summary(self) -> Summary:
        """The tuned band, and how reliably the stop is detected in it."""
        return Summary("Tuning of the end-stop detector", (self.conclusion,))

    @property
    def conclusion(self) -> str:
        """The tuned band, and how reliably the stop is detected in it, in two sentences."""
        rise, limit = (10 * np.log10(value) for value in (self.rise, self._at_last[0]))
        band = (
            f"Listen at {self.frequency:,.0f} Hz, {self.width:,.0f} Hz wide: at the stop it is {rise:.1f} dB "
            f"louder than moving; two consecutive checks that are {limit:.1f} dB louder make a stop."
        )
        if not self.separates:
            return (
                f"{band} The two cannot be distinguished: {100 * self.missed:.0f} % of the stops would be "
                "missed at the second check. Put the microphone nearer to the manipulator, or make the room "
                "quieter, and tune again with `capture tune`."
            )
        how = "well" if self.missed <= MAX_MISSED_WELL else "poorly"
        return (
            f"{band} They can be distinguished {how}: {_format_odds(self.missed)} stops is missed at the "
            f"second check, {_format_odds(self.false_stops)} traverses of 12,000 steps has a false stop."
        )


def check_tuning(tuning: Tuning, path: str | Path | None = None) -> None:
    """Raise InputError, which says how to tune anew, for a tuning under which stops would be missed."""
    if not tuning.separates:
        file = None if path is None else str(path)
        raise InputError(InputIssue(f"stops would not be detected. {tuning.conclusion}", file))


def select_band(frequencies: Array, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of a band."""
    return np.abs(frequencies - frequency) <= width / 2


def select_reference(frequencies: Array, rate: int, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of the band's neighbours, which show changes of the gain and room noise."""
    beside = np.abs(frequencies - frequency) - width / 2
    audible = (frequencies > MIN_FREQUENCY) & (frequencies < MAX_RELATIVE_FREQUENCY * rate)
    return audible & (beside > REFERENCE_GAP) & (beside <= REFERENCE_GAP + REFERENCE_WIDTH)


def save_tuning(tuning: Tuning, path: str | Path) -> None:
    """Write a tuning to a JSON file; raises InputError if it cannot be written."""
    content = {field.name: getattr(tuning, field.name) for field in fields(tuning)}
    content |= {name: [float(f"{value:.5g}") for value in content[name]] for name in SPECTRUM_FIELDS}
    write_atomically(path, json.dumps(content, allow_nan=False) + "\n")


def load_tuning(path: str | Path) -> Tuning:
    """Read a tuning that `save_tuning` wrote; raises InputError if there is none in the file."""
    try:
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(InputIssue("is no file; tune the detector first", str(path)))
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        content |= {name: np.array(content[name], float) for name in SPECTRUM_FIELDS}
        tuning = Tuning(**content)
        complete = _is_complete(tuning)
    except OSError as error:
        message = f"cannot be read ({error.strerror}); tune the detector first"
        raise InputError(InputIssue(message, str(path))) from None
    except (ValueError, TypeError, AttributeError, KeyError, ArithmeticError, RecursionError):
        raise InputError(InputIssue("is no tuning; tune the detector again", str(path))) from None
    if not complete:
        raise InputError(InputIssue("is damaged; tune the detector again", str(path)))
    return tuning


def _is_complete(tuning: Tuning) -> bool:
    numbers = [getattr(tuning, field.name) for field in fields(tuning) if field.name not in SPECTRUM_FIELDS]
    if not all(np.isfinite(number) and number > 0 for number in numbers):
        return False
    spectra, bins = (tuning.moving, tuning.at_stop), tuning.samples // 2 + 1
    if not isinstance(tuning.rate, int):
        return False
    if not all(
        spectrum.shape == (bins,) and np.all(np.isfinite(spectrum) & (spectrum > 0)) for spectrum in spectra
    ):
        return False
    return _agrees_with_spectra(tuning)


def _agrees_with_spectra(tuning: Tuning) -> bool:
    """Whether the numbers by which stops are detected can be those of the band in the spectra."""
    frequencies, samples = tuning.frequencies, tuning.samples
    band = select_band(frequencies, tuning.frequency, tuning.width)
    reference = select_reference(frequencies, tuning.rate, tuning.frequency, tuning.width)
    if not (band.any() and reference.any()):
        return False
    ratio = (tuning.at_stop[band] / tuning.moving[band]).mean() / tuning.rise
    most, reference_most = (ROUNDING * power_df(int(part.sum()), samples) for part in (band, reference))
    scatters = max(tuning.df, tuning.stop_df) <= most and tuning.reference_df <= reference_most
    with np.errstate(all="ignore"):
        rates = tuning.missed, tuning.false_stops
    return bool(1 / MAX_RISE_RATIO < ratio < MAX_RISE_RATIO) and scatters and bool(np.all(np.isfinite(rates)))


def _format_odds(share: float) -> str:
    if share < 1e-5:
        return "fewer than 1 of 100,000"
    number = 1 / share
    digits = 10 ** max(int(np.log10(number)) - 1, 0)
    return f"1 of {round(number / digits) * digits:,.0f}"


BAND_WIDTHS = (500.0, 1000.0, 2000.0)  # Hz
BAND_SPACING = 1 / 8  # of the width, between the middles of two candidate bands
MIN_CHECKS = 20  # checks
SCATTER_ALPHA = 0.01  # significance at which the observed scatter replaces the theoretical one


def choose_tuning(moving: Sound, at_stop: Sound, rate: int, seconds: float) -> Tuning:
    """Choose the band in which the stop differs most from the moving joint, relative to the scatter.

    Parameters
    ----------
    moving, at_stop : array of float32, shape (n,)
        The joint stepping freely, and stepping against its stop; a few seconds each.
    rate : int
        Samples per second.
    seconds : float
        Of a check: 5 steps of 10 ms make 0.05 s.

    Returns
    -------
    Tuning
        Also where the two cannot be distinguished: see `Tuning.separates`.

    Raises
    ------
    InputError
        If a recording is too short, clipped or dead.

    Notes
    -----
    The band has the largest log(rise) sqrt(n / 2): the rise of its power in units of the
    scatter, n being its degrees of freedom.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> quiet, loud = rng.normal(0, 0.01, (2, 48000)).astype("float32")
    >>> at = np.arange(48000) / 48000
    >>> loud = loud + (0.01 * np.sin(2 * np.pi * 5000 * at)).astype("float32")
    >>> choose_tuning(quiet, loud, 48000, 0.05).separates
    True
    """
    number = round(seconds * rate)
    freely = power_densities(_split_checks(moving, number, "moving"), rate)
    pushing = power_densities(_split_checks(at_stop, number, "at the stop"), rate)
    typical, stop = _median_spectrum(freely), _median_spectrum(pushing)
    frequency, width = _choose_band(stop / typical, number, rate)
    bins = bin_frequencies(number, rate)
    band, reference = select_band(bins, frequency, width), select_reference(bins, rate, frequency, width)
    inside, outside = ((freely / typical)[:, part].mean(axis=1) for part in (band, reference))
    inside_stop, outside_stop = ((pushing / typical)[:, part].mean(axis=1) for part in (band, reference))
    theory, reference_theory = (power_df(int(part.sum()), number) for part in (band, reference))
    return Tuning(
        rate=rate,
        seconds=seconds,
        frequency=frequency,
        width=width,
        rise=float(np.median(inside_stop) / np.median(inside)),
        reference_rise=max(1.0, float(np.median(outside_stop) / np.median(outside))),
        colour=float(np.median(inside / outside)),
        df=_estimate_df(inside / outside, theory, 2 / reference_theory),
        stop_df=_estimate_df(inside_stop, theory),
        reference_df=_estimate_df(outside, reference_theory),
        moving=typical,
        at_stop=stop,
    )


def _split_checks(sound: Sound, number: int, state: str) -> npt.NDArray[np.float32]:
    checks = len(sound) // number
    fault = find_fault(Samples(sound), len(sound))
    if not fault and checks < MIN_CHECKS:
        fault = f"only {checks} checks, and at least {MIN_CHECKS} are needed; listen for a few seconds"
    if fault:
        raise InputError(f"listening to the joint {state}: {fault}")
    return sound[: checks * number].reshape(checks, number)


def _median_spectrum(densities: Array) -> Array:
    """The median over checks, robust against bangs, scaled to be the mean for noise."""
    return np.maximum(np.median(densities, axis=0) / np.log(2), np.finfo(float).tiny)


def _choose_band(ratio: Array, number: int, rate: int) -> tuple[float, float]:
    bins = bin_frequencies(number, rate)
    best, chosen = -np.inf, (0.0, 0.0)
    for width in BAND_WIDTHS:
        lowest, highest = MIN_FREQUENCY + width / 2, MAX_RELATIVE_FREQUENCY * rate - width / 2
        for frequency in np.arange(lowest, highest, BAND_SPACING * width):
            band = select_band(bins, frequency, width)
            contrast = np.log(ratio[band].mean()) * np.sqrt(power_df(int(band.sum()), number) / 2)
            if contrast > best:
                best, chosen = contrast, (float(frequency), width)
    return chosen


def _estimate_df(powers: Array, theory: float, added: float = 0.0) -> float:
    """Degrees of freedom: the theoretical ones, unless the powers scatter significantly more.

    `added` is the part of the variance of log(powers) that stems from what they are divided by.
    """
    variance, df = float(np.var(np.log(powers), ddof=1)), len(powers) - 1
    critical = (2 / theory + added) * power_quantile(SCATTER_ALPHA, df)
    return 2 / (variance - added) if variance > critical else theory


def record_joint(
    controller: Controller, source: AudioSource, clock: Clock, joint: int, checks: int, check_every: int
) -> Sound:
    """Record a joint over so many checks of `check_every` steps, negative in direction ``-``; shape (n,)."""
    sounds = []
    for _ in range(checks):
        began = clock.now()
        controller.step(joint, check_every)
        sounds.append(source.read(clock.now() - began).values)
    return np.concatenate(sounds)
