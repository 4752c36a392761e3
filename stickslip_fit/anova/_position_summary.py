"""Text of the analysis of position: sentences and the table."""

from __future__ import annotations

from math import expm1

from stickslip_fit._format import format_p_value, format_percent, join_words, joint_name, pluralize
from stickslip_fit._summary import Table
from stickslip_fit.anova._overall_summary import terms_columns, terms_row
from stickslip_fit.anova.position import DAY, DIRECTION, POSITION, PositionAnalysis
from stickslip_fit.anova.term_test import TermTest

BY_DAY, BY_DIRECTION = f"{DAY} x {POSITION}", f"{DIRECTION} x {POSITION}"
CHANGES = {BY_DAY: "from session to session", BY_DIRECTION: "between the directions"}


def conclude_positions(analysis: PositionAnalysis) -> list[str]:
    """Sentences on one joint's profile."""
    tests = {test.term: test for test in analysis.tests}
    where = f"over {len(analysis.stretches)} stretches"
    return _conclude_profile(tests, where) if POSITION in tests else []


def _conclude_profile(tests: dict[str, TermTest], where: str) -> list[str]:
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
        sentences.append(
            f"No difference of the profile {join_words([CHANGES[term] for term in hidden], 'or')} shows; "
            f"{sizes} rms would most likely have shown."
        )
    return sentences


def _rms(test: TermTest) -> str:
    return f"{format_percent(test.size)} rms"


def _difference(test: TermTest) -> str:
    assert test.effect is not None
    return format_percent(expm1(test.effect.difference))


def _adjusted(test: TermTest) -> str:
    return f"adjusted p {format_p_value(test.p_holm, relation=True)}"


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
