"""Where each calibration strategy fails: the configurations in which it errs most."""

from __future__ import annotations

from textwrap import fill

import pandas as pd

from stickslip_fit.report.table import Column, Table
from stickslip_fit.report.wording import configuration, joint_name, number, percent_number, step_unit, way
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import WIDTH
from stickslip_fit.strategies.trials import WHERE
from stickslip_fit.units import text_table

NOTE = (
    "Rms over the traverses of a configuration and direction, all sessions; the largest relative ones are "
    "shown. Times scatter: over how well a traverse repeats in that direction. Among many configurations the "
    "largest comes to about 2 by chance, and to more where a calibration is itself not sure."
)
ON_A_PAGE, IN_TEXT = 2, 1


def worst_table(found: Comparison, joint: int, most: int = ON_A_PAGE) -> Table:
    """The configurations in which each strategy errs most, as shares of the step size.

    Parameters
    ----------
    found : Comparison
    joint : int
    most : int, optional
        Configurations shown of each strategy.
    """
    table, unit = worst_configurations(found, joint), step_unit(joint)
    columns = (
        Column("strategy", text=True),
        Column("configuration", text=True),
        Column("direction", text=True),
        Column("traverses"),
        Column("rms", unit),
        Column("bias", unit),
        Column("rms", "%"),
        Column("worst", "%"),
        Column("times scatter"),
    )
    low, high = found.machine.ranges[joint]
    body = []
    for strategy in found.compared(joint):
        for _, row in table[table["strategy"] == strategy].head(most).iterrows():
            cells = (
                configuration(row, high - low),
                way(str(row["direction"])),
                f"{int(row['traverses']):,}",
                number(row["rms"], unit),
                number(row["bias"], unit),
                percent_number(row["rms_relative"]),
                percent_number(row["worst_relative"]),
                f"{row['times_scatter']:.1f}",
            )
            body.append((strategy, *cells))
    caption = f"{joint_name(joint).capitalize()}: where each strategy errs most"
    return Table(caption, columns, tuple(body), note=NOTE)


def worst_configurations(found: Comparison, joint: int) -> pd.DataFrame:
    """Errors by strategy, direction and configuration, each strategy's largest relative rms first.

    Returns
    -------
    DataFrame
        As `Comparison.accuracy` returns it, and times_scatter: the relative rms over the repeatability.
    """
    table = found.accuracy("direction", *WHERE)
    mine = table[table["joint"] == joint]
    scatter = [found.repeatability[joint, str(direction)] for direction in mine["direction"]]
    mine = mine.assign(times_scatter=mine["rms_relative"] / scatter)
    return mine.sort_values("rms_relative", ascending=False, kind="stable")


def worst_text(found: Comparison) -> str:
    """Every strategy's worst configuration (n traverses), for the terminal; empty where none is compared."""
    parts = []
    for joint in found.joints:
        table = worst_table(found, joint, IN_TEXT)
        unit = step_unit(joint)
        heads = ["strategy", "configuration", "", "n", f"rms {unit}", "rms %", "/ scatter"]
        body = [(*row[:5], row[6], row[8]) for row in table.rows]
        parts.append(f"{table.caption}\n{text_table(heads, body, left=3)}")
    return "\n\n".join([*parts, fill(NOTE, WIDTH)]) if parts else ""
