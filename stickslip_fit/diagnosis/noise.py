"""The noise of a log: repeatability, heteroscedastic configurations, and outlying counts.

All three are estimated from residuals without their best-fitting structure. Repeatability is a standard
deviation for each joint and direction. Configurations with larger noise follow from a two-component
mixture with empirical-Bayes weights (H. Robbins, Proc. Third Berkeley Symp. 1:157, 1956). Outliers are
tested by a likelihood ratio against noise alone, the p-value averaged over the tails that noise may have, as
likely as the bulk of the residuals makes them (X.-L. Meng, Ann. Stat. 22:1142, 1994). How uncertain these
estimates are shows in the expected variance of each response (G. K. Smyth, Stat. Appl. Genet. Mol. Biol.
3:3, 2004, for the standard deviations).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import digamma, softmax, stdtrit, zeta

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.evidence import log_likelihood_ratio
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit
from stickslip_fit.diagnosis.misfit import TAIL_DF, StructureRemoved
from stickslip_fit.diagnosis.noise_shape import Skewness, fit_skewness, merge_neighbours
from stickslip_fit.diagnosis.unevenness import (
    MIN_FREE,
    Unevenness,
    estimate_unevenness,
    group_rows,
    log_student_t,
    residuals_of,
    weighted_median,
)

# Heteroscedasticity
MIXTURE_TAIL_DF = (5.0, 200.0)  # of Student t noise
RELATIVE_SDS = 0.55 * 2 ** (np.arange(9) / 4)  # grid of standard deviations of both components
RATIO_STEPS = (2, 3, 4)  # steps of the grid between quiet and noisy: ratios of 1.4 to 2
NOISY_SHARES = (0.05, 0.1, 0.2, 0.3, 0.5)  # of the configurations
OUTLIER_SHARE, OUTLIER_SCALE = 0.01, 5.0  # Cauchy component: an outlier makes no configuration noisy
MIN_MIXTURE_LOG_RATIO = 3.0  # nats over homoscedastic noise
MIN_TAIL_LOG_RATIO = 10.0  # nats above which heavy tails alone do not explain the mixture
MIN_NOISY_PROBABILITY = 0.02  # above which a configuration may be a noisy one
# Repeatability
MAX_MEDIANS = 10.0  # of the absolute residuals; larger residuals are clipped
MIN_DRIVE_DF = 8  # for a drive's own standard deviation
MAX_POOLINGS, POOLING_TOL, MAX_FALL = 100, 1e-6, 0.25  # of a mean whose weights depend on it
FINE_SHARE = 0.1  # of the rows, beside whose rounding that of others is coarse
PRIOR_DF = (4.0, 1e4)  # of what drives have in common; with the most, they do not differ
MIN_SD = 1e-7  # of a log's responses
MIN_CELL_ROWS, CLIP_SD = 3, 3.0  # rows whose mean is subtracted; clipping of residuals in it
MIN_UNEVEN_LOG_ODDS = 3.0  # nats over structure, where residuals show either
SMOOTH_SD, MIN_NOISY_ROWS = 2.5, 7  # standard errors of that test of structure; rows
CLEAR_MEAN = 3.0  # standard errors of a mean that is no noise
# Outliers
TAIL_PRIOR = dict(zip(TAIL_DF, (0.5, 0.25, 0.15, 0.1), strict=True))  # heavy tails are the rule
MIN_TAIL_PROBABILITY = 1e-4  # of a df; noise of a less likely one is not simulated
MAX_EXCEEDANCES, BATCH_SIZE = 40, 500  # simulated logs above the statistic, after which none is added
SCALE_GRID = (0.9, 1.0, 1.1)  # of the standard deviation by the median
MIN_OUTLIER_MEDIANS, MAX_OUTLIER_MEDIANS = 5.5, 120.0  # absolute residuals; larger ones count as so large
N_MERGED = 300  # groups of residuals that are no outliers, where there are more of these
MISFIRE_SHARES = (0.0015, 0.003, 0.006, 0.012, 0.025, 0.05)
MAX_MISFIRE_SHARE = 0.1  # of the rows
NEIGHBOURS = 2  # rows on either side, in time or in a column
MIN_RUN = 3  # rows of the same sign that are neighbours in a column, which are structure
MIN_ECHO_SD = 4.5  # of an outlier in autocorrelated noise, the larger ones and their traces subtracted
MEDIAN_TOL = 1e-6  # standard deviations; rounding noise of the projection
MIN_LOG_RATIO = 0.5  # nats; noise alone often gives as much and need not be simulated


@dataclass(frozen=True, eq=False)
class Heteroscedasticity:
    """Standard deviation of each row's configuration over that of the quiet ones.

    Attributes
    ----------
    ratio : array, shape (n,)
        Posterior estimate; 1 where the noise is homoscedastic.
    max_ratio : array, shape (n,)
        That of the noisy component, unless the configuration is clearly quiet or heavy tails alone explain
        the mixture.
    mean_square : array, shape (n,)
        Posterior mean of its square; `ratio` is that of its inverse square.
    """

    ratio: Array
    max_ratio: Array
    mean_square: Array


def estimate_heteroscedasticity(deviation: Array, kind: IntArray, counts: Array) -> Heteroscedasticity:
    """Classify configurations as quiet or noisy by a two-component mixture.

    `deviation` are residuals in units of the pooled noise, each of which `counts` as part of a row; `kind`
    numbers the configuration of each.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> kind = np.repeat(np.arange(40), 15)
    >>> noise = np.where(kind < 12, 2.0, 1.0)
    >>> ratio = estimate_heteroscedasticity(noise * rng.standard_normal(600), kind, np.ones(600)).ratio
    >>> bool(np.corrcoef(ratio, noise)[0, 1] > 0.9)
    True
    >>> np.unique(estimate_heteroscedasticity(rng.standard_normal(600), kind, np.ones(600)).max_ratio)
    array([1.])
    """
    null, best, noisy_probability, ratio = -np.inf, -np.inf, np.zeros(int(kind.max()) + 1), 1.0
    for df in MIXTURE_TAIL_DF:
        fits = [_log_likelihood(deviation, sd, df, kind, counts) for sd in RELATIVE_SDS]
        null = max(null, *(float(fit.sum()) for fit in fits))
        for steps, share in product(RATIO_STEPS, NOISY_SHARES):
            for quiet, noisy in zip(fits, fits[steps:], strict=False):
                mixture = np.logaddexp(np.log1p(-share) + quiet, np.log(share) + noisy)
                if (likelihood := float(mixture.sum())) > best:
                    best, ratio = likelihood, RELATIVE_SDS[steps] / RELATIVE_SDS[0]
                    noisy_probability = np.exp(np.log(share) + noisy - mixture)
    if best < null + MIN_MIXTURE_LOG_RATIO:
        return Heteroscedasticity(*np.ones((3, len(deviation))))
    estimate = 1.0 / np.sqrt(1.0 - noisy_probability + noisy_probability / ratio**2)
    mean_square = 1.0 - noisy_probability + noisy_probability * ratio**2
    maybe_noisy = (noisy_probability > MIN_NOISY_PROBABILITY) & (best > null + MIN_TAIL_LOG_RATIO)
    return Heteroscedasticity(estimate[kind], np.where(maybe_noisy, ratio, 1.0)[kind], mean_square[kind])


def _log_likelihood(deviation: Array, sd: float, df: float, kind: IntArray, counts: Array) -> Array:
    """Log likelihood of each configuration's residuals under Student t noise, with a Cauchy component."""
    scale = sd * np.sqrt((df - 2.0) / df)
    noise = log_student_t(deviation / scale, df) - np.log(scale)
    cauchy = log_student_t(deviation / OUTLIER_SCALE, 1.0) - np.log(OUTLIER_SCALE)
    both = np.logaddexp(np.log1p(-OUTLIER_SHARE) + noise, np.log(OUTLIER_SHARE) + cauchy)
    return np.bincount(kind, counts * both)


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """The noise of a log.

    Attributes
    ----------
    sd : array
        Standard deviation of each drive's responses in quiet configurations, without rounding.
    df : array
        Of each of these; rows whose rounding is coarse beside that of others tell little.
    heteroscedasticity : Heteroscedasticity
        Of configurations, beside `unevenness`.
    skewness : Skewness or None
        Of responses in units of their standard deviation; None where it is not clear.
    """

    sd: Array
    df: Array
    heteroscedasticity: Heteroscedasticity
    unevenness: Unevenness
    skewness: Skewness | None

    @property
    def ratio(self) -> Array:
        """Standard deviation of each row relative to that of its drive, shape (n,)."""
        return self.unevenness.ratio * self.heteroscedasticity.ratio

    def expected(self) -> NoiseEstimate:
        """With posterior means of the variances, as honest standard errors have them.

        As weights the estimates themselves are too sharp: rows whose noise is underestimated weigh most, so
        that the standard error is too small (P. Meier, Biometrics 9:59, 1953).
        """
        noisy = self.heteroscedasticity
        return replace(
            self,
            sd=np.sqrt(shrink_variances(self.sd**2, self.df)),
            heteroscedasticity=replace(noisy, ratio=np.sqrt(noisy.mean_square)),
        )


