"""Joints fitted by themselves or, where causes act on all of them alike, together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.levenberg_marquardt import Minimum
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.problem import Problem, System
from stickslip_fit.fit.repeatability import Repeatability, pooled, variance_of
from stickslip_fit.fit.shared import Sharing
from stickslip_fit.fit.terms import Terms
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# The first pass weighs all traverses alike; then the rounding's share of the variance, and under heavy tails
# the residuals themselves, change the weights until they settle.
MOST_PASSES = 100
SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class Fitting:
    """Problems that are minimised as one system.

    Attributes
    ----------
    problems : tuple of Problem
    whole : System
        Their rows and groups, one problem's after the other's.
    columns : tuple of array of int
        Where each problem's parameters stand among those of the whole.
    """

    problems: tuple[Problem, ...]
    whole: System
    columns: tuple[Indices, ...]

    def groups(self, number: int) -> slice:
        """Places of one problem's groups among those of the whole."""
        first = sum(len(problem.groups) for problem in self.problems[:number])
        return slice(first, first + len(self.problems[number].groups))

    def rows(self, number: int) -> slice:
        """Places of one problem's rows among those of the whole."""
        first = sum(len(problem.y) for problem in self.problems[:number])
        return slice(first, first + len(self.problems[number].y))

    def part(self, found: Minimum, number: int) -> Minimum:
        """What was found for one problem."""
        groups, columns = self.groups(number), self.columns[number]
        return Minimum(
            values=found.values[groups, columns],
            curvature=self.square(found.curvature, number),
            residual=found.residual[self.rows(number)],
            converged=found.converged[groups],
            rank=found.rank[groups],
            at_bound=found.at_bound[groups, columns],
            iterations=found.iterations,
        )

    def square(self, matrices: Array, number: int) -> Array:
        """One problem's part of a matrix for each group, shape (g, p, p)."""
        columns = self.columns[number]
        return matrices[self.groups(number)][:, columns[:, None], columns]


@dataclass(frozen=True, eq=False)
class Settled:
    """Where a fit came to rest.

    Attributes
    ----------
    found : Minimum
        Of the whole.
    repeatability : tuple of dict of str to Repeatability
        Of each problem, by direction.
    weight, information : array, shape (n,)
        Of each row in the search, and of what it tells about the parameters.
    """

    found: Minimum
    repeatability: tuple[dict[str, Repeatability], ...]
    weight: Array
    information: Array


def by_itself(problem: Problem) -> Fitting:
    """One joint that shares nothing with the others."""
    return Fitting((problem,), problem, (np.arange(problem.start.shape[1]),))


def together(problems: Sequence[Problem], shared: int) -> Fitting:
    """Joints whose last parameters, so many of them, are the same for all.

    Parameters
    ----------
    problems : sequence of Problem
        One for each joint; among its own parameters none is shared.
    shared : int
    """
    own = [problem.start.shape[1] - shared for problem in problems]
    columns = tuple(np.r_[np.arange(count), max(own) + np.arange(shared)] for count in own)
    width = max(own) + shared
    groups, offset = _groups(problems), np.cumsum([0, *(len(problem.y) for problem in problems)])

    def part(some: Indices) -> Model:
        """The model of some of the rows, in the order of the whole."""
        ends = np.searchsorted(some, offset)
        models = [
            problem.part(some[first:last] - before)
            for problem, first, last, before in zip(problems, ends, ends[1:], offset, strict=False)
        ]
        return _side_by_side(models, ends, columns, width)

    def beside(name: str, nothing: float) -> Array:
        """A table of each problem's groups and parameters; what a problem lacks has no effect."""
        tables = []
        for problem, mine in zip(problems, columns, strict=True):
            table = np.full((len(problem.groups), width), nothing)
            table[:, mine] = getattr(problem, name)
            tables.append(table)
        return np.concatenate(tables)

    one_set = Groups(pd.DataFrame({"set": [0]}), np.zeros(len(groups), dtype=np.intp))
    whole = System(
        groups, Sharing(np.arange(width) >= max(own), one_set),
        np.concatenate([problem.y for problem in problems]),
        _side_by_side([problem.model for problem in problems], offset, columns, width),
        beside("start", 0.0), beside("scales", 1.0), beside("lower", -np.inf), beside("upper", np.inf), part,
    )  # fmt: skip
    return Fitting(tuple(problems), whole, columns)


def _side_by_side(models: Sequence[Model], ends: Indices, columns: Sequence[Indices], width: int) -> Model:
    """One model of the rows of several, each between two ends and with parameters of its own columns."""

    def model(values: Array) -> tuple[Array, Array]:
        predicted, slopes = np.empty(len(values)), np.zeros((len(values), width))
        for each, mine, first, last in zip(models, columns, ends, ends[1:], strict=False):
            rows = slice(first, last)
            predicted[rows], slopes[rows, mine] = each(values[rows, mine])
        return predicted, slopes

    return model


def _groups(problems: Sequence[Problem]) -> Groups:
    before = np.cumsum([0, *(len(problem.groups) for problem in problems)])
    of_row = [problem.groups.of_row + first for problem, first in zip(problems, before[:-1], strict=True)]
    tables = [problem.groups.table.assign(joint=problem.law.joint) for problem in problems]
    return Groups(pd.concat(tables, ignore_index=True), np.concatenate(of_row))


def settle(fitting: Fitting, terms: Terms, weight: Array | None = None) -> Settled:
    """Minimise, weigh the rows by what is left over, and so on until the weights settle."""
    likelihood, start = terms.likelihood, fitting.whole.start
    weight = np.ones(len(fitting.whole.y)) if weight is None else weight
    for _ in range(MOST_PASSES):
        found = fitting.whole.minimise(weight, start)
        repeatability = tuple(
            from_residuals(problem, fitting.part(found, number), likelihood) | terms.given(problem.law.joint)
            for number, problem in enumerate(fitting.problems)
        )
        each = zip(fitting.problems, repeatability, strict=True)
        scale2 = np.concatenate(
            [variance_of(problem.rows, problem.rounding, mine, likelihood) for problem, mine in each]
        )
        before, weight = weight, likelihood.share(found.residual**2 / scale2) / scale2
        start = found.values
        if np.max(np.abs(weight / before - 1.0)) < SETTLED:
            break
    return Settled(found, repeatability, weight, likelihood.information / scale2)


def from_residuals(problem: Problem, found: Minimum, likelihood: Likelihood) -> dict[str, Repeatability]:
    """Repeatability of each direction from what the fit leaves over."""
    repeatability = {}
    for way in ("+", "-"):
        mine = (problem.rows["direction"] == way).to_numpy()
        freedom = int(mine.sum() - found.rank[problem.ways == way].sum())
        repeatability[way] = pooled(
            found.residual[mine], problem.rounding[mine], freedom, "residuals", likelihood
        )
    return repeatability
