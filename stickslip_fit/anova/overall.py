"""analyze_overall: whether sessions, directions and configurations differ, by all traverses of a joint.

The response is log(step size). Factors are session, direction and configuration, with their interactions of
two where the traverses suffice. A configuration is a level where configurations repeat; where they do not,
the step size is a smooth function of where the joints stand: polynomials of each coordinate, of the middle
of the stretch and of the published load. Sums of squares are of type II. All terms are fixed and compared
with the residual, so that the answer is of the sessions of the log. Interactions that the model leaves out
are in the residual: where directions took turns that costs power and makes no false alarms. Under Student's t
with 3 degrees of freedom and where configurations do not repeat, 9 in place of 5 of 100 logs without
an effect of the configuration show one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.anova.contrasts import indicator_columns, orthonormal_basis
from stickslip_fit.anova.designs import NotTestable
from stickslip_fit.anova.factor_test import AssumptionCheck, check_assumptions
from stickslip_fit.anova.position import CONFIGURATION, DAY, DIRECTION, refuse
from stickslip_fit.anova.term_test import (
    MAX_COLUMNS,
    NO_SCATTER,
    ErrorTerm,
    Term,
    TermTest,
    name_term,
    run_term_test,
)
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine, load_machine

OVERALL = "all traverses"
ASKED = ((DAY,), (DIRECTION,), (CONFIGURATION,), (DAY, DIRECTION))
ALL_PAIRS = tuple(combinations((CONFIGURATION, DAY, DIRECTION), 2))
TWO_WAY = (DAY, DIRECTION)
# Degree of the polynomials, 0 for configurations as levels, and interactions. The first is used that the
# traverses suffice for. A polynomial of degree 5 follows a whole period of a sine, of degree 3 a bend.
MODELS = tuple(
    (degree, pairs)
    for pairs, degrees in ((ALL_PAIRS, (0, 5, 3)), ((TWO_WAY,), (0, 5, 3)), ((), (0, 3)))
    for degree in degrees
)
MIN_RESIDUAL_DF, MIN_RESIDUAL_SHARE = 6, 0.25  # of the traverses, that a model leaves to compare with
RESIDUAL = "residual"
DRIFT = (
    "traverses drift within their session: sessions and configurations may differ by the hour, and not the "
    "directions, which took turns"
)
HEAVY_TAILS = "the traverses do not scatter normally: take an adjusted p just below 5 % for none"


@dataclass(frozen=True, eq=False)
class OverallAnalysis:
    """The analysis of all traverses of one joint.

    Attributes
    ----------
    joint : int
    tests : tuple of TermTest
    degree : int
        Of the polynomials of where the joints stand; 0 where configurations are levels.
    terms : tuple of str
        Of the model.
    rows : DataFrame
        Observations.
    residuals : array, shape (n,)
        Of the logarithm.
    deviation : float
        Their standard deviation.
    machine : Machine
    """

    joint: int
    tests: tuple[TermTest, ...]
    degree: int
    terms: tuple[str, ...]
    rows: pd.DataFrame = field(repr=False)
    residuals: Array = field(repr=False)
    deviation: float
    machine: Machine = field(default_factory=load_machine)

    @cached_property
    def assumptions(self) -> tuple[AssumptionCheck, ...]:
        """Whether the residuals are such as an F test assumes, and directions took turns."""
        codes = [_number_levels(self.rows[name]) for name in ("direction", "session")]
        checks = check_assumptions(self.residuals, self.rows["session_seconds"].to_numpy(float), *codes)
        in_turn = checks[-1].outcome == "holds"
        messages = {"normal scatter": HEAVY_TAILS} | ({"drift within a session": DRIFT} if in_turn else {})
        return tuple(
            replace(check, message=messages.get(check.name, check.message))
            if check.outcome == "doubtful"
            else check
            for check in checks
        )


def analyze_overall(rows: pd.DataFrame, machine: Machine) -> tuple[OverallAnalysis | None, list[NotTestable]]:
    """The analysis of one joint's observations, and the tests that cannot be made.

    Parameters
    ----------
    rows : DataFrame
        See `step_size_observations`.
    """
    joint, y = int(rows["joint"].iloc[0]), np.log(rows["step_size"].to_numpy(float))
    y = y - np.median(y)
    model = _choose_model(rows)
    if isinstance(model, str):
        return None, [refuse(joint, OVERALL, model)]
    residuals = y - model.whole @ (model.whole.T @ y)
    error = ErrorTerm(residuals, model.residual_df, RESIDUAL)
    if np.sqrt(error.mean_square) <= NO_SCATTER:
        return None, [refuse(joint, OVERALL, "no scatter at all, so that nothing can be compared with it")]
    tests, refused = [], []
    for term, bases in model.bases.items():
        if not bases[1].shape[1]:
            refused.append(refuse(joint, name_term(term), "it changes together with other factors"))
            continue
        levels, codes = model.levels.get(term, ((), None))
        tests.append(run_term_test(term, y, bases, error, codes=codes, levels=levels))
    if not tests:
        return None, refused
    terms = tuple(map(name_term, model.columns))
    scatter = (residuals, float(np.sqrt(error.mean_square)))
    return OverallAnalysis(joint, tuple(tests), model.degree, terms, rows, *scatter, machine), refused


@dataclass(frozen=True)
class OverallModel:
    """Columns of each term, shape (n, p), names and codes of the levels of session and direction, degree."""

    columns: Mapping[Term, Array]
    levels: Mapping[Term, tuple[tuple[str, ...], IntArray]]
    degree: int

    @cached_property
    def whole(self) -> Array:
        """Orthonormal basis of all terms."""
        return self.span(self.columns)

    @property
    def residual_df(self) -> int:
        """What all terms leave."""
        return self.whole.shape[0] - self.whole.shape[1]

    def span(self, terms: Mapping[Term, Array]) -> Array:
        """Orthonormal basis of the general mean and some terms, shape (n, q)."""
        n = len(next(iter(self.columns.values())))
        columns = np.hstack([np.ones((n, 1)), *terms.values()])
        return orthonormal_basis(columns, np.zeros((n, 0)))

    @cached_property
    def bases(self) -> dict[Term, tuple[Array, Array]]:
        """Of each term asked: bases of all that do not contain it, and of it beside them (type II)."""
        return {term: self._bases(term) for term in ASKED if term in self.columns}

    def _bases(self, term: Term) -> tuple[Array, Array]:
        others = {name: part for name, part in self.columns.items() if not set(term) <= set(name)}
        basis = self.span(others)
        return basis, orthonormal_basis(self.columns[term], basis)

    @property
    def is_sufficient(self) -> bool:
        """Whether sessions and directions can be told apart, and enough is left to compare with."""
        return self.residual_df >= max(MIN_RESIDUAL_DF, MIN_RESIDUAL_SHARE * len(self.whole)) and all(
            self.bases[term][1].shape[1] for term in self.levels
        )


def _choose_model(rows: pd.DataFrame) -> OverallModel | str:
    """The richest model that the traverses suffice for, or why there is none; seen by the design alone."""
    named: dict[Term, pd.Series] = {(DAY,): rows["session"], (DIRECTION,): rows["direction"]}
    levels = {
        term: (tuple(map(str, np.unique(column.to_numpy(object)))), _number_levels(column))
        for term, column in named.items()
        if column.nunique() > 1
    }
    factors: dict[Term, Array] = {term: indicator_columns(codes) for term, (_, codes) in levels.items()}
    if not factors and rows["configuration"].nunique() < 2:
        return "one session, one direction and one configuration: nothing to compare"
    fits = False
    for degree, asked in MODELS:
        place = _place_columns(rows, degree)
        single = {(CONFIGURATION,): place, **factors} if place.shape[1] else factors
        pairs = [pair for pair in asked if {pair[:1], pair[1:]} <= set(single)]
        width = {term: part.shape[1] for term, part in single.items()}
        if sum(width.values()) + sum(width[pair[:1]] * width[pair[1:]] for pair in pairs) > MAX_COLUMNS:
            continue
        fits = True
        products: dict[Term, Array] = {pair: _multiply(single[pair[:1]], single[pair[1:]]) for pair in pairs}
        model = OverallModel({**single, **products}, levels, degree)
        if model.is_sufficient:
            return model
    if not fits:
        return "too many sessions at once; select fewer by date"
    return (
        "too few traverses, or directions and sessions that each have configurations of their own: repeat "
        "some configurations in both directions and in each session"
    )


def _place_columns(rows: pd.DataFrame, degree: int) -> Array:
    """Where the joints stand: a column for each configuration, or for each power of each coordinate."""
    if degree == 0:
        codes = _number_levels(rows["configuration"])
        return indicator_columns(codes) if codes.max() else np.zeros((len(rows), 0))
    return np.hstack([np.zeros((len(rows), 0)), *_coordinate_powers(rows, degree)])


def _coordinate_powers(rows: pd.DataFrame, degree: int) -> Iterator[Array]:
    """Legendre polynomials of each coordinate that varies, at most one fewer than it has values."""
    table = rows.assign(middle=(rows["low"] + rows["high"]) / 2)
    names = [*position_columns(rows), "middle", *(name for name in ("load_middle",) if name in table)]
    for name in names:
        x = table[name].to_numpy(float)
        n_values = len(np.unique(x))
        if not np.isfinite(x).all() or n_values < 2:
            continue
        scaled = 2.0 * (x - x.min()) / np.ptp(x) - 1.0
        yield np.polynomial.legendre.legvander(scaled, min(degree, n_values - 1))[:, 1:]


def _multiply(first: Array, second: Array) -> Array:
    """Products of each two columns, shape (n, p q)."""
    return (first[:, :, None] * second[:, None, :]).reshape(len(first), -1)


def _number_levels(column: pd.Series) -> IntArray:
    return np.unique(column.to_numpy(object), return_inverse=True)[1]
