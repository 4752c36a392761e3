"""Where each calibration strategy fails: the configurations in which it errs most."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import (
    format_configuration,
    format_direction,
    format_number,
    format_percent,
    joint_name,
    step_unit,
)
from stickslip_fit._summary import Column, Table, paragraph, text_table
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.trials import WHERE

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
                format_configuration(row, high - low),
                format_direction(str(row["direction"])),
                f"{int(row['traverses']):,}",
                format_number(row["rms"], unit),
                format_number(row["bias"], unit),
                format_percent(row["rms_relative"], with_unit=False),
                format_percent(row["worst_relative"], with_unit=False),
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
    return "\n\n".join([*parts, paragraph(NOTE)]) if parts else ""
