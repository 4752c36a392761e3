"""Sums of squares of a linear model's terms, types I, II and III, whatever the coding and the balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.anova.comparison import shift
from stickslip_fit.anova.projection import orthonormal

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Term:
    """One term of a model.

    Attributes
    ----------
    name : str
    factors : frozenset of str
        What it is a product of.
    columns : array, shape (n, p)
        Its part of the design matrix.
    """

    name: str
    factors: frozenset[str]
    columns: Array


@dataclass(frozen=True)
class Line:
    """One line of a table: sum of squares and degrees of freedom."""

    name: str
    squares: float
    freedom: int


RESIDUAL = "residual"


def sequential(values: Array, terms: Sequence[Term]) -> list[Line]:
    """Type I: what each term adds to those before it; with the residual the lines add up to the total.

    Parameters
    ----------
    values : array, shape (n,)
    terms : sequence of Term
        Without the intercept, which is always there.

    Examples
    --------
    >>> sessions = Term("session", frozenset({"session"}), np.array([[1.0], [1], [0], [0]]))
    >>> [(line.name, round(line.squares, 9), line.freedom) for line in sequential([1.0, 2, 3, 4], [sessions])]
    [('session', 4.0, 1), ('residual', 1.0, 2)]
    """
    left = _centred(values)
    basis = _intercept(len(left))
    lines = []
    for term in terms:
        added = orthonormal(term.columns, basis)
        share = left @ added
        left = left - added @ share
        basis = np.hstack([basis, added])
        lines.append(Line(term.name, float(share @ share), added.shape[1]))
    left = left - basis @ (basis.T @ left)
    return [*lines, Line(RESIDUAL, float(left @ left), len(left) - basis.shape[1])]


def marginal(values: Array, terms: Sequence[Term]) -> list[Line]:
    """Type II: what each term adds to all those that do not contain it."""
    rest = sequential(values, terms)[-1]
    lines = []
    for term in terms:
        others = [other for other in terms if not term.factors <= other.factors]
        lines.append(_last(values, [*others, term]))
    return [*lines, rest]


def partial(values: Array, terms: Sequence[Term]) -> list[Line]:
    """Type III: what each term adds to all others, columns being coded by sum-to-zero contrasts."""
    rest = sequential(values, terms)[-1]
    lines = [_last(values, [*(other for other in terms if other is not term), term]) for term in terms]
    return [*lines, rest]


def _last(values: Array, terms: Sequence[Term]) -> Line:
    return sequential(values, terms)[-2]


def _centred(values: Array) -> Array:
    shifted = shift(values)
    return shifted - shifted.mean()


def _intercept(n: int) -> Array:
    return np.full((n, 1), n**-0.5)
