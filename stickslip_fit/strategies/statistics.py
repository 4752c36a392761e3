"""Statistics of prediction errors: rms, bias and worst with intervals, paired tests, Cramer-Rao bound.

Units are sessions, or configurations where there is one session. Intervals of rms errors combine Cox's
for the mean of log-normal variables (Zhou and Gao, Stat. Med. 16:783, 1997) with that of the sample
mean. Pairs of strategies are compared by t tests on log ratios, with variances shrunk by empirical
Bayes (G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3:3, 2004) and p-values adjusted after Holm. The bound
holds for unbiased estimators that use the traverses of one session only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.optimize import brentq
from scipy.special import digamma, polygamma
from scipy.stats import t as student_t

from stickslip_fit._typing import Array
from stickslip_fit.anova.contrasts import adjust_holm
from stickslip_fit.estimation._optimize import RANK_TOL, mean_step_sizes
from stickslip_fit.estimation.noise import COVERAGE
from stickslip_fit.laws import traverse_length
from stickslip_fit.strategies.base import solve_law, stepping_seconds
from stickslip_fit.strategies.designs import PRIOR_INFORMATION, exchange_rows, mean_variance_loss
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
    """Sum up errors, every unit (session) counting alike.

    Parameters
    ----------
    errors : DataFrame
        As `with_errors` returns it.
    by : sequence of str
        Columns to group by.
    unit : sequence of str
        Columns that say what was drawn at random: `SESSIONS`, or `CONFIGURATIONS` where there is one session.

    Returns
    -------
    DataFrame
        The columns `by`, traverses, units, and for absolute errors, and relative ones under ``_relative``:
        rms and bias with ``_low`` and ``_high``, 95 % by Student's t over the units (of sizes by the
        logarithm, and wide enough for heavy tails); worst, the largest error with its sign; typical_worst,
        the mean of the units' worst sizes, with its interval. An interval is NaN where there is one unit,
        and where it would reach beyond a factor of 100 either way.
    """
    keys = [*by, *(name for name in unit if name not in by)]
    work = errors.assign(**{f"square_{kind}": errors[kind] ** 2 for kind in ERROR_SCALES.values()})
    work = work.assign(**{f"size_{kind}": errors[kind].abs() for kind in ERROR_SCALES.values()})
    each = work.groupby(keys, dropna=False, observed=True, sort=False).agg(
        **{f"square_{kind}": (f"square_{kind}", "mean") for kind in ERROR_SCALES.values()},
        **{f"mean_{kind}": (kind, "mean") for kind in ERROR_SCALES.values()},
        **{f"worst_{kind}": (f"size_{kind}", "max") for kind in ERROR_SCALES.values()},
    )
    units = each.groupby(level=list(by), dropna=False, observed=True, sort=False)
    groups = errors.groupby(list(by), dropna=False, observed=True, sort=False)
    found = pd.DataFrame({"traverses": groups["traverse"].nunique(), "units": units.size()})
    for suffix, kind in ERROR_SCALES.items():
        square, half = _log_interval(each, f"square_{kind}", by)
        _add_log_interval(found, f"rms{suffix}", np.sqrt(square), half / 2)
        bias, error = units[f"mean_{kind}"].mean(), units[f"mean_{kind}"].std(ddof=1) / np.sqrt(units.size())
        found[f"bias{suffix}"] = bias
        found[f"bias{suffix}_low"] = bias - t_half_width(found["units"]) * error
        found[f"bias{suffix}_high"] = bias + t_half_width(found["units"]) * error
        high, low = groups[kind].max(), groups[kind].min()
        found[f"worst{suffix}"] = high.where(high >= -low, low)
        worst, half = _log_interval(each, f"worst_{kind}", by)
        _add_log_interval(found, f"typical_worst{suffix}", worst, half)
    return found.reset_index()


def t_half_width(units: npt.ArrayLike) -> Array:
    """Half-width of a 95 % interval of a mean over so many units, in standard errors; NaN for one."""
    df = np.asarray(units, float) - 1.0
    return np.asarray(student_t.ppf(0.5 + COVERAGE / 2, np.where(df > 0, df, np.nan)))


def _log_interval(each: pd.DataFrame, name: str, by: Sequence[str]) -> tuple[pd.Series, pd.Series]:
    """Mean of what is above 0, and the half-width of an interval of its logarithm.

    Cox's width, of the mean of log-normal numbers (Zhou and Gao, Stat. Med. 16:783, 1997), allows for small
    means that come with small spreads; the width from the spread itself, for tails that are no log-normal
    ones. Neither holds by itself under scatter like Student's t with 5 degrees of freedom (88 to 93 % of 95);
    their squares' sum does, and is wide where the scatter is Gaussian (97 to nearly 100 %).
    """
    units = each[name].groupby(level=list(by), dropna=False, observed=True, sort=False)
    size, mean = units.size(), units.mean()
    # A unit may be right to the last step by luck; its logarithm must not rule all others.
    kept = np.log(np.maximum(each[name], MIN_RELATIVE_SIZE * units.transform("mean")))
    spread = kept.groupby(level=list(by), dropna=False, observed=True, sort=False).var(ddof=1)
    cox = spread / size + spread**2 / (2 * np.maximum(size - 1, 1))
    plain = units.var(ddof=1) / mean**2 / size
    return mean, t_half_width(size) * np.sqrt(cox + plain)


def _add_log_interval(found: pd.DataFrame, name: str, value: pd.Series, half: pd.Series) -> None:
    factor = np.exp(half.where(half <= np.log(MAX_INTERVAL_FACTOR)))
    found[name] = value
    found[f"{name}_low"], found[f"{name}_high"] = value / factor, value * factor


MIN_VARIANCES = 3  # variances that say anything about how variances spread
MAX_LOG_PRIOR_DF = 12.0  # log of the most and of the fewest degrees of freedom that others may add


@dataclass(frozen=True, eq=False)
class EmpiricalBayesVariances:
    """Variances drawn together.

    Attributes
    ----------
    variance : array, shape (m,)
    freedom : float
        Degrees of freedom of each.
    """

    variance: Array
    df: float


def shrink_variances(variance: Array, df: int, most: int) -> EmpiricalBayesVariances:
    """Draw variances towards what they have in common, the more alike they are.

    Parameters
    ----------
    variance : array, shape (m,)
        Above 0.
    freedom : int
        Degrees of freedom of each.
    most : int
        Degrees of freedom in all of them together, which none can have more than.

    Examples
    --------
    Three variances that differ by no more than chance become one:

    >>> found = shrink_variances(np.array([1.0, 0.5, 2.0]), df=2, most=6)
    >>> found.variance.round(2), found.df
    (array([1.78, 1.78, 1.78]), 6.0)
    """
    if len(variance) < MIN_VARIANCES:
        return EmpiricalBayesVariances(variance, float(df))
    half = df / 2.0
    log = np.log(variance) - digamma(half) + np.log(half)
    beyond = float(np.var(log, ddof=1) - polygamma(1, half))
    if beyond <= polygamma(1, np.exp(MAX_LOG_PRIOR_DF)):
        return EmpiricalBayesVariances(np.full(len(variance), np.exp(log.mean())), float(most))
    prior = np.exp(
        brentq(lambda size: float(polygamma(1, np.exp(size))) - beyond, -MAX_LOG_PRIOR_DF, MAX_LOG_PRIOR_DF)
    )
    usual = np.exp(log.mean() + digamma(prior) - np.log(prior))
    drawn = (2.0 * prior * usual + df * variance) / (2.0 * prior + df)
    return EmpiricalBayesVariances(drawn, float(min(2.0 * prior + df, most)))


SIGNIFICANCE_LEVEL = 0.05
BETTER, WORSE, INDISTINGUISHABLE = "better", "worse", "indistinguishable on this log"


def compare_pairs(errors: pd.DataFrame, unit: Sequence[str]) -> pd.DataFrame:
    """Differences of rms between every two strategies of one joint, over its units (sessions).

    Parameters
    ----------
    errors : DataFrame
        Of one joint, as `with_errors` returns it, the same traverses for every strategy.
    unit : sequence of str
        See `summarise`.

    Returns
    -------
    DataFrame
        strategy, other, units; difference, the mean over the units of the rms of `strategy` less that of
        `other`, with ``_low`` and ``_high`` (95 %, Student's t), absolute and under ``_relative``; p, of the
        paired t test on the log ratio of relative rms; p_adjusted, for all pairs of the joint (Holm); and
        verdict on `strategy`.
    """
    names = list(dict.fromkeys(errors["strategy"]))
    rms = {kind: _rms_by_unit(errors, kind, unit, names) for kind in ERROR_SCALES.values()}
    pairs = list(combinations(range(len(names)), 2))
    if not pairs:
        return pd.DataFrame()
    first, second = np.array(pairs).T
    found = pd.DataFrame(
        {
            "strategy": np.array(names, object)[first],
            "other": np.array(names, object)[second],
            "units": len(rms["relative"]),
        }
    )
    for suffix, kind in ERROR_SCALES.items():
        difference = rms[kind][:, first] - rms[kind][:, second]
        mean, error = _mean_and_error(difference)
        half = t_half_width(len(difference)) * error
        found[f"difference{suffix}"] = mean
        found[f"difference{suffix}_low"], found[f"difference{suffix}_high"] = mean - half, mean + half
    # A strategy may be right to the last step by luck; its logarithm must not rule all others.
    log = np.log(np.maximum(rms["relative"], MIN_RELATIVE_SIZE * rms["relative"].mean(axis=0)))
    log_ratio = log[:, first] - log[:, second]
    found["p"] = paired_t_p_values(log_ratio, most=(len(names) - 1) * (len(log) - 1))
    found["p_adjusted"] = adjust_holm(found["p"])
    less, more = (
        (sign * found["difference_relative"] < 0) & (sign * log_ratio.mean(axis=0) < 0) for sign in (1, -1)
    )
    seen = found["p_adjusted"] < SIGNIFICANCE_LEVEL
    found["verdict"] = np.select([seen & less, seen & more], [BETTER, WORSE], INDISTINGUISHABLE)
    return found


def paired_t_p_values(log_ratios: Array, most: int) -> Array:
    """Of the paired t test, shape (units, m) -> (m,); 1 where there is one unit or nothing differs.

    The variances are moderated: three sessions alone could hardly show any difference of many.

    Parameters
    ----------
    log_ratios : array, shape (units, m)
        Of what is compared, such as rms errors.
    most : int
        Degrees of freedom in all of them together.

    Examples
    --------
    >>> paired_t_p_values(np.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]]), most=2).round(3)
    array([0.074, 1.   ])
    """
    units, found = len(log_ratios), np.ones(log_ratios.shape[1])
    differ = np.flatnonzero(np.ptp(log_ratios, axis=0) > 0)
    if units > 1 and len(differ):
        mean, variance = log_ratios[:, differ].mean(axis=0), log_ratios[:, differ].var(axis=0, ddof=1)
        moderated = shrink_variances(variance, units - 1, most)
        found[differ] = 2 * student_t.sf(np.abs(mean) / np.sqrt(moderated.variance / units), moderated.df)
    return found


def _mean_and_error(differences: Array) -> tuple[Array, Array]:
    if len(differences) < 2:
        return differences.mean(axis=0), np.full(differences.shape[1], np.nan)
    return differences.mean(axis=0), differences.std(axis=0, ddof=1) / np.sqrt(len(differences))


def _rms_by_unit(errors: pd.DataFrame, kind: str, unit: Sequence[str], names: list[str]) -> Array:
    """Shape (units, strategies)."""
    squares = errors.assign(square=errors[kind] ** 2)
    each = squares.groupby([*unit, "strategy"], dropna=False, observed=True, sort=False)["square"].mean()
    return np.sqrt(each.unstack("strategy")[names].to_numpy())


def compute_bounds(
    trials: Sequence[EvaluationCase], held_out: Array, most: int, handling: float
) -> pd.DataFrame:
    """What the k traverses of a session that predict the held-out ones best could reach.

    The bound is that of an unbiased estimate which knows only today's traverses, under a law that is right;
    what borrows from other sessions may do better, and what is biased may be lucky.

    Parameters
    ----------
    trials : sequence of Trial
        Of one joint.
    held_out : array of int
        Places of the traverses that are predicted, see `Outcomes.errors`.
    most : int
        Traverses in a direction up to which to go.
    handling : float
        Seconds that a traverse costs beside its steps.

    Returns
    -------
    DataFrame
        traverses (in each direction), seconds (of a session, both directions), and rms, rms_relative, floor,
        floor_relative of a held-out traverse: the bound, and what remains of it when the law is known.
    """
    tables = [
        each
        for trial in trials
        if (each := _compute_case_bounds(trial, held_out, most, handling)) is not None
    ]
    if not tables:
        return pd.DataFrame()
    table = pd.concat(tables)
    both = table.groupby(["session", "traverses"], sort=False)
    summed = both["seconds"].sum().groupby("traverses").mean()
    weights = table["rows"]
    columns = ["square", "square_relative", "noise", "noise_relative"]
    pooled = table[columns].mul(weights, axis=0).assign(traverses=table["traverses"], rows=weights)
    sums = pooled.groupby("traverses").sum()
    found = np.sqrt(sums[columns].div(sums["rows"], axis=0))
    found.columns = pd.Index(["rms", "rms_relative", "floor", "floor_relative"])
    return found.assign(seconds=summed).reset_index()


def prediction_variance(jacobian: Array, made: Array, variance: Array) -> Array:
    """Cramer-Rao bound of the variance of responses, shape (n, p) -> (n,).

    Parameters
    ----------
    jacobian : array, shape (n, p)
        Slopes of the responses to predict.
    made : array, shape (k, p)
        Slopes of the traverses made.
    variance : array, shape (k,)
        Of their responses.

    Notes
    -----
    What the traverses made leave open counts as known: a choice that is best for the rows to predict leaves
    open only what these do not depend on.
    """
    estimator = np.linalg.pinv(made / np.sqrt(variance)[:, None], rcond=RANK_TOL)
    return np.sum((jacobian @ estimator) ** 2, axis=1)


def _compute_case_bounds(
    trial: EvaluationCase, held_out: Array, most: int, handling: float
) -> pd.DataFrame | None:
    task, rows = trial.task, trial.rows
    found = solve_law(task.law, rows, task.repeatability)
    held = rows[rows.index.isin(held_out)]
    if held.empty or not found.known.all():
        return None
    offered = rows.loc[task.offered.index]
    y, rounding = task.law.response(rows)
    variance = pd.Series(task.repeatability**2 + rounding, rows.index)
    scales = task.law.scales(mean_step_sizes(found.groups, rows, y))[0]
    slopes = task.law.jacobian(rows, np.broadcast_to(found.values[0], (len(rows), len(scales)))) * scales
    of_row = pd.DataFrame(slopes, rows.index)
    region, candidates = (of_row.loc[each.index].to_numpy() for each in (held, offered))
    noise, step = (
        variance[held.index].to_numpy(),
        (traverse_length(held) / np.exp(y[rows.index.isin(held.index)])),
    )
    seconds = stepping_seconds(offered) + handling
    lines = []
    for count in range(len(scales), min(most, len(offered)) + 1):
        prior = PRIOR_INFORMATION * np.eye(len(scales))
        chosen = exchange_rows(candidates, count, mean_variance_loss(region), prior)
        made = variance[offered.index].to_numpy()[chosen]
        square = noise + prediction_variance(region, candidates[chosen], made)
        lines.append(
            {
                "session": task.session, "traverses": count, "seconds": seconds[chosen].sum(),
                "rows": len(held), "square": np.mean(square * step**2), "square_relative": np.mean(square),
                "noise": np.mean(noise * step**2), "noise_relative": np.mean(noise),
            }
        )  # fmt: skip
    return pd.DataFrame(lines) if lines else None