def shrink_variances(variance: Array, df: Array) -> Array:
    """Posterior means of variances that were estimated with so many degrees of freedom, shape (k,).

    Their prior is a scaled inverse chi-square about their mean, whose degrees of freedom follow from their
    spread (G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3:3, 2004, section 6.2). Variances with fewer than
    `MIN_DRIVE_DF` degrees of freedom are taken to be the mean.

    Examples
    --------
    Estimates that differ by no more than chance are pooled; 5 % are added for the error of the pool.

    >>> shrink_variances(np.array([0.8, 1.2]), np.array([20.0, 20.0])).round(2)
    array([1.05, 1.05])
    """
    from scipy.optimize import brentq

    known = df >= MIN_DRIVE_DF
    if not known.any():
        return variance
    own, least, most = np.where(known, df, 0.0), *PRIOR_DF
    log_variance = np.log(variance[known]) - digamma(df[known] / 2) + np.log(df[known] / 2)
    excess = float(np.var(log_variance, ddof=1)) if known.sum() > 1 else 0.0
    # The trigamma function, the first derivative of digamma, is this zeta function.
    excess -= float(np.mean(zeta(2, df[known] / 2)))
    excess = float(np.clip(excess, zeta(2, most / 2), zeta(2, least / 2)))
    prior_df = brentq(lambda d: float(zeta(2, d / 2)) - excess, least / 2, 2 * most)
    mean = float(own @ variance) / (float(own.sum()) - 2.0)
    return np.asarray((own * variance + (prior_df - 2.0) * mean) / (own + prior_df - 2.0))


