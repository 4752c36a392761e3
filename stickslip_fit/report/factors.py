"""Which factors matter: the analysis of variance as the report's page has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stickslip_fit._format import (
    MINUS,
    format_direction,
    format_number,
    format_p_value,
    format_range,
    joint_name,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Table
from stickslip_fit.anova import Anova, Answer, Component, Components
from stickslip_fit.anova.text import told_by_joint
from stickslip_fit.anova.verdict import doubts, reasons
from stickslip_fit.report.figures.factors import factor_pictures
from stickslip_fit.report.figures.picture import Picture

MOST_ROWS = 24
NONE = "–"
AT_FLOOR = "*"


@dataclass(frozen=True)
class Factors:
    """One joint's part of the section: heading, sentences, tables, figures."""

    heading: str
    told: list[str]
    tables: list[Table]
    pictures: list[Picture]


def factors(found: Anova) -> list[Factors]:
    """What matters for each joint."""
    return [
        Factors(
            joint_name(joint).capitalize(),
            [typeset(sentence) for sentence in told],
            _tables(joint, found),
            factor_pictures(joint, found.answers),
        )
        for joint, told in told_by_joint(found).items()
    ]


def cautions(found: Anova) -> list[str]:
    """Premises that fail, then what cannot be answered."""
    return [*doubts(found.answers), *(typeset(each) for each in reasons(found.refusals))]


def _tables(joint: int, found: Anova) -> list[Table]:
    mine = [each for each in found.answers if each.question.joint == joint]
    known = [each for each in found.components if each.joint == joint]
    return [*([_answers_table(joint, mine)] if mine else []), *(_components_table(each) for each in known)]


def _answers_table(joint: int, answers: Sequence[Answer]) -> Table:
    unit = step_unit(joint)
    columns = (
        Column("question", text=True),
        Column("session", text=True),
        Column("largest less smallest", text=True),
        Column("difference (95 %)", unit),
        Column("omega²"),
        Column("F (degrees)"),
        Column("F test", group="p"),
        Column("adjusted", group="p"),
        Column("permuted", group="p"),
        Column("would show", unit),
    )
    shown = [each for each in answers if len(answers) <= MOST_ROWS or each.question.session is None]
    note = (
        "Adjusted: for everything asked of this log (Holm). Permuted: from relabelled readings; "
        f"{AT_FLOOR} the smallest that so few can give. Would show: the smallest difference that is seen at "
        "5 % in 80 of 100 such logs. " + _places(shown)
    )
    if len(shown) < len(answers):
        note += f" Not shown: {len(answers) - len(shown)} answers within single sessions."
    body = tuple(_row(each) for each in shown)
    return Table(f"Factors of {joint_name(joint)}", columns, body, stubs=2, note=note)


def _row(answer: Answer) -> tuple[str, ...]:
    asked, effect, unit = answer.question, answer.effect, step_unit(answer.question.joint)
    at_floor = answer.permutation.p_value <= answer.permutation.floor * (1 + 1e-9)
    levels = (
        answer.furthest
        if asked.analysis == "day"
        else tuple(map(typeset, map(format_direction, answer.furthest)))
    )
    probabilities = [
        format_p_value(value) for value in (answer.p_value, answer.p_holm, answer.permutation.p_value)
    ]
    statistic = f"{answer.statistic:.3g}" if answer.statistic < 1000 else f"{answer.statistic:,.0f}"
    return (
        f"{asked.analysis} {format_direction(asked.direction)}" if asked.direction else asked.analysis,
        asked.session or "all",
        _less(*levels),
        f"{format_number(effect.difference, unit)} ({format_range(effect.low, effect.high, unit)})",
        f"{float(answer.squares.omega_squared):.2f}",
        f"{statistic} ({', '.join(str(freedom) for freedom in answer.squares.freedom[1:])})",
        *probabilities[:2],
        probabilities[2] + (AT_FLOOR if at_floor else ""),
        format_number(answer.detectable, unit),
    )


def _less(largest: str, smallest: str) -> str:
    """What both names begin with is said once: theta −90° less 0°."""
    first, _, rest = smallest.partition(" ")
    return f"{largest} less {rest if rest and largest.startswith(f'{first} ') else smallest}"


def _places(answers: Sequence[Answer]) -> str:
    """At which configuration each question was asked."""
    places: dict[str, list[str]] = {}
    for each in answers:
        names = places.setdefault(each.question.configuration, [])
        names += [each.question.analysis] if each.question.analysis not in names else []
    return " ".join(
        f"{' and '.join(names).capitalize()}: at {typeset(where)}." for where, names in places.items()
    )


def _components_table(found: Components) -> Table:
    unit = step_unit(found.joint)
    columns = (
        Column("source", text=True),
        Column("standard deviation", unit),
        Column("95 % interval", unit),
        Column("share of the step size", "%"),
    )
    parts: list[tuple[str, Component | None]] = [
        ("day, both directions alike", found.day),
        ("day, each direction by itself", found.day_direction),
        ("day, in one direction altogether", found.total),
        ("reading to reading", found.replicate),
    ]
    body = [
        (
            name,
            format_number(part.deviation, unit),
            f"{format_number(part.low, unit)} to {format_number(part.high, unit)}",
            f"{100 * part.deviation / found.mean:.2f}",
        )
        for name, part in parts
        if part is not None
    ]
    if found.direction is not None and found.direction_low is not None and found.direction_high is not None:
        bounds = f"{format_number(found.direction_low, unit)} to {format_number(found.direction_high, unit)}"
        share = f"{100 * found.direction / found.mean:.2f}".replace("-", MINUS)
        body.append((f"direction, + less {MINUS}", format_number(found.direction, unit), bounds, share))
    note = (
        "Sessions are drawn at random; the two directions are all there are, so that the last row is a "
        "difference and no standard deviation. Restricted maximum likelihood; an interval that begins at 0 "
        "includes no change at all."
    )
    caption = f"Where the variation of {joint_name(found.joint)} comes from"
    return Table(caption, columns, tuple(body), note=note)
