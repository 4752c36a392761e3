"""Text of an analysis of variance: conclusions, recommendations, tables, failed assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

import pandas as pd

from stickslip_fit._format import (
    MINUS,
    capitalize_first,
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_range,
    format_step,
    format_step_range,
    join_words,
    joint_name,
    pluralize,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.anova.analysis import Anova
from stickslip_fit.anova.designs import MAX_SESSIONS, FactorTestDesign, NotTestable
from stickslip_fit.anova.factor_test import FactorTest
from stickslip_fit.anova.formula import FormulaTable
from stickslip_fit.anova.variance_components import VarianceComponent, VarianceComponents
from stickslip_fit.units import from_si

SIGNIFICANCE_LEVEL = 0.05
ALL_SESSIONS = "over all sessions"
COST_LIMIT = 3.0  # times the repeatability: a cost that a lab would want to avoid
MAX_LISTED_SESSIONS = 3  # sessions that a list names


def is_significant(factor_test: FactorTest) -> bool:
    """Whether levels differ at 5 %, everything that was asked taken into account."""
    return factor_test.p_holm < SIGNIFICANCE_LEVEL


def conclude(joint: int, factor_tests: Sequence[FactorTest]) -> list[str]:
    """What a joint's answers come to, one sentence for each question."""
    subset = [each for each in factor_tests if each.design.joint == joint]
    writers = {"day": _conclude_day, "direction": _conclude_direction, "normal-force": _conclude_normal_force}
    by_name = {name: [each for each in subset if each.design.analysis == name] for name in writers}
    return [capitalize_first(tell(by_name[name])) for name, tell in writers.items() if by_name[name]]


def recommend(components: VarianceComponents, factor_tests: Sequence[FactorTest]) -> list[str]:
    """Whether to recalibrate each session and to keep parameters for each direction, with the cost of not."""
    subset = [each for each in factor_tests if each.design.joint == components.joint]
    return [_recommend_recalibration(components, subset), *_recommend_directions(components, subset)]


def _recommend_recalibration(components: VarianceComponents, factor_tests: Sequence[FactorTest]) -> str:
    changes = any(is_significant(each) for each in factor_tests if each.design.analysis == "day")
    cost, low, high = (
        sqrt(2.0) * value
        for value in (components.total.deviation, components.total.low, components.total.high)
    )
    price = (
        f"the calibration of another session is off by {format_step(cost, components.joint)} a step "
        f"rms ({format_percent(cost / components.mean)}; 95 %: {format_step_range(low, high, components.joint)}), "
        f"{_format_ratio(cost / components.replicate.deviation)} what one reading differs from the next"
    )
    if changes:
        return f"Recalibrate each session: {price}."
    if high > COST_LIMIT * components.replicate.deviation:
        return f"Whether to recalibrate each session this log is too small to say: {price}."
    return f"This log gives no reason to recalibrate each session: {price}."


def _recommend_directions(components: VarianceComponents, factor_tests: Sequence[FactorTest]) -> list[str]:
    if components.direction is None:
        return []
    differs = any(is_significant(each) for each in factor_tests if each.design.analysis == "direction")
    cost, limit = abs(components.direction) / 2, COST_LIMIT * components.replicate.deviation
    share = format_percent(cost / components.mean)
    price = f"one set for both is off by {format_step(cost, components.joint)} a step ({share})"
    if differs:
        return [f"Keep separate parameters for each direction: {price}."]
    if max(map(abs, (components.direction_low or 0.0, components.direction_high or 0.0))) / 2 > limit:
        return [
            f"Whether to keep separate parameters for each direction this log is too small to say: {price}."
        ]
    return [f"This log gives no reason for separate parameters: {price}."]


def _format_ratio(ratio: float) -> str:
    return f"{ratio:.2g} times"


