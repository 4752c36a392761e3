"""Uneven noise: standard deviations that differ by more than a factor of two somewhere.

Rows are grouped by session, part of a session, the noise of their neighbours in time, configuration, range of
the traverse, by ranges of every coordinate and column, and by the texts of a column. For each grouping the
distribution of the groups' standard deviations is estimated nonparametrically (J. Kiefer and J. Wolfowitz,
Ann. Math. Stat. 27:887, 1956), once without limits and once as assumed: within a factor of two in each joint,
the same in all sessions. Their likelihood ratio decides.

Calibration parameters hide unevenness: fitted by least squares, they carry the noise of noisy rows into quiet
ones. So each hypothesis weighs the rows as it says, and the likelihood is that of the residuals without the
calibration (H. D. Patterson and R. Thompson, Biometrika 58:545, 1971). Tails may be as heavy as Student's t
with 5 degrees of freedom, with a few gross errors, under either hypothesis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array
from scipy.special import poch

from stickslip_fit._rows import rank_within, unique_rows
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.proposed import POSITION, TRANSVERSE_LOAD, ZETA
from stickslip_fit.diagnosis.carriers import find_carriers, traverse_average
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.logs.history import JOINT_NET_USE, NET_USE, PAST, RECENT_USE, TIME_OF_DAY

# Carriers that are no reason for noise.
NO_REASON = {ZETA, TRANSVERSE_LOAD, "other_load", "other_pause", "tilt_age", TIME_OF_DAY, "joint_travel"}
NO_REASON |= {*RECENT_USE, *NET_USE, *JOINT_NET_USE, *PAST}

CONTAMINATION, CONTAMINATION_SCALE = 0.01, 5.0  # Cauchy component of all likelihoods: gross errors
TAIL_DF = (5.0, 200.0)  # of Student t noise
STEP = 0.125  # of the grid of standard deviations, in octaves
RELATIVE_SDS = 2.0 ** np.arange(-3.0, 4.0 + STEP, STEP)
STEPS_AS_ASSUMED = round(1.0 / STEP) + 1  # of this grid: a factor of two, wherever it lies
MIN_LOG_RATIO = 3.0  # nats over standard deviations as assumed, beside the log of the number of groupings
MIN_TWICE_LOG_RATIO = 1.0  # the same where it is clear that sessions differ, but not that by a factor of two
MIN_TRIAL_LOG_RATIO, MAX_TRIALS, N_REWEIGHTS = 0.3, 3, 3  # of groupings that are looked at closely
MAX_ROUNDS, EM_STEPS, MAX_WINDOWS = 3, 30, 2
STRETCH = "stretch of time"
MIN_LIKELIHOOD = 1e-300  # relative to that of the best standard deviation
N_BINS, N_PARTS, N_STRETCHES = 6, 3, 8  # of a coordinate in each joint; of a session; of the travel
N_BESIDE, MAX_LEVELS, ROWS_PER_LEVEL = 6, 10, 12  # neighbours on either side; groups by their noise
PRIOR_ROWS, MIN_VARIANCE, MIN_LENGTH = 2.0, 1e-3, 1e-12
MIN_GROUP_ROWS = 4  # on average; single rows that are far off are heavy tails
MIN_FREE = 1e-6  # of a row's information, beside rounding
N_PROJECTIONS, MAX_PULL = 3, 3.0
MAX_MEDIANS = 10.0  # of the absolute residuals, at which larger ones are clipped in standard deviations


@dataclass(frozen=True, eq=False)
class Grouping:
    """Groups of rows that may differ in their noise; n rows in m groups.

    Attributes
    ----------
    labels : array of int, shape (n,)
        Group of each row.
    stratum : array of int, shape (m,)
        Of each group. Noise as assumed differs within a stratum by `steps` of the grid at most.
    """

    labels: IntArray
    stratum: IntArray
    steps: int = STEPS_AS_ASSUMED

    def sum(self, table: Array) -> Array:
        """Sums over the rows of each group, (D, n, K) -> (D, m, K)."""
        return np.stack([self._sums @ one for one in table])

    @cached_property
    def strata(self) -> list[IntArray]:
        """The groups of each stratum."""
        return [np.flatnonzero(self.stratum == one) for one in np.unique(self.stratum)]

    @cached_property
    def _sums(self) -> csr_array:
        n = len(self.labels)
        return csr_array((np.ones(n), (self.labels, np.arange(n))), shape=(len(self.stratum), n))


@dataclass(frozen=True, eq=False)
class Unevenness:
    """Standard deviations that differ more than assumed; n rows.

    Attributes
    ----------
    ratio : array, shape (n,)
        Of each row's standard deviation to that of all rows; 1 where the noise is as assumed.
    carriers : tuple of str
        What rows with more than twice the noise of others have in common, by the name of the grouping.
    log_ratio : float
        Log likelihood ratio to noise as assumed.
    """

    ratio: Array
    carriers: tuple[str, ...] = ()
    log_ratio: float = 0.0


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of a fit, for weights of any kind; n rows.

    Attributes
    ----------
    values : array, shape (n,)
        In units of each row's usual noise.
    drive : array of int, shape (n,)
        Rows that share a standard deviation.
    slopes : array, shape (n, p)
        Of the expected values by the parameters of each row's block, in the same units; 0 for none.
    block : array of int, shape (n,)
    share : array or float, shape (n,)
        Of each row's noise that was subtracted with anything else.
    """

    values: Array
    drive: IntArray
    slopes: Array
    block: IntArray
    share: Array | float = 0.0

    def __len__(self) -> int:
        return len(self.values)

    def reweight(self, ratio: Array) -> WeightedResiduals:
        """What is left with weights for noise that is `ratio` times the usual, shape (n,).

        Each drive's standard deviation is estimated anew. Gross errors draw the fit to themselves by no more
        than `MAX_PULL` standard deviations would (P. J. Huber, Ann. Math. Stat. 35:73, 1964).
        """
        values, slopes, weight = self.values / ratio, self.slopes / ratio[:, None], np.ones(len(self))
        sd = self._drive_sd(values, weight)
        for _ in range(N_PROJECTIONS):
            left, leverage, log_determinant = self._project(values / sd, slopes / sd[:, None], weight)
            free = np.maximum(1.0 - leverage - self.share, MIN_FREE)
            sd = sd * (change := self._drive_sd(left / np.sqrt(free), free))
            weight = np.minimum(1.0, MAX_PULL / np.maximum(np.abs(left / change), MAX_PULL))
        left = left / change
        log_determinant -= float(np.log(change) @ leverage)
        kept = np.maximum(1.0 - self.share, MIN_FREE) + np.zeros(len(left))
        log_volume = -float(kept @ np.log(ratio * sd)) - log_determinant
        return WeightedResiduals(ratio, left / np.sqrt(kept), kept, left / np.sqrt(free), free, log_volume)

    def _project(self, values: Array, slopes: Array, weight: Array) -> tuple[Array, Array, float]:
        """Values without their weighted fit in each block, leverages, and half the log determinant."""
        n, width = slopes.shape
        weighted = slopes * weight[:, None]
        products = (weighted[:, :, None] * slopes[:, None, :]).reshape(n, -1)
        gram = (self._sums @ products).reshape(-1, width, width)
        places = np.arange(width)
        gram[:, places, places] += gram[:, places, places] == 0  # of blocks with fewer parameters
        inverse = np.linalg.inv(gram)
        fitted = np.einsum("bij,bj->bi", inverse, self._sums @ (weighted * values[:, None]))
        leverage = np.einsum("ni,nij,nj->n", weighted, inverse[self.block], slopes)
        left = values - np.sum(slopes * fitted[self.block], axis=1)
        return left, leverage, 0.5 * float(np.sum(np.linalg.slogdet(gram)[1]))

    @cached_property
    def _sums(self) -> csr_array:
        """From rows to sums over each block."""
        n = len(self)
        return csr_array((np.ones(n), (self.block, np.arange(n))), shape=(int(self.block.max()) + 1, n))

    @cached_property
    def _drives(self) -> list[BoolArray]:
        """The rows of each drive."""
        return [self.drive == number for number in np.unique(self.drive)]

    def _drive_sd(self, values: Array, free: Array) -> Array:
        size, sd = np.abs(values), np.ones(len(values))
        for own in self._drives:
            most = MAX_MEDIANS * weighted_median(size[own], free[own])
            sd[own] = np.sqrt(np.average(np.minimum(size[own], most) ** 2, weights=free[own])) or 1.0
        return sd