def estimate_noise(
    linearized: LinearizedFit,
    left: StructureRemoved,
    rounding: Array,
    drive: IntArray,
    kind: IntArray,
    least_sd: float = MIN_SD,
    relative_sd: Array | float = 1.0,
    columns: tuple[str, ...] = (),
) -> NoiseEstimate:
    """Estimate the noise from residuals without structure.

    `rounding`, shape (n,), is the variance that rounding adds; `drive` numbers the joint and direction of
    each row, `kind` its configuration. No standard deviation is below `least_sd`; all are over the
    `relative_sd` of their rows. `columns` are as of `group_rows`.
    """
    deviation, rounding = left.residual * linearized.scale / relative_sd, rounding / np.square(relative_sd)
    free = np.maximum(1.0 - linearized.leverage - left.leverage, MIN_FREE)
    scale = np.sqrt(_estimate_drive_sd(deviation, free, rounding, drive, least_sd)[drive] ** 2 + rounding)
    # Rows that the law nearly follows one by one resemble each other's residuals: they count for less.
    cell, counts = kind * (drive.max() + 1) + drive, np.minimum(free / (1.0 - MAX_LEVERAGE), 1.0)
    standardized = deviation / scale / np.sqrt(free)
    uneven, skewness = Unevenness(np.ones(len(deviation))), None
    if linearized.noise_filter is None:
        uneven = _estimate_unevenness(linearized, left, scale * relative_sd, drive, kind, columns)
        if left.log_evidence > 0:  # what looks like structure may be where the noise is large
            whole = StructureRemoved(linearized.residual, np.zeros(len(deviation)))
            alone = _estimate_unevenness(linearized, whole, scale * relative_sd, drive, kind, columns)
            if alone.log_ratio > uneven.log_ratio + left.log_evidence + MIN_UNEVEN_LOG_ODDS:
                uneven = alone
        skewness = fit_skewness((standardized / uneven.ratio)[counts == 1.0])
    within = _subtract_cell_means(standardized / uneven.ratio, cell)
    noisy = estimate_heteroscedasticity(within, kind, counts)
    ratio = uneven.ratio * noisy.ratio
    most = np.inf if skewness else MAX_MEDIANS
    sd = _estimate_drive_sd(deviation / ratio, free, rounding / ratio**2, drive, least_sd, most)
    if skewness:
        scale = np.sqrt((sd[drive] * ratio) ** 2 + rounding)
        skewness = fit_skewness((deviation / scale / np.sqrt(free))[counts == 1.0])
    variance = np.square(sd[drive] * ratio)
    finest = variance + np.minimum(rounding, np.quantile(rounding, FINE_SHARE))
    informative = free * np.square(finest / (variance + rounding))  # noise hides in rounding that is coarser
    return NoiseEstimate(sd, np.bincount(drive, informative, len(sd)), noisy, uneven, skewness)