def _conclude_day(factor_tests: Sequence[FactorTest]) -> str:
    changed = [each for each in factor_tests if is_significant(each)]
    same = [each for each in factor_tests if not is_significant(each)]
    sentences = []
    if changed:
        sizes = [f"{_effect_text(each)} in direction {_test_direction(each)}" for each in changed]
        sentences.append(
            f"the step size changes from session to session, by up to {join_words(sizes)} ({_adjusted_p_text(changed)})"
        )
    if same:
        directions = join_words([_test_direction(each) for each in same])
        seen = [
            f"{format_step(each.detectable, each.design.joint)} in direction {_test_direction(each)}"
            for each in same
        ]
        sentences.append(
            f"no change from session to session shows in direction {directions} ({_adjusted_p_text(same)}); one of "
            f"{join_words(seen)} would most likely have shown"
        )
    return "; ".join(sentences) + "."


def _conclude_direction(factor_tests: Sequence[FactorTest]) -> str:
    over = [each for each in factor_tests if each.design.session is None]
    within = [each for each in factor_tests if each.design.session is not None]
    differing = [each for each in within if is_significant(each)]
    if over and is_significant(over[0]):
        return f"the two directions differ by {_effect_text(over[0])}, taken over all sessions ({_adjusted_p_text(over)})."
    if differing:
        each_of = f"{len(differing)} of {len(within)} sessions" if len(within) > 1 else "the session"
        sizes = sorted(each.effect.difference for each in differing)
        joint = factor_tests[0].design.joint
        spread = (
            format_step(sizes[0], joint) if len(sizes) == 1 else format_step_range(sizes[0], sizes[-1], joint)
        )
        unsure = "; from so few, or so different, sessions it cannot be said of others" if over else ""
        return f"the two directions differ in {each_of}, by {spread} ({_adjusted_p_text(differing)}){unsure}."
    least = min(factor_tests, key=lambda each: each.detectable)
    return (
        f"no difference between the directions shows ({_adjusted_p_text(factor_tests)}); one of "
        f"{format_step(least.detectable, least.design.joint)} would most likely have shown."
    )


def _conclude_normal_force(factor_tests: Sequence[FactorTest]) -> str:
    over = [each for each in factor_tests if each.design.session is None] or list(factor_tests)
    differing = [each for each in over if is_significant(each)]
    if not differing:
        least = max(over, key=lambda each: each.detectable)
        return (
            f"turning the base about the joint's axis changes nothing that shows ({_adjusted_p_text(over)}); a change of "
            f"{format_step(least.detectable, least.design.joint)} would most likely have shown."
        )
    sizes = [
        f"{_effect_text(each)} in direction {_test_direction(each)} (between {' and '.join(each.extreme_levels)})"
        for each in differing
    ]
    sentences = f"{join_words(sizes)} ({_adjusted_p_text(differing)})"
    if _may_be_drift(differing):
        return (
            f"between orientations of the base about the joint's axis the step size differs, by {sentences}; but "
            "readings drift, or may, within their session, which alone could do that."
        )
    return f"turning the base about the joint's axis changes the step size, by {sentences}."


def _may_be_drift(factor_tests: Sequence[FactorTest]) -> bool:
    """Whether readings drift, or levels were read one after another: then the hour could be what matters."""
    by_time = {"levels in turn", "drift within a session"}
    return any(
        each.name in by_time and each.verdict == "doubtful"
        for one in factor_tests
        for each in one.assumptions
    )


def _test_direction(factor_test: FactorTest) -> str:
    return format_direction(str(factor_test.design.direction))


def _effect_text(factor_test: FactorTest) -> str:
    return f"{format_step(factor_test.effect.difference, factor_test.design.joint)} ({format_percent(factor_test.relative_difference)})"


def _adjusted_p_text(factor_tests: Sequence[FactorTest]) -> str:
    """The least convincing adjusted p-value of effects, the most convincing one where none shows."""
    values = [each.p_holm for each in factor_tests]
    shown = max(values) if all(value < SIGNIFICANCE_LEVEL for value in values) else min(values)
    return f"adjusted p {format_p_value(shown, relation=True)}"


