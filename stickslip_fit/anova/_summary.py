"""Text of an analysis of variance: conclusions, recommendations, tables, failed assumptions."""

from __future__ import annotations

from collections.abc import Sequence
from math import expm1, sqrt
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
    format_step_range,
    format_value,
    join_words,
    joint_name,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.anova._overview import (
    KEEP_APART,
    RECALIBRATE,
    Advice,
    name_difference,
    overview_table,
    write_overview,
)
from stickslip_fit.anova._terms_summary import (
    BY_DAY_AND_DIRECTION,
    conclude_overall,
    conclude_positions,
    overall_table,
    positions_table,
)
from stickslip_fit.anova.analysis import Anova
from stickslip_fit.anova.contrasts import SIGNIFICANCE_LEVEL
from stickslip_fit.anova.designs import MAX_SESSIONS, FactorTestDesign, NotTestable
from stickslip_fit.anova.factor_test import AssumptionCheck, FactorTest
from stickslip_fit.anova.formula import FormulaTable
from stickslip_fit.anova.overall import OVERALL, OverallAnalysis
from stickslip_fit.anova.position import DAY, DIRECTION
from stickslip_fit.anova.variance_components import VarianceComponent, VarianceComponents
from stickslip_fit.units import from_si

ALL_SESSIONS = "over all sessions"
COST_LIMIT = 3.0  # times the repeatability: a cost that a lab would want to avoid
MAX_LISTED_SESSIONS = 3  # sessions that a list names


def conclude(joint: int, factor_tests: Sequence[FactorTest]) -> list[str]:
    """A sentence for each analysis of a joint."""
    writers = {"day": _conclude_day, "direction": _conclude_direction, "normal-force": _conclude_normal_force}
    return [
        capitalize_first(write(subset))
        for name, write in writers.items()
        if (
            subset := [
                test for test in factor_tests if (test.design.analysis, test.design.joint) == (name, joint)
            ]
        )
    ]


def recommend(components: VarianceComponents, anova: Anova) -> list[Advice]:
    """Whether to recalibrate each session and to keep parameters for each direction, with the cost."""
    joint = components.joint
    shown = {
        test.design.analysis
        for test in anova.factor_tests
        if test.design.joint == joint and test.is_significant
    }
    shown |= anova.shown_terms(joint)
    if BY_DAY_AND_DIRECTION in shown:
        shown |= {DAY, DIRECTION}
    return [
        _recommend_recalibration(components, DAY in shown),
        *_recommend_directions(components, DIRECTION in shown),
    ]


def _advice_by_joint(anova: Anova) -> dict[int, list[Advice]]:
    """By the variance components of one configuration; without these by all traverses together."""
    advice = {each.joint: recommend_overall(each) for each in anova.overall}
    return advice | {each.joint: recommend(each, anova) for each in anova.components}


def recommend_overall(analysis: OverallAnalysis) -> list[Advice]:
    """As `recommend`, with the cost in the sessions of the log."""
    actions = {
        DAY: (RECALIBRATE, "the calibration of another session is off by up to {} a step", 1.0),
        DIRECTION: (KEEP_APART, "one set for both is off by {} a step", 0.5),
    }
    differing = {test.term for test in analysis.tests if test.is_significant}
    advice = []
    for test in analysis.tests:
        if test.term in actions and test.effect is not None:
            action, price, share = actions[test.term]
            needed = not differing.isdisjoint((test.term, BY_DAY_AND_DIRECTION))
            too_small = not needed and share * test.effect.high > COST_LIMIT * analysis.deviation
            cost = format_percent(share * expm1(test.effect.difference))
            advice.append(Advice(action, price.format(cost), None if too_small else needed))
    return advice


def _recommend_recalibration(components: VarianceComponents, changes: bool) -> Advice:
    total, replicate, unit = components.total, components.replicate.deviation, components.unit
    cost, low, high = (sqrt(2.0) * value for value in (total.deviation, total.low, total.high))
    price = (
        f"the calibration of another session is off by {format_value(cost, unit)} a step rms "
        f"({format_percent(cost / components.mean)}; 95 %: {format_step_range(low, high, unit)}), "
        f"{cost / replicate:.2g} times what one traverse differs from the next"
    )
    too_small = not changes and high > COST_LIMIT * replicate
    return Advice(RECALIBRATE, price, None if too_small else changes)


