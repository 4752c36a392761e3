"""A question's answer: how sure, how large, what could have been seen, and whether its premises hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.anova.comparison import SumsOfSquares, compare, sums_of_squares
from stickslip_fit.anova.effect import Effect, effect_of
from stickslip_fit.anova.permutation import Permutation, permutation_test
from stickslip_fit.anova.power import smallest_difference
from stickslip_fit.anova.premises import AssumptionCheck, check_assumptions
from stickslip_fit.anova.question import READINGS, Question, Refusal

REPEATS_EXACTLY = 1e-12  # relative scatter that is the rounding of doubles
ROUNDED = 1.5  # times the rounding of the counts: scatter that is hardly more than it


@dataclass(frozen=True)
class Answer:
    """What a log says to one question; SI.

    Attributes
    ----------
    question : Question
    squares : SumsOfSquares
        Sums of squares, F and its p-value.
    effect : Effect
        Means of the levels and the largest difference between them.
    levels : tuple of str
        Names of the levels, in the order of `effect`'s means.
    permutation : Permutation
    p_holm : float
        The F test's p-value, adjusted for everything that was asked.
    detectable : float
        The smallest difference between two levels that so many readings, scattering so much, would show
        at 5 % in 80 of 100 such logs.
    premises : tuple of AssumptionCheck
    """

    question: Question
    squares: SumsOfSquares
    effect: Effect
    levels: tuple[str, ...]
    permutation: Permutation
    p_holm: float
    detectable: float
    premises: tuple[AssumptionCheck, ...]

    @property
    def p_value(self) -> float:
        """Of the F test."""
        return float(self.squares.p_value)

    @property
    def statistic(self) -> float:
        """F."""
        return float(self.squares.statistic)

    @property
    def furthest(self) -> tuple[str, str]:
        """The levels with the largest and with the smallest mean."""
        return self.levels[self.effect.largest], self.levels[self.effect.smallest]

    @property
    def relative(self) -> float:
        """The difference as a share of the mean step size."""
        return self.effect.difference / float(self.question.readings["step_size"].mean())

    @property
    def table(self) -> pd.DataFrame:
        """Sums of squares (SI), degrees of freedom, mean squares, F and p; over sessions, of cell means."""
        squares, question = self.squares, self.question
        names = ["session", question.factor, question.error_term, "total"]
        sums = [squares.blocks, squares.between, squares.within, squares.total]
        freedom = [*squares.freedom, sum(squares.freedom)]
        table = pd.DataFrame({"term": names, "ss": np.array(sums, float), "df": freedom})
        if question.error_term == READINGS:
            table = table[1:].reset_index(drop=True)
        table["ms"] = (table["ss"] / table["df"]).where(table["term"] != "total")
        tested = table["term"] == question.factor
        table["F"] = np.where(tested, self.statistic, np.nan)
        return table.assign(p=np.where(tested, self.p_value, np.nan))


def answer(question: Question) -> Answer | Refusal:
    """Answer one question; `p_holm` is its p-value as if nothing else had been asked.

    Readings without any scatter are refused: F would be infinite.
    """
    units = question.units
    values = units["step_size"].to_numpy(float)
    comparison = compare(units["level"], units["block"])
    squares = sums_of_squares(values, comparison)
    spread = float(np.sqrt(squares.variance))
    if spread <= REPEATS_EXACTLY * float(np.abs(values).max()):
        return Refusal(
            question.analysis, question.joint, question.direction, question.session, question.configuration,
            f"{question.error_term}: no scatter at all, so that nothing can be compared with it",
        )  # fmt: skip
    return Answer(
        question,
        squares,
        effect_of(values, comparison),
        tuple(map(str, np.unique(units["level"].to_numpy(object)))),
        permutation_test(values, comparison),
        float(squares.p_value),
        smallest_difference(spread, comparison),
        _assumption_checks(question, spread),
    )


def _assumption_checks(question: Question, spread: float) -> tuple[AssumptionCheck, ...]:
    rows = question.readings
    codes = [np.unique(rows[name].to_numpy(object), return_inverse=True)[1] for name in ("level", "session")]
    checks = check_assumptions(
        rows["step_size"].to_numpy(float), rows["session_seconds"].to_numpy(float), codes[0], codes[1]
    )
    rounding = float(np.sqrt(np.mean(rows["rounding"] ** 2)))
    if question.error_term == READINGS and spread < ROUNDED * rounding:
        message = "readings scatter hardly more than the counts are rounded: check the end stop more often"
        checks = (*checks, AssumptionCheck("finer than the count", "doubtful", message))
    return checks
