"""The noise of a log: repeatability, heteroscedastic configurations, and outlying counts.

All three are estimated from residuals without their best-fitting structure. Repeatability is a standard
deviation for each joint and direction. Configurations with larger noise follow from a two-component
mixture with empirical-Bayes weights (H. Robbins, Proc. Third Berkeley Symp. 1:157, 1956). Outliers are
tested by a likelihood ratio against noise alone, maximized over the tail weights that the bulk of the
residuals allows (R. L. Berger and D. D. Boos, J. Am. Stat. Assoc. 89:1012, 1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student_t

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import StructureRemoved

MIXTURE_TAIL_DF = (5.0, 200.0)  # degrees of freedom that noise may have
RELATIVE_SDS = 0.55 * 2 ** (np.arange(9) / 4)  # sizes of the quiet or noisy noise, in that of all
RATIO_STEPS = (2, 3, 4)  # places in UNITS between quiet and noisy: 1.4 to 2 times
NOISY_SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the configurations that are noisy
OUTLIER_SHARE, OUTLIER_SCALE = (
    0.01,
    5.0,
)  # of rows that are off by anything: one does not make a configuration noisy
MIN_TAIL_LOG_RATIO = 10.0  # nats by which it must be, so that no heavy tails look like it
MIN_NOISY_PROBABILITY = 0.02  # odds of being noisy, below which a configuration is a quiet one
MIN_MIXTURE_LOG_RATIO = 3.0  # nats by which that must be likelier than even noise


@dataclass(frozen=True, eq=False)
class Heteroscedasticity:
    """Noise of each row's configuration over that of the quiet ones, shape (n,); 1 where noise is even.

    Attributes
    ----------
    ratio : array, shape (n,)
    at_most : array, shape (n,)
        That of the noisy ones, unless the configuration is plainly a quiet one; 1 also where heavy tails
        alone might look like some noisy configurations.
    """

    ratio: Array
    max_ratio: Array


def estimate_heteroscedasticity(deviation: Array, kind: IntArray) -> Heteroscedasticity:
    """Find out which configurations are the noisy ones, if there are any.

    Parameters
    ----------
    deviation : array, shape (n,)
        Residuals in units of the noise of all.
    kind : array of int, shape (n,)
        Configuration of each row.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> kind = np.repeat(np.arange(40), 15)
    >>> noise = np.where(kind < 12, 2.0, 1.0)
    >>> found = estimate_heteroscedasticity(noise * rng.standard_normal(600), kind).ratio
    >>> bool(np.corrcoef(found, noise)[0, 1] > 0.9)
    True
    >>> np.unique(estimate_heteroscedasticity(rng.standard_normal(600), kind).max_ratio)
    array([1.])
    """
    even, best, odds, times = -np.inf, -np.inf, np.zeros(int(kind.max()) + 1), 1.0
    for df in MIXTURE_TAIL_DF:
        fits = [_log_likelihood(deviation, unit, df, kind) for unit in RELATIVE_SDS]
        even = max(even, *(float(fit.sum()) for fit in fits))
        for apart, share in product(RATIO_STEPS, NOISY_SHARES):
            for quiet, noisy in zip(fits, fits[apart:], strict=False):
                as_noisy = np.log(share) + noisy
                either = np.logaddexp(np.log1p(-share) + quiet, as_noisy)
                if (likelihood := float(either.sum())) > best:
                    best, odds, times = (
                        likelihood,
                        np.exp(as_noisy - either),
                        RELATIVE_SDS[apart] / RELATIVE_SDS[0],
                    )
    if best < even + MIN_MIXTURE_LOG_RATIO:
        return Heteroscedasticity(np.ones(len(deviation)), np.ones(len(deviation)))
    likely = 1.0 / np.sqrt(1.0 - odds + odds / times**2)
    doubtful = (
        (odds > MIN_NOISY_PROBABILITY)
        if best > even + MIN_TAIL_LOG_RATIO
        else np.zeros(len(odds), dtype=bool)
    )
    return Heteroscedasticity(likely[kind], np.where(doubtful, times, 1.0)[kind])


def _log_likelihood(deviation: Array, unit: float, df: float, kind: IntArray) -> Array:
    """Log likelihood of each configuration's residuals under noise of a size."""
    scale = unit * np.sqrt((df - 2.0) / df)  # makes `unit` the standard deviation
    noise = student_t.logpdf(deviation / scale, df) - np.log(scale)
    wild = student_t.logpdf(deviation / OUTLIER_SCALE, 1.0) - np.log(OUTLIER_SCALE)
    return np.bincount(kind, np.logaddexp(np.log1p(-OUTLIER_SHARE) + noise, np.log(OUTLIER_SHARE) + wild))