def _recommend_directions(components: VarianceComponents, differs: bool) -> list[Advice]:
    if components.direction is None:
        return []
    cost, limit = abs(components.direction) / 2, COST_LIMIT * components.replicate.deviation
    share = format_percent(cost / components.mean)
    price = f"one set for both is off by {format_value(cost, components.unit)} a step ({share})"
    largest = max(map(abs, (components.direction_low or 0.0, components.direction_high or 0.0))) / 2
    too_small = not differs and largest > limit
    return [Advice(KEEP_APART, price, None if too_small else differs)]


def _conclude_day(factor_tests: Sequence[FactorTest]) -> str:
    changed = [test for test in factor_tests if test.is_significant]
    same = [test for test in factor_tests if not test.is_significant]
    sentences = []
    if changed:
        sentences.append(
            "the step size changes from session to session, by up to "
            f"{join_words(list(map(_effect_text, changed)))} ({_adjusted_p_text(changed)})"
        )
    if same:
        sentences.append(
            f"no change from session to session shows {join_words(list(map(_not_shown_text, same)))}"
        )
    return f"at one configuration, {'; '.join(sentences)}."


def _conclude_direction(factor_tests: Sequence[FactorTest]) -> str:
    over = [test for test in factor_tests if test.design.session is None]
    within = [test for test in factor_tests if test.design.session is not None]
    differing = [test for test in within if test.is_significant]
    if over and over[0].is_significant:
        return (
            f"at one configuration, the two directions differ by {_difference_text(over[0])}, taken over all "
            f"sessions ({_adjusted_p_text(over)})."
        )
    if differing:
        sessions = f"{len(differing)} of {len(within)} sessions" if len(within) > 1 else "the session"
        sizes = sorted(test.effect.difference for test in differing)
        unit = factor_tests[0].design.unit
        size = (
            format_value(sizes[0], unit) if len(sizes) == 1 else format_step_range(sizes[0], sizes[-1], unit)
        )
        unsure = "; from so few, or so different, sessions it cannot be said of others" if over else ""
        p_value = _adjusted_p_text(differing)
        return (
            f"at one configuration, the two directions differ in {sessions}, by {size} ({p_value}){unsure}."
        )
    shown = over or [max(within, key=lambda test: test.effect.difference)]
    where = f"session {shown[0].design.session}" if len(within) > 1 and not over else ""
    told = _not_shown_text(shown[0], where)
    return f"at one configuration, no difference between the directions shows {told}."


def _conclude_normal_force(factor_tests: Sequence[FactorTest]) -> str:
    over = [test for test in factor_tests if test.design.session is None] or list(factor_tests)
    differing = [test for test in over if test.is_significant]
    if not differing:
        return (
            "turning the base about the joint's axis changes nothing that shows "
            f"{join_words(list(map(_not_shown_text, over)))}."
        )
    sizes = [f"{_effect_text(test)} (between {' and '.join(test.extreme_levels)})" for test in differing]
    size = f"{join_words(sizes)} ({_adjusted_p_text(differing)})"
    if _may_be_drift(differing):
        return (
            f"between orientations of the base about the joint's axis the step size differs, by {size}; but "
            "repeated traverses drift, or may, within their session, which alone could do that."
        )
    return f"turning the base about the joint's axis changes the step size, by {size}."


def _may_be_drift(factor_tests: Sequence[FactorTest]) -> bool:
    """Whether observations drift, or levels were measured one after another."""
    return any(
        check.name in ("levels in turn", "drift within a session") and check.outcome == "doubtful"
        for test in factor_tests
        for check in test.assumptions
    )


def _direction_text(test: FactorTest) -> str:
    return f"in direction {format_direction(test.design.direction)}"


def _difference_text(test: FactorTest) -> str:
    difference = format_value(test.effect.difference, test.design.unit)
    return f"{difference} ({format_percent(test.relative_difference)})"


def _effect_text(test: FactorTest) -> str:
    return f"{_difference_text(test)} {_direction_text(test)}"


def _not_shown_text(test: FactorTest, where: str = "") -> str:
    """The estimate of what does not show, and what would have unless several levels reach it."""
    effect, unit = test.effect, test.design.unit
    where = where or (_direction_text(test) if test.design.direction else "")
    found = f"{format_value(effect.difference, unit)}, 95 %: {format_range(effect.low, effect.high, unit)}"
    text = f"{where} ({found}; {_adjusted_p_text([test])}".lstrip()
    if effect.difference >= test.detectable:
        return f"{text})"
    return f"{text}; one of {format_value(test.detectable, unit)} would most likely have shown)"


def _adjusted_p_text(factor_tests: Sequence[FactorTest]) -> str:
    """The largest adjusted p-value of significant effects; the smallest where none is significant."""
    values = [test.p_holm for test in factor_tests]
    p_value = max(values) if all(value < SIGNIFICANCE_LEVEL for value in values) else min(values)
    return f"adjusted p {format_p_value(p_value, relation=True)}"


