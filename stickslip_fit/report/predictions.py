"""What a plan's traverses will take: a table for the terminal, a CSV file for the lab."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_configuration, format_value, step_unit
from stickslip_fit._summary import text_table
from stickslip_fit.errors import shorten
from stickslip_fit.fit import Result
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.sheet import sheet_table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import from_si

MOST_ROWS = 40
TO_COME = "a session to come"
STEP_SIZES = {"step_size_nm": "nm", "step_size_urad": "µrad"}


def predictions_text(result: Result, plan: Plan, predicted: pd.DataFrame) -> str:
    """The first traverses of a plan with their counts, and why some have no interval.

    Parameters
    ----------
    result : Result
        What `predicted` was worked out from.
    plan : Plan
    predicted : DataFrame
        As `fit.predict.predict_plan` returns it.
    """
    rows = plan.rows()
    both = pd.concat([rows, predicted], axis=1).head(MOST_ROWS)
    cells = [
        [
            shorten(str(row["session"]), 20),
            f"{row['joint']} {row['direction']}",
            format_configuration(row, result.machine.span(int(row["joint"]))),
            f"{row['steps']:,.0f}",
            f"{row['low']:,.0f} to {row['high']:,.0f}" if pd.notna(row["low"]) else "–",
            format_value(row["step_size"], step_unit(int(row["joint"])), 2),
        ]
        for _, row in both.iterrows()
    ]
    header = ["session", "joint", "configuration", "steps", "95 % of counts", "step size"]
    lines = [_heading(plan, predicted), "", text_table(header, cells, left=3)]
    if len(rows) > MOST_ROWS:
        lines.append(f"(the first {MOST_ROWS} of {len(rows):,} traverses; -o writes them all)")
    return "\n".join([*lines, *_without_interval(result, rows, predicted)])


def predictions_csv(plan: Plan, predicted: pd.DataFrame) -> str:
    """Every traverse in a log's columns, with steps, low, high, step size and whose calibration it is."""
    sheet = sheet_table(plan).drop(columns=["time", "steps", "step_period_ms", "status", "note"])
    prismatic = (plan.rows()["joint"] == PRISMATIC).to_numpy()
    for name in ("steps", "low", "high"):
        sheet[name] = predicted[name].astype("Int64").to_numpy()
    for (name, unit), mine in zip(STEP_SIZES.items(), (prismatic, ~prismatic), strict=True):
        shown = from_si(predicted["step_size"].to_numpy(float), unit)
        sheet[name] = [f"{value:.6g}" if own else "" for value, own in zip(shown, mine, strict=True)]
    sheet["calibration"] = predicted["calibration"].replace("", TO_COME).to_numpy()
    return sheet.to_csv(index=False, lineterminator="\n")


def _heading(plan: Plan, predicted: pd.DataFrame) -> str:
    sources = [
        f"session {shorten(name, 30)}" if name else TO_COME for name in predicted["calibration"].unique()
    ]
    return f"{plan.name}: counts as they will be noted, by the calibration of {', '.join(sources)}"


def _without_interval(result: Result, rows: pd.DataFrame, predicted: pd.DataFrame) -> list[str]:
    """The remarks that say why there are no error bars."""
    bare = {
        (int(j), str(way)) for j, way in rows.loc[predicted["low"].isna(), ["joint", "direction"]].to_numpy()
    }
    messages = [
        f"! {remark.message}"
        for remark in result.remarks
        if (remark.joint, remark.direction) in bare and remark.flag == "few_replicates"
    ]
    return list(dict.fromkeys(messages))
