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

CHECKS_PER_TRAVERSE = 2400  # of a traverse of 12,000 steps
FALSE_STOPS_PER_TRAVERSE = 3e-4  # in such a traverse, on average
SINGLE_CHECK_ALPHA = 0.01  # chance of a check that would make a stop of a bang beside it
MASKED_ALPHA = 2e-5  # chance of a check that is thought to be drowned by the room
MISSED_ALPHA = 1e-5  # a check at the stop that stays below the limit, where the limit may be chosen
COLOUR_MEMORY = 60  # checks over which the tuned band's share of the sound is averaged
GAIN_MEMORY = 8  # checks over which the reference is: short, to follow a gain that drifts
NODES = 80  # of Gauss and Legendre
TABLE_CHECKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 40, COLOUR_MEMORY)  # checks in a baseline


@dataclass(frozen=True, eq=False)
class DetectionLimits:
    """What the rises of two running checks must reach to be a stop.

    A rise is the power in the tuned band over its baseline, about chi2(n) / n while the joint moves freely.

    Attributes
    ----------
    pair_threshold : array, shape (61,)
        The mean of the two must reach it; by the number of checks in the baseline, 0 to 60.
    least : array, shape (61,)
        Either must reach it.
    drowned : array, shape (61,)
        The rise of the reference beyond which a check says nothing.
    reference_rise : float
        What the stop itself adds to the reference.
    """

    pair_threshold: Array
    least: Array
    masked: Array
    reference_rise: float

    @property
    def max_rise(self) -> Array:
        """The most that one check can count, so that it needs another beside it, shape (61,)."""
        return 2 * self.pair_threshold - self.least


def compute_limits(df: float, reference_df: float, rise: float, reference_rise: float) -> DetectionLimits:
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
    checks = np.array(TABLE_CHECKS, float)
    gain = np.minimum(checks, 2 * GAIN_MEMORY - 1)
    free = df / (1 + 2 / checks + 2 * df / (gain * reference_df))
    pair = np.array([pair_limit(float(each)) for each in free])
    pair = np.maximum(pair, min(np.sqrt(rise), rise * power_quantile(1 - MISSED_ALPHA, df)))
    least = np.maximum([power_quantile(SINGLE_CHECK_ALPHA, float(each)) for each in free], np.sqrt(pair))
    reference = reference_df / (1 + 1 / gain)
    masked = reference_rise * np.array([power_quantile(MASKED_ALPHA, float(each)) for each in reference])
    every = np.arange(COLOUR_MEMORY + 1)
    pair, least, masked = (np.interp(every, checks, each) for each in (pair, least, masked))
    return DetectionLimits(pair, least, masked, reference_rise)


def pair_limit(df: float, chance: float = FALSE_STOPS_PER_TRAVERSE / CHECKS_PER_TRAVERSE) -> float:
    """What the mean of two running checks exceeds by so small a chance, either counting no more than its cap.

    Examples
    --------
    >>> round(pair_limit(200.0), 2)
    1.41
    """
    from scipy import optimize

    least = power_quantile(SINGLE_CHECK_ALPHA, df)

    def excess(limit: float) -> float:
        return float(np.log(pair_chance(limit, least, df) / chance))

    return float(optimize.brentq(excess, least * 1.0001, power_quantile(chance, df), xtol=1e-6))


def pair_chance(limit: float, least: float, df: float, rise: float = 1.0) -> float:
    """Chance that two running checks make a stop, their powers `rise` times chi2(n) / n each.

    P = int_least^cap f(r) S(2 limit - r) dr + S(cap) S(least), f the density of a check's rise, S the chance
    that another exceeds it and cap = 2 limit - least.
    """
    from scipy import special

    cap, half = 2 * limit - least, df / 2

    def beyond(value: float | Array) -> Array:
        return np.asarray(special.gammaincc(half, half * value / rise))

    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    first = least + (cap - least) * (nodes + 1) / 2
    scaled = half * first / rise
    density = np.exp(half * np.log(scaled) - scaled - special.gammaln(half)) / first
    return float(
        (cap - least) / 2 * weights @ (density * beyond(2 * limit - first)) + beyond(cap) * beyond(least)
    )


