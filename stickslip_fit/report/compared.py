"""Calibration strategies compared, as a notebook and a page have them."""

from __future__ import annotations

import pandas as pd

from stickslip_fit.report.claimed import claimed_table
from stickslip_fit.report.display import provenance_of
from stickslip_fit.report.jinja import template
from stickslip_fit.report.table import Column, Table
from stickslip_fit.report.wording import (
    joint_name,
    number,
    percent_number,
    step_unit,
    typeset,
)
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import heading, left_out_text
from stickslip_fit.strategies.verdict import against_best, answer


def comparison_html(found: Comparison) -> str:
    """One small piece of HTML that needs nothing but itself."""
    left_out = left_out_text(found)
    return template("display.html.j2").render(
        title="Calibration strategies compared",
        said=[typeset(heading(found))],
        remarks=[],
        tables=[table(found, joint) for joint in found.joints for table in (comparison_table, claimed_table)],
        folded=[("Left out", left_out)] if left_out else [],
        provenance=provenance_of(found.provenance),
    )


def comparison_table(found: Comparison, joint: int) -> Table:
    """One joint's strategies: cost, errors, and what is seen of a difference from the best."""
    accuracy, cost, unit = found.accuracy(), found.cost(), step_unit(joint)
    table = accuracy[accuracy["joint"] == joint].merge(
        cost[cost["joint"] == joint], on="strategy", suffixes=("", "_made")
    )
    best, others = against_best(found, joint)
    against = others.set_index("strategy") if len(others) else pd.DataFrame()
    columns = (
        Column("strategy", text=True),
        Column("traverses each way"),
        Column("time", "min"),
        Column("rms", unit),
        Column("95 % interval", unit),
        Column("bias", unit),
        Column("worst", unit),
        Column("rms", "%"),
        Column("95 % interval", "%"),
        Column("less the best's", "%"),
        Column("95 % interval", "%"),
        Column("verdict", text=True),
    )
    body = tuple(
        (*_cells(row, unit), *(("", "", "least rms") if row["strategy"] == best else _against(row, against)))
        for _, row in table.iterrows()
    )
    return Table(f"Strategies for {joint_name(joint)}", columns, body, note=typeset(answer(found, joint)))


def _cells(row: pd.Series, unit: str) -> tuple[str, ...]:
    return (
        str(row["strategy"]),
        f"{row['traverses_made']:.3g}",
        f"{row['seconds'] / 60:.0f}",
        number(row["rms"], unit),
        f"{number(row['rms_low'], unit)} to {number(row['rms_high'], unit)}",
        number(row["bias"], unit),
        number(row["worst"], unit),
        percent_number(row["rms_relative"]),
        f"{percent_number(row['rms_relative_low'])} to {percent_number(row['rms_relative_high'])}",
    )


def _against(row: pd.Series, against: pd.DataFrame) -> tuple[str, str, str]:
    pair = against.loc[row["strategy"]]
    low, high = (percent_number(pair[f"difference_relative_{end}"]) for end in ("low", "high"))
    return percent_number(pair["difference_relative"]), f"{low} to {high}", str(pair["verdict"])