MAX_MEDIANS = 10.0  # medians; what is further off is taken for this far
MIN_DRIVE_DF = 8  # degrees of freedom by which a drive is judged by itself
MIN_CELL_ROWS, CLIP_SD = 3, 3.0  # rows whose mean is taken out; departures that count as this far in it
MAX_LEVERAGE = 0.8


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Of every row of a log.

    Attributes
    ----------
    sd : array
        Standard deviation of each drive's responses in configurations that repeat well, rounding left out.
    uneven : Unevenness
        How much worse each row's configuration repeats.
    """

    sd: Array
    uneven: Heteroscedasticity


def estimate_noise(
    linearized: LinearizedFit, left: StructureRemoved, rounding: Array, drive: IntArray, kind: IntArray
) -> NoiseEstimate:
    """Judge the noise by what is left of the residuals.

    Parameters
    ----------
    linearized : Study
    left : Cleared
        Residuals in units of the study's scale, without structure.
    rounding : array, shape (n,)
        Variance that rounding adds.
    drive, kind : array of int, shape (n,)
        Rows of one drive repeat equally well, but for some kinds of rows.
    """
    deviation = left.residual * linearized.scale
    free = np.maximum(1.0 - linearized.leverage - left.leverage, 1.0 - MAX_LEVERAGE)
    even = _estimate_drive_sd(deviation, free, rounding, drive)
    scale = np.sqrt(even[drive] ** 2 + rounding)
    uneven = estimate_heteroscedasticity(
        _subtract_cell_means(deviation / scale / np.sqrt(free), kind * (drive.max() + 1) + drive), kind
    )
    times = uneven.ratio
    return NoiseEstimate(_estimate_drive_sd(deviation / times, free, rounding / times**2, drive), uneven)


def _subtract_cell_means(deviation: Array, cell: IntArray) -> Array:
    """Departures from the mean of rows that ought to be alike: what else is wrong must not pass for noise."""
    rows = np.bincount(cell)
    mean = np.bincount(cell, np.clip(deviation, -CLIP_SD, CLIP_SD)) / np.maximum(rows, 1)
    apart = (deviation - mean[cell]) * np.sqrt(rows / np.maximum(rows - 1, 1))[cell]
    return np.where(rows[cell] >= MIN_CELL_ROWS, apart, deviation)


def _estimate_drive_sd(deviation: Array, free: Array, rounding: Array, drive: IntArray) -> Array:
    number, size = int(drive.max()) + 1, np.abs(deviation)
    median = np.array([np.median(size[drive == k]) if np.any(drive == k) else np.inf for k in range(number)])
    squares = np.minimum(size, MAX_MEDIANS * np.maximum(median, 1e-7)[drive]) ** 2
    df = np.bincount(drive, free, number)
    pooled = max(float(squares.sum() / max(df.sum(), 1.0) - rounding.mean()), 1e-14)
    rows = np.maximum(np.bincount(drive, minlength=number), 1)
    own = np.bincount(drive, squares, number) / np.maximum(df, 1.0)
    own -= np.bincount(drive, rounding, number) / rows
    return np.sqrt(np.where(df >= MIN_DRIVE_DF, np.maximum(own, 0.04 * pooled), pooled))


TAIL_DF = (5.0, 8.0, 15.0, 200.0)  # degrees of freedom that noise may have
MAX_TAIL_LOG_RATIO = 6.0  # nats by which a tail must be less likely than the best not to be judged by
TAIL_ERROR_RATE = float(chi2.sf(2 * MAX_TAIL_LOG_RATIO, 1))  # chance that the true tail is
MAX_EXCEEDANCES, BATCH_SIZE = (
    40,
    500,
)  # logs of noise alone that are likelier misfires: no alarm, whatever others say
SCALE_GRID = (0.9, 1.0, 1.1)  # of what the median says
MIN_OUTLIER_MEDIANS, MAX_OUTLIER_MEDIANS = 5.5, 120.0  # medians of the noise, between which misfires lie
MISFIRE_SHARES = (0.0015, 0.003, 0.006, 0.012, 0.025, 0.05)
MAX_MISFIRE_SHARE = 0.1  # of a log: more are not looked at
MEDIAN_TOL = 1e-6  # repeatabilities; rounding noise of what recalibration absorbs
MIN_LOG_RATIO = 0.5  # nats in favour of misfires; noise alone often gives as much, and need not be simulated


@dataclass(frozen=True, eq=False)
class Outliers:
    """Rows that look like misfires, and how likely anything like them is by chance."""

    rows: IntArray
    p_value: float


def find_outliers(
    linearized: LinearizedFit, residual: Array, drive: IntArray, draws: int, rng: np.random.Generator
) -> Outliers:
    """Look for counts that are wildly off.

    Parameters
    ----------
    linearized : Study
    residual : array, shape (n,)
        In units of the noise, with whatever else is wrong taken out.
    drive : array of int, shape (n,)
        Rows of one drive repeat equally well.
    draws : int
    rng : Generator
    """
    judge = _OutlierTest(linearized, drive)
    ratio, odds, by_tail = _log_likelihood_ratio(judge.off(residual[:, None]))
    if ratio[0] < MIN_LOG_RATIO:
        return Outliers(np.zeros(0, dtype=np.intp), 1.0)
    rows = judge.known[odds[0] > 1.0]
    if not len(rows):
        return Outliers(rows, 1.0)
    allowed = [df for df, fit in by_tail.items() if fit[0] > max(by_tail.values())[0] - MAX_TAIL_LOG_RATIO]
    by_chance = [judge.p_value(float(ratio[0]), df, draws, rng) for df in allowed]
    return Outliers(
        rows, min(1.0, max(by_chance) + (TAIL_ERROR_RATE if len(allowed) < len(TAIL_DF) else 0.0))
    )


class _OutlierTest:
    """Of rows that recalibration does not take up, by their departures in units of their drive's median.

    Parameters
    ----------
    study : Study
    drive : array of int, shape (n,)
    """

    def __init__(self, linearized: LinearizedFit, drive: IntArray) -> None:
        self.study = linearized
        self.known = np.flatnonzero(linearized.leverage < MAX_LEVERAGE)
        self.drive = drive[self.known]

    def off(self, residuals: Array) -> Array:
        """Departures, shape (n, k) -> (k, known)."""
        kept = np.sqrt(1.0 - self.study.leverage[self.known])
        return _scale_by_median(np.abs(residuals[self.known]).T / kept, self.drive)

    def p_value(self, ratio: float, df: float, draws: int, rng: np.random.Generator) -> float:
        """How often logs of noise alone, with a tail, reach a likelihood ratio once recalibrated."""
        higher = made = 0
        while made < draws and higher < MAX_EXCEEDANCES:
            size = min(BATCH_SIZE, draws - made)
            noise = student_t.rvs(df, size=(len(self.study), size), random_state=rng)
            higher += int(np.sum(_log_likelihood_ratio(self.off(self.study.project(noise)))[0] >= ratio))
            made += size
        return (1 + higher) / (1 + made)


def _scale_by_median(deviation: Array, drive: IntArray) -> Array:
    """Departures in units of their drive's median, which no few wild ones move; shape (k, n).

    Where recalibration takes up whatever a drive did, nothing in it departs.
    """
    found = np.empty_like(deviation)
    for each in np.unique(drive):
        subset = drive == each
        median = np.median(deviation[:, subset], axis=1, keepdims=True)
        found[:, subset] = deviation[:, subset] / np.where(median > MEDIAN_TOL, median, np.inf)
    return found


def _log_density(deviation: Array, unit: float, df: float) -> Array:
    """Of the size of Student's t over `unit`."""
    constant = float(student_t.logpdf(0.0, df)) + np.log(2.0 * unit)
    return constant - (df + 1.0) / 2.0 * np.log1p((deviation * (unit / np.sqrt(df))) ** 2)


