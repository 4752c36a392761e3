"""Text of the analysis of all traverses of a joint: sentences and the table."""

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
from stickslip_fit.anova.position import CONFIGURATION, DAY, DIRECTION
from stickslip_fit.anova.term_test import TermTest, name_term

BY_DAY_AND_DIRECTION = name_term((DAY, DIRECTION))
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
    p_value = f"adjusted p {format_p_value(test.p_holm, relation=True)}"
    if test.effect is None:
        size, facts = f"{format_percent(test.size)} rms", p_value
    else:
        difference, low, high = map(expm1, (test.effect.difference, test.effect.low, test.effect.high))
        size = format_percent(difference)
        facts = f"95 %: {format_percent_range(low, high)}; {name_levels(test)}; {p_value}"
    return f"{size}, {facts}" if inside else f"{size} ({facts})"


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
