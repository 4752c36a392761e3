"""The tables of a diagnosis."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MINUS,
    format_angle,
    format_direction,
    format_estimate,
    format_interval,
    format_length,
    format_p_value,
    format_percent,
    pluralize,
    typeset,
)
from stickslip_fit._summary import Column, Table
from stickslip_fit.diagnose import Diagnosis, Gain, NextTraverse
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.telling.text import LIKELY_ENOUGH, ranking, where

MOST_RANKED, MOST_TRAVERSES = 10, 20
NONE = "–"


def findings_tables(diagnosis: Diagnosis) -> list[Table]:
    """What is wrong with its size, its parameters, and traverses that are wildly off."""
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        Column("effect, rms", "%"),
        Column("95 % interval", "%"),
        Column("joints", text=True),
        Column("p"),
        Column("cannot be told from", text=True),
    )
    rows = tuple(
        (
            finding.cause,
            format_percent(finding.effect.estimate, with_unit=False),
            format_interval(finding.effect, "%", 1),
            ", ".join(map(str, finding.joints)),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or NONE,
        )
        for finding in diagnosis.findings
    )
    note = (
        "Effect: rms over all rows of what the cause does to the count, beyond what recalibration absorbs. "
        "p: the chance of anything as far off, anywhere that was searched, if nothing were wrong."
    )
    found = [Table("What is wrong", columns, rows, note=note)]
    parameters = _parameters(diagnosis)
    wild = [_wild(each.traverses) for each in diagnosis.findings if each.traverses is not None]
    return [*found, *([parameters] if parameters.rows else []), *wild]


def gain_tables(diagnosis: Diagnosis) -> list[Table]:
    """Errors on traverses that took no part."""
    named = [each for each in diagnosis.findings if each.cause != UNKNOWN]
    steps = [(f"with {each.cause}", each.gain) for each in named] if len(named) > 1 else []
    lines: list[tuple[str, Gain | None]] = [
        ("held-out traverses", diagnosis.gain),
        *steps,
        ("a new session, by its calibration", diagnosis.gain_new_session),
    ]
    rows = tuple(_gain(name, gain) for name, gain in lines if gain is not None)
    if not rows or not named:
        return []
    columns = (
        Column("predicted", text=True),
        Column("published law", "%"),
        Column("extended law", "%"),
        Column("gain", "%"),
        Column("95 % interval", "%"),
        Column("noise floor", "%"),
    )
    note = (
        "Rms error of the step size on traverses that took no part in choosing or fitting anything. The "
        "interval is for a fresh replicate of this campaign; the noise floor includes the rounding of counts."
    )
    return [Table("What the extended law gains", columns, rows, note=note)]


def further(diagnosis: Diagnosis) -> list[Table]:
    """The ranking of causes, and the traverses that would tell."""
    ranked = [each for each in ranking(diagnosis) if each[1] >= LIKELY_ENOUGH][:MOST_RANKED]
    columns = (
        Column("cause", text=True),
        Column("probability", "%"),
        Column("odds against chance", "powers of ten"),
    )
    rows = tuple(
        (
            cause,
            f"{100 * likely:.0f}" if likely < 0.995 else "> 99",
            f"{odds:.1f}".replace("-", MINUS) if np.isfinite(odds) else NONE,
        )
        for cause, likely, odds in ranked
    )
    found = [Table("What may be at work", columns, rows)] if rows else []
    if diagnosis.next_experiment:
        found.append(_next(diagnosis))
    return found


def _parameters(diagnosis: Diagnosis) -> Table:
    columns: tuple[Column, ...] = (
        Column("cause", text=True),
        Column("parameter", text=True),
        Column("estimate"),
        Column("95 % interval"),
        Column("of", text=True),
    )
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            finding.cause,
            each.name,
            typeset(format_estimate(each.size, each.unit, signed=True)),
            format_interval(each.size, each.unit, 1),
            where(each),
        )
        for finding in diagnosis.findings
        for each in finding.parameters
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    return Table("Parameters of what was named", columns, rows, stubs=2)


def _wild(traverses: pd.DataFrame) -> Table:
    columns = (
        Column("session", text=True),
        Column("time", text=True),
        Column("joint", text=True),
        Column("steps"),
        Column("count less law", "%"),
    )
    order = traverses["departure"].abs().sort_values(ascending=False).index
    shown = traverses.loc[order].head(MOST_TRAVERSES)
    rows = tuple(
        (
            str(row["session"]),
            row["time"].strftime("%Y-%m-%d %H:%M:%S"),
            f"{row['joint']} {format_direction(str(row['direction']))}",
            f"{row['steps']:,}",
            format_percent(float(row["departure"]), signed=True).removesuffix("%").strip(),
        )
        for _, row in shown.iterrows()
    )
    left_out = len(shown) < len(traverses)
    note = f"The {MOST_TRAVERSES} furthest off of {pluralize(len(traverses), 'count')}." if left_out else ""
    return Table("Counts that are wildly off", columns, rows, note=note)


def _gain(name: str, gain: Gain) -> tuple[str, ...]:
    return (
        name,
        format_percent(gain.baseline, with_unit=False),
        format_percent(gain.extended, with_unit=False),
        format_percent(gain.baseline - gain.extended, with_unit=False),
        f"{format_percent(gain.low, with_unit=False)} to {format_percent(gain.high, with_unit=False)}",
        format_percent(gain.noise_floor, with_unit=False),
    )


def _next(diagnosis: Diagnosis) -> Table:
    columns = (
        Column("tells apart", text=True),
        Column("joint", text=True),
        Column("times"),
        *(Column(name) for name in ("q1", "q2", "q3", "theta", "psi", "from", "to")),
        Column("when", text=True),
    )
    rows = tuple(_traverse(each) for each in diagnosis.next_experiment)
    return Table("Traverses that would tell", columns, rows, stubs=1)


def _traverse(each: NextTraverse) -> tuple[str, ...]:
    ends = format_length if each.joint == 3 else format_angle
    stands = [(name, getattr(each, name)) for name in ("q1", "q2", "q3", "theta", "psi")]
    places = [
        (format_length if name == "q3" else format_angle)(value)
        if np.isfinite(value) and name != f"q{each.joint}"
        else NONE
        for name, value in stands
    ]
    limits = [ends(value) if np.isfinite(value) else "stop" for value in (each.start, each.stop)]
    return (
        ", ".join(each.tells_apart),
        f"{each.joint} {format_direction(each.direction)}",
        str(each.repeats),
        *places,
        *limits,
        each.note,
    )