def _log_likelihood_ratio(deviation: Array) -> tuple[Array, Array, dict[float, Array]]:
    """Log likelihood ratio of noise with misfires to noise alone, (k,), and each row's odds of one, (k, n).

    A misfire's size is as likely between 5 and 10 medians as between 50 and 100. Beside these, the log
    likelihood of each tail, misfires allowed, (k,).
    """
    n = deviation.shape[1]
    number = max(int(MAX_MISFIRE_SHARE * n), 1)
    places = np.argpartition(-deviation, number - 1, axis=1)[:, :number]
    top = np.take_along_axis(deviation, places, axis=1)
    far = top > MIN_OUTLIER_MEDIANS
    wild = np.where(
        far & (top < MAX_OUTLIER_MEDIANS),
        1.0 / (top * np.log(MAX_OUTLIER_MEDIANS / MIN_OUTLIER_MEDIANS)),
        0.0,
    )
    alone, both = np.full(len(deviation), -np.inf), np.full(len(deviation), -np.inf)
    odds, by_tail = np.zeros_like(top), dict.fromkeys(TAIL_DF, both)
    for df in TAIL_DF:
        middle = float(student_t.ppf(0.75, df))
        for scale in SCALE_GRID:
            log_noise = _log_density(deviation, middle / scale, df)
            total = log_noise.sum(axis=1)
            alone = np.maximum(alone, total)
            ratio = wild * np.exp(-np.take_along_axis(log_noise, places, axis=1))
            for share in MISFIRE_SHARES:
                # Only for the few rows that are far does the mixture differ from a share of the noise.
                gained = np.where(far, np.log1p(share * (ratio - 1.0)), np.log1p(-share)).sum(axis=1)
                value = total + gained + (n - top.shape[1]) * np.log1p(-share)
                by_tail[df] = np.maximum(by_tail[df], value)
                better = value > both
                both = np.where(better, value, both)
                odds = np.where(better[:, None], share * ratio / (1 - share), odds)
    full = np.zeros_like(deviation)
    np.put_along_axis(full, places, odds, axis=1)
    return both - alone, full, by_tail
