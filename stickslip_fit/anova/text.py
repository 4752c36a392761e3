"""What matters in a log, as text for the terminal: the answer first, then the tables."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

from stickslip_fit._format import format_direction, format_p_value, format_step, format_step_range, step_unit
from stickslip_fit._summary import text_table
from stickslip_fit.anova.answer import Answer
from stickslip_fit.anova.components import Component, Components
from stickslip_fit.anova.verdict import advice, doubts, reasons, verdicts
from stickslip_fit.anova.within import MOST_SESSIONS
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.anova.analyse import Anova

WIDTH = 110
INDENTED: dict[str, Any] = {
    "initial_indent": "  ",
    "subsequent_indent": "    ",
    "break_on_hyphens": False,
}
EXPLAINED = (
    "adjusted: p over everything asked (Holm); permuted: p from relabelled readings, * the least that so\n"
    "few can give; would show: the smallest difference seen at 5 % in 80 of 100 such logs"
)


def anova_text(found: Anova) -> str:
    """Sentences, tables, doubts, and what cannot be answered."""
    parts = [_paragraph(joint, told) for joint, told in told_by_joint(found).items()]
    parts = parts or ["Nothing can be answered from this log."]
    for place in dict.fromkeys((each.question.joint, each.question.configuration) for each in found.answers):
        mine = [each for each in found.answers if (each.question.joint, each.question.configuration) == place]
        parts.append(f"joint {place[0]} at {place[1]}\n{_answers(mine)}")
    if found.answers:
        parts[-1] += f"\n{EXPLAINED}{_not_asked(found.answers)}"
    if found.answers:
        parts.append(f"sums of squares, over sessions of the means of cells\n{_squares(found.answers)}")
    if found.components:
        parts.append(f"standard deviations of the step size (95 %)\n{_components(found.components)}")
    for heading, lines in (
        ("premises", doubts(found.answers)),
        ("cannot be answered", reasons(found.refusals)),
    ):
        if lines:
            parts.append("\n".join([heading, *(fill(line, WIDTH, **INDENTED) for line in lines)]))
    return "\n\n".join(parts)


def _not_asked(answers: Sequence[Answer]) -> str:
    """Of many sessions, single ones are not asked unless one is named."""
    most = max(each.question.readings["session"].nunique() for each in answers)
    within = any(each.question.session for each in answers)
    return "" if within or most <= MOST_SESSIONS else "\nwithin a single session: name it with --session"


def told_by_joint(found: Anova) -> dict[int, list[str]]:
    """The sentences of each joint: what matters, and what to do."""
    joints = dict.fromkeys(each.question.joint for each in found.answers)
    told = {joint: verdicts(joint, found.answers) for joint in joints}
    for each in found.components:
        told.setdefault(each.joint, []).extend(advice(each, found.answers))
    return told


def _paragraph(joint: int, told: Sequence[str]) -> str:
    return fill(f"Joint {joint}. {' '.join(told)}", WIDTH, break_on_hyphens=False)


def _answers(answers: Sequence[Answer]) -> str:
    header = [
        "question", "", "session", "difference", "95 %", "largest less smallest", "F", "df", "p", "adjusted",
        "permuted", "omega²", "would show",
    ]  # fmt: skip
    return text_table(header, [_row(each) for each in answers], left=3)


def _row(answer: Answer) -> list[str]:
    joint = answer.question.joint
    floor = answer.permutation.p_value <= answer.permutation.floor * (1 + 1e-9)
    return [
        *_question(answer),
        format_step(answer.effect.difference, joint),
        format_step_range(answer.effect.low, answer.effect.high, joint),
        " less ".join(map(format_direction, answer.furthest)),
        f"{answer.statistic:.4g}",
        ", ".join(str(freedom) for freedom in answer.squares.freedom[1:]),
        format_p_value(answer.p_value),
        format_p_value(answer.p_holm),
        format_p_value(answer.permutation.p_value) + ("*" if floor else " "),
        f"{float(answer.squares.omega_squared):.2f}",
        format_step(answer.detectable, joint),
    ]


def _question(answer: Answer) -> list[str]:
    asked = answer.question
    sessions = asked.session or ("all" if asked.analysis == "day" else "over all")
    return [asked.analysis, format_direction(asked.direction or ""), sessions]


def _squares(answers: Sequence[Answer]) -> str:
    header = ["joint, question", "", "session", "term", "SS", "df", "MS", "F", "p"]
    rows = []
    for each in answers:
        head = _question(each)
        head[0] = f"{each.question.joint} {head[0]}"
        for line in each.table.itertuples(index=False):
            rows.append([*head, *_line(line, each.question.joint)])
            head = ["", "", ""]
    return text_table(header, rows, left=4)


def _line(line: Any, joint: int) -> list[str]:
    unit = step_unit(joint)
    sums = [from_si(from_si(value, unit), unit) for value in (line.ss, line.ms)]
    shown = [f"{value:.5g} {unit}²" if value == value else "" for value in sums]
    tested = [f"{line.F:.4g}", format_p_value(line.p)] if line.F == line.F else ["", ""]
    return [line.term, shown[0], str(line.df), shown[1], *tested]


def _components(found: Sequence[Components]) -> str:
    header = ["", "day", "day x direction", "day, either way", "replicate", "direction + less −"]
    return text_table(header, [_components_row(each) for each in found])


def _components_row(found: Components) -> list[str]:
    def shown(part: Component | None) -> str:
        if part is None:
            return "–"
        bounds = format_step_range(part.low, part.high, found.joint)
        return f"{format_step(part.deviation, found.joint)} ({bounds})"

    direction = "–"
    if found.direction is not None and found.direction_low is not None and found.direction_high is not None:
        bounds = format_step_range(found.direction_low, found.direction_high, found.joint)
        direction = f"{format_step(found.direction, found.joint)} ({bounds})"
    parts = (found.day, found.day_direction, found.total, found.replicate)
    return [f"joint {found.joint}", *map(shown, parts), direction]
