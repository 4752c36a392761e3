"""Text of the analyses of all traverses of a joint, together and by position: sentences and tables."""

from __future__ import annotations

from math import expm1

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_percent_range,
    format_range,
    join_words,
    joint_name,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.anova.overall import OverallAnalysis
from stickslip_fit.anova.position import CONFIGURATION, DAY, DIRECTION, POSITION, PositionAnalysis
from stickslip_fit.anova.term_test import TermTest, name_term

BY_DAY_AND_DIRECTION = name_term((DAY, DIRECTION))
PROFILE_CHANGES = {
    f"{DAY} x {POSITION}": "from session to session",
    f"{DIRECTION} x {POSITION}": "between the directions",
}
SHOWN = {
    DAY: "the step size changes from session to session, by up to",
    DIRECTION: "the two directions differ, by",
    CONFIGURATION: "the step size differs between configurations, by",
    BY_DAY_AND_DIRECTION: "how the directions differ changes from session to session, by",
}
NOT_SHOWN = {
    DAY: "no change from session to session shows",
    DIRECTION: "no difference between the directions shows",
    CONFIGURATION: "no difference between configurations shows",
    BY_DAY_AND_DIRECTION: "no change from session to session of how the directions differ shows",
}


def conclude_overall(analysis: OverallAnalysis) -> list[str]:
    """A sentence for each test."""
    first, *others = map(_conclude, analysis.tests)
    return [
        f"By {pluralize(len(analysis.rows), 'traverse')} together, {first}",
        *map(capitalize_first, others),
    ]


def _conclude(test: TermTest) -> str:
    if test.is_significant:
        return f"{SHOWN[test.term]} {estimate_text(test)}."
    return f"{NOT_SHOWN[test.term]} ({estimate_text(test, inside=True)}){would_text(test)}."


def estimate_text(test: TermTest, *, inside: bool = False) -> str:
    """The largest difference between levels, or the rms, with interval and adjusted p-value."""
    if test.effect is None:
        size, facts = _rms(test), _adjusted(test)
    else:
        difference, low, high = map(expm1, (test.effect.difference, test.effect.low, test.effect.high))
        size = format_percent(difference)
        facts = f"95 %: {format_percent_range(low, high)}; {name_levels(test)}; {_adjusted(test)}"
    return f"{size}, {facts}" if inside else f"{size} ({facts})"


def _rms(test: TermTest) -> str:
    return f"{format_percent(test.size)} rms"


def _difference(test: TermTest) -> str:
    assert test.effect is not None
    return format_percent(expm1(test.effect.difference))


def _adjusted(test: TermTest) -> str:
    return f"adjusted p {format_p_value(test.p_holm, relation=True)}"


def would_text(test: TermTest) -> str:
    """What would have been declared; nothing where the estimate among several levels is as large."""
    if test.effect is None:
        return f"; {format_percent(test.detectable)} rms would most likely have shown"
    if test.effect.difference >= test.detectable_difference:
        return ""
    return f"; one of {format_percent(expm1(test.detectable_difference))} would most likely have shown"


def name_levels(test: TermTest) -> str:
    """The largest level against the smallest."""
    largest, smallest = test.extreme_levels
    if test.term == DIRECTION:
        largest, smallest = format_direction(largest), format_direction(smallest)
    return f"{largest} against {smallest}"


def terms_columns(df: str = "df") -> tuple[Column, ...]:
    """The columns of a table of terms."""
    return (
        *words("factor", "largest against smallest"),
        Column("difference (95 %)", "%"),
        Column("rms", "%"),
        Column(f"F ({df})"),
        *numbers("F test", "adjusted", group="p"),
        Column("detectable", "%"),
    )


def terms_row(test: TermTest, detectable: float) -> tuple[str, ...]:
    """A row for `terms_columns`."""
    effect, difference = test.effect, ""
    if effect is not None:
        size, low, high = (expm1(value) for value in (effect.difference, effect.low, effect.high))
        difference = f"{format_number(size, '%', 1)} ({format_range(low, high, '%', 1)})"
    statistic = f"{test.statistic:.3g}" if test.statistic < 1000 else f"{test.statistic:,.0f}"
    return (
        test.term,
        typeset_text(name_levels(test)) if effect is not None else "",
        difference,
        f"{100 * test.size:.2g}",
        f"{statistic} ({', '.join(f'{df:.3g}' for df in test.df)})",
        format_p_value(test.p_value),
        format_p_value(test.p_holm),
        f"{100 * detectable:.2g}",
    )


def overall_table(analysis: OverallAnalysis) -> Table:
    """The tests of all traverses of one joint."""
    where = "each configuration is a level"
    if analysis.degree:
        where = (
            "configurations hardly repeat: where the joints stand is polynomials of degree "
            f"{analysis.degree} in each coordinate and in the middle of the stretch"
        )
    note = (
        f"{pluralize(len(analysis.rows), 'traverse')} together, of the logarithm of the step size; {where}. "
        f"Model: {join_words(analysis.terms)}; sums of squares of type II, each compared with the residual: "
        "what is found is of the sessions of this log. Rms: without what noise adds. Adjusted: for "
        "everything asked of this log (Holm). Detectable: the difference, or where there is none the rms, "
        "that is declared, adjusted, in 80 of 100 such logs."
    )
    rows = tuple(
        terms_row(test, test.detectable if test.effect is None else expm1(test.detectable_difference))
        for test in analysis.tests
    )
    caption = f"All traverses of {joint_name(analysis.joint, analysis.machine)}"
    return Table(caption, terms_columns(), rows, note=note)


def conclude_positions(analysis: PositionAnalysis) -> list[str]:
    """Sentences on one joint's profile."""
    tests = {test.term: test for test in analysis.tests}
    where = f"over {len(analysis.stretches)} stretches"
    return _conclude_profile(tests, where) if POSITION in tests else []


def _conclude_profile(tests: dict[str, TermTest], where: str) -> list[str]:
    common, changing = tests[POSITION], {term: tests[term] for term in PROFILE_CHANGES if term in tests}
    changes = [
        f"{PROFILE_CHANGES[term]} (by {_rms(test)}, {_adjusted(test)})"
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
        return [
            f"No difference along the travel shows {where} ({_rms(common)}, {_adjusted(common)}); {would}."
        ]
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
        where = join_words([PROFILE_CHANGES[term] for term in hidden], "or")
        sentences.append(
            f"No difference of the profile {where} shows; {sizes} rms would most likely have shown."
        )
    return sentences


def positions_table(analysis: PositionAnalysis) -> Table:
    """The tests of one joint's stretches."""
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
        f"the rms that is declared, adjusted, in 80 of 100 such logs.{load}{left_out}"
    )
    rows = tuple(terms_row(test, test.detectable) for test in analysis.tests)
    caption = f"Along the travel of {joint_name(analysis.joint, analysis.machine)}"
    return Table(caption, terms_columns("degrees"), rows, note=note)
