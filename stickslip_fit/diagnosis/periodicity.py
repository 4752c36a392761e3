"""Whether a sampled signal has a strict period, which noise that swings does not keep.

An autoregression follows any swing, and would take a season or the mains for noise. A wave of fixed phase
explains a strict period with four numbers, and leaves innovations that are smaller. The two are compared by
the Bayesian information criterion: noise alone, and a wave with one harmonic in noise that is estimated
beside it. Where the phase drifts, as that of sunspots does, the noise wins.
"""

from __future__ import annotations

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import N_HARMONICS
from stickslip_fit.causes.smooth import harmonics
from stickslip_fit.diagnosis.autocorrelation import Autocorrelation, estimate_autoregression
from stickslip_fit.diagnosis.linearized import LinearizedFit

N_FINER = 41  # periods between the two neighbours of the best of a grid
MIN_ADVANTAGE = 3.0  # nats beyond what the criterion asks for
FASTEST = 2.5  # samples for each period of a wave that is looked for


def count_harmonics(period: float, interval: float, most: int) -> int:
    """How many harmonics samples at an interval show, the first of which is the wave itself.

    Examples
    --------
    >>> count_harmonics(12.0, 1.0, 6), count_harmonics(3.0, 1.0, 6)
    (4, 1)
    """
    return int(np.clip(period / (FASTEST * interval), 1, most))


def find_period(
    linearized: LinearizedFit, effects: Array, sample: IntArray, seconds: Array, periods: Array
) -> float:
    """The strict period of a signal; NaN where noise that swings describes it as well.

    Parameters
    ----------
    linearized : LinearizedFit
        Of n rows of one session, whose noise counts as independent.
    effects : array, shape (n, m)
        Whitened and projected; they count as part of the mean.
    sample : array of int, shape (n,)
        See `Autocorrelation`.
    seconds : array, shape (n,)
    periods : array, shape (p,)
        A grid, evenly in frequency.
    """
    if not len(periods):
        return float("nan")
    interval = float(np.median(np.diff(seconds)))
    step = 1.0 / periods.max() if len(periods) == 1 else float(np.abs(np.diff(1.0 / periods)).max())
    independent = Autocorrelation(sample, None)

    def search(around: Array, noise: Autocorrelation, most: int) -> float:
        """The period whose wave explains most of what the law leaves, under some noise."""
        target, explained = _whiten(linearized.residual[:, None], noise), []
        for period in around:
            wave = harmonics(seconds, period, count_harmonics(period, interval, most))
            columns = _whiten(linearized.project(linearized.whiten(wave)), noise)
            size = np.linalg.lstsq(columns, target, rcond=None)[0]
            explained.append(float(np.sum((columns @ size) ** 2)))
        return float(around[int(np.argmax(explained))])

    def finer(period: float) -> Array:
        rates = 1.0 / period + np.linspace(-step, step, N_FINER)
        return 1.0 / rates[rates > 0]

    period = search(finer(search(periods, independent, 2)), independent, 2)
    wave = harmonics(seconds, period, count_harmonics(period, interval, 2))
    with_wave = np.concatenate([effects, linearized.project(linearized.whiten(wave))], axis=1)
    cost = 0.5 * wave.shape[1] * np.log(len(sample)) + np.log(len(periods) * N_FINER)
    noise = Autocorrelation(sample, None, estimate_autoregression(linearized, with_wave, sample))
    without = Autocorrelation(sample, None, estimate_autoregression(linearized, effects, sample))
    advantage = _criterion(linearized, with_wave, noise) - _criterion(linearized, effects, without)
    if advantage < cost + MIN_ADVANTAGE:
        return float("nan")
    return search(finer(period), noise, N_HARMONICS)  # the harmonics tell the period best


def _whiten(columns: Array, noise: Autocorrelation) -> Array:
    return columns if noise.noise_filter is None else np.asarray(noise.noise_filter @ columns)


def _criterion(linearized: LinearizedFit, effects: Array, noise: Autocorrelation) -> float:
    """Log likelihood with an autoregression, less what the criterion asks for its coefficients."""
    columns = np.concatenate([linearized.basis.toarray(), effects, linearized.residual[:, None]], axis=1)
    columns, n, order = _whiten(columns, noise), len(columns), len(noise.coefficients)
    size = np.linalg.lstsq(columns[:, :-1], columns[:, -1], rcond=None)[0]
    innovations = columns[:, -1] - columns[:, :-1] @ size
    squares = max(float(innovations @ innovations), float(np.finfo(float).tiny))
    log_determinant = noise.log_determinant if order else 0.0
    return log_determinant - 0.5 * n * float(np.log(squares)) - 0.5 * order * float(np.log(n))
