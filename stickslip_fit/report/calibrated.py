"""The calibrated parameters: closed form beside least squares, and whether they agree."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_direction, format_percent, format_uncertain, joint_name, pluralize
from stickslip_fit._summary import Column, Table, words
from stickslip_fit.fit import Repeatability, Result
from stickslip_fit.fit.summary import own_parameters

MOST_SESSIONS = 8
DISAGREES = "*"


def compared(calibration: Result, fit: Result) -> pd.DataFrame:
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
    theirs = fit.parameters.drop(columns="unit")
    both = calibration.parameters.merge(theirs, on=keys, sort=False, suffixes=("_closed", "_fit"))
    comparable = both[["low_closed", "high_closed", "estimate_fit"]].notna().all(axis=1)
    inside = both["estimate_fit"].between(both["low_closed"], both["high_closed"])
    return both.assign(comparable=comparable, agrees=comparable & inside)


def agreement(table: pd.DataFrame) -> str:
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
        f"Those that do not are marked {DISAGREES}."
    )


def parameter_tables(table: pd.DataFrame, fit: Result) -> list[Table]:
    """One table for each joint: sessions and directions down, parameters across."""
    return [_joint_table(table[table["joint"] == joint], joint, fit) for joint in fit.joints]


def _joint_table(table: pd.DataFrame, joint: int, fit: Result) -> Table:
    parameters = own_parameters(fit.joints[joint])
    groups = fit.joints[joint].groups
    sessions = list(groups["session"].unique())
    shown = sessions[-MOST_SESSIONS:]
    indexed = table.set_index(["session", "direction", "name"])
    heads = (Column(head, text=True) for head in ("session", "direction", "estimator"))
    columns = (*heads, *(Column(each.name, each.unit.replace("1", "")) for each in parameters))
    body = []
    for group in groups[groups["session"].isin(shown)].itertuples():
        found = [indexed.loc[(group.session, group.direction, each.name)] for each in parameters]
        for which, estimator in (("closed", "closed form"), ("fit", "least squares")):
            cells = (_cell(row, which) for row in found)
            body.append((str(group.session), format_direction(group.direction), estimator, *cells))
    meanings = "; ".join(f"{each.name}: {each.meaning}" for each in parameters)
    note = f"± one standard error. {DISAGREES} outside the closed form's 95 % interval. {meanings}."
    if len(shown) < len(sessions):
        note += f" The latest {len(shown)} of {len(sessions)} sessions; a saved fit holds all."
    return Table(f"Parameters of {joint_name(joint)}", columns, tuple(body), stubs=3, note=note)


def _cell(row: pd.Series, which: str) -> str:
    off = which == "fit" and row["comparable"] and not row["agrees"]
    value = format_uncertain(
        row[f"estimate_{which}"], row[f"standard_error_{which}"], row["unit"], with_unit=False
    )
    return value + (DISAGREES if off else "")


def repeatability_table(calibration: Result, fit: Result) -> Table:
    """How well a traverse repeats, by replicates and by what the fit leaves over."""
    columns = (
        *words("joint", "direction"),
        Column("repeatability", "%", "from replicates"),
        Column("degrees of freedom", group="from replicates"),
        Column("repeatability", "%", "from the fit's residuals"),
        Column("degrees of freedom", group="from the fit's residuals"),
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
                body.append((joint_name(joint), format_direction(sign), *cells))
    note = (
        "Standard deviation of a traverse's count, relative, rounding left out. Replicates made hours apart "
        "also hold what drifted between them; residuals also hold what the law lacks."
    )
    return Table("Repeatability", columns, tuple(body), stubs=2, note=note)


def _repeatability_cells(found: Repeatability) -> tuple[str, str]:
    return format_percent(found.value, with_unit=False), f"{found.freedom:,}"