def _estimate_unevenness(
    linearized: LinearizedFit,
    left: StructureRemoved,
    scale: Array,
    drive: IntArray,
    kind: IntArray,
    columns: tuple[str, ...],
) -> Unevenness:
    """From symmetrized residuals without means of replicates that are beyond chance: effects, not noise."""
    residuals = residuals_of(linearized, left.residual, scale, drive, left.leverage)
    free = np.sqrt(np.maximum(1.0 - linearized.leverage - left.leverage, MIN_FREE))
    if skewness := fit_skewness((residuals.values / free)[free**2 > 1.0 - MAX_LEVERAGE]):
        residuals = replace(residuals, values=free * skewness.symmetrize(residuals.values / free))
    cell, size = kind * (drive.max() + 1) + drive, np.clip(residuals.values, -CLIP_SD, CLIP_SD)
    rows = np.maximum(np.bincount(cell), 1)
    mean, mean_square = np.bincount(cell, size) / rows, np.bincount(cell, size**2) / rows
    error = np.sqrt(np.maximum((mean_square - mean**2) * rows / np.maximum(rows - 1, 1), 1.0) / rows)
    clear = (rows >= MIN_CELL_ROWS) & (np.abs(mean) > CLEAR_MEAN * error)
    within = (residuals.values - mean[cell]) * np.sqrt(rows / np.maximum(rows - 1, 1))[cell]
    residuals = replace(residuals, values=np.where(clear[cell], within, residuals.values))
    uneven = estimate_unevenness(residuals, group_rows(linearized, kind, residuals, columns))
    numbers = [values for name in columns if (values := linearized.columns[name]).dtype.kind in "fiu"]
    # What changes steadily along a column where it is large is structure.
    if any(_is_smooth(residuals.values, uneven.ratio > 1.0, values.astype(float)) for values in numbers):
        return Unevenness(np.ones(len(linearized)))
    return uneven