def power_quantile(chance: float, df: float) -> float:
    """What chi2(n) / n exceeds by so much chance."""
    from scipy import special

    return float(special.gammainccinv(df / 2, chance)) * 2 / df


MIN_FREQUENCY, MAX_RELATIVE_FREQUENCY = 500.0, 0.45  # Hz, share of the rate: what is listened to
REFERENCE_GAP, REFERENCE_WIDTH = (
    500.0,
    2000.0,
)  # Hz; from the band's edges to the reference, and its width either side
SPECTRUM_FIELDS = ("moving", "at_stop")
MAX_MISSED_WELL, MAX_MISSED = 1e-3, 5e-2  # share of stops not found at the second check


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
        """What two running checks must reach."""
        return compute_limits(self.df, self.reference_df, self.rise, self.reference_rise)

    @cached_property
    def _weights(self) -> Array:
        band = select_band(self.frequencies, self.frequency, self.width)
        reference = select_reference(self.frequencies, self.rate, self.frequency, self.width)
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
        return self._weights @ power_densities(values, self.rate).T

    @property
    def missed(self) -> float:
        """Expected share of stops that are not found at the second check.

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
        """Expected number of stops imagined in a traverse of 2,400 checks: 12,000 steps, 5 each."""
        return CHECKS_PER_TRAVERSE * pair_chance(*self._at_last, self.df)

    @property
    def separates(self) -> bool:
        """Whether the stop can be told from the moving joint."""
        return self.missed <= MAX_MISSED

    @property
    def _at_last(self) -> tuple[float, float]:
        return float(self.limits.pair_threshold[-1]), float(self.limits.least[-1])

    def plot_spectrum(self) -> npt.NDArray[np.object_]:
        """Both spectra with the tuned band; see `report.figures.spectrum`."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.strategies import plot_spectrum

        return collect_axes(plot_spectrum(self))

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
        how = "well" if self.missed <= MAX_MISSED_WELL else "poorly"
        return (
            f"{found} They can be told apart {how}: not found at the second check {_format_odds(self.missed)} "
            f"stops, imagined {_format_odds(self.false_stops)} traverses of 12,000 steps."
        )


