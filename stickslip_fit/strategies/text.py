"""A comparison as text for the terminal: each joint's answer first, then its tables."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_number, format_range, step_unit
from stickslip_fit._summary import paragraph, text_table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.verdict import against_best, answer

ADJUSTED = " p allows for all pairs of a joint being compared at once (Holm); the intervals do not."


def text(found: Comparison) -> str:
    """What each strategy costs and how well it predicts, joint by joint, and what was left out."""
    parts = [paragraph(f"{heading(found)}{ADJUSTED if found.joints else ''}")]
    for joint in found.joints:
        parts += [
            f"joint {joint} ({'prismatic' if joint == PRISMATIC else 'rotary'})",
            paragraph(answer(found, joint)),
            _absolute_text(found, joint),
            _relative_text(found, joint),
            _directions_text(found, joint),
        ]
    parts.append(left_out_text(found))
    return "\n\n".join(part for part in parts if part)


def heading(found: Comparison) -> str:
    """What was compared, and how."""
    files = ", ".join(found.provenance.log_files) or "a log"
    said = (
        f"{len(found.strategies)} calibration strategies on {files}. Each calibrates a session from its own "
        f"traverses only, and may look back on {found.looks_back}. Errors are predicted less measured mean "
        "step size, of traverses that none of them calibrates from; a traverse costs "
        f"{found.handling:.0f} s beside its steps. Intervals are made to hold 95 % under scatter with heavy "
        "tails too, so that they are wide where it is Gaussian."
    )
    return said if found.joints else f"{said} No session is left in which they can be compared."


def left_out_text(found: Comparison) -> str:
    """Which sessions each strategy could not calibrate, and why."""
    lines = ["left out"]
    for strategy, joints, ways, sessions, why in left_out(found):
        where = f"joint {joints}, {f'direction {ways}, ' * bool(ways)}session {sessions}"
        lines.append(paragraph(f"{strategy}: {where}: {why}", first="  ", then="    "))
    return "\n".join(lines) if len(lines) > 1 else ""


def left_out(found: Comparison) -> list[tuple[str, str, str, str, str]]:
    """What could not be calibrated, alike cases together: strategy, joints, directions, sessions and why."""
    alike: dict[tuple[str, str, str, str], list[str]] = {}
    for (strategy, reason, joint), mine in found.left_out.groupby(
        ["strategy", "reason", "joint"], sort=False
    ):
        ways = " and ".join(way for way in dict.fromkeys(mine["direction"]) if way)
        sessions = ", ".join(dict.fromkeys(mine["session"]))
        alike.setdefault((strategy or "all strategies", ways, sessions, reason), []).append(str(joint))
    return [
        (strategy, ", ".join(joints), ways, sessions, reason)
        for (strategy, ways, sessions, reason), joints in alike.items()
    ]


def between(row: pd.Series, name: str, unit: str) -> str:
    """An interval without its unit."""
    return format_range(row[f"{name}_low"], row[f"{name}_high"], unit)


def _absolute_text(found: Comparison, joint: int) -> str:
    unit, cost = step_unit(joint), found.cost()
    table = _of(found.accuracy(), joint).merge(_of(cost, joint), on="strategy", suffixes=("", "_made"))
    header = [f"in {unit}", "each way", "min", "rms", "95 %", "bias", "95 %", "worst", "typical worst"]
    rows = [
        [
            row["strategy"],
            f"{row['traverses_made']:.3g}",
            f"{row['seconds'] / 60:.0f}",
            format_number(row["rms"], unit),
            between(row, "rms", unit),
            format_number(row["bias"], unit),
            between(row, "bias", unit),
            format_number(row["worst"], unit),
            format_number(row["typical_worst"], unit),
        ]
        for _, row in table.iterrows()
    ]
    return text_table(header, rows)


def _relative_text(found: Comparison, joint: int) -> str:
    best, others = against_best(found, joint)
    against = others.set_index("strategy") if len(others) else pd.DataFrame()
    header = ["in %", "rms", "95 %", "worst", "less the best's, 95 %", "p", ""]
    rows = []
    for _, row in _of(found.accuracy(), joint).iterrows():
        name = str(row["strategy"])
        cells = [name, format_number(row["rms_relative"], "%"), between(row, "rms_relative", "%")]
        cells.append(format_number(row["worst_relative"], "%"))
        if name == best:
            rows.append([*cells, "", "", "least rms"])
            continue
        pair = against.loc[name]
        p = f"{pair['p_adjusted']:.2g}" if pair["p_adjusted"] >= 1e-4 else "<0.0001"
        verdict = str(pair["verdict"]).removesuffix(" on this log")
        rows.append([*cells, between(pair, "difference_relative", "%"), p, verdict])
    return text_table(header, rows)


def _directions_text(found: Comparison, joint: int) -> str:
    mine = _of(found.accuracy("direction"), joint)
    ways = list(dict.fromkeys(mine["direction"]))
    if len(ways) < 2:
        return ""
    header = ["by direction, rms in %", *(head for way in ways for head in (way, "95 %"))]
    rows = []
    for strategy, own in mine.groupby("strategy", sort=False):
        cells = []
        for _, row in own.set_index("direction").loc[ways].iterrows():
            cells += [format_number(row["rms_relative"], "%"), between(row, "rms_relative", "%")]
        rows.append([str(strategy), *cells])
    return text_table(header, rows)


def _of(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    return table[table["joint"] == joint]
