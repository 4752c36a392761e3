"""Accuracy on traverses that no calibration used, the law beside the constant step (thesis Ch. 7)."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from stickslip_fit._format import (
    format_configuration,
    format_direction,
    format_number,
    format_percent,
    joint_name,
    pluralize,
    step_unit,
)
from stickslip_fit._summary import Column, Table, numbers
from stickslip_fit.fit import summarise
from stickslip_fit.machine import Machine

CONFIGURATION = ["q1", "q2", "q3", "theta", "psi", "start", "stop"]
MOST_SESSIONS, MOST_CONFIGURATIONS = 12, 15
FEWEST = 3  # traverses whose rms has an interval worth printing
MISSING = "–"


def by_direction(errors: pd.DataFrame, joint: int) -> Table:
    """One row for each direction, and one for both together."""
    mine = errors[errors["joint"] == joint]
    each, both = summarise(mine, ["joint", "direction"]), summarise(mine, ["joint"])
    body = [(format_direction(row["direction"]), *_cells(row, joint)) for _, row in each.iterrows()]
    body += [("both", *_cells(row, joint)) for _, row in both.iterrows()] if len(each) > 1 else []
    return Table(f"Accuracy of {joint_name(joint)} by direction", _columns(joint, "direction"), tuple(body))


def by_session(errors: pd.DataFrame, joint: int) -> Table:
    """One row for each session and direction."""
    mine = errors[errors["joint"] == joint]
    order = list(dict.fromkeys(mine["session"]))
    shown = order[-MOST_SESSIONS:]
    summary = summarise(mine[mine["session"].isin(shown)], ["session", "direction"])
    summary = summary.sort_values("session", key=lambda names: names.map(order.index), kind="stable")
    body = (
        (str(row["session"]), format_direction(row["direction"]), *_cells(row, joint))
        for _, row in summary.iterrows()
    )
    note = f"The latest {len(shown)} of {len(order)} sessions." if len(shown) < len(order) else ""
    return _table(f"Accuracy of {joint_name(joint)} by session", joint, ("session", "direction"), body, note)


def configurations_of(errors: pd.DataFrame, joint: int) -> pd.DataFrame:
    """Summary of a joint's errors by configuration and direction, the law's worst first."""
    mine = errors[errors["joint"] == joint]
    mine = mine.assign(**{name: mine[name].round(9) + 0.0 for name in CONFIGURATION})
    summary = summarise(mine, ["joint", "direction", *CONFIGURATION])
    return summary.sort_values("law_rms_relative", ascending=False, kind="stable")


def by_configuration(summary: pd.DataFrame, machine: Machine) -> Table:
    """One row for each of the configurations and directions in which the law is worst."""
    joint = int(summary["joint"].iloc[0])
    shown = summary.head(MOST_CONFIGURATIONS)
    body = (
        (
            format_configuration(row, machine.span(joint)),
            format_direction(row["direction"]),
            *_cells(row, joint),
        )
        for _, row in shown.iterrows()
    )
    note = (
        ""
        if len(shown) == len(summary)
        else f"The worst {len(shown)} of {len(summary):,}, over all sessions."
    )
    heads = ("configuration", "direction")
    return _table(f"Accuracy of {joint_name(joint)} by configuration, worst first", joint, heads, body, note)


def explain(errors: pd.DataFrame) -> str:
    """What the tables hold."""
    if errors.empty:
        return "The log has no traverse that a calibration of its session predicts and did not use."
    return (
        f"{pluralize(len(errors), 'traverse')} that took no part in the calibration, each predicted by its "
        "own session's closed-form calibration and by that session's constant step. An error is predicted "
        "less measured mean step size; rms with its 95 % interval (for Gaussian errors); worst is the "
        "largest of all, with its sign; bias is the mean."
    )


def _table(
    caption: str, joint: int, heads: tuple[str, ...], body: Iterable[tuple[str, ...]], note: str
) -> Table:
    return Table(caption, _columns(joint, *heads), tuple(body), stubs=len(heads), note=note)


def _columns(joint: int, *heads: str) -> tuple[Column, ...]:
    unit = step_unit(joint)
    return (
        *(Column(head, text=True) for head in heads),
        Column("traverses"),
        *numbers("rms", "95 % interval", "worst", "bias", unit=unit, group="law"),
        *numbers("rms", "worst", unit="%", group="law"),
        Column("rms", unit, "constant step"),
        *numbers("rms", "worst", unit="%", group="constant step"),
    )


def _cells(row: pd.Series, joint: int) -> tuple[str, ...]:
    unit = step_unit(joint)

    def shown(name: str) -> str:
        return format_number(row[name], unit)

    return (
        f"{int(row['traverses']):,}",
        shown("law_rms"),
        f"{shown('law_rms_low')} to {shown('law_rms_high')}" if row["traverses"] >= FEWEST else MISSING,
        shown("law_worst"),
        shown("law_bias"),
        format_percent(row["law_rms_relative"], with_unit=False),
        format_percent(row["law_worst_relative"], with_unit=False),
        shown("constant_rms"),
        format_percent(row["constant_rms_relative"], with_unit=False),
        format_percent(row["constant_worst_relative"], with_unit=False),
    )