def _is_smooth(residual: Array, is_noisy: BoolArray, values: Array) -> bool:
    """Whether residuals of noisy rows, all of shape (n,), resemble those beside them in a column.

    By the mean square of successive differences, of variance 1 / n in independent noise (J. von Neumann, Ann.
    Math. Stat. 12:367, 1941).
    """
    own = residual[is_noisy][np.argsort(values[is_noisy], kind="stable")]
    if len(own) < MIN_NOISY_ROWS:
        return False
    ratio = float(np.sum(np.diff(own) ** 2)) / (2.0 * float(np.sum(own**2)))
    return ratio < 1.0 - SMOOTH_SD / np.sqrt(len(own))


def _subtract_cell_means(deviation: Array, cell: IntArray) -> Array:
    """Deviations from the mean of replicates, so that a systematic effect does not count as noise."""
    rows = np.bincount(cell)
    mean = np.bincount(cell, np.clip(deviation, -CLIP_SD, CLIP_SD)) / np.maximum(rows, 1)
    within = (deviation - mean[cell]) * np.sqrt(rows / np.maximum(rows - 1, 1))[cell]
    return np.where(rows[cell] >= MIN_CELL_ROWS, within, deviation)


def _estimate_drive_sd(
    deviation: Array,
    free: Array,
    rounding: Array,
    drive: IntArray,
    least_sd: float,
    max_medians: float = MAX_MEDIANS,
) -> Array:
    number, variance = int(drive.max()) + 1, np.zeros(len(deviation))
    for own in (drive == k for k in np.unique(drive)):
        most = max_medians * max(
            weighted_median(np.abs(deviation[own]) / np.sqrt(free[own]), free[own]), least_sd
        )
        variance[own] = np.minimum(deviation[own] ** 2 / free[own], most**2) - rounding[own]
    df, total = np.bincount(drive, free, number), np.bincount(drive, free * variance, number)
    pooled = pool_variance(variance, free, rounding, least_sd**2)
    of_drive = np.maximum(total / np.maximum(df, MIN_FREE), 0.04 * pooled)
    return np.sqrt(np.where(df >= MIN_DRIVE_DF, of_drive, pooled))


def pool_variance(variance: Array, free: Array, rounding: Array, least: float) -> float:
    """Mean of what single rows say of a variance that all have beside their rounding, at least `least`.

    All are of shape (n,): of each row the square less its rounding's variance, by which it may be negative,
    the degrees of freedom, and its rounding's variance, in which a small variance does not show. Weights are
    those of maximum likelihood; those of a chi-square that equals its df, as of `pool_residuals`, let coarse
    rows count as much as fine ones.

    Examples
    --------
    >>> coarse, fine = np.array([0.9, -0.9, -0.6]), np.array([1.2e-4, 0.8e-4])
    >>> rounding = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    >>> round(pool_variance(np.concatenate([coarse, fine]), np.ones(5), rounding, 0.0), 7)
    0.0001
    """
    pooled = max(float(free @ (variance + rounding)) / float(free.sum()), least)
    for _ in range(MAX_POOLINGS):
        weight = free * np.square(pooled / (pooled + rounding))
        mean = float(weight @ variance) / float(weight.sum())
        before, pooled = pooled, max(mean, MAX_FALL * pooled, least)
        if abs(pooled - before) <= POOLING_TOL * before:
            break
    return pooled


@dataclass(frozen=True, eq=False)
class Outliers:
    """Rows whose counts are outliers, and the p-value of the test for any."""

    rows: IntArray
    p_value: float


def find_outliers(
    linearized: LinearizedFit, residual: Array, drive: IntArray, n_simulations: int, rng: np.random.Generator
) -> Outliers:
    """Test for outlying counts in whitened residuals without structure, shape (n,).

    `drive` numbers the joint and direction of each row.
    """
    test = _OutlierTest(linearized, drive)
    ratio, odds, by_tail = _log_likelihood_ratio(test.deviations(residual[:, None]))
    if ratio[0] < MIN_LOG_RATIO:
        return Outliers(np.zeros(0, dtype=np.intp), 1.0)
    rows = test.known[odds[0] > 1.0]
    if not len(rows):
        return Outliers(rows, 1.0)
    if linearized.noise_filter is not None:
        rows = _without_echoes(linearized, rows)
        if not len(rows):
            return Outliers(rows, 1.0)
    probability = softmax([np.log(TAIL_PRIOR[df]) + float(fit[0]) for df, fit in by_tail.items()])
    p_value = sum(
        share
        * (test.p_value(float(ratio[0]), df, n_simulations, rng) if share > MIN_TAIL_PROBABILITY else 1.0)
        for df, share in zip(by_tail, probability, strict=True)
    )
    return Outliers(rows, float(p_value))


