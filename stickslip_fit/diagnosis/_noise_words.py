"""What is said of noise that is not as assumed: skewed, rounded, or larger in some rows than in others."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_significant, join_words
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.diagnosis._unknown_summary import name_carrier
from stickslip_fit.diagnosis.finding import TableInfo
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Diagnosis

NOISY = 2.0  # times the noise of the quietest session or label
MANY_LABELS = 3  # noisy ones above which they are counted instead of named
ENDS = (0.02, 0.98)  # quantiles of the rows between which the noise is compared
MAX_QUIET = 0.1  # share of quiet rows in a range of a column that is called noisy
COMMON = {
    "configuration": "in some configurations",
    "range": "in some ranges of the travel",
    "position": "in some places of the travel",
    "part of a session": "in some parts of the sessions",
    "stretch of time": "in some stretches of time",
}


def describe_noise(diagnosis: Diagnosis) -> list[str]:
    """A sentence on skewed, rounded or uneven noise; none where there is none of these."""
    problem, listed, table = diagnosis.selection.problem, diagnosis.noise_properties, diagnosis.table
    said = []
    if "uneven" in listed:
        said += [_describe_unevenness(problem, carrier, table) for carrier in problem.uneven]
    if "skewed" in listed and problem.skewness is not None:
        ends = ("fewer steps", "more steps") if table is None else ("smaller values", "larger values")
        said.append(f"its long tail is towards {ends[problem.skewness.g > 0]}")
    if "rounded" in listed and problem.spacing is not None:
        spacing = np.round(problem.spacing * problem.rows["steps"].to_numpy(float)).astype(int)
        found = [str(one) for one in np.unique(spacing[spacing > 0])]
        said.append(f"counts are multiples of {join_words(found, 'or')} steps, which no column says")
    if not said:
        return []
    noise = "The noise" if table is None else f"The noise of {table.response}"
    return [f"{noise} is not as assumed, which is allowed for: {join_words(said)}."]


def _describe_unevenness(problem: DiagnosisProblem, carrier: str, table: TableInfo | None) -> str:
    ratio = problem.noise_ratio
    if carrier == "session":
        sessions = problem.rows["session"].to_numpy(object)
        return _compare_labels(ratio, sessions, "session" if table is None else table.roles["session"])
    column = table.roles.get("group", "") if table and carrier == "configuration" else carrier
    if table and column in problem.rows and not pd.api.types.is_numeric_dtype(problem.rows[column]):
        return _compare_labels(ratio, problem.rows[column].to_numpy(object), column)
    low, high = np.quantile(ratio, ENDS)
    larger = f"it is up to {high / low:.0f} times as large"
    if table and column in problem.rows:
        noisy = _describe_range(problem.rows[column].to_numpy(float), ratio > np.sqrt(low * high))
        return f"{larger} at {noisy or 'some values'} of {column} as at others"
    where = COMMON.get(carrier, f"at some values of {name_carrier(carrier)}")
    return f"{larger} {where} as {where[:2]} others"


def _compare_labels(ratio: Array, labels: npt.NDArray[np.object_], name: str) -> str:
    """The noise of some sessions, or rows with some labels of a column, beside that of others."""
    by_label = pd.Series(ratio).groupby(labels).median()
    is_noisy = by_label > by_label.min() * min(NOISY, np.sqrt(by_label.max() / by_label.min()))
    if not is_noisy.any():  # what else the noise depends on hides it
        return f"it is not the same in all values of {name}"
    times = float(by_label[is_noisy].median() / by_label[~is_noisy].median())
    noisy, sessions = [str(one) for one in by_label.index[is_noisy]], name == "session"
    where = f"{name}{'s' * (sessions and len(noisy) > 1)} {join_words(noisy)}"
    if len(noisy) > MANY_LABELS:
        where = f"{len(noisy)} of {len(by_label)} {'sessions' if sessions else f'values of {name}'}"
    return f"it is {times:.0f} times as large in {where} as in others"


def _describe_range(values: Array, is_noisy: BoolArray) -> str:
    """From where to where the noise is large; empty where it is not so in between."""
    if not is_noisy.any():
        return ""
    low, high = float(values[is_noisy].min()), float(values[is_noisy].max())
    inside = (values >= low) & (values <= high)
    if np.sum(inside & ~is_noisy) > MAX_QUIET * inside.sum():
        return ""
    return f"values from {format_significant(low, 2)} to {format_significant(high, 2)}"