def weighted_median(values: Array, weight: Array) -> float:
    """The least value up to which at least half of the weight lies.

    Examples
    --------
    >>> weighted_median(np.array([3.0, 1.0, 2.0]), np.array([5.0, 1.0, 1.0]))
    3.0
    """
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])


def residuals_of(
    linearized: LinearizedFit, values: Array, scale: Array, drive: IntArray, share: Array
) -> Residuals:
    """Residuals of a linearized fit: `values`, shape (n,), in units of another `scale`.

    `share` is as of `Residuals`; what all blocks of the fit have in common adds to it.
    """
    slopes = np.zeros((len(linearized), max([1, *(columns.shape[1] for _, columns in linearized.blocks)])))
    block = np.zeros(len(linearized), dtype=np.intp)
    for number, (rows, columns) in enumerate(linearized.blocks):
        slopes[rows, : columns.shape[1]], block[rows] = columns, number
    shared = np.sum(linearized.shared_basis**2, axis=1)
    units = linearized.scale / scale
    return Residuals(values * units, drive, slopes * units[:, None], block, share + shared)


@dataclass(frozen=True, eq=False)
class WeightedResiduals:
    """What weighted least squares leaves; n rows.

    Attributes
    ----------
    ratio : array, shape (n,)
        The noise for which the rows are weighted.
    left, kept : array, shape (n,)
        In units of that noise; and how much of a row each counts, what was subtracted with anything else
        left out.
    standardized : array, shape (n,)
        With what calibration took of their variance.
    free : array, shape (n,)
        What calibration left of each row's information.
    log_volume : float
        What belongs to the log likelihood beside the density of `left`.
    """

    ratio: Array
    left: Array
    kept: Array
    standardized: Array
    free: Array
    log_volume: float

    @property
    def log_likelihood(self) -> float:
        """Restricted, at the likeliest tails."""
        return float(np.max(_log_densities(self.left) @ self.kept + self.log_volume))