def list_failed_assumptions(factor_tests: Sequence[FactorTest]) -> list[str]:
    """Premises that fail, then those that nothing can be told of, each once, with the questions concerned."""
    sentences: dict[str, dict[str, list[FactorTestDesign]]] = {"doubtful": {}, "cannot tell": {}}
    fine: dict[str, None] = {}
    for each in factor_tests:
        for premise in each.assumptions:
            if premise.verdict == "holds":
                fine[premise.name] = None
            else:
                sentences[premise.verdict].setdefault(premise.message, []).append(each.design)
    lines = [
        f"{capitalize_first(message)} ({name_designs(factor_tests)})."
        for by_message in sentences.values()
        for message, factor_tests in by_message.items()
    ]
    return [*lines, f"All other checks of {join_words(list(fine))} pass."] if fine else lines


def list_not_testable(reasons_by_design: Sequence[NotTestable]) -> list[str]:
    """Why questions cannot be answered, each reason once."""
    sentences: dict[str, list[NotTestable]] = {}
    for each in reasons_by_design:
        sentences.setdefault(each.reason, []).append(each)
    return [
        f"{capitalize_first(name_designs(factor_tests))}: {reason}."
        for reason, factor_tests in sentences.items()
    ]


def name_designs(factor_tests: Sequence[FactorTestDesign | NotTestable]) -> str:
    """Questions in few words, the sessions of one kind together."""
    sessions: dict[str, list[str]] = {}
    for each in factor_tests:
        parts = [
            f"joint {each.joint}",
            each.analysis,
            *([format_direction(each.direction)] if each.direction else []),
        ]
        sessions.setdefault(" ".join(parts), []).append(each.session or ALL_SESSIONS)
    return join_words([f"{name}{_sessions_text(which)}" for name, which in sessions.items()])


def _sessions_text(which: Sequence[str]) -> str:
    if set(which) == {ALL_SESSIONS}:
        return ""
    few = (
        [*which[:MAX_LISTED_SESSIONS], f"{len(which) - MAX_LISTED_SESSIONS} more"]
        if len(which) > MAX_LISTED_SESSIONS + 1
        else which
    )
    return f" [{', '.join(few)}]"


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
    cautions = [*list_failed_assumptions(anova.answers), *list_not_testable(anova.not_testable)]
    if cautions:
        sections.append(Section(CAUTIONS, tuple(map(typeset_text, cautions))))
    return Summary(
        "Which factors matter",
        tuple(map(typeset_text, headline)) or ("Nothing can be answered from this log.",),
        tuple(sections),
    )


def sentences_by_joint(anova: Anova) -> dict[int, list[str]]:
    """What matters for each joint, and what to do."""
    joints = dict.fromkeys(each.design.joint for each in anova.answers)
    sentences = {joint: conclude(joint, anova.answers) for joint in joints}
    for each in anova.components:
        sentences.setdefault(each.joint, []).extend(recommend(each, anova.answers))
    return sentences


def _tables(joint: int, anova: Anova) -> list[Table]:
    answers = [each for each in anova.answers if each.design.joint == joint]
    tables = [_answers_table(joint, answers), _squares_table(joint, answers)] if answers else []
    return [*tables, *(_components_table(each) for each in anova.components if each.joint == joint)]


def _answers_table(joint: int, answers: Sequence[FactorTest]) -> Table:
    unit = step_unit(joint)
    columns = (
        *words("question", "session", "largest less smallest"),
        Column("difference (95 %)", unit),
        *numbers("omega²", "F (degrees)"),
        *numbers("F test", "adjusted", "permuted", group="p"),
        Column("would show", unit),
    )
    shown = [each for each in answers if len(answers) <= MAX_ROWS or each.design.session is None]
    note = (
        "Adjusted: for everything asked of this log (Holm). Permuted: from relabelled readings; "
        f"{AT_FLOOR} the smallest that so few can give. Would show: the smallest difference that is seen at "
        f"5 % in 80 of 100 such logs. {_places(shown)}"
    )
    if len(shown) < len(answers):
        note += f" Not shown: {len(answers) - len(shown)} answers within single sessions."
    elif _sessions_not_asked(answers):
        note += " Within a single session: name it with --session."
    return Table(f"Factors of {joint_name(joint)}", columns, tuple(map(_test_row, shown)), stubs=2, note=note)


