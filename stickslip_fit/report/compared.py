"""Calibration strategies compared, as a notebook and a page have them."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from stickslip_fit._format import (
    MINUS,
    MISSING,
    format_number,
    format_percent,
    format_percent_range,
    format_range,
    joint_name,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Table
from stickslip_fit.report.claimed import claimed_table
from stickslip_fit.report.figures.pareto import pareto_picture
from stickslip_fit.report.figures.picture import Picture
from stickslip_fit.report.implied import implied_table
from stickslip_fit.report.worst import worst_table
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import heading, left_out
from stickslip_fit.strategies.verdict import against_best, answer

NOTE = "Verdicts allow for all pairs of strategies being compared at once (Holm); the intervals do not."


@dataclass(frozen=True)
class Joint:
    """One joint's part of a comparison.

    Attributes
    ----------
    name, answer : str
    strategies : Table
        What each costs and reaches.
    picture : Picture
        The same drawn.
    further : list of Table
        Where each fails; the thesis's claims.
    """

    name: str
    answer: str
    strategies: Table
    picture: Picture
    further: list[Table]


@dataclass(frozen=True)
class Compared:
    """The parts of a comparison that a page is made of.

    Attributes
    ----------
    said : str
        What was compared, and how.
    joints : list of Joint
    left_out : Table or None
        Sessions that a strategy could not calibrate, and why.
    """

    said: str
    joints: list[Joint]
    left_out: Table | None


def compared(found: Comparison, sessions: int = 0) -> Compared:
    """All parts of a comparison, pictures drawn.

    Parameters
    ----------
    found : Comparison
    sessions : int, optional
        Of the log; said where the comparison is over fewer.
    """
    joints = [
        Joint(
            joint_name(joint).capitalize(),
            _said(answer(found, joint)),
            comparison_table(found, joint),
            pareto_picture(found, joint),
            [worst_table(found, joint), implied_table(found, joint), claimed_table(found, joint)],
        )
        for joint in found.joints
    ]
    return Compared(typeset(heading(found)) + _of_all(found, sessions), joints, left_out_table(found))


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
        Column("traverses each way", group="a session's calibration"),
        Column("time", "min", "a session's calibration"),
        Column("rms", unit, "error"),
        Column("95 % interval", unit, "error"),
        Column("bias", unit, "error"),
        Column("worst", unit, "error"),
        Column("rms", "%", "relative error"),
        Column("95 % interval", "%", "relative error"),
        Column("95 % interval", "%", "less the best's"),
        Column("verdict", text=True),
    )
    body = tuple(
        (*_cells(row, unit), *(("", "least rms") if row["strategy"] == best else _against(row, against)))
        for _, row in table.iterrows()
    )
    return Table(f"Strategies for {joint_name(joint)}", columns, body, note=NOTE)


def left_out_table(found: Comparison) -> Table | None:
    """Sessions that a strategy could not calibrate, and why; None where there is none."""
    heads = ("strategy", "joint", "direction", "session", "why")
    body = tuple(
        (strategy, joints, ways.replace("-", MINUS) or MISSING, sessions, typeset(why))
        for strategy, joints, ways, sessions, why in left_out(found)
    )
    columns = tuple(Column(head, text=True) for head in heads)
    return Table("Left out", columns, body) if body else None


def _of_all(found: Comparison, sessions: int) -> str:
    seen = {*found.spent["session"], *found.left_out["session"]} - {""}
    if len(seen) >= sessions:
        return ""
    return f" Compared on the latest {len(seen)} of {sessions:,} sessions; stickslip-fit compare takes all."


def _said(text: str) -> str:
    return typeset(text).replace("(-)", f"({MINUS})")


def _cells(row: pd.Series, unit: str) -> tuple[str, ...]:
    return (
        str(row["strategy"]),
        f"{row['traverses_made']:.3g}",
        f"{row['seconds'] / 60:.0f}",
        format_number(row["rms"], unit),
        format_range(row["rms_low"], row["rms_high"], unit),
        format_number(row["bias"], unit),
        format_number(row["worst"], unit),
        format_percent(row["rms_relative"], with_unit=False),
        format_percent_range(row["rms_relative_low"], row["rms_relative_high"]),
    )


def _against(row: pd.Series, against: pd.DataFrame) -> tuple[str, str]:
    pair = against.loc[row["strategy"]]
    bounds = format_percent_range(pair["difference_relative_low"], pair["difference_relative_high"])
    return bounds, str(pair["verdict"]).removesuffix(" on this log")
