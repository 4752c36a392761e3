"""What a study says: each joint's answer and strategies, the tip, and what was left out."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_number,
    format_percent,
    format_percent_range,
    format_range,
    format_value,
    joint_name,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.estimation.result import library_versions
from stickslip_fit.studies.study import SimulationStudy, rows_of_joint, write_study_headline
from stickslip_fit.units import JOINTS


@summarize.register
def summarize_study(found: SimulationStudy) -> Summary:
    """Which strategy survives what, joint by joint; where the tip ends; who takes no part."""
    sections = [Section(paragraphs=(typeset_text(_heading(found)),))]
    sections += [
        Section(capitalize_first(joint_name(joint)), tables=(_joint_table(found, joint),))
        for joint in found.joints
    ]
    tips = found.tips()
    if len(tips):
        sections.append(Section(_tip_title(found), (_tip_answer(tips),), (_tips_table(found, tips),)))
    left_out = _left_out(found)
    plan = found.plan
    return Summary(
        "Calibration strategies in simulation",
        tuple(typeset_text(f"Joint {joint}. {write_study_headline(found, joint)}") for joint in found.joints),
        (*sections, *([Section(tables=(left_out,))] if left_out.rows else [])),
        provenance=(
            *((f"scenario {each.name}", f"sha256 {plan.sha256(each)}") for each in plan.scenarios),
            (f"machine {plan.machine.name}", f"sha256 {plan.machine.sha256}"),
            ("versions", ", ".join(f"{name} {version}" for name, version in library_versions().items())),
            ("command", found.command or "none: made from Python"),
            ("seed", str(plan.seed)),
        ),
    )


def _heading(found: SimulationStudy) -> str:
    """What was simulated."""
    plan = found.plan
    return (
        f"{plan.name}: {plan.campaigns:,} campaigns of {len(plan.plan.sessions)} sessions with "
        f"{'each of ' * (len(plan.scenarios) > 1)}{len(plan.scenarios)} "
        f"scenario{'s' * (len(plan.scenarios) > 1)}, {len(plan.strategies)} calibration strategies. Each "
        "calibrates a session from its own traverses, which it chooses once, before any campaign. Errors are "
        "predicted less true mean step size, of all configurations of the plan, with 95 % intervals over "
        "campaigns; held is the share of stated 95 % intervals that hold the truth; a traverse costs "
        f"{found.design.handling_seconds:.0f} s beside its steps."
    )


def _joint_table(found: SimulationStudy, joint: int) -> Table:
    """One joint's strategies in each scenario."""
    unit = step_unit(joint)
    columns = (
        *words("scenario", "strategy"),
        Column("each way", group="a session"),
        Column("time", "min", "a session"),
        *numbers("rms", "95 %", "bias", "worst", unit="%"),
        Column("rms", unit),
        *numbers("held", "failed", unit="%"),
    )
    rows = tuple(_cells(row, unit) for _, row in rows_of_joint(found.accuracy(), joint).iterrows())
    return Table(f"Strategies for {joint_name(joint)}", columns, rows, stubs=2)


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


def _tip_title(found: SimulationStudy) -> str:
    return (
        f"The tip after {found.plan.moves} open-loop moves of {format_value(found.plan.length, 'mm', 2)} "
        "a session"
    )


def _tip_answer(tips: pd.DataFrame) -> str:
    """Where the tip ends with the best strategy of each scenario."""
    closest = []
    for scenario, rows in tips.groupby("scenario", sort=False):
        best = rows.loc[rows["often"].idxmin()]
        reach = format_value(best["often"], "µm", 1)
        closest.append(f"{scenario}: {best['strategy']}, 95 % of moves within {reach}")
    return f"Closest to where they should end: {'; '.join(closest)}."


def _tips_table(found: SimulationStudy, tips: pd.DataFrame) -> Table:
    heads = ("rms", "half within", "95 % within", "in 9 campaigns of 10", "worst")
    columns = (
        *words("scenario", "strategy"),
        *(Column(head, "µm") for head in heads),
        *(Column(f"joint {joint}", "%", "share of the mean square") for joint in JOINTS),
        Column("unknown", "%"),
    )
    rows = tuple(
        (
            str(row["scenario"]),
            str(row["strategy"]),
            *(format_number(row[name], "µm") for name in ("rms", "median", "often")),
            format_range(row["often_low"], row["often_high"], "µm"),
            format_number(row["worst"], "µm"),
            *(format_number(row[f"share_{joint}"], "%", 0) for joint in JOINTS),
            format_percent(row["unknown"], with_unit=False) if row["unknown"] > 0 else "0",
        )
        for _, row in tips.iterrows()
    )
    return Table(_tip_title(found), columns, rows, stubs=2)


def _left_out(found: SimulationStudy) -> Table:
    """Which strategies take no part where, and why."""
    columns = tuple(Column(head, text=True) for head in ("strategy", "joint", "direction", "why"))
    table = found.design.left_out
    if table.empty:
        return Table("Left out", columns, ())
    rows = tuple(
        (
            strategy,
            str(joint),
            " and ".join(map(format_direction, dict.fromkeys(cases["direction"]))),
            reason,
        )
        for (strategy, joint, reason), cases in table.groupby(["strategy", "joint", "reason"], sort=False)
    )
    return Table("Left out", columns, rows)