def list_failed_assumptions(anova: Anova) -> list[str]:
    """Assumptions that fail, then those that cannot be checked, each once, with the tests concerned."""
    sentences: dict[str, dict[str, list[FactorTestDesign | NotTestable]]] = {
        "doubtful": {},
        "cannot tell": {},
    }
    fine: dict[str, None] = {}
    checked: list[tuple[FactorTestDesign | NotTestable, tuple[AssumptionCheck, ...]]] = [
        (NotTestable(OVERALL, each.joint, None, None, None, ""), each.assumptions) for each in anova.overall
    ]
    checked += [(each.design, each.assumptions) for each in anova.factor_tests]
    for design, checks in checked:
        for check in checks:
            if check.outcome == "holds":
                fine[check.name] = None
            else:
                sentences[check.outcome].setdefault(check.message, []).append(design)
    lines = [
        f"{capitalize_first(message)} ({name_designs(designs)})."
        for by_message in sentences.values()
        for message, designs in by_message.items()
    ]
    return [*lines, f"All other checks of {join_words(list(fine))} pass."] if fine else lines


def list_not_testable(reasons_by_design: Sequence[NotTestable]) -> list[str]:
    """Why tests cannot be made, each reason once; what all traverses may answer is marked as of one place."""
    designs: dict[tuple[str, str], list[NotTestable]] = {}
    for each in reasons_by_design:
        alone = each.analysis in (DAY, DIRECTION) and each.configuration is not None
        designs.setdefault((" at one configuration" if alone else "", each.reason), []).append(each)
    return [
        f"{capitalize_first(name_designs(same))}{where}: {reason}."
        for (where, reason), same in designs.items()
    ]


def name_designs(designs: Sequence[FactorTestDesign | NotTestable]) -> str:
    """Tests in few words, the sessions of one kind together."""
    by_name: dict[str, list[str]] = {}
    for design in designs:
        name = f"joint {design.joint} {design.analysis} {format_direction(design.direction)}".strip()
        by_name.setdefault(name, []).append(design.session or ALL_SESSIONS)
    return join_words([f"{name}{_sessions_text(sessions)}" for name, sessions in by_name.items()])


def _sessions_text(sessions: Sequence[str]) -> str:
    if set(sessions) == {ALL_SESSIONS}:
        return ""
    if len(sessions) > MAX_LISTED_SESSIONS + 1:
        n_more = len(sessions) - MAX_LISTED_SESSIONS
        sessions = [*sessions[:MAX_LISTED_SESSIONS], f"{n_more} more"]
    return f" [{', '.join(sessions)}]"


MAX_ROWS = 24
AT_FLOOR = "*"
NO_ANSWER = "Nothing can be answered from this log."
CAUTIONS = "What to mind, and what cannot be answered"


@summarize.register
def summarize_anova(anova: Anova) -> Summary:
    """All factors in one table, a section for each joint, failed assumptions, tests that cannot be made."""
    sentences = sentences_by_joint(anova)
    advice = _advice_by_joint(anova)
    headline = [write_overview(joint, anova, advice.get(joint, [])) for joint in sentences]
    overview = overview_table(list(sentences), anova)
    sections = [Section(tables=(overview,))] if overview.rows else []
    sections += [
        Section(
            capitalize_first(joint_name(joint, anova.machine)),
            tuple(map(typeset_text, lines)),
            tuple(_tables(joint, anova)),
        )
        for joint, lines in sentences.items()
    ]
    cautions = [*list_failed_assumptions(anova), *list_not_testable(anova.not_testable)]
    if cautions:
        sections.append(Section(CAUTIONS, tuple(map(typeset_text, cautions))))
    return Summary(
        "Which factors matter",
        tuple(map(typeset_text, headline)) or (NO_ANSWER,),
        tuple(sections),
    )


def sentences_by_joint(anova: Anova) -> dict[int, list[str]]:
    """Conclusions and recommendations for each joint."""
    sentences = {each.joint: conclude_overall(each) for each in anova.overall}
    for joint in dict.fromkeys(each.design.joint for each in anova.factor_tests):
        sentences.setdefault(joint, []).extend(conclude(joint, _select_told(joint, anova)))
    for joint, advice in _advice_by_joint(anova).items():
        sentences.setdefault(joint, []).extend(each.with_price() for each in advice)
    for analysis in anova.positions:
        sentences.setdefault(analysis.joint, []).extend(conclude_positions(analysis))
    return dict(sorted(sentences.items()))