def find_runs(rows: IntArray, columns: Array, residuals: Array) -> BoolArray:
    """Which of some rows are next to others of them in a column, and as far off to the same side.

    What steepens towards one end of a column is no error of single rows.

    Parameters
    ----------
    rows : array of int, shape (m,)
    columns : array, shape (n, k)
    residuals : array, shape (n, r)
        Of which at least `MIN_RUN` of a run have the same sign; without structure, or with it.
    """
    run = np.zeros(len(rows), dtype=bool)
    for values in columns.T if len(rows) >= MIN_RUN else ():
        place = np.argsort(np.argsort(values, kind="stable"))[rows]
        order = np.argsort(place)
        for part in np.split(order, np.flatnonzero(np.diff(place[order]) > NEIGHBOURS) + 1):
            above = np.sum(residuals[rows[part]] > 0, axis=0)
            run[part] |= np.maximum(above, len(part) - above).max() >= MIN_RUN
    return run


def _without_echoes(linearized: LinearizedFit, rows: IntArray) -> IntArray:
    """Outlying rows of autocorrelated noise that are single responses far off.

    A filter predicts the row after an outlier wrongly, too; and a lasting change leaves one large residual,
    where it begins. Rows are taken by size, each with its trace subtracted, from residuals from which no
    structure is removed: what was taken for structure may be the outliers'.
    """
    assert linearized.noise_filter is not None
    n, session = len(linearized), linearized.rows["session"].to_numpy(object)
    single, lasting = np.zeros((n, len(rows))), np.zeros((n, len(rows)))
    single[rows, np.arange(len(rows))] = 1.0
    for k, row in enumerate(rows):
        lasting[row:, k] = session[row:] == session[row]
    traces, changes = (_unit_columns(np.asarray(linearized.noise_filter @ one)) for one in (single, lasting))
    left, found = linearized.residual.copy(), []
    for _ in rows:
        sizes, as_changes = np.abs(traces.T @ left), np.abs(changes.T @ left)
        k = int(np.argmax(np.maximum(sizes, as_changes)))
        best = traces[:, k] if sizes[k] >= as_changes[k] else changes[:, k]
        if max(sizes[k], as_changes[k]) < MIN_ECHO_SD:
            break
        if sizes[k] >= as_changes[k]:
            found.append(int(rows[k]))
        left -= best * (best @ left)
    return np.array(sorted(set(found)), dtype=np.intp)


def explains_more(linearized: LinearizedFit, log_evidence: float) -> bool:
    """Whether in autocorrelated noise one outlier is likelier than a structure of this log evidence.

    An outlier there leaves traces in the rows after it, as the beginning of a structure does.
    """
    if linearized.noise_filter is None:
        return False
    traces, residual = linearized.noise_filter, linearized.residual
    squares = np.asarray((traces**2).sum(axis=0)).ravel()
    explained = float(np.max((traces.T @ residual) ** 2 / squares)) / float(residual @ residual)
    log_ratio = float(log_likelihood_ratio(explained, linearized.df))
    return log_ratio - np.log(len(linearized)) > log_evidence


def _unit_columns(columns: Array) -> Array:
    return columns / np.linalg.norm(columns, axis=0)


