"""Whether a sampled signal has a strict period, which noise that swings does not keep.

An autoregression follows any swing, and would take a season or the mains for noise. A wave of fixed phase
explains a strict period with a few numbers, and leaves innovations that are smaller. The two are compared by
the Bayesian information criterion: noise alone, and a wave with as many harmonics as it asks for in
noise that is estimated beside it. Where the phase drifts, as that of sunspots does, the noise wins.
"""

from __future__ import annotations

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.smooth import N_HARMONICS, harmonics
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.mean_structure import Mean

OVERSAMPLING, N_FINER = 4, 21  # frequencies for each of the signal's own; about the best of them
MIN_ADVANTAGE = 6.0  # nats beyond what the criterion asks for
MAX_WITHOUT_GAIN = 2  # harmonics in a row that do not raise the criterion, after which none is tried
FASTEST = 2.5  # samples for each period of a wave that is looked for


def count_harmonics(period: float, interval: float, most: int) -> int:
    """How many harmonics samples at an interval show, the first of which is the wave itself.

    Examples
    --------
    >>> count_harmonics(12.0, 1.0, 6), count_harmonics(3.0, 1.0, 6)
    (4, 1)
    """
    return int(np.clip(period / (FASTEST * interval), 1, most))


def find_period(linearized: LinearizedFit, mean: Mean, seconds: Array, longest: float) -> tuple[float, int]:
    """The strict period of a signal, and how many harmonics its wave has, the first being the wave itself.

    Parameters
    ----------
    linearized : LinearizedFit
        Of n rows of one session, whose noise counts as independent.
    mean : Mean
        Beside which the wave stands.
    seconds : array, shape (n,)
    longest : float
        Period, in the unit of `seconds`.

    Returns
    -------
    period : float
        NaN where noise that swings describes the signal as well.
    harmonics : int
        0 there.
    """
    interval, sample = float(np.median(np.diff(seconds))), mean.noise.sample
    length = OVERSAMPLING * (int(np.ptp(sample)) + 1)
    rates = np.fft.rfftfreq(length, interval)
    allowed = np.flatnonzero((rates > 1.0 / longest) & (rates < 1.0 / (FASTEST * interval)))
    if not len(allowed):
        return float("nan"), 0
    independent = Autocorrelation(sample, None)

    def wave(period: float, number: int) -> Array:
        return linearized.project(linearized.whiten(harmonics(seconds, period, number)))

    def strongest_rate(noise: Autocorrelation) -> float:
        """Of the periodogram under some noise: a wave is filtered as what it explains is."""
        series = np.zeros(length)
        series[sample - sample.min()] = noise.whiten(linearized.residual)
        return float(rates[allowed[np.argmax(np.abs(np.fft.rfft(series)[allowed]))]])

    def search(around: Array, noise: Autocorrelation, most: int) -> float:
        """The period whose wave explains most of what the law leaves, under some noise."""
        target, explained = noise.whiten(linearized.residual), []
        for period in around:
            columns = noise.whiten(wave(period, count_harmonics(period, interval, most)))
            size = np.linalg.lstsq(columns, target, rcond=None)[0]
            explained.append(float(np.sum((columns @ size) ** 2)))
        return float(around[int(np.argmax(explained))])

    def finer(period: float) -> Array:
        around = 1.0 / period + rates[1] * np.linspace(-1.0, 1.0, N_FINER)
        return 1.0 / around[around > 0]

    def judge(period: float, number: int) -> tuple[float, Autocorrelation]:
        """What the criterion says of a wave, and the noise beside it."""
        beside = mean.extend(linearized, wave(period, number))
        return beside.value - number * float(np.log(len(sample))), beside.noise

    least = mean.value + np.log(len(allowed)) + MIN_ADVANTAGE
    best, found = float(least), None
    # Slow noise hides a wave among independent values, and noise that swings takes it into itself. Of a wave
    # with harmonics, one of them may be the strongest.
    for under in (independent, mean.noise):
        strongest = search(finer(1.0 / strongest_rate(under)), under, 1)
        for period in (strongest, 2.0 * strongest):
            highest = count_harmonics(period, interval, N_HARMONICS) if period < longest else 0
            without_gain = 0
            for number in range(1, highest + 1):
                value, noise = judge(period, number)
                without_gain = 0 if value > best else without_gain + 1
                if value > best:
                    best, found = value, (period, number, noise)
                if without_gain == MAX_WITHOUT_GAIN:
                    break
    if found is None:
        return float("nan"), 0
    period, number, noise = found
    return search(finer(period), noise, number), number  # the harmonics tell the period best
