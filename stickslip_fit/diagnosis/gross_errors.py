"""Gross errors: counts so far off that they would distort the noise, the baseline and every search.

They are set aside before anything else is estimated. A robust fit of the baseline shows them: iteratively
reweighted least squares under Student's t (K. Lange, R. Little and J. Taylor, JASA 84:881, 1989), first with
one set of calibration parameters for the whole campaign, where no single traverse has much leverage, then,
from its weights, with each session's own.

A large real effect is no gross error. It is shared by the traverses next to a row in time, by those of the
same configuration, or by many rows; a gross error stands alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import pdtrc, stdtr, stdtrit

from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.linearized import LawBlock, fit_extended, split_positions
from stickslip_fit.diagnosis.noise import NEIGHBOURS, Outliers, find_runs, pool_variance
from stickslip_fit.diagnosis.noise_shape import fit_skewness
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.selection import NO_ROWS, Selection, select_outliers
from stickslip_fit.diagnosis.testability import MIN_DF
from stickslip_fit.diagnosis.unevenness import MIN_FREE, Residuals, estimate_unevenness, group_rows

TAIL_DF = 5.0  # of Student's t, the heaviest tails that noise may have
UNIT_MEDIAN = float(stdtrit(TAIL_DF, 0.75))  # of its absolute value, in units of its scale
MAX_PASSES, WEIGHT_TOL = 25, 0.05
SUSPECT_Z, NO_WEIGHT = 10.0, 1e-6  # in the fit of the whole campaign; weight in that of each session
RANK_TOL = 1e-6  # singular values of a block's Jacobian, relative to the largest
PRIOR_DF = 4.0  # of the usual noise, for that of one block
MIN_SCALE = 0.01  # of a robust fit, relative to the noise by least squares
MIN_RELATIVE_SD = 0.3  # of a drive's noise, relative to that of all drives
MAX_LOOKS = 4  # for gross errors that larger ones hide
MAX_EXPECTED = 0.01  # rows of noise in the whole log that are as far off as one beside a certain gross error
# Rows that may be gross errors together with others: the probability that noise gives so many that are as far
# off as the least of them. It is small, as a tail is sensitive to the scale, which is estimated.
MAX_SUSPECTED, MAX_TOGETHER = 0.1, 1e-5
MAX_SHARE, MAX_ANYWAY = 0.05, 2  # of the rows; more are an effect, but for so few
SHARED_DEPARTURE = 0.25  # of a row's departure; a neighbour with more has it too


def find_gross_errors(problem: DiagnosisProblem, level: float, known: IntArray = NO_ROWS) -> Outliers:
    """Rows that Student's t noise gives with a probability below `level` in the whole log, and their p-value.

    None where so many rows depart that it is an effect, or where there are too few rows to tell. Beside an
    error that is many times as large another one is hidden, so that rows without the `known` ones and those
    found are looked through until none is left. The known ones are not among the result.
    """
    rows, p_value, kept = NO_ROWS, 1.0, np.setdiff1d(np.arange(len(problem)), known)
    for _ in range(MAX_LOOKS):
        more = _find_largest(set_aside(problem, np.setdiff1d(np.arange(len(problem)), kept)), level)
        if not len(more.rows):
            break
        rows, p_value = np.union1d(rows, kept[more.rows]), min(p_value, more.p_value)
        kept = np.delete(kept, more.rows)
    return Outliers(rows, p_value)


def _find_largest(problem: DiagnosisProblem, level: float) -> Outliers:
    """The largest of the gross errors, and those that these do not hide."""
    nothing = Outliers(NO_ROWS, 1.0)
    widths = [part.values.shape[1] - problem.n_shared for part in problem.parts]
    blocks = [len(np.unique(part.block)) for part in problem.parts]
    df = len(problem) - problem.n_shared - int(np.dot(widths, blocks))
    # A robust fit may run through as many rows as it has parameters; of half of them the median would be 0.
    if df < max(MIN_DF, len(problem) / 2):
        return nothing
    linearized = problem.linearize()
    if linearized.fits_exactly:
        return nothing
    z, parts = fit_robustly(problem)
    same = np.zeros(len(problem), dtype=np.intp)
    skewness = fit_skewness(z)
    symmetric = z if skewness is None else skewness.symmetrize(z)
    residuals = Residuals(symmetric, same, np.zeros((len(problem), 1)), same)
    groupings = group_rows(linearized, problem.configuration, residuals, problem.noise_columns)
    uneven = estimate_unevenness(residuals, groupings)
    ratio = np.maximum(uneven.ratio, 1.0)
    if np.any(ratio > 1.0):
        skewness = fit_skewness(z / ratio)

    def count_expected(deviation: Array) -> Array:
        """How many rows of noise alone are as far off, shape of `deviation`."""
        own = deviation if skewness is None else skewness.symmetrize(deviation)
        return 2.0 * len(problem) * stdtr(TAIL_DF, -np.abs(own))

    rows = np.flatnonzero(count_expected(z / ratio) < MAX_SUSPECTED)
    rows = rows[~(_have_company(z, rows, problem) | find_runs(rows, problem.smooth_columns, z[:, None]))]
    # A robust fit with few rows for each parameter runs through most of them, and far from the others.
    expected = count_expected(_deviation_from_others(problem, parts, ratio, rows))
    order = np.argsort(expected)
    rows, expected = rows[order], expected[order]
    # Where one is certain, another as far off as noise hardly ever is, is likely.
    found = int(np.sum(expected < MAX_EXPECTED)) if np.any(expected < level) else 0
    together = pdtrc(np.arange(len(expected)), expected)
    if len(together) and together.min() < MAX_TOGETHER:
        found = max(found, int(np.argmin(together)) + 1)
    if not 0 < found <= max(MAX_SHARE * len(problem), MAX_ANYWAY):
        return nothing
    return Outliers(np.sort(rows[:found]), float(min(expected[0], together.min())))


def _deviation_from_others(
    problem: DiagnosisProblem, parts: Sequence[LawBlock], ratio: Array, rows: IntArray
) -> Array:
    """How far rows are from what the other rows of their block predict by least squares.

    In units of the standard deviation of that difference: of the prediction, and of the noise that the others
    have by their residuals, shrunk towards the usual. The usual is `ratio` times as large in each row, shape
    (n,). Where the others do not determine the prediction, it is that of `parts`.
    """
    z = np.empty(len(problem))
    slopes: dict[int, Array] = {}
    for part in parts:
        predicted, own = part.law.model(problem.rows.iloc[part.rows])(part.values)
        z[part.rows] = problem.responses[part.rows] - predicted
        slopes |= dict(zip(part.rows.tolist(), own[:, : own.shape[1] - problem.n_shared], strict=True))
    scale = _robust_scale(z, problem) * ratio
    z /= scale
    deviation = z[rows].copy()
    for part in parts:
        for block in np.unique(part.block[np.isin(part.rows, rows)]):
            every = part.rows[part.block == block]
            others = np.setdiff1d(every, rows)
            jacobian = np.stack([slopes[row] / scale[row] for row in every])
            jacobian /= np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
            known = ~np.isin(every, rows)
            if np.linalg.matrix_rank(jacobian[known], RANK_TOL) < np.linalg.matrix_rank(jacobian, RANK_TOL):
                continue
            inverse = np.linalg.pinv(jacobian[known], RANK_TOL)
            weights = jacobian[~known] @ inverse
            difference = z[every[~known]] - weights @ z[others]
            left = z[others] - jacobian[known] @ (inverse @ z[others])
            df = len(others) - np.linalg.matrix_rank(jacobian[known], RANK_TOL)
            variance = max((PRIOR_DF + float(left @ left)) / (PRIOR_DF + df), 1.0)
            sizes = difference / np.sqrt(variance * (1.0 + np.sum(weights**2, axis=1)))
            deviation[np.searchsorted(rows, every[~known])] = sizes
    return deviation


def fit_robustly(problem: DiagnosisProblem) -> tuple[Array, tuple[LawBlock, ...]]:
    """The baseline's robust fit: residuals in units of the scale of Student's t noise, (n,), and the laws."""
    campaign = tuple(_merge_sessions(part, problem.noise_group) for part in problem.parts)
    z, weight, campaign = _iterate_weights(problem, campaign, np.ones(len(problem)))
    # In a session with few traverses a gross error may draw the fit to itself: there it has no weight.
    suspect = np.abs(z) > SUSPECT_Z
    weight = np.where(suspect & (suspect.mean() <= MAX_SHARE), NO_WEIGHT, weight)
    # Not from the least-squares values: a gross error may have driven those of its session anywhere.
    sessions = [replace(part, block=own.block) for part, own in zip(campaign, problem.parts, strict=True)]
    z, _, parts = _iterate_weights(problem, sessions, weight)
    return z, parts


def set_aside(problem: DiagnosisProblem, rows: IntArray) -> DiagnosisProblem:
    """The problem without some rows, its baseline refitted and its repeatability that of the other rows.

    Without rows it is the problem itself, unless its baseline has no finite prediction.
    """
    if not len(rows) and all(
        np.isfinite(part.law.predict(problem.rows.iloc[part.rows], part.values)).all()
        for part in problem.parts
    ):
        return problem
    trimmed = replace(problem, parts=fit_robustly(problem)[1], trimmed=len(rows) > 0)
    smaller = trimmed.without_rows(rows)
    linearized, drive, number = smaller.linearize(), smaller.noise_group, len(problem.repeatability)
    free, rounding = 1.0 - linearized.leverage, smaller.rounding / np.square(smaller.relative_sd)
    squares = np.square(linearized.residual * smaller.scale / smaller.relative_sd) - free * rounding
    df, total = np.bincount(drive, free, number), np.bincount(drive, squares, number)
    pooled = pool_variance(squares / np.maximum(free, MIN_FREE), free, rounding, np.finfo(float).tiny)
    variance = np.where(
        df > 1.0, np.maximum(total / np.maximum(df, 1.0), MIN_RELATIVE_SD**2 * pooled), pooled
    )
    return replace(smaller, repeatability=np.sqrt(variance))


def with_gross_errors(selection: Selection, n: int, aside: IntArray, p_value: float) -> Selection:
    """A selection from the other rows as one of all `n` rows, with the gross errors among its outliers."""
    if not len(aside):
        return selection
    kept = np.setdiff1d(np.arange(n), aside)
    others = [one for one in selection.selected if one.misfit is not None]
    return replace(
        selection,
        outliers=np.sort(np.concatenate([aside, kept[selection.outliers]])),
        selected=(select_outliers(selection.problem, p_value), *others),
        p_value=min(selection.p_value, p_value),
    )


def _iterate_weights(
    problem: DiagnosisProblem, parts: Sequence[LawBlock], weight: Array
) -> tuple[Array, Array, tuple[LawBlock, ...]]:
    """Residuals in units of their scale, relative weights, and the laws, after convergence.

    Rows of `NO_WEIGHT` keep it.
    """
    scale = problem.scale
    for _ in range(MAX_PASSES):
        sd = scale / np.sqrt(weight)
        fit = fit_extended(
            problem.table, parts, problem.responses, sd, (), np.zeros(0), n_shared=problem.n_shared
        )
        parts = fit.parts
        scale = _robust_scale(fit.residual, problem)
        z = fit.residual / scale
        held, before = weight == NO_WEIGHT, weight
        weight = np.where(held, NO_WEIGHT, (TAIL_DF + 1.0) / (TAIL_DF + z**2))
        if np.max(np.abs(np.log(weight / before))) < WEIGHT_TOL:
            break
    return z, weight, tuple(parts)


def _robust_scale(residual: Array, problem: DiagnosisProblem) -> Array:
    """Scale of Student's t noise by the median of each drive's absolute residuals, shape (n,).

    Where most rows are equal, as many zeros are, a law may run through all of them, so that the median is 0.
    Rounding differs between the rows of a drive, and adds at least its own part.
    """
    size, drive = np.abs(residual) / problem.relative_sd, problem.noise_group
    pooled = max(float(np.median(size)), np.finfo(float).tiny)
    median = np.full(int(drive.max()) + 1, pooled)
    for number in np.unique(drive):
        median[number] = max(float(np.median(size[drive == number])), MIN_RELATIVE_SD * pooled)
    own = np.maximum(median[drive] * problem.relative_sd / UNIT_MEDIAN, MIN_SCALE * problem.scale)
    return np.maximum(own, np.sqrt(problem.rounding))


def _merge_sessions(part: LawBlock, drive: IntArray) -> LawBlock:
    """One block for each drive, at the median of its sessions' values."""
    block = drive[part.rows]
    values = np.empty_like(part.values)
    for number in np.unique(block):
        inside = block == number
        values[inside] = np.median(part.values[inside], axis=0)
    return replace(part, block=block, values=values)


def _have_company(z: Array, rows: IntArray, problem: DiagnosisProblem) -> BoolArray:
    """Whether most of a row's neighbours in time, or of its replicates, depart as it does."""
    session = problem.rows["session"].astype(object).factorize()[0]
    group = unique_rows(np.column_stack([session, problem.noise_group]))[1]
    cell = unique_rows(np.column_stack([problem.configuration, problem.noise_group]))[1]
    in_time, replicates = split_positions(group), split_positions(cell)
    company = np.zeros(len(rows), dtype=bool)
    for k, row in enumerate(rows):
        series = in_time[group[row]]
        place = int(np.searchsorted(series, row))
        before, after = series[max(place - NEIGHBOURS, 0) : place], series[place + 1 : place + 1 + NEIGHBOURS]
        same = replicates[cell[row]]
        company[k] = any(
            len(others) > 0 and np.mean(z[others] / z[row] > SHARED_DEPARTURE) > 0.5
            for others in (before, after, np.r_[before, after], same[same != row])
        )
    return company