class _OutlierTest:
    """Likelihood ratio test on rows of low leverage."""

    def __init__(self, linearized: LinearizedFit, drive: IntArray) -> None:
        self.linearized = linearized
        self.known = np.flatnonzero(linearized.leverage < MAX_LEVERAGE)
        self.noise_group = drive[self.known]

    def deviations(self, residuals: Array) -> Array:
        """Absolute residuals in units of their drive's median, shape (n, k) -> (k, known)."""
        kept = np.sqrt(1.0 - self.linearized.leverage[self.known])
        return _scale_by_median(np.abs(residuals[self.known]).T / kept, self.noise_group)

    def p_value(self, ratio: float, df: float, n_simulations: int, rng: np.random.Generator) -> float:
        """Share of logs of Student t noise alone with at least this likelihood ratio."""
        higher = done = 0
        while done < n_simulations and higher < MAX_EXCEEDANCES:
            size = min(BATCH_SIZE, n_simulations - done)
            noise = rng.standard_t(df, (len(self.linearized), size))
            ratios = _log_likelihood_ratio(self.deviations(self.linearized.project(noise)))[0]
            higher, done = higher + int(np.sum(ratios >= ratio)), done + size
        return (1 + higher) / (1 + done)


def _scale_by_median(deviation: Array, drive: IntArray) -> Array:
    """Deviations in units of their drive's median, shape (k, n); 0 where the calibration fits it exactly."""
    scaled = np.empty_like(deviation)
    for number in np.unique(drive):
        inside = drive == number
        median = np.median(deviation[:, inside], axis=1, keepdims=True)
        scaled[:, inside] = deviation[:, inside] / np.where(median > MEDIAN_TOL, median, np.inf)
    return scaled


def _log_density(deviation: Array, unit: float, df: float) -> Array:
    """Of the absolute value of Student's t over `unit`."""
    return np.log(2.0 * unit) + log_student_t(deviation * unit, df)


def _log_likelihood_ratio(deviation: Array) -> tuple[Array, Array, dict[float, Array]]:
    """Likelihood ratio of noise with outliers to noise alone.

    The prior of an outlier's size is log-uniform.

    Returns
    -------
    log_ratio : array, shape (k,)
    odds : array, shape (k, n)
        Of each row to be an outlier.
    by_tail : dict of float to array, shape (k,)
        Log likelihood of noise with outliers for each df.
    """
    n, deviation = deviation.shape[1], np.minimum(deviation, MAX_OUTLIER_MEDIANS)
    number = max(int(MAX_MISFIRE_SHARE * n), 1)
    places = np.argpartition(-deviation, number - 1, axis=1)[:, :number]
    top = np.take_along_axis(deviation, places, axis=1)
    others, rows = merge_neighbours(np.sort(deviation, axis=1)[:, : n - number], N_MERGED)
    far = top > MIN_OUTLIER_MEDIANS
    log_range = np.log(MAX_OUTLIER_MEDIANS / MIN_OUTLIER_MEDIANS)
    outlier_density = np.where(far, 1.0 / (top * log_range), 0.0)
    alone, both = np.full(len(deviation), -np.inf), np.full(len(deviation), -np.inf)
    odds, by_tail = np.zeros_like(top), dict.fromkeys(TAIL_DF, both)
    for df in TAIL_DF:
        middle = float(stdtrit(df, 0.75))
        for scale in SCALE_GRID:
            log_noise = _log_density(top, middle / scale, df)
            total = log_noise.sum(axis=1) + _log_density(others, middle / scale, df) @ rows
            alone = np.maximum(alone, total)
            ratio = outlier_density * np.exp(-log_noise)
            for share in MISFIRE_SHARES:
                # For rows that are not far the mixture is (1 - share) times the noise.
                gained = np.where(far, np.log1p(share * (ratio - 1.0)), np.log1p(-share)).sum(axis=1)
                value = total + gained + (n - top.shape[1]) * np.log1p(-share)
                by_tail[df] = np.maximum(by_tail[df], value)
                better = value > both
                both = np.where(better, value, both)
                odds = np.where(better[:, None], share * ratio / (1 - share), odds)
    full = np.zeros_like(deviation)
    np.put_along_axis(full, places, odds, axis=1)
    return both - alone, full, by_tail
