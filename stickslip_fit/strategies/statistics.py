"""Statistics of prediction errors: rms, bias and worst with intervals, paired tests, Cramer-Rao bound.

Units are sessions, or configurations where there is one session. Intervals of rms errors combine Cox's
for the mean of log-normal variables (Zhou and Gao, Stat. Med. 16:783, 1997) with that of the sample
mean. Pairs of strategies are compared by t tests on log ratios, with variances shrunk by empirical
Bayes (G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3:3, 2004) and p-values adjusted after Holm. The bound
holds for unbiased estimators that use the traverses of one session only.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import digamma, polygamma, stdtr, stdtrit

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import adjust_holm
from stickslip_fit.estimation._optimize import RANK_TOL
from stickslip_fit.estimation.noise import COVERAGE
from stickslip_fit.laws import traverse_length
from stickslip_fit.strategies.base import LawEstimate, LawFit, solve_together, stepping_seconds
from stickslip_fit.strategies.designs import PRIOR_INFORMATION, add_rows, improve_design, mean_variance_loss
from stickslip_fit.strategies.evaluation import POSITION_COLUMNS, EvaluationCase

SESSION_UNIT, CONFIGURATION_UNIT = ("session",), ("direction", *POSITION_COLUMNS)
MIN_RELATIVE_SIZE = 0.1  # of the mean
MAX_INTERVAL_FACTOR = 100.0  # factor; an interval that reaches further either way says nothing
ERROR_SCALES = {"": "absolute", "_relative": "relative"}


def add_errors(table: pd.DataFrame) -> pd.DataFrame:
    """With columns absolute (rad or m) and relative: predicted less measured mean step size."""
    return table.assign(
        absolute=table["predicted"] - table["measured"],
        relative=table["predicted"] / table["measured"] - 1.0,
        **{name: table[name].round(9) + 0.0 for name in POSITION_COLUMNS},
    )


def summarize_errors(errors: pd.DataFrame, by: Sequence[str], unit: Sequence[str]) -> pd.DataFrame:
    """Rms, bias and largest error, every sampling unit (session) with the same weight.

    Parameters
    ----------
    errors : DataFrame
        As `add_errors` returns it.
    by : sequence of str
        Columns to group by.
    unit : sequence of str
        Columns of the sampling unit: `SESSION_UNIT`, or `CONFIGURATION_UNIT` where there is one session.

    Returns
    -------
    DataFrame
        The columns `by`, traverses, units, and for absolute errors, and relative ones under ``_relative``:
        rms and bias with ``_low`` and ``_high``, 95 % by Student's t over the units (of rms on the log
        scale, and wide enough for heavy tails); worst, the largest error with its sign; typical_worst,
        the mean of the units' largest absolute errors, with its interval. An interval is NaN where there is
        one unit, and where it would reach beyond a factor of 100 either way.
    """
    keys = [*by, *(name for name in unit if name not in by)]
    of_unit = _Groups(_number_groups(errors, keys))
    of_group = _Groups(_number_groups(errors, by))
    units = _Groups(of_group.number[of_unit.first])
    summary = errors[[*by]].iloc[of_group.first].reset_index(drop=True)
    traverse, distinct = pd.factorize(errors["traverse"])
    pairs = np.unique(of_group.number * len(distinct) + traverse)
    traverses = np.bincount(pairs // max(len(distinct), 1))
    columns: dict[str, npt.ArrayLike] = {"traverses": traverses, "units": units.size}
    reach = t_half_width(units.size)
    for suffix, kind in ERROR_SCALES.items():
        error = errors[kind].to_numpy(float)
        square, half = _log_interval(of_unit.mean(error**2), units)
        columns |= _with_log_interval(f"rms{suffix}", np.sqrt(square), half / 2)
        mean = of_unit.mean(error)
        bias, half = units.mean(mean), reach * np.sqrt(units.variance(mean) / units.size)
        columns |= {
            f"bias{suffix}": bias,
            f"bias{suffix}_low": bias - half,
            f"bias{suffix}_high": bias + half,
        }
        high, low = of_group.maximum(error), -of_group.maximum(-error)
        columns[f"worst{suffix}"] = np.where(high >= -low, high, low)
        columns |= _with_log_interval(
            f"typical_worst{suffix}", *_log_interval(of_unit.maximum(np.abs(error)), units)
        )
    return summary.assign(**columns)


def _number_groups(errors: pd.DataFrame, by: Sequence[str]) -> IntArray:
    """The group of each row, numbered as they first appear."""
    return errors.groupby(list(by), dropna=False, observed=True, sort=False).ngroup().to_numpy(np.intp)


class _Groups:
    """Statistics over groups of values, from the number of each value's group."""

    def __init__(self, number: IntArray) -> None:
        self.number = number
        self.size = np.bincount(number)
        self.first = np.unique(number, return_index=True)[1]

    def mean(self, values: Array) -> Array:
        return np.bincount(self.number, values) / self.size

    def variance(self, values: Array) -> Array:
        """Of a sample; NaN where a group has one value."""
        squares = np.bincount(self.number, (values - self.mean(values)[self.number]) ** 2)
        return squares / np.where(self.size > 1, self.size - 1, np.nan)

    def maximum(self, values: Array) -> Array:
        largest = np.full(len(self.size), -np.inf)
        np.maximum.at(largest, self.number, values)
        return largest


