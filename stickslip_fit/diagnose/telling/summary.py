"""What a diagnosis says: the answer, sizes and gain, the alternatives, and what the log could not show."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MINUS,
    MISSING,
    format_angle,
    format_direction,
    format_estimate,
    format_interval,
    format_length,
    format_p_value,
    format_percent,
    format_percent_range,
    join_words,
    pluralize,
    typeset,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.diagnose.diagnosis import Diagnosis, Gain, NextTraverse, SizedParameter
from stickslip_fit.diagnose.experiments.next_experiment import out_of_reach
from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnose.telling.answer import answer
from stickslip_fit.units import PRISMATIC

LIKELY_ENOUGH, MAX_RANKED, MAX_TRAVERSES = 0.015, 10, 20
POWER_OF_TEN = np.log(10.0)


@summarize.register
def summarize_diagnosis(diagnosis: Diagnosis) -> Summary:
    """The answer; findings with sizes and gain; what else it could be; what could not be seen."""
    name = Path(diagnosis.log_file).name or "a log that was never in a file"
    further = traverses_table("Traverses that would tell", diagnosis.next_experiment)
    return Summary(
        f"Diagnosis of {name}",
        tuple(map(typeset, answer(diagnosis))),
        (
            Section(tables=(*_findings_tables(diagnosis), *_gain_tables(diagnosis))),
            Section(
                "What else it could be",
                tuple(_alternatives(diagnosis)),
                (*_ranking_tables(diagnosis), *further),
                key="alternatives",
            ),
            Section("What this log could not have shown", tuple(_not_seen(diagnosis)), key="unseen"),
        ),
        provenance=(
            (name, f"sha256 {diagnosis.log_sha256}"),
            ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
        ),
    )


def _findings_tables(diagnosis: Diagnosis) -> list[Table]:
    """What is wrong with its size, its parameters, and counts that are wildly off."""
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        *numbers("effect, rms", "95 % interval", unit="%"),
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
            ", ".join(finding.equivalent) or MISSING,
        )
        for finding in diagnosis.findings
    )
    note = (
        "Effect: rms over all rows of what the cause does to the count, beyond what recalibration absorbs. "
        "p: the chance of anything as far off, anywhere that was searched, if nothing were wrong."
    )
    outliers = [_outliers(each.traverses) for each in diagnosis.findings if each.traverses is not None]
    return [Table("What is wrong", columns, rows, note=note), *_parameters(diagnosis), *outliers]


def _parameters(diagnosis: Diagnosis) -> list[Table]:
    columns: tuple[Column, ...] = (
        *words("cause", "parameter"),
        *numbers("estimate", "95 % interval"),
        Column("of", text=True),
    )
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            finding.cause,
            each.name,
            typeset(format_estimate(each.size, each.unit, signed=True)),
            format_interval(each.size, each.unit, 1),
            _scope(each),
        )
        for finding in diagnosis.findings
        for each in finding.parameters
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    return [Table("Parameters of what was named", columns, rows, stubs=2)] if rows else []


def _scope(parameter: SizedParameter) -> str:
    """What a parameter belongs to, where that is not the whole campaign."""
    direction = format_direction(parameter.direction)
    joint = f"joint {parameter.joint} {direction}".strip() if parameter.joint else ""
    session = f"session {parameter.session}" if parameter.session else ""
    return ", ".join(filter(None, [joint, session]))


def _outliers(traverses: pd.DataFrame) -> Table:
    columns = (*words("session", "time", "joint"), Column("steps"), Column("count less law", "%"))
    order = traverses["departure"].abs().sort_values(ascending=False).index
    shown = traverses.loc[order].head(MAX_TRAVERSES)
    rows = tuple(
        (
            str(row["session"]),
            row["time"].strftime("%Y-%m-%d %H:%M:%S"),
            f"{row['joint']} {format_direction(str(row['direction']))}",
            f"{row['steps']:,}",
            format_percent(float(row["departure"]), with_unit=False, signed=True),
        )
        for _, row in shown.iterrows()
    )
    left_out = len(shown) < len(traverses)
    note = f"The {MAX_TRAVERSES} furthest off of {pluralize(len(traverses), 'count')}." if left_out else ""
    return Table("Counts that are wildly off", columns, rows, note=note)


def _gain_tables(diagnosis: Diagnosis) -> list[Table]:
    """Errors on traverses that took no part, before and after."""
    named = [(each.cause, each.gain) for each in diagnosis.findings if each.cause != UNKNOWN]
    steps = [(f"with {cause}", gain) for cause, gain in named] if len(named) > 1 else []
    lines: list[tuple[str, Gain | None]] = [
        ("held-out traverses", diagnosis.gain),
        *steps,
        ("a new session, by its calibration", diagnosis.gain_new_session),
    ]
    rows = tuple(
        (
            name,
            format_percent(gain.baseline, with_unit=False),
            format_percent(gain.extended, with_unit=False),
            format_percent(gain.baseline - gain.extended, with_unit=False),
            format_percent_range(gain.low, gain.high),
            format_percent(gain.noise_floor, with_unit=False),
        )
        for name, gain in lines
        if gain is not None
    )
    if not rows or not named:
        return []
    heads = ("published law", "extended law", "gain", "95 % interval", "noise floor")
    columns = (Column("predicted", text=True), *(Column(head, "%") for head in heads))
    note = (
        "Rms error of the step size on traverses that took no part in choosing or fitting anything. The "
        "interval is for a fresh replicate of this campaign; the noise floor includes the rounding of counts."
    )
    return [Table("What the extended law gains", columns, rows, note=note)]


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    said = [
        f"Whatever {first} would do in this log, {second} could have done too."
        for first, second in diagnosis.alike
    ]
    beyond = out_of_reach(diagnosis.findings, diagnosis.next_experiment)
    said += [f"No traverse within reach tells {one} from {other}." for one, other in beyond]
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        said.append("Structure without a name is not put into the law, so that it gains nothing.")
    return said


def ranking(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """Causes that may be at work, likeliest first: name, probability, log10 of the odds against chance.

    The odds are those of the look at the residuals that found it, or else of the last one.
    """
    odds = dict(diagnosis.search.last.by_cause)
    for found in diagnosis.search.found:
        looked: Misfit | None = found.misfit
        if looked is not None:
            odds |= {cause: looked.by_cause[cause] for cause in (found.cause, *found.naming.rivals)}
    likely = {cause: value for cause, value in diagnosis.inclusion.items() if value is not None}
    order = sorted(likely, key=lambda cause: (-likely[cause], cause))
    return [(cause, likely[cause], odds.get(cause, np.nan) / POWER_OF_TEN) for cause in order]


def _ranking_tables(diagnosis: Diagnosis) -> list[Table]:
    ranked = [each for each in ranking(diagnosis) if each[1] >= LIKELY_ENOUGH][:MAX_RANKED]
    columns = (
        Column("cause", text=True),
        Column("probability", "%"),
        Column("odds against chance", "powers of ten"),
    )
    rows = tuple(
        (
            cause,
            f"{100 * likely:.0f}" if likely < 0.995 else "> 99",
            f"{odds:.1f}".replace("-", MINUS) if np.isfinite(odds) else MISSING,
        )
        for cause, likely, odds in ranked
    )
    return [Table("What may be at work", columns, rows)] if rows else []


def traverses_table(caption: str, traverses: Sequence[NextTraverse]) -> list[Table]:
    """Traverses to make next, with the causes that they tell apart or show; nothing where there are none."""
    places = ("q1", "q2", "q3", "theta", "psi", "from", "to")
    columns = (*words("causes", "joint"), *map(Column, ("times", *places)), *words("when"))
    rows = tuple(map(_traverse, traverses))
    return [Table(caption, columns, rows)] if rows else []


def _traverse(each: NextTraverse) -> tuple[str, ...]:
    ends = format_length if each.joint == PRISMATIC else format_angle
    stands = [(name, getattr(each, name)) for name in ("q1", "q2", "q3", "theta", "psi")]
    places = [
        (format_length if name == "q3" else format_angle)(value)
        if np.isfinite(value) and name != f"q{each.joint}"
        else MISSING
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


def _not_seen(diagnosis: Diagnosis) -> list[str]:
    """Causes that could not have been seen, by reason."""
    causes: dict[str, list[str]] = {}
    for cause, reason in diagnosis.untestable.items():
        causes.setdefault(reason, []).append(cause)
    if not causes:
        return ["Nothing: every cause that is known would have shown at its largest plausible size."]
    return [f"{join_words(names)}: {typeset(reason)}" for reason, names in causes.items()]
