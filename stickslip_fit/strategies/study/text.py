"""A study as text for the terminal: each joint's answer first, then its table; the tip; what was left out."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import MISSING, format_number, format_value, step_unit
from stickslip_fit._summary import paragraph, text_table
from stickslip_fit.machine import JOINTS, PRISMATIC
from stickslip_fit.strategies.study.study import Study
from stickslip_fit.strategies.study.verdict import answer, of_joint
from stickslip_fit.strategies.text import between


def text(found: Study) -> str:
    """Which strategy survives what, joint by joint."""
    parts = [paragraph(heading(found))]
    for joint in found.joints:
        parts += [
            f"joint {joint} ({'prismatic' if joint == PRISMATIC else 'rotary'})",
            paragraph(answer(found, joint)),
            _joint_text(found, joint),
        ]
    tips = found.tips()
    if len(tips):
        parts += [f"the tip after {moves_made(found)}", paragraph(tip_answer(found)), _tips_text(tips)]
    return "\n\n".join(filter(None, [*parts, left_out_text(found)]))


def heading(found: Study) -> str:
    """What was simulated."""
    plan = found.plan
    return (
        f"{plan.name}: {plan.campaigns:,} campaigns of {len(plan.plan.sessions)} sessions with "
        f"{'each of ' * (len(plan.scenarios) > 1)}{len(plan.scenarios)} "
        f"scenario{'s' * (len(plan.scenarios) > 1)}, {len(plan.strategies)} calibration strategies. Each "
        "calibrates a session from its own traverses, which it chooses once, before any campaign. Errors are "
        "predicted less true mean step size, of all configurations of the plan, with 95 % intervals over "
        "campaigns; held is the share of stated 95 % intervals that hold the truth; a traverse costs "
        f"{found.design.handling:.0f} s beside its steps."
    )


def moves_made(found: Study) -> str:
    """The moves in words."""
    return f"{found.plan.moves} open-loop moves of {format_value(found.plan.length, 'mm', 2)} a session"


def tip_answer(found: Study) -> str:
    """Where the tip ends with the best strategy of each scenario."""
    tips, told = found.tips(), []
    for scenario, mine in tips.groupby("scenario", sort=False):
        best = mine.loc[mine["often"].idxmin()]
        told.append(
            f"{scenario}: {best['strategy']}, 95 % of moves within {format_value(best['often'], 'µm', 1)}"
        )
    return f"Closest to where they should end: {'; '.join(told)}."


def left_out_text(found: Study) -> str:
    """Which strategies take no part where, and why."""
    table = found.design.left_out
    if table.empty:
        return ""
    lines = ["left out"]
    for (strategy, joint, reason), mine in table.groupby(["strategy", "joint", "reason"], sort=False):
        ways = " and ".join(dict.fromkeys(mine["direction"]))
        said = f"{strategy}: joint {joint}, direction {ways}: {reason}"
        lines.append(paragraph(said, first="  ", then="    "))
    return "\n".join(lines)


def _joint_text(found: Study, joint: int) -> str:
    unit = step_unit(joint)
    header = ["rms in %", "each way", "min", "rms", "95 %", "bias", "worst", unit, "held"]
    rows = []
    for scenario, mine in of_joint(found.accuracy(), joint).groupby("scenario", sort=False):
        rows.append([str(scenario), *[""] * (len(header) - 1)])
        rows += [_cells(row, unit) for _, row in mine.iterrows()]
    return text_table(header, rows)


def _cells(row: pd.Series, unit: str) -> list[str]:
    failed = f" ({format_value(row['failed'], '%', 2)} failed)" if row["failed"] > 0 else ""
    return [
        f"  {row['strategy']}{failed}",
        f"{row['traverses']:.3g}",
        f"{row['seconds'] / 60:.0f}",
        format_number(row["rms_relative"], "%"),
        between(row, "rms_relative", "%"),
        format_number(row["bias_relative"], "%"),
        format_number(row["worst_relative"], "%"),
        format_number(row["rms"], unit),
        format_value(row["covered"], "%", 0) if np.isfinite(row["covered"]) else MISSING,
    ]


def _tips_text(tips: pd.DataFrame) -> str:
    header = ["in µm", "rms", "half within", "95 % within", "in 9 campaigns of 10", "worst"]
    header += [f"joint {joint}" for joint in JOINTS]
    rows = []
    for scenario, mine in tips.groupby("scenario", sort=False):
        rows.append([str(scenario), *[""] * (len(header) - 1)])
        rows += [_tip_cells(row) for _, row in mine.iterrows()]
    return text_table(header, rows)


def _tip_cells(row: pd.Series) -> list[str]:
    unknown = f" ({format_value(row['unknown'], '%', 2)} unknown)" if row["unknown"] > 0 else ""
    lengths = [_micrometres(row[name]) for name in ("rms", "median", "often")]
    span = f"{_micrometres(row['often_low'])} to {_micrometres(row['often_high'])}"
    shares = [format_value(row[f"share_{joint}"], "%", 0) for joint in JOINTS]
    return [f"  {row['strategy']}{unknown}", *lengths, span, _micrometres(row["worst"]), *shares]


def _micrometres(length: float) -> str:
    return format_value(length, "µm", 1).removesuffix(" µm")