def t_half_width(units: npt.ArrayLike) -> Array:
    """Half-width of a 95 % interval of a mean over so many units, in standard errors; NaN for one."""
    df = np.asarray(units, float) - 1.0
    return np.asarray(stdtrit(np.where(df > 0, df, np.nan), 0.5 + COVERAGE / 2))


def _log_interval(values: Array, groups: _Groups) -> tuple[Array, Array]:
    """Mean of positive numbers over the units, and the half-width of the 95 % interval of its logarithm.

    Cox's width for the mean of log-normal numbers (Zhou and Gao, Stat. Med. 16:783, 1997) is right where a
    small mean comes with a small spread; that of the sample mean, where tails are heavier than log-normal.
    Under scatter like Student's t with 5 df either covers 88 to 93 %. The root of their squares' sum covers
    95 %, and 97 to nearly 100 % where the scatter is Gaussian.
    """
    size, mean = groups.size, groups.mean(values)
    # A unit without error by chance has a logarithm that would dominate the spread.
    spread = groups.variance(np.log(np.maximum(values, MIN_RELATIVE_SIZE * mean[groups.number])))
    cox = spread / size + spread**2 / (2 * np.maximum(size - 1, 1))
    plain = groups.variance(values) / mean**2 / size
    return mean, t_half_width(size) * np.sqrt(cox + plain)


def _with_log_interval(name: str, value: Array, half: Array) -> dict[str, Array]:
    """Columns of a value and its interval."""
    factor = np.exp(np.where(half <= np.log(MAX_INTERVAL_FACTOR), half, np.nan))
    return {name: value, f"{name}_low": value / factor, f"{name}_high": value * factor}


MIN_VARIANCES = 3  # fewer do not determine their prior
MAX_LOG_PRIOR_DF = 12.0  # largest absolute logarithm of half the prior's df


def shrink_variances(variance: Array, df: int, max_df: int) -> tuple[Array, float]:
    """Shrink variances towards their common prior, by empirical Bayes (Smyth 2004).

    Parameters
    ----------
    variance : array, shape (m,)
        Above 0.
    df : int
        Of each.
    max_df : int
        Of all of them together; upper limit of the df returned.

    Returns
    -------
    variance : array, shape (m,)
    df : float
        Of each, the prior's included.

    Examples
    --------
    Three variances that differ by no more than chance become one:

    >>> variance, df = shrink_variances(np.array([1.0, 0.5, 2.0]), df=2, max_df=6)
    >>> variance.round(2), df
    (array([1.78, 1.78, 1.78]), 6.0)
    """
    from scipy.optimize import brentq

    if len(variance) < MIN_VARIANCES:
        return variance, float(df)
    half = df / 2.0
    log = np.log(variance) - digamma(half) + np.log(half)
    excess = float(np.var(log, ddof=1) - polygamma(1, half))
    if excess <= polygamma(1, np.exp(MAX_LOG_PRIOR_DF)):
        return np.full(len(variance), np.exp(log.mean())), float(max_df)
    half_prior_df = np.exp(
        brentq(lambda size: float(polygamma(1, np.exp(size))) - excess, -MAX_LOG_PRIOR_DF, MAX_LOG_PRIOR_DF)
    )
    prior_variance = np.exp(log.mean() + digamma(half_prior_df) - np.log(half_prior_df))
    shrunk = (2.0 * half_prior_df * prior_variance + df * variance) / (2.0 * half_prior_df + df)
    return shrunk, float(min(2.0 * half_prior_df + df, max_df))


