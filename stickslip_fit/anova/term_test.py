"""TermTest: the F test of one term of a model of all traverses, in the logarithm of the step size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import (
    SIGNIFICANCE_LEVEL,
    LevelDifference,
    adjusted_means,
    compare_means,
    difference_factor,
    noncentrality_at_power,
)

MAX_COLUMNS = 400  # of a model: more take minutes
NO_SCATTER = 1e-12  # relative: the rounding of doubles

Term = tuple[str, ...]


@dataclass(frozen=True)
class ErrorTerm:
    """The part of the response, shape (n,), that a term is compared with, its df and its name."""

    values: Array
    df: int
    name: str

    @property
    def mean_square(self) -> float:
        """Of the error."""
        return float(self.values @ self.values) / self.df


@dataclass(frozen=True)
class TermTest:
    """One F test of a term of the model; sizes are relative.

    Attributes
    ----------
    term, error_term : str
        What is tested, and against what.
    statistic : float
        F.
    df : tuple of (float, float)
    p_value, p_holm : float
        The second adjusted over all tests of the log.
    omega_squared : float
        Partial.
    size : float
        Rms over the units of what the term does, less what noise does, at least 0.
    rms_unit, difference_unit : float
        The rms, and the difference between two levels that fewest units compare, whose noncentrality is 1.
    effect : LevelDifference or None
        Means of the levels and the largest difference between them, in log step size; None for interactions.
    levels : tuple of str
        In the order of the means.
    level : float
        Of the p-value, at which it is decided beside all other tests; see `holm_levels`.
    """

    term: str
    error_term: str
    statistic: float
    df: tuple[float, float]
    p_value: float
    p_holm: float
    omega_squared: float
    size: float
    rms_unit: float
    difference_unit: float
    effect: LevelDifference | None
    levels: tuple[str, ...]
    level: float = SIGNIFICANCE_LEVEL

    @property
    def extreme_levels(self) -> tuple[str, str]:
        """The levels with the largest and with the smallest mean; empty for an interaction."""
        if self.effect is None:
            return "", ""
        return self.levels[self.effect.largest], self.levels[self.effect.smallest]

    @property
    def detectable(self) -> float:
        """The rms that is found significant with a power of 80 %."""
        return self.rms_unit * self._root_noncentrality

    @property
    def detectable_difference(self) -> float:
        """As `detectable`, of the difference between two levels; NaN for an interaction."""
        return self.difference_unit * self._root_noncentrality

    @property
    def _root_noncentrality(self) -> float:
        return float(np.sqrt(noncentrality_at_power(self.df, self.level)))

    @property
    def is_significant(self) -> bool:
        """Whether the term shows at 5 %, adjusted over all tests."""
        return self.p_holm < SIGNIFICANCE_LEVEL


def name_term(term: Term) -> str:
    """A term in words: day x position."""
    return " x ".join(term)


def run_term_test(
    term: Term,
    values: Array,
    bases: tuple[Array, Array],
    error: ErrorTerm,
    *,
    codes: IntArray | None = None,
    levels: Sequence[str] = (),
    epsilon: float = 1.0,
) -> TermTest:
    """The test of one term, as if it were the only one.

    Parameters
    ----------
    values : array, shape (n,)
    bases : tuple of (array, array), shape (n, p) and (n, q)
        Orthonormal, of the terms beside which it is tested and of what it adds to them.
    codes : array of int, shape (n,), optional
        Of a main effect, the level of each unit, the names of which are `levels`.
    epsilon : float, optional
        Box's, by which degrees of freedom are reduced.
    """
    from scipy.special import fdtrc

    others, effect = bases
    n, df, variance = len(values), effect.shape[1], error.mean_square
    statistic, reduced = (
        float(np.sum((effect.T @ values) ** 2)) / df / variance,
        (epsilon * df, epsilon * error.df),
    )
    excess = df * (statistic - 1.0)
    difference, difference_unit = None, float("nan")
    if codes is not None:
        difference = compare_means(values, codes, others, np.sqrt(variance), reduced[1])
        factor = difference_factor(adjusted_means(values, codes, others)[1])
        difference_unit = float(np.sqrt(variance / epsilon * factor.max()))
    return TermTest(
        name_term(term),
        error.name,
        statistic,
        reduced,
        p_value := float(fdtrc(*reduced, statistic)),
        p_value,
        max(0.0, excess / (excess + n)),
        float(np.sqrt(max(0.0, excess * variance / n))),
        float(np.sqrt(variance / epsilon / n)),
        difference_unit,
        difference,
        tuple(levels),
    )
