"""Memory: residuals that follow those before them, alternatives that stand for "unknown".

Either noise is a first-order autoregression, or each traverse in one direction follows the residual of the
traverse before it. Both are judged by restricted likelihood (H. Patterson and R. Thompson, Biometrika 58:545,
1971): residuals are those of a calibration that took the noise for independent and followed its slow part,
so that the calibration is fitted again under the correlation. With L the prediction-error filter, B an
orthonormal basis of the calibration and r residuals orthogonal to it, the restricted sum of squares is
|L r|^2 - r' L'L B (B' L'L B)^-1 B' L'L r, and half of log det B' L'L B is the price of the refit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.linalg import solve_triangular
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.linearized import LinearizedFit, split_positions
from stickslip_fit.logs.history import previous_rows

AR1_COEFFICIENTS = (-0.3, 0.2, 0.35, 0.5, 0.65, 0.8)
# Of one direction on the residual before, which may be as far below as above it.
LAG_COEFFICIENTS = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
SHARED_FILL = 0.25  # of the rows, above which a direction of the calibration counts as shared by all
# Nats, below which memory counts for nothing, also if the refit adds twice as much as it does to independent
# noise: it is then left out, since in long logs it takes most of the time.
NEGLIGIBLE = -50.0
RANK_TOL = 1e-6  # of the square of a direction that rows left out have not determined


@dataclass(frozen=True, eq=False)
class _CalibrationPart:
    """Directions of the calibration that no sequence connects to others, orthonormal.

    Attributes
    ----------
    rows : array of int, shape (s,)
        All rows that they and their neighbours have.
    basis, diagonal, neighbours : array, shape (s, p)
        The directions B, D B and (S + S') B, see `Sequences`.
    """

    rows: IntArray
    basis: Array
    diagonal: Array
    neighbours: Array

    def filtered(self, coefficient: float) -> Array:
        """L'L B less B, shape (s, p)."""
        return coefficient**2 * self.diagonal - coefficient * self.neighbours


@dataclass(frozen=True, eq=False)
class Sequences:
    """Which row follows which, and a calibration; n rows.

    L'L = 1 + c^2 D - c (S + S') with c the coefficient, S the row before each row, and D = 1 for rows that
    one follows, less 1 for the first ones of a stationary sequence, whose variance is that of all.

    Attributes
    ----------
    previous : array of int, shape (n,)
        The row before each row, -1 for the first of a sequence.
    basis : sparse array, shape (n, p)
        Of the calibration.
    onto : array of bool, shape (n,), or None
        Rows that follow the row before them. None for all, which then are stationary sequences.
    """

    previous: IntArray
    basis: csr_array
    onto: BoolArray | None = None

    @cached_property
    def before(self) -> IntArray:
        """The row that each row follows, -1 where it follows none, shape (n,)."""
        return self.previous if self.onto is None else np.where(self.onto, self.previous, -1)

    @property
    def n_stationary(self) -> int:
        """Number of stationary sequences."""
        return int(np.sum(self.previous < 0)) if self.onto is None else 0

    @cached_property
    def diagonal(self) -> Array:
        """D, shape (n,)."""
        successors = np.bincount(self.before[self.before >= 0], minlength=len(self.before)).astype(float)
        return successors - (self.before < 0) if self.onto is None else successors

    @cached_property
    def _neighbours(self) -> csr_array:
        n, follows = len(self.before), np.flatnonzero(self.before >= 0)
        step = csr_array((np.ones(len(follows)), (follows, self.before[follows])), shape=(n, n))
        return csr_array(step + step.T)

    @cached_property
    def _split(self) -> tuple[list[_CalibrationPart], _CalibrationPart]:
        """Parts of the calibration, and what is shared by all rows."""
        n, every = len(self.before), csc_array(self.basis)
        is_shared = np.diff(every.indptr) > SHARED_FILL * n
        own, shared = csr_array(every[:, ~is_shared]), every[:, is_shared].toarray()
        neighbours, diagonal = csr_array(self._neighbours @ own), csr_array(diags_array(self.diagonal) @ own)
        connection = abs(own).T @ (abs(own) + abs(neighbours))
        _, label = connected_components(connection, directed=False)
        parts = []
        for columns in split_positions(label):
            inside = (
                csc_array(own[:, columns]),
                csc_array(diagonal[:, columns]),
                csc_array(neighbours[:, columns]),
            )
            rows = np.unique(np.concatenate([one.indices for one in inside])).astype(np.intp)
            basis, squared, beside = (csr_array(one)[rows].toarray() for one in inside)
            turn = _orthonormal_turn(basis)
            part = _CalibrationPart(rows, basis @ turn, squared @ turn, beside @ turn)
            shared[rows] -= part.basis @ (part.basis.T @ shared[rows])
            parts.append(part)
        shared = shared @ _orthonormal_turn(shared)
        together = np.arange(n), shared, self.diagonal[:, None] * shared, self._neighbours @ shared
        return parts, _CalibrationPart(*together)

    def sum_along(self, residuals: Array) -> list[Array]:
        """Of each part of the calibration D B and (S + S') B with residuals, (n, k) -> (2 p, k)."""
        parts, shared = self._split
        return [
            np.concatenate([one.diagonal, one.neighbours], axis=1).T @ residuals[one.rows]
            for one in (*parts, shared)
        ]

    def refit(self, coefficient: float) -> CalibrationRefit:
        """The calibration under the correlation of a coefficient."""
        parts, shared = self._split
        factors, crosses = [], []
        shared_filtered = shared.filtered(coefficient)
        left = np.eye(shared.basis.shape[1]) + shared.basis.T @ shared_filtered
        for part in parts:
            factor = np.linalg.cholesky(
                np.eye(part.basis.shape[1]) + part.basis.T @ part.filtered(coefficient)
            )
            cross = solve_triangular(factor, part.basis.T @ shared_filtered[part.rows], lower=True)
            left -= cross.T @ cross
            factors.append(factor)
            crosses.append(cross)
        return CalibrationRefit(coefficient, factors, crosses, np.linalg.cholesky(left))

    def without(self, rows: IntArray) -> Sequences:
        """The sequences of the other rows, which go on after the rows left out."""
        n = len(self.previous)
        kept, place = np.setdiff1d(np.arange(n), rows), np.full(n + 1, -1)
        place[kept] = np.arange(len(kept))
        is_out = np.zeros(n + 1, dtype=bool)
        is_out[rows] = True
        previous = self.previous[kept]
        while np.any(inside := is_out[previous]):
            previous = np.where(inside, self.previous[previous], previous)
        onto = None if self.onto is None else self.onto[kept]
        return Sequences(place[previous], csr_array(self.basis[kept]), onto)


def _orthonormal_turn(columns: Array) -> Array:
    """What turns columns, shape (s, p), into an orthonormal basis of their span, shape (p, q)."""
    squares, right = np.linalg.eigh(columns.T @ columns)
    known = squares > RANK_TOL
    return np.asarray(right[:, known] / np.sqrt(squares[known]))


@dataclass(frozen=True, eq=False)
class LagSums:
    """Sums over the rows of k logs.

    Attributes
    ----------
    sequences : Sequences
    residuals : array, shape (n, k)
    squares, diagonal : array, shape (k,)
        Of the residuals, and of D (see `Sequences`) with their squares.
    products : array, shape (k,)
        Each residual times the one that it follows.
    """

    sequences: Sequences
    residuals: Array
    squares: Array
    diagonal: Array
    products: Array

    @cached_property
    def along(self) -> list[Array]:
        """As of `Sequences.sum_along`."""
        return self.sequences.sum_along(self.residuals)


def sum_lags(every: Iterable[Sequences], residuals: Array) -> dict[int, LagSums]:
    """Sums for sequences, by the `id` of each; residuals (n, k)."""
    squares = residuals**2
    total = squares.sum(axis=0)
    products: dict[int, Array] = {}
    sums: dict[int, LagSums] = {}
    for one in every:
        if id(one) in sums:
            continue
        if id(one.previous) not in products:
            # The first row of a sequence times any other, which does not count.
            products[id(one.previous)] = residuals * residuals[one.previous]
        follows = (one.before >= 0).astype(float)
        sums[id(one)] = LagSums(
            one, residuals, total, one.diagonal @ squares, follows @ products[id(one.previous)]
        )
    return sums


@dataclass(frozen=True, eq=False)
class CalibrationRefit:
    """A calibration under a correlation.

    Attributes
    ----------
    coefficient : float
    factors : list of array, shape (p, p)
        Cholesky factor of B' L'L B of each part.
    crosses : list of array, shape (p, q)
        The same solved for what all rows share.
    shared : array, shape (q, q)
        Cholesky factor of what is left of that.
    """

    coefficient: float
    factors: list[Array]
    crosses: list[Array]
    shared: Array

    @cached_property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of B' L'L B."""
        return 2.0 * sum(float(np.log(one.diagonal()).sum()) for one in (*self.factors, self.shared))

    def explained(self, sums: LagSums) -> Array:
        """What the refit takes off the sum of squares, shape (k,)."""
        squares = np.zeros_like(sums.squares)
        *products, shared = (self._products(one) for one in sums.along)
        for factor, cross, own in zip(self.factors, self.crosses, products, strict=True):
            solved = solve_triangular(factor, own, lower=True, check_finite=False)
            squares += np.einsum("ij,ij->j", solved, solved)
            shared = shared - cross.T @ solved
        return np.asarray(squares + np.sum(np.linalg.solve(self.shared, shared) ** 2, axis=0))

    def _products(self, along: Array) -> Array:
        """B' L'L r, from the sums along the two directions of each column."""
        diagonal, neighbours = np.split(along, 2)
        return np.asarray(self.coefficient**2 * diagonal - self.coefficient * neighbours)


@dataclass(frozen=True, eq=False)
class AR1:
    """An autoregression of the residuals, or what one direction keeps of the row before.

    Attributes
    ----------
    cause : str
    sequences : Sequences
    coefficient : float
        The share.
    """

    cause: str
    sequences: Sequences
    coefficient: float
    version: None = None
    values: None = None

    @property
    def before(self) -> IntArray:
        """As of the `sequences`."""
        return self.sequences.before

    @cached_property
    def _refit(self) -> CalibrationRefit:
        return self.sequences.refit(self.coefficient)

    def log_evidence(self, sums: LagSums, df: int) -> Array:
        """Log restricted likelihood ratio to white noise, the size of the noise unknown; shape (k,)."""
        carried, n_parameters = self.coefficient, self.sequences.basis.shape[1]
        squares = sums.squares - 2 * carried * sums.products + carried**2 * sums.diagonal
        stationary = 0.5 * self.sequences.n_stationary
        price = stationary * np.log1p(-(carried**2)) if stationary else 0.0
        log = price - 0.5 * df * np.log(squares / sums.squares)
        if np.all(log + 2.0 * carried**2 * n_parameters < NEGLIGIBLE):
            return np.asarray(log)
        squares -= self._refit.explained(sums)
        return np.asarray(
            price - 0.5 * self._refit.log_determinant - 0.5 * df * np.log(squares / sums.squares)
        )

    def shape(self, residual: Array) -> Array:
        """Prediction of each residual from the one before, shape (n,)."""
        return np.where(self.before >= 0, self.coefficient * residual[self.before], 0.0)


def memory_alternatives(linearized: LinearizedFit) -> Iterator[AR1]:
    """Memory from traverse to traverse and of each joint, then onto traverses in one direction only."""
    rows, sign = linearized.rows, linearized.direction_sign
    session = pd.factorize(rows["session"].astype(object))[0]
    for name, group in (("", session), (" of each joint", 10 * session + rows["joint"].to_numpy())):
        before = previous_rows(group.astype(np.int64)).astype(np.intp)
        both = Sequences(before, linearized.basis)
        yield from (AR1(f"unknown:memory{name}", both, carried) for carried in AR1_COEFFICIENTS)
        for direction, own in (("+", sign > 0), ("-", sign < 0)):
            # Of each direction's noise its own estimate is known, so that the variances need not agree.
            one_way = Sequences(before, linearized.basis, own)
            label = f"unknown:memory-by-direction{name}, {direction} only"
            yield from (AR1(label, one_way, carried) for carried in LAG_COEFFICIENTS)