def group_rows(
    linearized: LinearizedFit, configuration: IntArray, residuals: Residuals, columns: tuple[str, ...] = ()
) -> dict[str, Grouping]:
    """Groupings of rows within which the noise may be larger, by what the rows of a group have in common.

    Of rows that are no traverses, `columns` are those on which the noise may depend.
    """
    n, known = len(linearized), linearized.table.once(_group_by_columns, columns)
    groupings = {**known.of_sessions, "configuration": _make_grouping(configuration, known.joint)}
    groupings |= known.of_carriers
    weighted = residuals.reweight(np.ones(n))
    if known.ends is not None:
        local = _bin(_estimate_local_sds(known.ends, known.joint, weighted), known.joint)
        groupings[POSITION] = _make_grouping(local, known.joint)
    if known.in_order:
        level = _rank_by_neighbours(linearized.rows["session"].to_numpy(object), weighted)
        groupings[STRETCH] = _make_grouping(level, np.zeros(n, dtype=np.intp))
    return {
        name: grouping
        for name, grouping in groupings.items()
        if 1 < len(grouping.stratum) <= n / MIN_GROUP_ROWS
    }


@dataclass(frozen=True, eq=False)
class _ColumnGroupings:
    """Groupings that follow from the columns of n rows alone.

    Attributes
    ----------
    joint : array of int, shape (n,)
        0 of what has no joint.
    ends : array, shape (n, 2), or None
        Of each traverse, the lower one first; None for rows that are no traverses.
    in_order : bool
        Whether the order of the rows is that of measurement.
    of_sessions, of_carriers : dict of str to Grouping
    """

    joint: IntArray
    ends: Array | None
    in_order: bool
    of_sessions: dict[str, Grouping]
    of_carriers: dict[str, Grouping]


def _group_by_columns(table: RowTable, columns: tuple[str, ...]) -> _ColumnGroupings:
    rows, n = table.frame, len(table)
    session = pd.factorize(rows["session"].astype(object))[0]
    joint, everywhere, ends = np.zeros(n, dtype=np.intp), np.zeros(n, dtype=np.intp), None
    of_sessions = {"session": _make_grouping(session, everywhere, 0)}
    if in_order := bool(rows["session_seconds"].notna().all()):
        part = rank_within(session) * N_PARTS // np.bincount(session)[session]
        of_sessions["part of a session"] = _make_grouping(session * N_PARTS + part, everywhere)
    of_carriers = {}
    if {"joint", "start", "stop", "before_load"} <= set(rows.columns):
        joint = rows["joint"].to_numpy(np.intp)
        ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1).round(6)
        of_carriers["range"] = _make_grouping(unique_rows(np.column_stack([joint, ends]))[1], joint)
        for carrier in find_carriers(table):
            if carrier.name not in NO_REASON:
                label = _bin(traverse_average(carrier.values), joint)
                of_carriers[carrier.name] = _make_grouping(label, joint)
    for name in columns:
        is_number = pd.api.types.is_numeric_dtype(rows[name])
        label = _bin(rows[name].to_numpy(float), joint) if is_number else pd.factorize(rows[name])[0]
        of_carriers[name] = _make_grouping(label, everywhere)
    return _ColumnGroupings(joint, ends, in_order, of_sessions, of_carriers)


