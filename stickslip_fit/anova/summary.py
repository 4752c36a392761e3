"""What an analysis of variance says: which factors matter, what to do, and every number behind it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd

from stickslip_fit._format import (
    MINUS,
    capitalize_first,
    format_direction,
    format_number,
    format_p_value,
    format_range,
    join_words,
    joint_name,
    pluralize,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.anova.analyse import Anova
from stickslip_fit.anova.answer import Answer
from stickslip_fit.anova.components import Component, Components
from stickslip_fit.anova.formula import FormulaTable
from stickslip_fit.anova.verdict import LEVEL, advice, doubts, reasons, verdicts
from stickslip_fit.anova.within import MOST_SESSIONS
from stickslip_fit.units import from_si

MAX_ROWS = 24
AT_FLOOR = "*"
CAUTIONS = "What to mind, and what cannot be answered"


@summarize.register
def summarize_anova(anova: Anova) -> Summary:
    """A paragraph and a section for each joint, then assumptions that fail and what has no answer."""
    sentences = sentences_by_joint(anova)
    headline = [f"Joint {joint}. {' '.join(said)}" for joint, said in sentences.items()]
    sections = [
        Section(capitalize_first(joint_name(joint)), tables=tuple(_tables(joint, anova)))
        for joint in sentences
    ]
    cautions = [*doubts(anova.answers), *reasons(anova.refusals)]
    if cautions:
        sections.append(Section(CAUTIONS, tuple(map(typeset, cautions))))
    return Summary(
        "Which factors matter",
        tuple(map(typeset, headline)) or ("Nothing can be answered from this log.",),
        tuple(sections),
    )


def sentences_by_joint(anova: Anova) -> dict[int, list[str]]:
    """What matters for each joint, and what to do."""
    joints = dict.fromkeys(each.question.joint for each in anova.answers)
    sentences = {joint: verdicts(joint, anova.answers) for joint in joints}
    for each in anova.components:
        sentences.setdefault(each.joint, []).extend(advice(each, anova.answers))
    return sentences


def _tables(joint: int, anova: Anova) -> list[Table]:
    answers = [each for each in anova.answers if each.question.joint == joint]
    tables = [_answers_table(joint, answers), _squares_table(joint, answers)] if answers else []
    return [*tables, *(_components_table(each) for each in anova.components if each.joint == joint)]


def _answers_table(joint: int, answers: Sequence[Answer]) -> Table:
    unit = step_unit(joint)
    columns = (
        *words("question", "session", "largest less smallest"),
        Column("difference (95 %)", unit),
        *numbers("omega²", "F (degrees)"),
        *numbers("F test", "adjusted", "permuted", group="p"),
        Column("would show", unit),
    )
    shown = [each for each in answers if len(answers) <= MAX_ROWS or each.question.session is None]
    note = (
        "Adjusted: for everything asked of this log (Holm). Permuted: from relabelled readings; "
        f"{AT_FLOOR} the smallest that so few can give. Would show: the smallest difference that is seen at "
        f"5 % in 80 of 100 such logs. {_places(shown)}"
    )
    if len(shown) < len(answers):
        note += f" Not shown: {len(answers) - len(shown)} answers within single sessions."
    elif _sessions_not_asked(answers):
        note += " Within a single session: name it with --session."
    return Table(f"Factors of {joint_name(joint)}", columns, tuple(map(_row, shown)), stubs=2, note=note)


def _sessions_not_asked(answers: Sequence[Answer]) -> bool:
    """Of many sessions, single ones are not asked unless one is named."""
    most = max(each.question.readings["session"].nunique() for each in answers)
    return most > MOST_SESSIONS and not any(each.question.session for each in answers)


def _row(answer: Answer) -> tuple[str, ...]:
    effect, unit = answer.effect, step_unit(answer.question.joint)
    day = answer.question.analysis == "day"
    levels = answer.furthest if day else [typeset(format_direction(level)) for level in answer.furthest]
    at_floor = answer.permutation.p_value <= answer.permutation.floor * (1 + 1e-9)
    statistic = f"{answer.statistic:.3g}" if answer.statistic < 1000 else f"{answer.statistic:,.0f}"
    return (
        *_question(answer),
        _less(*levels),
        f"{format_number(effect.difference, unit)} ({format_range(effect.low, effect.high, unit)})",
        f"{float(answer.squares.omega_squared):.2f}",
        f"{statistic} ({', '.join(str(df) for df in answer.squares.freedom[1:])})",
        format_p_value(answer.p_value),
        format_p_value(answer.p_holm),
        format_p_value(answer.permutation.p_value) + (AT_FLOOR if at_floor else ""),
        format_number(answer.detectable, unit),
    )


def _question(answer: Answer) -> tuple[str, str]:
    asked = answer.question
    return f"{asked.analysis} {format_direction(asked.direction)}".strip(), asked.session or "all"


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


def _squares_table(joint: int, answers: Sequence[Answer]) -> Table:
    unit = step_unit(joint)
    columns = (
        *words("question", "session", "term"),
        Column("SS", f"{unit}²"),
        Column("df"),
        Column("MS", f"{unit}²"),
        *numbers("F", "p"),
    )
    rows = [
        (*_question(each), *_line(line, unit))
        for each in answers
        for line in each.table.itertuples(index=False)
    ]
    note = "Over sessions of the means of cells."
    return Table(
        f"Sums of squares of {joint_name(joint)}", columns, tuple(rows), stubs=3, note=note, folded=True
    )


def _line(line: Any, unit: str) -> tuple[str, ...]:
    ss, ms = (f"{from_si(from_si(value, unit), unit):.5g}" for value in (line.ss, line.ms))
    tested = (f"{line.F:.4g}", format_p_value(line.p)) if line.F == line.F else ("", "")
    return (line.term, ss, str(line.df), ms if line.ms == line.ms else "", *tested)


def _components_table(found: Components) -> Table:
    unit = step_unit(found.joint)
    columns = (
        Column("source", text=True),
        *numbers("standard deviation", "95 % interval", unit=unit),
        Column("share of the step size", "%"),
    )
    parts: list[tuple[str, Component | None]] = [
        ("day, both directions alike", found.day),
        ("day, each direction by itself", found.day_direction),
        ("day, in one direction altogether", found.total),
        ("reading to reading", found.replicate),
    ]
    sizes = [(name, part.deviation, part.low, part.high) for name, part in parts if part is not None]
    if found.direction is not None and found.direction_low is not None and found.direction_high is not None:
        direction = (found.direction, found.direction_low, found.direction_high)
        sizes.append((f"direction, + less {MINUS}", *direction))
    body = tuple(
        (
            name,
            format_number(size, unit),
            format_range(low, high, unit),
            format_number(size / found.mean, "%"),
        )
        for name, size, low, high in sizes
    )
    note = (
        "Sessions are drawn at random; the two directions are all there are, so that the last row is a "
        "difference and no standard deviation. Restricted maximum likelihood; an interval that begins at 0 "
        "includes no change at all."
    )
    caption = f"Where the variation of {joint_name(found.joint)} comes from"
    return Table(caption, columns, body, note=note)


@summarize.register
def summarize_formula(found: FormulaTable) -> Summary:
    """What shows an effect, then the table; sums of squares in SI units of the response."""
    table = found.table
    heads = ("sum of squares", "df", "mean square", "F", "p", "p, adjusted", "omega²")
    rows = [_formula_row(row) for _, row in table.iterrows()]
    if found.kind == 1:
        total = sum(line.squares for line in found.lines)
        rows.append(("total", f"{total:.6g}", str(found.count - 1), *[""] * 5))
    note = (
        f"{found.formula}, type {found.kind}, {pluralize(found.count, 'reading')}. Sums of squares in the "
        "response's SI unit; adjusted for all terms (Holm); omega² partial."
    )
    columns = (Column("term", text=True), *map(Column, heads))
    caption = f"Analysis of variance, {joint_name(found.joint)}"
    return Summary(
        found.formula,
        (f"Joint {found.joint}. {_formula_sentence(table)}",),
        (Section(tables=(Table(caption, columns, tuple(rows), note=note),)),),
    )


def _formula_sentence(table: pd.DataFrame) -> str:
    terms = table[:-1]
    shown = terms[terms["p_holm"] < LEVEL]
    untested = list(terms.loc[terms["df"] == 0, "term"])
    said = "Nothing in the formula shows an effect."
    if len(shown):
        worst = format_p_value(shown["p_holm"].max(), relation=True)
        said = f"What shows an effect: {join_words(list(shown['term']))} (adjusted p {worst})."
    if untested:
        said += f" Other terms say all that {join_words(untested)} could say."
    return said


def _formula_row(row: pd.Series) -> tuple[str, ...]:
    mean = f"{row['ms']:.6g}" if row["df"] else ""
    tested = [
        f"{row['F']:.4g}",
        format_p_value(row["p"]),
        format_p_value(row["p_holm"]),
        f"{row['omega_squared']:.2f}",
    ]
    return (
        row["term"],
        f"{row['ss']:.6g}",
        str(row["df"]),
        mean,
        *(tested if row["F"] == row["F"] else [""] * 4),
    )
