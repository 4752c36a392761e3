"""A simulated study, as a notebook and a page have it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_number,
    format_percent,
    format_percent_range,
    format_value,
    joint_name,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Table, template
from stickslip_fit.fit.provenance import versions
from stickslip_fit.machine import JOINTS
from stickslip_fit.strategies.study import Study
from stickslip_fit.strategies.study.text import heading, left_out_text, moves_made, tip_answer
from stickslip_fit.strategies.study.verdict import answer


def study_html(found: Study) -> str:
    """One small piece of HTML that needs nothing but itself."""
    left_out = left_out_text(found)
    return template("display.html.j2").render(
        title="Calibration strategies in simulation",
        said=[typeset(heading(found))],
        remarks=[],
        tables=[*(joint_table(found, joint) for joint in found.joints), *tips_table(found)],
        folded=[("Left out", left_out)] if left_out else [],
        provenance=_provenance(found),
    )


def joint_table(found: Study, joint: int) -> Table:
    """One joint's strategies in each scenario."""
    table, unit = found.accuracy(), step_unit(joint)
    columns = (
        Column("scenario", text=True),
        Column("strategy", text=True),
        Column("each way", group="a session"),
        Column("time", "min", group="a session"),
        Column("rms", "%"),
        Column("95 %", "%"),
        Column("bias", "%"),
        Column("worst", "%"),
        Column("rms", unit),
        Column("held", "%"),
        Column("failed", "%"),
    )
    body = tuple(_cells(row, unit) for _, row in table[table["joint"] == joint].iterrows())
    caption = f"Strategies for {joint_name(joint)}"
    return Table(caption, columns, body, stubs=2, note=typeset(answer(found, joint)))


def tips_table(found: Study) -> list[Table]:
    """Where the tip ends; no table where no move was made."""
    tips = found.tips()
    if tips.empty:
        return []
    columns = (
        Column("scenario", text=True),
        Column("strategy", text=True),
        Column("rms", "µm"),
        Column("half within", "µm"),
        Column("95 % within", "µm"),
        Column("in 9 campaigns of 10", "µm"),
        Column("worst", "µm"),
        *(Column(f"joint {joint}", "%", "share of the mean square") for joint in JOINTS),
    )
    body = tuple(_tip_cells(row) for _, row in tips.iterrows())
    caption = f"The tip after {moves_made(found)}"
    return [Table(caption, columns, body, stubs=2, note=typeset(tip_answer(found)))]


def _cells(row: pd.Series, unit: str) -> tuple[str, ...]:
    return (
        str(row["scenario"]),
        str(row["strategy"]),
        f"{row['traverses']:.3g}",
        f"{row['seconds'] / 60:.0f}",
        format_percent(row["rms_relative"], with_unit=False),
        format_percent_range(row["rms_relative_low"], row["rms_relative_high"]),
        format_percent(row["bias_relative"], with_unit=False),
        format_percent(row["worst_relative"], with_unit=False),
        format_number(row["rms"], unit),
        f"{100 * row['covered']:.0f}" if np.isfinite(row["covered"]) else "",
        format_percent(row["failed"], with_unit=False) if row["failed"] > 0 else "0",
    )


def _tip_cells(row: pd.Series) -> tuple[str, ...]:
    return (
        str(row["scenario"]),
        str(row["strategy"]),
        *(_micrometres(row[name]) for name in ("rms", "median", "often")),
        f"{_micrometres(row['often_low'])} to {_micrometres(row['often_high'])}",
        _micrometres(row["worst"]),
        *(f"{100 * row[f'share_{joint}']:.0f}" for joint in JOINTS),
    )


def _micrometres(length: float) -> str:
    return format_value(length, "µm", 1).removesuffix(" µm")


def _provenance(found: Study) -> list[tuple[str, str]]:
    plan = found.plan
    return [
        *((f"scenario {each.name}", f"sha256 {plan.sha256(each)}") for each in plan.scenarios),
        (f"machine {plan.machine.name}", f"sha256 {plan.machine.sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in versions().items())),
        ("command", found.command or "none: made from Python"),
        ("seed", str(plan.seed)),
    ]
