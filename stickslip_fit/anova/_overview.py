"""The analysis of variance on one screen: what changes the step sizes, and one table of all factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import expm1

from stickslip_fit._format import (
    capitalize_first,
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_range,
    join_words,
    typeset_text,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.anova._terms_summary import BY_DAY_AND_DIRECTION, PROFILE_CHANGES, name_levels
from stickslip_fit.anova.analysis import Anova
from stickslip_fit.anova.factor_test import FactorTest
from stickslip_fit.anova.position import CONFIGURATION, DAY, DIRECTION, POSITION
from stickslip_fit.anova.term_test import TermTest

EFFECTS = {
    "day": "from session to session",
    "direction": "between the directions",
    "normal-force": "with the orientation of the base",
}


SHOWN = "yes"  # an effect
RECALIBRATE, KEEP_APART = "recalibrate each session", "keep separate parameters for each direction"


@dataclass(frozen=True)
class Advice:
    """Something that a lab may do.

    Attributes
    ----------
    action : str
        "recalibrate each session".
    price : str
        What it costs not to do it.
    needed : bool or None
        None if the log is too small to say.
    """

    action: str
    price: str
    needed: bool | None

    def with_price(self) -> str:
        """A sentence."""
        if self.needed is None:
            return f"Whether to {self.action} this log is too small to say: {self.price}."
        if self.needed:
            return f"{capitalize_first(self.action)}: {self.price}."
        return f"This log gives no reason to {self.action}: {self.price}."


def _advise(advice: Sequence[Advice]) -> list[str]:
    """What to do, and what the log is too small to say, in a sentence each."""
    needed = join_words([each.action for each in advice if each.needed])
    unsure = join_words([each.action for each in advice if each.needed is None], "or to")
    sentences = [f"{capitalize_first(needed)}."] if needed else []
    return [*sentences, f"This log is too small to say whether to {unsure}."] if unsure else sentences


def write_overview(joint: int, anova: Anova, advice: Sequence[Advice]) -> str:
    """Which factors change a joint's step size, by how much; then what to do about it."""
    changes = _overall_changes(joint, anova)
    told = anova.shown_terms(joint)
    for analysis, where in EFFECTS.items():
        tests = _tests_of(joint, anova, analysis) if analysis not in told else []
        over = [test for test in tests if test.design.session is None and test.is_significant]
        differing = over or [test for test in tests if test.is_significant]
        if differing:
            largest = max(differing, key=lambda test: test.relative_difference)
            session = "" if over else f" in session {largest.design.session}"
            changes.append(f"{where}{session} by up to {format_percent(largest.relative_difference)}")
    for test in _profile_of(joint, anova):
        if test.term == POSITION and test.effect is not None and test.is_significant:
            changes.append(f"along the travel by up to {format_percent(expm1(test.effect.difference))}")
    changes += _differing_profiles(joint, anova)
    found = f"the step size changes {join_words(changes)}" if changes else "no factor shows an effect"
    return " ".join([f"Joint {joint}: {found}.", *_advise(advice)])


def _overall_changes(joint: int, anova: Anova) -> list[str]:
    """Of all traverses together."""
    tests = {test.term: test for test in _overall_of(joint, anova) if test.is_significant}
    changes = [
        f"{where} by {'up to ' if term == DAY else ''}{format_percent(expm1(test.effect.difference))}"
        for term, where in EFFECTS.items()
        if (test := tests.get(term)) is not None and test.effect is not None
    ]
    if BY_DAY_AND_DIRECTION in tests and DIRECTION not in tests:
        size = format_percent(tests[BY_DAY_AND_DIRECTION].size)
        changes.append(f"between the directions in a way that differs from session to session ({size} rms)")
    if CONFIGURATION in tests:
        changes.append(f"between configurations ({format_percent(tests[CONFIGURATION].size)} rms)")
    return changes


def _differing_profiles(joint: int, anova: Anova) -> list[str]:
    """Between what the profile along the travel differs, with the rms of the differences, if it does."""
    differing = [
        f"{PROFILE_CHANGES[test.term]} ({format_percent(test.size)} rms)"
        for test in _profile_of(joint, anova)
        if test.term in PROFILE_CHANGES and test.is_significant
    ]
    return [f"along the travel in a way that differs {join_words(differing)}"] if differing else []