def select_band(frequencies: Array, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of a band."""
    return np.abs(frequencies - frequency) <= width / 2


def select_reference(frequencies: Array, rate: int, frequency: float, width: float) -> npt.NDArray[np.bool_]:
    """Bins of the band's neighbours, by which a change of the gain and a noise of the room are known."""
    beside = np.abs(frequencies - frequency) - width / 2
    audible = (frequencies > MIN_FREQUENCY) & (frequencies < MAX_RELATIVE_FREQUENCY * rate)
    return audible & (beside > REFERENCE_GAP) & (beside <= REFERENCE_GAP + REFERENCE_WIDTH)


def save_tuning(tuning: Tuning, path: str | Path) -> None:
    """Write a tuning to a JSON file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    content = {field.name: getattr(tuning, field.name) for field in fields(tuning)}
    content |= {name: [float(f"{value:.5g}") for value in content[name]] for name in SPECTRUM_FIELDS}
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
        content |= {name: np.array(content[name], float) for name in SPECTRUM_FIELDS}
        tuning = Tuning(**content)
        whole = _is_complete(tuning)
    except OSError as error:
        raise InputError(
            InputIssue(f"cannot be read ({error.strerror}); tune the ear first", str(path))
        ) from None
    except (ValueError, TypeError, AttributeError, KeyError):
        raise InputError(InputIssue("is no tuning; tune the ear again to write one", str(path))) from None
    if not whole:
        raise InputError(InputIssue("is damaged; tune the ear again to write it anew", str(path)))
    return tuning


def _is_complete(tuning: Tuning) -> bool:
    numbers = [getattr(tuning, field.name) for field in fields(tuning) if field.name not in SPECTRUM_FIELDS]
    return all(np.isfinite(number) and number > 0 for number in numbers) and all(
        spectrum.shape == tuning.frequencies.shape and np.all(np.isfinite(spectrum))
        for spectrum in (tuning.moving, tuning.at_stop)
    )


def _format_odds(share: float) -> str:
    if share < 1e-5:
        return "in fewer than 1 of 100,000"
    number = 1 / share
    digits = 10 ** max(int(np.log10(number)) - 1, 0)
    return f"in 1 of {round(number / digits) * digits:,.0f}"


BAND_WIDTHS = (500.0, 1000.0, 2000.0)  # Hz
BAND_SPACING = 1 / 8  # of the width, from the middle of one band that is tried to that of the next
MIN_CHECKS = 20  # checks
SCATTER_ALPHA = 0.01  # chance at which the scatter that was heard is believed rather than the theory


def choose_tuning(moving: Sound, at_stop: Sound, rate: int, seconds: float) -> Tuning:
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
    in_theory = power_df(int(band.sum()), number)
    outside_in_theory = power_df(int(reference.sum()), number)
    return Tuning(
        rate=rate,
        seconds=seconds,
        frequency=frequency,
        width=width,
        rise=float(np.median(inside_stop) / np.median(inside)),
        reference_rise=max(1.0, float(np.median(outside_stop) / np.median(outside))),
        colour=float(np.median(inside / outside)),
        df=_estimate_df(inside / outside, in_theory, 2 / outside_in_theory),
        stop_df=_estimate_df(inside_stop, in_theory),
        reference_df=_estimate_df(outside, outside_in_theory),
        moving=typical,
        at_stop=stop,
    )


def _split_checks(sound: Sound, number: int, which: str) -> npt.NDArray[np.float32]:
    fault = find_fault(Samples(sound), len(sound))
    if fault:
        raise InputError(f"listening to the joint {which}: {fault}")
    whole = len(sound) // number
    if whole < MIN_CHECKS:
        raise InputError(
            f"listening to the joint {which}: {whole} checks were heard and at least {MIN_CHECKS} are needed; "
            "listen for a few seconds"
        )
    return sound[: whole * number].reshape(whole, number)


def _median_spectrum(densities: Array) -> Array:
    """The median over checks, which a bang does not change, scaled to be the mean for noise."""
    return np.maximum(np.median(densities, axis=0) / np.log(2), np.finfo(float).tiny)


def _choose_band(ratio: Array, number: int, rate: int) -> tuple[float, float]:
    bins = bin_frequencies(number, rate)
    best, chosen = -np.inf, (0.0, 0.0)
    for width in BAND_WIDTHS:
        for frequency in np.arange(
            MIN_FREQUENCY + width / 2, MAX_RELATIVE_FREQUENCY * rate - width / 2, BAND_SPACING * width
        ):
            band = select_band(bins, frequency, width)
            contrast = np.log(ratio[band].mean()) * np.sqrt(power_df(int(band.sum()), number) / 2)
            if contrast > best:
                best, chosen = contrast, (float(frequency), width)
    return chosen


def _estimate_df(powers: Array, in_theory: float, added: float = 0.0) -> float:
    """Degrees of freedom; the theory's, unless the powers scatter more than chance would let them.

    `added` is what else the variance of the logarithms of `powers` holds: that of what they are divided by.
    """
    scatter, times = float(np.var(np.log(powers), ddof=1)), len(powers) - 1
    surprising = (2 / in_theory + added) * power_quantile(SCATTER_ALPHA, times)
    return 2 / (scatter - added) if scatter > surprising else in_theory


def record_joint(
    controller: Controller, source: AudioSource, clock: Clock, joint: int, checks: int, check_every: int
) -> Sound:
    """What a joint sounds like over so many checks.

    Parameters
    ----------
    controller : Controller
    source : Source
    clock : Clock
    joint : int
    checks : int
    check_every : int
        Steps between two checks: more than 0 in direction ``+``, less in ``-``.

    Returns
    -------
    array of float32, shape (n,)
    """
    heard = []
    for _ in range(checks):
        began = clock.now()
        controller.step(joint, check_every)
        heard.append(source.read(clock.now() - began).values)
    return np.concatenate(heard)