def _select_told(joint: int, anova: Anova) -> list[FactorTest]:
    """All but those at one configuration that do not show what all traverses together do."""
    shown = anova.shown_terms(joint)
    tests = [test for test in anova.factor_tests if test.design.joint == joint]
    shown -= {test.design.analysis for test in tests if test.is_significant}
    return [test for test in tests if test.design.analysis not in shown]


def tests_tables(anova: Anova) -> list[Table]:
    """The factors of each joint."""
    joints = sorted({test.design.joint for test in anova.factor_tests})
    return [
        _tests_table(joint, [test for test in anova.factor_tests if test.design.joint == joint])
        for joint in joints
    ]


def _tables(joint: int, anova: Anova) -> list[Table]:
    tests = [test for test in anova.factor_tests if test.design.joint == joint]
    tables = [overall_table(each) for each in anova.overall if each.joint == joint]
    tables += [_tests_table(joint, tests), _squares_table(joint, tests)] if tests else []
    tables += [positions_table(each) for each in anova.positions if each.joint == joint]
    return [*tables, *(_components_table(each) for each in anova.components if each.joint == joint)]


def _tests_table(joint: int, tests: Sequence[FactorTest]) -> Table:
    unit = tests[0].design.unit
    columns = (
        *words("factor", "session", "largest minus smallest"),
        Column("difference (95 %)", unit),
        *numbers("omega²", "F (df)"),
        *numbers("F test", "adjusted", "permutation", group="p"),
        Column("detectable", unit),
    )
    shown = [test for test in tests if len(tests) <= MAX_ROWS or test.design.session is None]
    note = (
        "Adjusted: for everything asked of this log (Holm). Permutation: p from relabelled traverses; "
        f"{AT_FLOOR} the smallest that so few can give. Detectable: the difference that is declared, "
        f"adjusted, in 80 of 100 such logs. {_places(shown)}"
    )
    if len(shown) < len(tests):
        note += f" Not shown: {len(tests) - len(shown)} answers within single sessions."
    elif _sessions_not_tested(tests):
        note += " Within a single session: name it with --session."
    return Table(
        f"Factors of {joint_name(joint, tests[0].design.machine)}",
        columns,
        tuple(map(_test_row, shown)),
        stubs=2,
        note=note,
    )


def _sessions_not_tested(tests: Sequence[FactorTest]) -> bool:
    """Of many sessions, single ones are not tested unless one is chosen."""
    n_sessions = max(test.design.observations["session"].nunique() for test in tests)
    return n_sessions > MAX_SESSIONS and not any(test.design.session for test in tests)


def _test_row(test: FactorTest) -> tuple[str, ...]:
    effect, unit = test.effect, test.design.unit
    largest, smallest = test.extreme_levels
    if test.design.analysis != "day":
        largest, smallest = (typeset_text(format_direction(level)) for level in (largest, smallest))
    at_floor = test.permutation.p_value <= test.permutation.floor * (1 + 1e-9)
    statistic = _format_digits(test.statistic, 3)
    return (
        *_design_cells(test),
        name_difference(largest, smallest),
        f"{format_number(effect.difference, unit)} ({format_range(effect.low, effect.high, unit)})",
        f"{float(test.sums.omega_squared):.2f}",
        f"{statistic} ({', '.join(str(df) for df in test.sums.df[1:])})",
        format_p_value(test.p_value),
        format_p_value(test.p_holm),
        format_p_value(test.permutation.p_value) + (AT_FLOOR if at_floor else ""),
        format_number(test.detectable, unit),
    )


def _design_cells(test: FactorTest) -> tuple[str, str]:
    design = test.design
    return f"{design.analysis} {format_direction(design.direction)}".strip(), design.session or "all"


def _places(tests: Sequence[FactorTest]) -> str:
    """The configuration of each analysis."""
    places: dict[str, list[str]] = {}
    for test in tests:
        names = places.setdefault(test.design.configuration, [])
        names += [test.design.analysis] if test.design.analysis not in names else []
    return " ".join(
        f"{' and '.join(names).capitalize()}: at {typeset_text(where)}." for where, names in places.items()
    )


def _squares_table(joint: int, tests: Sequence[FactorTest]) -> Table:
    unit = tests[0].design.unit
    columns = (
        *words("factor", "session", "term"),
        Column("SS", f"{unit}²"),
        Column("df"),
        Column("MS", f"{unit}²"),
        *numbers("F", "p"),
    )
    rows = [
        (*_design_cells(test), *_squares_row(line, unit))
        for test in tests
        for line in test.table.itertuples(index=False)
    ]
    note = "Over sessions of the means of cells."
    return Table(
        f"Sums of squares of {joint_name(joint, tests[0].design.machine)}",
        columns,
        tuple(rows),
        stubs=3,
        note=note,
        folded=True,
    )