SIGNIFICANCE_LEVEL = 0.05
BETTER, WORSE, INDISTINGUISHABLE = "better", "worse", "indistinguishable on this log"


def compare_pairs(errors: pd.DataFrame, unit: Sequence[str]) -> pd.DataFrame:
    """Differences of rms between every two strategies of one joint, over its units (sessions).

    Parameters
    ----------
    errors : DataFrame
        Of one joint, as `add_errors` returns it, the same traverses for every strategy.
    unit : sequence of str
        See `summarize_errors`.

    Returns
    -------
    DataFrame
        strategy, other, units; difference, the mean over the units of the rms of `strategy` less that of
        `other`, with ``_low`` and ``_high`` (95 %, Student's t), absolute and under ``_relative``; p, of the
        paired t test on the log ratio of relative rms; p_adjusted, for all pairs of the joint (Holm); and
        verdict on `strategy`.
    """
    names = list(dict.fromkeys(errors["strategy"]))
    squares = errors.assign(**{kind: errors[kind] ** 2 for kind in ERROR_SCALES.values()})
    by_unit = squares.groupby([*unit, "strategy"], dropna=False, observed=True, sort=False)
    rms = {  # shape (units, strategies)
        kind: np.sqrt(by_unit[kind].mean().unstack("strategy")[names].to_numpy())
        for kind in ERROR_SCALES.values()
    }
    combined = list(combinations(range(len(names)), 2))
    if not combined:
        return pd.DataFrame()
    first, second = np.array(combined).T
    units, labels = len(rms["relative"]), np.array(names, object)
    pairs = pd.DataFrame({"strategy": labels[first], "other": labels[second], "units": units})
    for suffix, kind in ERROR_SCALES.items():
        difference = rms[kind][:, first] - rms[kind][:, second]
        mean, half = difference.mean(axis=0), np.full(len(pairs), np.nan)
        if units > 1:
            half = t_half_width(units) * (difference.std(axis=0, ddof=1) / np.sqrt(units))
        pairs[f"difference{suffix}"] = mean
        pairs[f"difference{suffix}_low"], pairs[f"difference{suffix}_high"] = mean - half, mean + half
    # A strategy without error by chance has a logarithm that would dominate all ratios.
    log = np.log(np.maximum(rms["relative"], MIN_RELATIVE_SIZE * rms["relative"].mean(axis=0)))
    log_ratio = log[:, first] - log[:, second]
    pairs["p"] = paired_t_p_values(log_ratio, max_df=(len(names) - 1) * (units - 1))
    pairs["p_adjusted"] = adjust_holm(pairs["p"])
    less, more = (
        (sign * pairs["difference_relative"] < 0) & (sign * log_ratio.mean(axis=0) < 0) for sign in (1, -1)
    )
    significant = pairs["p_adjusted"] < SIGNIFICANCE_LEVEL
    verdicts = [significant & less, significant & more]
    pairs["verdict"] = np.select(verdicts, [BETTER, WORSE], INDISTINGUISHABLE)
    return pairs


def paired_t_p_values(log_ratios: Array, max_df: int) -> Array:
    """Of paired t tests with shrunken variances, shape (m,); 1 where one unit or nothing differs.

    Parameters
    ----------
    log_ratios : array, shape (units, m)
        Of what is compared, such as rms errors.
    max_df : int
        Of all of them together, see `shrink_variances`.

    Examples
    --------
    >>> paired_t_p_values(np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]]), max_df=2).round(3)
    array([0.074, 1.   ])
    """
    units, p_values = len(log_ratios), np.ones(log_ratios.shape[1])
    differ = np.flatnonzero(np.ptp(log_ratios, axis=0) > 0)
    if units > 1 and len(differ):
        mean, variance = log_ratios[:, differ].mean(axis=0), log_ratios[:, differ].var(axis=0, ddof=1)
        shrunk, df = shrink_variances(variance, units - 1, max_df)
        p_values[differ] = 2 * stdtr(df, -np.abs(mean) / np.sqrt(shrunk / units))
    return p_values


