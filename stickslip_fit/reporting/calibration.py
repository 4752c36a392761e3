"""Sections on the data and the calibration: sessions, coverage, parameters, load coefficients, flags."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import pandas as pd

from stickslip_fit._format import (
    format_direction,
    format_length,
    format_number,
    format_percent,
    format_uncertain,
    joint_name,
    pluralize,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.estimation import NoiseLevel, Result
from stickslip_fit.estimation._summary import own_parameters
from stickslip_fit.estimation.load_coefficient import THESIS_ITERATIONS
from stickslip_fit.plotting._style import select_recent

MAX_SESSIONS = 8
DISAGREEMENT_MARK = "*"


def compare_estimators(calibration: Result, fit: Result) -> pd.DataFrame:
    """Both estimators' parameters side by side.

    Returns
    -------
    DataFrame
        name, joint, direction, session, unit; and of each estimator (suffix _closed or _fit) estimate,
        standard_error, low, high; comparable (the closed form has an interval and the fit an estimate)
        and agrees (the estimate lies in the interval). The closed form's traverses are among the
        fit's, so its own 95 % interval is wide enough for their difference.
    """
    keys = ["name", "joint", "direction", "session"]
    theirs = fit.si.parameters.drop(columns="unit")
    both = calibration.si.parameters.merge(theirs, on=keys, sort=False, suffixes=("_closed", "_fit"))
    comparable = both[["low_closed", "high_closed", "estimate_fit"]].notna().all(axis=1)
    inside = both["estimate_fit"].between(both["low_closed"], both["high_closed"])
    return both.assign(comparable=comparable, agrees=comparable & inside)


def describe_agreement(table: pd.DataFrame) -> str:
    """How often the two estimators agree, in a sentence."""
    comparable, agrees = int(table["comparable"].sum()), int(table["agrees"].sum())
    if not table["estimate_closed"].notna().any():
        return "The closed form knows no parameter: the log has none of its calibration traverses."
    if not comparable:
        return (
            "Closed form and least squares cannot be compared: without replicates of the calibration "
            "traverses the closed form has no error bars."
        )
    told = (
        f"{agrees} of {pluralize(comparable, 'parameter')} from least squares lie within the closed form's "
        "95 % interval"
    )
    if agrees >= 0.9 * comparable:
        return f"{told}, as they should if the law holds and nothing changed during a session."
    return (
        f"{told}; if the law held and nothing changed during a session, about 95 in 100 would. "
        f"Those that do not are marked {DISAGREEMENT_MARK}."
    )


def parameter_tables(table: pd.DataFrame, fit: Result) -> list[Table]:
    """One table for each joint: sessions and directions down, parameters across."""
    return [_joint_table(table[table["joint"] == joint], joint, fit) for joint in fit.joints]


def _joint_table(table: pd.DataFrame, joint: int, fit: Result) -> Table:
    parameters = own_parameters(fit.joints[joint])
    groups = fit.joints[joint].groups
    sessions = list(groups["session"].unique())
    shown = sessions[-MAX_SESSIONS:]
    keys = ("session", "direction", "name")
    cells = {tuple(row[key] for key in keys): row for row in table.to_dict("records")}
    heads = (Column(head, text=True) for head in ("session", "direction", "estimator"))
    columns = (*heads, *(Column(each.name, each.unit.replace("1", "")) for each in parameters))
    body = []
    for group in groups[groups["session"].isin(shown)].itertuples():
        found = [cells[group.session, group.direction, each.name] for each in parameters]
        for which, estimator in (("closed", "closed form"), ("fit", "least squares")):
            shown_cells = (_parameter_cell(row, which) for row in found)
            body.append((str(group.session), format_direction(group.direction), estimator, *shown_cells))
    meanings = "; ".join(f"{each.name}: {each.meaning}" for each in parameters)
    note = f"± one standard error. {DISAGREEMENT_MARK} outside the closed form's 95 % interval. {meanings}."
    if len(shown) < len(sessions):
        note += f" The latest {len(shown)} of {len(sessions)} sessions; a saved fit holds all."
    return Table(f"Parameters of {joint_name(joint, fit.machine)}", columns, tuple(body), stubs=3, note=note)


def _parameter_cell(row: Mapping[Hashable, Any], which: str) -> str:
    off = which == "fit" and row["comparable"] and not row["agrees"]
    value = format_uncertain(
        row[f"estimate_{which}"], row[f"standard_error_{which}"], row["unit"], with_unit=False
    )
    return value + (DISAGREEMENT_MARK if off else "")


def repeatability_table(calibration: Result, fit: Result) -> Table:
    """How well a traverse repeats, by replicates and by the residuals of the fit."""
    columns = (
        *words("joint", "direction"),
        Column("scatter", "%", "of replicates"),
        Column("degrees of freedom", group="of replicates"),
        Column("scatter", "%", "of the fit's residuals"),
        Column("degrees of freedom", group="of the fit's residuals"),
    )
    body = []
    for joint, joint_fit in fit.joints.items():
        for sign in ("+", "-"):
            if (joint_fit.groups["direction"] == sign).any():
                replicates = calibration.joints[joint].repeatability[sign]
                of_replicates = (
                    _repeatability_cells(replicates) if replicates.source == "replicates" else ("–", "–")
                )
                cells = (*of_replicates, *_repeatability_cells(joint_fit.repeatability[sign]))
                body.append((joint_name(joint, fit.machine), format_direction(sign), *cells))
    note = (
        "Standard deviation of a traverse's count, relative, rounding left out. Replicates made hours apart "
        "also hold what drifted between them; residuals also hold what the law lacks."
    )
    return Table("Replicate and residual scatter", columns, tuple(body), stubs=2, note=note)


def _repeatability_cells(found: NoiseLevel) -> tuple[str, str]:
    return format_percent(found.value, with_unit=False), f"{found.df:,}"


def load_coefficient_table(table: pd.DataFrame) -> Table:
    """The table of `load_coefficients`, the latest sessions."""
    columns = (
        *words("session", "direction", "q3"),
        *numbers("gamma0", "delta", unit="µrad"),
        *numbers("exact", "±", "Eq. 6.6", unit="µrad", group="d"),
        *(
            Column("first guess" if k == 0 else f"pass {k}", "µrad", "d by the thesis's iteration")
            for k in range(THESIS_ITERATIONS + 1)
        ),
    )
    shown = select_recent(table)
    body = tuple(
        (
            str(row["session"]),
            format_direction(row["direction"]),
            format_length(row["q3"]),
            format_uncertain(row["gamma0"], row["gamma0_error"], "µrad", with_unit=False),
            format_number(row["delta"], "µrad"),
            format_number(row["d"], "µrad"),
            format_number(row["d_error"], "µrad"),
            format_number(row["quadratic"], "µrad"),
            *(format_number(row[f"iteration_{k}"], "µrad") for k in range(THESIS_ITERATIONS + 1)),
        )
        for row in shown.to_dict("records")
    )
    note = (
        "delta: change of the mean step under the full load (theta = 0, psi = 0) against none (theta = "
        "−90°). Exact: the integral of dq2 / (gamma0 + d sin zeta) solved for the steps counted; ± one "
        "standard error of it, from the counts. The iteration is the thesis's way to the same value, Eq. "
        "6.6 its quadratic in delta for any gamma0 (x in units of 0.01 rad, the only reading that makes "
        "sense)."
    )
    if len(shown) < len(table):
        note += f" The latest {shown['session'].nunique()} of {table['session'].nunique()} sessions."
    return Table(
        "Joint 2's d by exact solving, by the thesis's iteration, by its Eq. 6.6",
        columns,
        body,
        stubs=3,
        note=note,
    )
