"""Tables of accuracy: held-out errors of law and constant step by direction, session and configuration."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

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
from stickslip_fit.estimation import summarize_errors
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine

MAX_SESSIONS, MAX_CONFIGURATIONS = 12, 15
MIN_TRAVERSES = 3  # traverses whose rms has an interval worth printing
NO_VALUE = "–"


def direction_table(errors: pd.DataFrame, joint: int, machine: Machine) -> Table:
    """One row for each direction, and one for both together."""
    subset, unit = errors[errors["joint"] == joint], step_unit(joint, machine)
    each, both = summarize_errors(subset, ["joint", "direction"]), summarize_errors(subset, ["joint"])
    body = [(format_direction(row["direction"]), *_error_cells(row, unit)) for row in each.to_dict("records")]
    body += [("both", *_error_cells(row, unit)) for row in both.to_dict("records")] if len(each) > 1 else []
    return Table(
        f"Accuracy of {joint_name(joint, machine)} by direction",
        _error_columns(unit, "direction"),
        tuple(body),
    )


def session_table(errors: pd.DataFrame, joint: int, machine: Machine) -> Table:
    """One row for each session and direction."""
    subset, unit = errors[errors["joint"] == joint], step_unit(joint, machine)
    order = list(dict.fromkeys(subset["session"]))
    shown = order[-MAX_SESSIONS:]
    summary = summarize_errors(subset[subset["session"].isin(shown)], ["session", "direction"])
    summary = summary.sort_values("session", key=lambda names: names.map(order.index), kind="stable")
    body = (
        (str(row["session"]), format_direction(row["direction"]), *_error_cells(row, unit))
        for row in summary.to_dict("records")
    )
    note = f"The latest {len(shown)} of {len(order)} sessions." if len(shown) < len(order) else ""
    return _make_table(
        f"Accuracy of {joint_name(joint, machine)} by session", unit, ("session", "direction"), body, note
    )


def summarize_configurations(errors: pd.DataFrame, joint: int) -> pd.DataFrame:
    """Summary of a joint's errors by configuration and direction, the law's worst first."""
    subset = errors[errors["joint"] == joint]
    positions = [*position_columns(subset), "start", "stop"]
    subset = subset.assign(**{name: subset[name].round(9) + 0.0 for name in positions})
    summary = summarize_errors(subset, ["joint", "direction", *positions])
    return summary.sort_values("law_rms_relative", ascending=False, kind="stable")


def configuration_table(summary: pd.DataFrame, machine: Machine) -> Table:
    """One row for each of the configurations and directions in which the law is worst."""
    joint = int(summary["joint"].iloc[0])
    shown, unit = summary.head(MAX_CONFIGURATIONS), step_unit(joint, machine)
    body = (
        (format_configuration(row, machine), format_direction(row["direction"]), *_error_cells(row, unit))
        for row in shown.to_dict("records")
    )
    note = (
        ""
        if len(shown) == len(summary)
        else f"The worst {len(shown)} of {len(summary):,}, over all sessions."
    )
    heads = ("configuration", "direction")
    return _make_table(
        f"Accuracy of {joint_name(joint, machine)} by configuration, worst first", unit, heads, body, note
    )


def explain_tables(errors: pd.DataFrame) -> str:
    """What the tables hold."""
    if errors.empty:
        return "The log has no traverse that a calibration of its session predicts and did not use."
    return (
        f"{pluralize(len(errors), 'traverse')} that took no part in the calibration, each predicted by its "
        "own session's closed-form calibration and by that session's constant step. An error is predicted "
        "less measured mean step size; rms with its 95 % interval (for Gaussian errors); worst is the "
        "largest of all, with its sign; bias is the mean."
    )


def _make_table(
    caption: str, unit: str, heads: tuple[str, ...], body: Iterable[tuple[str, ...]], note: str
) -> Table:
    return Table(caption, _error_columns(unit, *heads), tuple(body), stubs=len(heads), note=note)


def _error_columns(unit: str, *heads: str) -> tuple[Column, ...]:
    return (
        *(Column(head, text=True) for head in heads),
        Column("traverses"),
        *numbers("rms", "95 % interval", "worst", "bias", unit=unit, group="law"),
        *numbers("rms", "worst", unit="%", group="law"),
        Column("rms", unit, "constant step"),
        *numbers("rms", "worst", unit="%", group="constant step"),
    )


def _error_cells(row: Mapping[Hashable, Any], unit: str) -> tuple[str, ...]:

    def shown(name: str) -> str:
        return format_number(row[name], unit)

    return (
        f"{int(row['traverses']):,}",
        shown("law_rms"),
        f"{shown('law_rms_low')} to {shown('law_rms_high')}"
        if row["traverses"] >= MIN_TRAVERSES
        else NO_VALUE,
        shown("law_worst"),
        shown("law_bias"),
        format_percent(row["law_rms_relative"], with_unit=False),
        format_percent(row["law_worst_relative"], with_unit=False),
        shown("constant_rms"),
        format_percent(row["constant_rms_relative"], with_unit=False),
        format_percent(row["constant_worst_relative"], with_unit=False),
    )