def overview_table(joints: Sequence[int], anova: Anova) -> Table:
    """All factors of all joints, over all sessions; of one session where only that was asked for."""
    rows = [
        row
        for joint in joints
        for make_rows in (_overall_rows, _factor_rows, _profile_rows)
        for row in make_rows(joint, anova)
    ]
    rows.sort(key=lambda row: row[-1] != SHOWN)
    columns = (
        *words("joint", "factor", "largest minus smallest"),
        Column("difference (95 %)", "%"),
        *numbers("detectable", unit="%"),
        Column("adjusted p"),
        *words("effect"),
    )
    note = (
        "Adjusted for everything asked of this log (Holm). Detectable: the difference, or rms, that is "
        "declared, adjusted, in 80 of 100 such logs."
    )
    with_effect = slice(0, max(1, sum(row[-1] == SHOWN for row in rows)))
    return Table("What changes the step size", columns, tuple(rows), stubs=2, note=note, short=with_effect)


def _factor_rows(joint: int, anova: Anova) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    told = {test.term for test in _overall_of(joint, anova)}
    for analysis in [name for name in EFFECTS if name not in told]:
        tests = _tests_of(joint, anova, analysis)
        for test in [test for test in tests if test.design.session is None] or tests:
            effect, mean = test.effect, float(test.design.observations["step_size"].mean())
            largest, smallest = test.extreme_levels
            if analysis != "day":
                largest, smallest = format_direction(largest), format_direction(smallest)
            low, high = effect.low / mean, effect.high / mean
            rows.append(
                (
                    str(joint),
                    f"{analysis} {format_direction(test.design.direction)}".strip(),
                    typeset_text(name_difference(largest, smallest)),
                    f"{format_number(test.relative_difference, '%', 1)} ({format_range(low, high, '%', 1)})",
                    format_number(test.detectable / mean, "%", 1),
                    format_p_value(test.p_holm),
                    SHOWN if test.is_significant else "none shown",
                )
            )
    return rows


def _overall_rows(joint: int, anova: Anova) -> list[tuple[str, ...]]:
    """All traverses together: the difference between levels, or the rms."""
    rows: list[tuple[str, ...]] = []
    for test in _overall_of(joint, anova):
        difference, detectable = format_number(test.size, "%", 2), format_number(test.detectable, "%", 2)
        if (effect := test.effect) is not None:
            size, low, high = (expm1(value) for value in (effect.difference, effect.low, effect.high))
            difference = f"{format_number(size, '%', 1)} ({format_range(low, high, '%', 1)})"
            detectable = format_number(expm1(test.detectable_difference), "%", 1)
        rows.append(
            (
                str(joint),
                test.term,
                "rms" if effect is None else typeset_text(name_levels(test).replace(" against ", " minus ")),
                difference,
                detectable,
                format_p_value(test.p_holm),
                SHOWN if test.is_significant else "none shown",
            )
        )
    return rows


def _profile_rows(joint: int, anova: Anova) -> list[tuple[str, ...]]:
    """Terms with position: sizes are rms over the stretches."""
    return [
        (
            str(joint),
            "along travel" if test.term == POSITION else test.term,
            "rms over stretches",
            format_number(test.size, "%", 2),
            format_number(test.detectable, "%", 2),
            format_p_value(test.p_holm),
            SHOWN if test.is_significant else "none shown",
        )
        for test in _profile_of(joint, anova)
    ]


def name_difference(largest: str, smallest: str) -> str:
    """Two levels, without the repeated name: theta −90° minus 0°."""
    first, _, rest = smallest.partition(" ")
    return f"{largest} minus {rest if rest and largest.startswith(f'{first} ') else smallest}"


def _tests_of(joint: int, anova: Anova, analysis: str) -> list[FactorTest]:
    designs = ((test, test.design) for test in anova.factor_tests)
    return [test for test, design in designs if (design.joint, design.analysis) == (joint, analysis)]


def _overall_of(joint: int, anova: Anova) -> list[TermTest]:
    return [test for each in anova.overall if each.joint == joint for test in each.tests]


def _profile_of(joint: int, anova: Anova) -> list[TermTest]:
    return [test for each in anova.positions if each.joint == joint for test in each.tests]