def _sessions_not_asked(answers: Sequence[FactorTest]) -> bool:
    """Of many sessions, single ones are not asked unless one is named."""
    most = max(each.design.readings["session"].nunique() for each in answers)
    return most > MAX_SESSIONS and not any(each.design.session for each in answers)


def _test_row(answer: FactorTest) -> tuple[str, ...]:
    effect, unit = answer.effect, step_unit(answer.design.joint)
    day = answer.design.analysis == "day"
    levels = (
        answer.extreme_levels
        if day
        else [typeset_text(format_direction(level)) for level in answer.extreme_levels]
    )
    at_floor = answer.permutation.p_value <= answer.permutation.floor * (1 + 1e-9)
    statistic = f"{answer.statistic:.3g}" if answer.statistic < 1000 else f"{answer.statistic:,.0f}"
    return (
        *_design_cells(answer),
        _less(*levels),
        f"{format_number(effect.difference, unit)} ({format_range(effect.low, effect.high, unit)})",
        f"{float(answer.squares.omega_squared):.2f}",
        f"{statistic} ({', '.join(str(df) for df in answer.squares.df[1:])})",
        format_p_value(answer.p_value),
        format_p_value(answer.p_holm),
        format_p_value(answer.permutation.p_value) + (AT_FLOOR if at_floor else ""),
        format_number(answer.detectable, unit),
    )


def _design_cells(answer: FactorTest) -> tuple[str, str]:
    asked = answer.design
    return f"{asked.analysis} {format_direction(asked.direction)}".strip(), asked.session or "all"


def _less(largest: str, smallest: str) -> str:
    """What both names begin with is said once: theta −90° less 0°."""
    first, _, rest = smallest.partition(" ")
    return f"{largest} less {rest if rest and largest.startswith(f'{first} ') else smallest}"


def _places(answers: Sequence[FactorTest]) -> str:
    """At which configuration each question was asked."""
    places: dict[str, list[str]] = {}
    for each in answers:
        names = places.setdefault(each.design.configuration, [])
        names += [each.design.analysis] if each.design.analysis not in names else []
    return " ".join(
        f"{' and '.join(names).capitalize()}: at {typeset_text(where)}." for where, names in places.items()
    )


def _squares_table(joint: int, answers: Sequence[FactorTest]) -> Table:
    unit = step_unit(joint)
    columns = (
        *words("question", "session", "term"),
        Column("SS", f"{unit}²"),
        Column("df"),
        Column("MS", f"{unit}²"),
        *numbers("F", "p"),
    )
    rows = [
        (*_design_cells(each), *_squares_row(line, unit))
        for each in answers
        for line in each.table.itertuples(index=False)
    ]
    note = "Over sessions of the means of cells."
    return Table(
        f"Sums of squares of {joint_name(joint)}", columns, tuple(rows), stubs=3, note=note, folded=True
    )


def _squares_row(line: Any, unit: str) -> tuple[str, ...]:
    ss, ms = (f"{from_si(from_si(value, unit), unit):.5g}" for value in (line.ss, line.ms))
    tested = (f"{line.F:.4g}", format_p_value(line.p)) if line.F == line.F else ("", "")
    return (line.term, ss, str(line.df), ms if line.ms == line.ms else "", *tested)


def _components_table(found: VarianceComponents) -> Table:
    unit = step_unit(found.joint)
    columns = (
        Column("source", text=True),
        *numbers("standard deviation", "95 % interval", unit=unit),
        Column("share of the step size", "%"),
    )
    parts: list[tuple[str, VarianceComponent | None]] = [
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
    shown = terms[terms["p_holm"] < SIGNIFICANCE_LEVEL]
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