def _format_digits(value: float, digits: int) -> str:
    """A number to so many digits, all of those before the point; never in powers of ten if it is large.

    >>> _format_digits(10057.3, 4), _format_digits(999.6, 3), _format_digits(0.01412, 3)
    ('10,057', '1,000', '0.0141')
    """
    text = f"{value:.{digits}g}"
    return text if "e+" not in text else f"{value:,.0f}"


def _squares_row(line: Any, unit: str) -> tuple[str, ...]:
    ss, ms = (_format_digits(from_si(from_si(value, unit), unit), 5) for value in (line.ss, line.ms))
    tested = (_format_digits(line.F, 4), format_p_value(line.p)) if line.F == line.F else ("", "")
    return (line.term, ss, str(line.df), ms if line.ms == line.ms else "", *tested)


def _components_table(components: VarianceComponents) -> Table:
    unit = components.unit
    columns = (
        Column("source", text=True),
        *numbers("standard deviation", "95 % interval", unit=unit),
        Column("share of the step size", "%"),
    )
    parts: list[tuple[str, VarianceComponent | None]] = [
        ("day, both directions alike", components.day),
        ("day, each direction by itself", components.day_direction),
        ("day, in one direction altogether", components.total),
        ("traverse to traverse", components.replicate),
    ]
    sizes = [(name, part.deviation, part.low, part.high) for name, part in parts if part is not None]
    if (
        components.direction is not None
        and components.direction_low is not None
        and components.direction_high is not None
    ):
        direction = (components.direction, components.direction_low, components.direction_high)
        sizes.append((f"direction, + minus {MINUS}", *direction))
    body = tuple(
        (
            name,
            format_number(size, unit),
            format_range(low, high, unit),
            format_number(size / components.mean, "%"),
        )
        for name, size, low, high in sizes
    )
    note = (
        "Sessions are drawn at random; the two directions are all there are, so that the last row is a "
        "difference and no standard deviation. Restricted maximum likelihood; an interval that begins at 0 "
        "includes no change at all."
    )
    caption = f"Where the variation of {joint_name(components.joint, components.machine)} comes from"
    return Table(caption, columns, body, note=note)


@summarize.register
def summarize_formula(result: FormulaTable) -> Summary:
    """Terms with an effect, then the table; sums of squares in SI units of the response."""
    table = result.table
    heads = ("sum of squares", "df", "mean square", "F", "p", "p, adjusted", "omega²")
    rows = [_formula_row(row) for _, row in table.iterrows()]
    if result.kind == 1:
        total = sum(line.sum_of_squares for line in result.lines)
        rows.append(("total", f"{total:.6g}", str(result.count - 1), *[""] * 5))
    note = (
        f"{result.formula}, type {result.kind}, {pluralize(result.count, 'traverse')}. Sums of squares in "
        "the response's SI unit; adjusted for all terms (Holm); omega² partial."
    )
    columns = (Column("term", text=True), *map(Column, heads))
    caption = f"Analysis of variance, {joint_name(result.joint, result.machine)}"
    return Summary(
        result.formula,
        (f"Joint {result.joint}. {_formula_sentence(table)}",),
        (Section(tables=(Table(caption, columns, tuple(rows), note=note),)),),
    )


def _formula_sentence(table: pd.DataFrame) -> str:
    terms = table[:-1]
    shown = terms[terms["p_holm"] < SIGNIFICANCE_LEVEL]
    untested = list(terms.loc[terms["df"] == 0, "term"])
    sentence = "Nothing in the formula shows an effect."
    if len(shown):
        worst = format_p_value(shown["p_holm"].max(), relation=True)
        sentence = f"What shows an effect: {join_words(list(shown['term']))} (adjusted p {worst})."
    if untested:
        sentence += f" Other terms explain all that {join_words(untested)} could explain."
    return sentence


def _formula_row(row: pd.Series) -> tuple[str, ...]:
    mean = _format_digits(row["ms"], 6) if row["df"] else ""
    tested = [
        _format_digits(row["F"], 4),
        format_p_value(row["p"]),
        format_p_value(row["p_holm"]),
        f"{row['omega_squared']:.2f}",
    ]
    return (
        row["term"],
        _format_digits(row["ss"], 6),
        str(row["df"]),
        mean,
        *(tested if row["F"] == row["F"] else [""] * 4),
    )