def _make_grouping(
    labels: npt.NDArray[np.integer], stratum: npt.NDArray[np.integer], steps: int = STEPS_AS_ASSUMED
) -> Grouping:
    _, first, labels = np.unique(labels, return_index=True, return_inverse=True)
    return Grouping(labels.ravel().astype(np.intp), stratum[first].astype(np.intp), steps)


def _bin(values: Array, joint: npt.NDArray[np.integer]) -> npt.NDArray[np.integer]:
    """Group of each row by ranges of a coordinate in each joint, about as many rows in each; shape (n,)."""
    label = np.full(len(values), N_BINS)
    for number in np.unique(joint):
        own = (joint == number) & np.isfinite(values)
        distinct = np.unique(values[own].round(9))
        edges = (distinct[1:] + distinct[:-1]) / 2
        if len(distinct) > N_BINS:
            edges = np.unique(np.quantile(values[own], np.arange(1, N_BINS) / N_BINS))
        label[own] = np.searchsorted(edges, values[own], side="right")
    return label + (N_BINS + 1) * joint


def _rank_by_neighbours(session: Array, weighted: WeightedResiduals) -> IntArray:
    """Group of each row by the noise of its neighbours in time, about as many rows in each; shape (n,).

    The larger of those before and after it in its session, by their median, so that a burst is seen to its
    ends. The row itself has no part in it: where the noise is the same, groups differ by chance only.
    """
    size, n = np.abs(weighted.standardized), len(session)
    level = np.zeros(n)
    for label in pd.unique(session):
        own = np.flatnonzero(session == label)
        beside = np.pad(size[own], N_BESIDE)
        medians = np.median(np.lib.stride_tricks.sliding_window_view(beside, N_BESIDE), axis=1)
        level[own] = np.maximum(medians[: len(own)], medians[N_BESIDE + 1 :])
    rank = np.argsort(np.argsort(level, kind="stable"))
    return rank * int(np.clip(n // ROWS_PER_LEVEL, 1, MAX_LEVELS)) // n


def _estimate_local_sds(ends: Array, joint: npt.NDArray[np.integer], weighted: WeightedResiduals) -> Array:
    """Standard deviation of each row, (n,): its variance averages local ones between its ends, (n, 2).

    The local ones are the likeliest under Student's t (the iteration is that of A. Fevotte, N. Bertin and
    J.-L. Durrieu, Neural Comput. 21:793, 2009), drawn towards 1 as by `PRIOR_ROWS` rows.
    """
    sds, df = np.ones(len(joint)), TAIL_DF[0]
    for number in np.unique(joint):
        own = joint == number
        edges = np.linspace(ends[own].min(), ends[own].max(), N_STRETCHES + 1)
        inside = np.minimum(ends[own][:, 1:], edges[1:]) - np.maximum(ends[own][:, :1], edges[:-1])
        share = np.maximum(inside, 0.0) / np.maximum(np.ptp(ends[own], axis=1), MIN_LENGTH)[:, None]
        squares, free, local = weighted.standardized[own] ** 2, weighted.free[own], np.ones(N_STRETCHES)
        for _ in range(EM_STEPS):
            variance = np.maximum(share @ local, MIN_VARIANCE)
            usual = (df + 1.0) / (df - 2.0 + squares / variance) * squares / variance
            above = share.T @ (free * usual / variance) + PRIOR_ROWS / local**2
            local = local * above / (share.T @ (free / variance) + PRIOR_ROWS / local)
        sds[own] = np.sqrt(share @ local)
    return sds


def estimate_unevenness(residuals: Residuals, groupings: Mapping[str, Grouping]) -> Unevenness:
    """Estimate by how much noise differs between groups, where that is clearly more than assumed.

    Examples
    --------
    >>> rng, session = np.random.default_rng(1), np.repeat([0, 1, 2], 100)
    >>> noise = rng.standard_normal(300) * (1 + 4 * (session == 2))
    >>> everywhere = np.zeros(300, dtype=int)
    >>> residuals = Residuals(noise, everywhere, np.zeros((300, 1)), everywhere)
    >>> found = estimate_unevenness(residuals, {"session": Grouping(session, np.zeros(3, dtype=int), 0)})
    >>> found.carriers, float(round(found.ratio[-1] / found.ratio[0]))
    (('session',), 5.0)
    """
    ratio, carriers, remaining = np.ones(len(residuals)), [], dict(groupings)
    log_ratio, least = 0.0, MIN_LOG_RATIO + np.log(max(len(groupings), 1))
    for _ in range(MAX_ROUNDS):
        weighted = residuals.reweight(ratio)
        log_density = _tabulate(weighted.standardized, weighted.free)
        tables = {name: grouping.sum(log_density) for name, grouping in remaining.items()}
        fits = {
            name: _fit_sds(table, remaining[name])
            for name, table in tables.items()
            if _largest_gain(table, remaining[name]) > MIN_TRIAL_LOG_RATIO
        }
        likely = [name for name, fit in fits.items() if fit.log_ratio > MIN_TRIAL_LOG_RATIO]
        likely.sort(key=lambda name: -fits[name].log_ratio)
        tests = {name: _refine(residuals, ratio, remaining[name], fits[name]) for name in likely[:MAX_TRIALS]}
        clear = [name for name, test in tests.items() if test.log_ratio > least]
        if not clear:
            break
        best = max(clear, key=lambda name: tests[name].log_likelihood)
        test, grouping = tests[best], remaining.pop(best)
        log_ratio += test.log_ratio
        if grouping.steps != STEPS_AS_ASSUMED:
            test = _refine(residuals, ratio, replace(grouping, steps=STEPS_AS_ASSUMED), fits[best])
        if test.log_ratio > MIN_TWICE_LOG_RATIO:
            carriers.append(best)
        ratio = ratio * test.sds
    return Unevenness(ratio / np.exp(np.mean(np.log(ratio))), tuple(carriers), log_ratio)


@dataclass(frozen=True, eq=False)
class _SdFit:
    """Standard deviations of m groups, free and as assumed: log likelihood at each df, and estimates.

    The likelihoods are averages over the distributions of standard deviations.
    """

    log_likelihood: tuple[Array, Array]
    sds: tuple[Array, Array]

    @property
    def log_ratio(self) -> float:
        return float(np.max(self.log_likelihood[0]) - np.max(self.log_likelihood[1]))


@dataclass(frozen=True, eq=False)
class _Test:
    """Free standard deviations against ones as assumed; likelihood and estimates are those of the former."""

    log_ratio: float
    log_likelihood: float
    sds: Array


def _refine(residuals: Residuals, ratio: Array, grouping: Grouping, fit: _SdFit) -> _Test:
    """Test standard deviations of groups in rows weighted by either hypothesis's own estimates.

    `ratio`, shape (n,), is what the rows' noise is otherwise; the sds are for each row, too.
    """
    log_likelihood, sds = [], []
    for which in (0, 1):
        own = fit
        for _ in range(N_REWEIGHTS):
            used = own.sds[which][grouping.labels]
            weighted = residuals.reweight(ratio * used)
            table = grouping.sum(_tabulate(weighted.standardized * used, weighted.free))
            own = _fit_sds(table, grouping)
        # The restricted likelihood of the estimates, averaged over the standard deviations that rows allow.
        estimates = _log_densities(weighted.standardized) @ weighted.free - np.log(used) @ weighted.free
        restricted = _log_densities(weighted.left) @ weighted.kept + weighted.log_volume
        log_likelihood.append(np.max(restricted + own.log_likelihood[which] - estimates))
        sds.append(own.sds[which][grouping.labels])
    return _Test(float(log_likelihood[0] - log_likelihood[1]), float(log_likelihood[0]), sds[0])


def _log_densities(z: Array) -> Array:
    """Of noise with variance 1 and a few gross errors, one array for each of `TAIL_DF`, as precise as `z`."""
    scales = [math.sqrt((df - 2.0) / df) for df in TAIL_DF]
    noise = [log_student_t(z / one, df) - math.log(one) for one, df in zip(scales, TAIL_DF, strict=True)]
    return contaminate(np.stack(noise), z)


def contaminate(log_density: Array, z: Array) -> Array:
    """Log density of noise that is a gross error now and then."""
    log_error = log_student_t(z / CONTAMINATION_SCALE, 1.0) + math.log(CONTAMINATION / CONTAMINATION_SCALE)
    # Gross errors are never so unlikely that this overflows; it is three times as fast as `logaddexp`.
    ratio = np.exp(math.log(1.0 - CONTAMINATION) + log_density - log_error)
    return np.asarray(log_error + np.log(1.0 + ratio))


def _tabulate(z: Array, free: Array) -> Array:
    """Log density of each row at each df and relative standard deviation, shape (len(TAIL_DF), n, K).

    It counts as much as calibration left `free` of the row. In single precision, to some 1e-5 nats.
    """
    log_density = _log_densities((z[:, None] / RELATIVE_SDS).astype(np.float32)).astype(float)
    return np.asarray(free[:, None] * (log_density - np.log(RELATIVE_SDS)))


def log_student_t(x: Array, df: float) -> Array:
    """Log density of Student's t."""
    constant = math.log(poch(0.5 * df, 0.5)) - 0.5 * math.log(math.pi * df)
    return np.asarray(constant - (df + 1.0) / 2.0 * np.log(1.0 + x**2 / df))


def _largest_gain(log: Array, grouping: Grouping) -> float:
    """Log likelihood ratio of free standard deviations to ones as assumed, each group at its best."""
    free = log.max(axis=2).sum(axis=1)
    limited = sum(_reach(log[:, groups], grouping.steps).max(axis=1) for groups in grouping.strata)
    return float(np.max(free) - np.max(limited))


def _reach(log: Array, steps: int) -> Array:
    """Log likelihood of all groups, each at its best in a window of so many steps, shape (D, windows)."""
    n_windows = log.shape[2] - steps
    highest = log[:, :, :n_windows].copy()
    for first in range(1, steps + 1):
        np.maximum(highest, log[:, :, first : first + n_windows], out=highest)
    return np.asarray(highest.sum(axis=1))


def _fit_sds(log: Array, grouping: Grouping) -> _SdFit:
    """Fit the distributions of standard deviations to the groups' log likelihood, (D, m, K), by EM."""
    n_tails = len(log)
    highest = log.max(axis=2, keepdims=True)
    likelihood = np.maximum(np.exp(log - highest), MIN_LIKELIHOOD)
    total, posterior = np.zeros((2, n_tails)) + highest.sum(axis=(1, 2)), np.empty((2, *log.shape))
    for groups in grouping.strata:
        allowed = _likely_windows(log[:, groups], grouping.steps)
        weight, own = allowed / allowed.sum(axis=1, keepdims=True), likelihood[:, groups]
        turned = own.transpose(0, 2, 1)
        for _ in range(EM_STEPS):
            weight = weight * (turned @ (1.0 / (own @ weight))) / len(groups)
        value = np.log(own @ weight).sum(axis=1)
        for which, window in enumerate((np.zeros(n_tails, dtype=np.intp), 1 + value[:, 1:].argmax(axis=1))):
            total[which] += value[np.arange(n_tails), window]
            posterior[which][:, groups] = own * weight[np.arange(n_tails), :, window][:, None]
    best = [each[np.argmax(value)] for each, value in zip(posterior, total, strict=True)]
    sds = [1.0 / np.sqrt(each @ RELATIVE_SDS**-2.0 / each.sum(axis=1)) for each in best]
    return _SdFit((total[0], total[1]), (sds[0], sds[1]))


def _likely_windows(log: Array, steps: int) -> Array:
    """Standard deviations that a distribution may have, shape (df, K, W): all, then those in some window.

    `log`, shape (df, m, K), is the log likelihood of each group. Windows span `steps`; the likeliest are
    taken, each group at its best in them.
    """
    first = np.argsort(-_reach(log, steps), axis=1)[:, None, :MAX_WINDOWS]
    place = np.arange(log.shape[2])[:, None]
    inside = (place >= first) & (place <= first + steps)
    return np.concatenate([np.ones((len(log), len(place), 1)), inside], axis=2)