def compute_bounds(
    cases: Sequence[EvaluationCase], held_out: Array, max_traverses: int, handling_time: float
) -> pd.DataFrame:
    """Cramer-Rao bound of held-out errors with an I-optimal design of k traverses of the same session.

    The bound holds for unbiased estimates from that session's traverses only, under the true law. Estimates
    that use other sessions too, and biased ones, may have smaller errors.

    Parameters
    ----------
    cases : sequence of EvaluationCase
        Of one joint.
    held_out : array of int
        The traverses that are predicted, as `EvaluationTables.errors` numbers them.
    max_traverses : int
        Largest k, in one direction.
    handling_time : float
        Seconds that a traverse costs beside its steps.

    Returns
    -------
    DataFrame
        traverses (in each direction), seconds (of a session, both directions), and rms, rms_relative, floor,
        floor_relative of a held-out traverse: the bound, and its part that remains when the law is known.
    """
    tasks = [case.task for case in cases]
    fits = [LawFit(one.law, case.rows, one.repeatability) for one, case in zip(tasks, cases, strict=True)]
    tables = [
        _compute_case_bounds(case, estimate, held_out, max_traverses, handling_time)
        for case, estimate in zip(cases, solve_together(fits), strict=True)
    ]
    if all(table.empty for table in tables):
        return pd.DataFrame()
    table = pd.concat([table for table in tables if len(table)])
    sessions = table.groupby(["session", "traverses"], sort=False)
    summed = sessions["seconds"].sum().groupby("traverses").mean()
    weights = table["rows"]
    columns = ["square", "square_relative", "noise", "noise_relative"]
    pooled = table[columns].mul(weights, axis=0).assign(traverses=table["traverses"], rows=weights)
    sums = pooled.groupby("traverses").sum()
    bounds = np.sqrt(sums[columns].div(sums["rows"], axis=0))
    bounds.columns = pd.Index(["rms", "rms_relative", "floor", "floor_relative"])
    return bounds.assign(seconds=summed).reset_index()


def prediction_variance(jacobian: Array, measured: Array, variance: Array) -> Array:
    """Cramer-Rao bound of the variance of responses, shape (n, p) -> (n,).

    Parameters
    ----------
    jacobian : array, shape (n, p)
        Of the responses to predict.
    measured : array, shape (k, p)
        Jacobian of the measured responses.
    variance : array, shape (k,)
        Of the measured responses.

    Notes
    -----
    Directions in parameter space that the measured traverses do not determine count as known: under a design
    that is optimal for the rows to predict, these rows do not depend on them.
    """
    estimator = np.linalg.pinv(measured / np.sqrt(variance)[:, None], rcond=RANK_TOL)
    return np.sum((jacobian @ estimator) ** 2, axis=1)


def _compute_case_bounds(
    case: EvaluationCase, estimate: LawEstimate, held_out: Array, max_traverses: int, handling_time: float
) -> pd.DataFrame:
    task, rows, law = case.task, case.rows, case.task.law
    is_test = rows.index.isin(held_out)
    if not is_test.any() or not estimate.known.all():
        return pd.DataFrame()
    candidate = rows.index.get_indexer(task.offered.index)
    y, rounding = law.response(rows)
    variance = task.repeatability**2 + rounding
    scales = law.scales(np.exp(np.mean(np.log(traverse_length(rows)) - y, keepdims=True)))[0]
    slopes = law.jacobian(rows, np.broadcast_to(estimate.values, (len(rows), len(scales)))) * scales
    noise, step = variance[is_test], traverse_length(rows[is_test]) / np.exp(y[is_test])
    seconds = stepping_seconds(rows.iloc[candidate]) + handling_time
    aim = mean_variance_loss(slopes[is_test]), PRIOR_INFORMATION * np.eye(len(scales))
    most, offered, records = min(max_traverses, len(candidate)), slopes[candidate], []
    added = add_rows(offered, most, *aim)
    for count in range(len(scales), most + 1):
        chosen = improve_design(offered, added[:count], *aim)
        design = candidate[chosen]
        square = noise + prediction_variance(slopes[is_test], slopes[design], variance[design])
        records.append(
            {
                "session": task.session,
                "traverses": count,
                "seconds": seconds[chosen].sum(),
                "rows": len(noise),
                "square": np.mean(square * step**2),
                "square_relative": np.mean(square),
                "noise": np.mean(noise * step**2),
                "noise_relative": np.mean(noise),
            }
        )
    return pd.DataFrame(records)
