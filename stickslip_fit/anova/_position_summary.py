"""Text of the analysis of position: sentences and the table."""

from __future__ import annotations

from math import expm1

from stickslip_fit._format import (
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_range,
    join_words,
    joint_name,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.anova.position import DAY, DIRECTION, POSITION, PositionAnalysis, PositionTest

BY_DAY, BY_DIRECTION = f"{DAY} x {POSITION}", f"{DIRECTION} x {POSITION}"
CHANGES = {BY_DAY: "from session to session", BY_DIRECTION: "between the directions"}


def conclude_positions(analysis: PositionAnalysis) -> list[str]:
    """Sentences on one joint's profile, and on day and direction over all its stretches."""
    tests = {test.term: test for test in analysis.tests}
    where = f"over {len(analysis.stretches)} stretches"
    sentences = _conclude_profile(tests, where) if POSITION in tests else []
    levels = [_conclude_levels(tests[term]) for term in (DAY, DIRECTION) if term in tests]
    return [*sentences, f"Over all stretches together {'; '.join(levels)}."] if levels else sentences


def _conclude_profile(tests: dict[str, PositionTest], where: str) -> list[str]:
    common, changing = tests[POSITION], {term: tests[term] for term in CHANGES if term in tests}
    changes = [
        f"{CHANGES[term]} (by {_rms(test)}, {_adjusted(test)})"
        for term, test in changing.items()
        if test.is_significant
    ]
    if not common.is_significant:
        would = f"{format_percent(common.detectable)} rms would most likely have shown"
        if changes:
            return [
                f"The step size differs along the travel, and differently {join_words(changes)}, {where}; "
                f"what all have in common does not show ({_adjusted(common)}); {would}."
            ]
        return [f"No difference along the travel shows {where} ({_adjusted(common)}); {would}."]
    largest, smallest = common.extreme_levels
    sentences = [
        f"The step size differs along the travel, by {_rms(common)} {where}: it is {_difference(common)} "
        f"larger at {largest} than at {smallest} ({_adjusted(common)})."
    ]
    if changes:
        sentences.append(f"The profile differs {join_words(changes)}.")
    hidden = [term for term, test in changing.items() if not test.is_significant]
    if hidden:
        sizes = join_words([format_percent(tests[term].detectable) for term in hidden])
        sentences.append(
            f"No difference of the profile {join_words([CHANGES[term] for term in hidden], 'or')} shows; "
            f"{sizes} rms would most likely have shown."
        )
    return sentences


def _conclude_levels(test: PositionTest) -> str:
    what = "the step size changes from session to session" if test.term == DAY else "the directions differ"
    if not test.is_significant:
        what = "change from session to session" if test.term == DAY else "difference between the directions"
        return (
            f"no {what} shows ({_adjusted(test)}); {format_percent(test.detectable)} rms would most likely "
            "have shown"
        )
    return f"{what}, by up to {_difference(test)} ({_less(test)}, {_adjusted(test)})"


def _less(test: PositionTest) -> str:
    largest, smallest = test.extreme_levels
    if test.term == DIRECTION:
        largest, smallest = format_direction(largest), format_direction(smallest)
    return f"{largest} against {smallest}"


def _rms(test: PositionTest) -> str:
    return f"{format_percent(test.size)} rms"


def _difference(test: PositionTest) -> str:
    assert test.effect is not None
    return format_percent(expm1(test.effect.difference))


def _adjusted(test: PositionTest) -> str:
    return f"adjusted p {format_p_value(test.p_holm, relation=True)}"


def positions_table(analysis: PositionAnalysis) -> Table:
    """The tests of one joint's stretches."""
    columns = (
        *words("factor", "largest against smallest"),
        Column("difference (95 %)", "%"),
        Column("rms", "%"),
        Column("F (degrees)"),
        *numbers("F test", "adjusted", group="p"),
        Column("detectable", "%"),
    )
    ends = "the same ends" if analysis.repeated else "middles in the same class"
    left_out = ""
    if analysis.n_left_out:
        traverses = pluralize(analysis.n_left_out, "traverse")
        left_out = (
            f" Left out: {traverses} over half of the travel or more, or over a stretch that no other "
            "session or configuration has."
        )
    load = ""
    if analysis.machine.has_published_geometry:
        load = (
            " Gravity's load changes along the travel of a rotary joint and is part of this; the figure of "
            "the step size along the travel has what the law leaves of it."
        )
    errors = {
        error: join_words([test.term for test in analysis.tests if test.error_term == error])
        for error in dict.fromkeys(test.error_term for test in analysis.tests)
    }
    against = "; ".join(f"{terms} with {error}" for error, terms in errors.items())
    note = (
        f"{pluralize(len(analysis.rows), 'traverse')} over {len(analysis.stretches)} stretches; traverses of "
        f"one stretch have {ends}. All factors together, of the logarithm of the step size; sums of squares "
        f"of type II. Compared: {against}. Rms: without what noise adds. Degrees of freedom are fewer where "
        "neighbouring stretches err alike. Adjusted: for everything asked of this log (Holm). Detectable: "
        f"the rms that is seen at 5 % in 80 of 100 such logs.{load}{left_out}"
    )
    rows = tuple(map(_row, analysis.tests))
    caption = f"Along the travel of {joint_name(analysis.joint, analysis.machine)}"
    return Table(caption, columns, rows, note=note)


def _row(test: PositionTest) -> tuple[str, ...]:
    effect, difference = test.effect, ""
    if effect is not None:
        size, low, high = (expm1(value) for value in (effect.difference, effect.low, effect.high))
        difference = f"{format_number(size, '%', 1)} ({format_range(low, high, '%', 1)})"
    statistic = f"{test.statistic:.3g}" if test.statistic < 1000 else f"{test.statistic:,.0f}"
    return (
        test.term,
        typeset_text(_less(test)) if effect is not None else "",
        difference,
        f"{100 * test.size:.2g}",
        f"{statistic} ({', '.join(f'{df:.3g}' for df in test.df)})",
        format_p_value(test.p_value),
        format_p_value(test.p_holm),
        f"{100 * test.detectable:.2g}",
    )
