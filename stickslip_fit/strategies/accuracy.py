"""Errors of strategies summed up: rms, bias and worst, with intervals over sessions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit.fit.intervals import COVERAGE
from stickslip_fit.strategies.trials import WHERE

Array = npt.NDArray[np.float64]

SESSIONS, CONFIGURATIONS = ("session",), ("direction", *WHERE)
SMALLEST_SHARE = 0.1  # of the mean
WIDEST = 100.0  # factor; an interval that reaches further either way says nothing
SCALES = {"": "absolute", "_relative": "relative"}


def with_errors(table: pd.DataFrame) -> pd.DataFrame:
    """With columns absolute (rad or m) and relative: predicted less measured mean step size."""
    return table.assign(
        absolute=table["predicted"] - table["measured"],
        relative=table["predicted"] / table["measured"] - 1.0,
        **{name: table[name].round(9) + 0.0 for name in WHERE},
    )


def summarise(errors: pd.DataFrame, by: Sequence[str], unit: Sequence[str]) -> pd.DataFrame:
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
    work = errors.assign(**{f"square_{kind}": errors[kind] ** 2 for kind in SCALES.values()})
    work = work.assign(**{f"size_{kind}": errors[kind].abs() for kind in SCALES.values()})
    each = work.groupby(keys, dropna=False, observed=True, sort=False).agg(
        **{f"square_{kind}": (f"square_{kind}", "mean") for kind in SCALES.values()},
        **{f"mean_{kind}": (kind, "mean") for kind in SCALES.values()},
        **{f"worst_{kind}": (f"size_{kind}", "max") for kind in SCALES.values()},
    )
    units = each.groupby(level=list(by), dropna=False, observed=True, sort=False)
    groups = errors.groupby(list(by), dropna=False, observed=True, sort=False)
    found = pd.DataFrame({"traverses": groups["traverse"].nunique(), "units": units.size()})
    for suffix, kind in SCALES.items():
        square, half = _sized(each, f"square_{kind}", by)
        _bounded(found, f"rms{suffix}", np.sqrt(square), half / 2)
        bias, error = units[f"mean_{kind}"].mean(), units[f"mean_{kind}"].std(ddof=1) / np.sqrt(units.size())
        found[f"bias{suffix}"] = bias
        found[f"bias{suffix}_low"] = bias - reach(found["units"]) * error
        found[f"bias{suffix}_high"] = bias + reach(found["units"]) * error
        high, low = groups[kind].max(), groups[kind].min()
        found[f"worst{suffix}"] = high.where(high >= -low, low)
        worst, half = _sized(each, f"worst_{kind}", by)
        _bounded(found, f"typical_worst{suffix}", worst, half)
    return found.reset_index()


def reach(units: npt.ArrayLike) -> Array:
    """Half-width of a 95 % interval of a mean over so many units, in standard errors; NaN for one."""
    freedom = np.asarray(units, float) - 1.0
    return np.asarray(student_t.ppf(0.5 + COVERAGE / 2, np.where(freedom > 0, freedom, np.nan)))


def _sized(each: pd.DataFrame, name: str, by: Sequence[str]) -> tuple[pd.Series, pd.Series]:
    """Mean of what is above 0, and the half-width of an interval of its logarithm.

    Cox's width, of the mean of log-normal numbers (Zhou and Gao, Stat. Med. 16:783, 1997), allows for small
    means that come with small spreads; the width from the spread itself, for tails that are no log-normal
    ones. Neither holds by itself under scatter like Student's t with 5 degrees of freedom (88 to 93 % of 95);
    their squares' sum does, and is wide where the scatter is Gaussian (97 to nearly 100 %).
    """
    units = each[name].groupby(level=list(by), dropna=False, observed=True, sort=False)
    size, mean = units.size(), units.mean()
    # A unit may be right to the last step by luck; its logarithm must not rule all others.
    kept = np.log(np.maximum(each[name], SMALLEST_SHARE * units.transform("mean")))
    spread = kept.groupby(level=list(by), dropna=False, observed=True, sort=False).var(ddof=1)
    cox = spread / size + spread**2 / (2 * np.maximum(size - 1, 1))
    plain = units.var(ddof=1) / mean**2 / size
    return mean, reach(size) * np.sqrt(cox + plain)


def _bounded(found: pd.DataFrame, name: str, value: pd.Series, half: pd.Series) -> None:
    factor = np.exp(half.where(half <= np.log(WIDEST)))
    found[name] = value
    found[f"{name}_low"], found[f"{name}_high"] = value / factor, value * factor
