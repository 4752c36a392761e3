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
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.linearized import LinearizedFit, split_positions
from stickslip_fit.logs.history import previous_rows

AR1_COEFFICIENTS = (-0.3, 0.2, 0.35, 0.5, 0.65, 0.8)
# Of one direction on the residual before, which may be as far below as above it.
LAG_COEFFICIENTS = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
SHARED_FILL = 0.25  # of the rows, above which a direction of the calibration counts as shared by all
# Nats, below which memory counts for nothing, also if the refit adds twice what it does to white noise: it is
# then left out, since in long logs it takes most of the time.
NEGLIGIBLE, LEAST_SHARE = -30.0, 1e-12
MAX_FEW = 0.2  # of the logs in which it counts, for which sums are made anew
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
    def neighbour_squares(self) -> float:
        """Squared Frobenius norm of (S + S') B: over c^2, the squares that a refit takes off white noise."""
        return float(np.sum((self._neighbours @ self.basis).data ** 2))

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
        inside = csc_array(own), csc_array(diagonal), csc_array(neighbours)
        for columns in split_positions(label):
            rows = np.unique(np.concatenate([_entries(one, k)[0] for one in inside for k in columns]))
            basis, squared, beside = (_take_block(one, rows, columns) for one in inside)
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
        solvers, crosses, log_determinant = [], [], 0.0
        filtered = shared.filtered(coefficient)
        left = np.eye(shared.basis.shape[1]) + shared.basis.T @ filtered
        for part in parts:
            width = part.basis.shape[1]
            factor = np.linalg.cholesky(np.eye(width) + part.basis.T @ part.filtered(coefficient))
            solvers.append(np.linalg.solve(factor, _products_of_sums(coefficient, width)))
            crosses.append(np.linalg.solve(factor, part.basis.T @ filtered[part.rows]))
            left -= crosses[-1].T @ crosses[-1]
            log_determinant += 2.0 * float(np.log(factor.diagonal()).sum())
        factor = np.linalg.cholesky(left)
        log_determinant += 2.0 * float(np.log(factor.diagonal()).sum())
        solvers.append(np.linalg.solve(factor, _products_of_sums(coefficient, len(factor))))
        crosses = [np.linalg.solve(factor, cross.T) for cross in crosses]
        return CalibrationRefit(solvers, crosses, log_determinant)

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


def _entries(matrix: csc_array, column: int) -> tuple[IntArray, Array]:
    """Rows and values of a column."""
    inside = slice(matrix.indptr[column], matrix.indptr[column + 1])
    return matrix.indices[inside].astype(np.intp), matrix.data[inside]


def _take_block(matrix: csc_array, rows: IntArray, columns: IntArray) -> Array:
    """Some columns in some rows, which have all of their entries; ten times as fast as scipy's slices."""
    block = np.zeros((len(rows), len(columns)))
    for place, column in enumerate(columns):
        where, values = _entries(matrix, column)
        block[np.searchsorted(rows, where), place] = values
    return block


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

    def select(self, which: BoolArray) -> LagSums:
        """The sums of some logs."""
        parts = self.squares[which], self.diagonal[which], self.products[which]
        return LagSums(self.sequences, self.residuals[:, which], *parts)

    @cached_property
    def along(self) -> list[Array]:
        """As of `Sequences.sum_along`."""
        return self.sequences.sum_along(self.residuals)


def sum_lags(every: Iterable[Sequences], residuals: Array) -> dict[int, LagSums]:
    """Sums for sequences, by the `id` of each; residuals (n, k)."""
    unique = list({id(one): one for one in every}.values())
    if not unique:
        return {}
    weights = [np.ones(len(residuals)), *(one.diagonal for one in unique)]
    total, *diagonals = np.stack(weights) @ residuals**2
    sums: dict[int, LagSums] = {}
    for previous in {id(one.previous): one.previous for one in unique}.values():
        own = [k for k, one in enumerate(unique) if one.previous is previous]
        follows = np.stack([(unique[k].before >= 0).astype(float) for k in own])
        # Of a first row it is the product with any other, which does not count.
        for k, products in zip(own, follows @ (residuals * residuals[previous]), strict=True):
            sums[id(unique[k])] = LagSums(unique[k], residuals, total, diagonals[k], products)
    return sums


def _products_of_sums(coefficient: float, width: int) -> Array:
    """What turns sums as of `Sequences.sum_along` into B' L'L r, shape (p, 2 p)."""
    return np.concatenate([coefficient**2 * np.eye(width), -coefficient * np.eye(width)], axis=1)


@dataclass(frozen=True, eq=False)
class CalibrationRefit:
    """A calibration under a correlation.

    Attributes
    ----------
    solvers : list of array, shape (p, 2 p)
        Of each part, then of what all rows share: sums to B' L'L r, solved by the factor of B' L'L B.
    crosses : list of array, shape (q, p)
        What all rows share loses by each part.
    log_determinant : float
        Logarithm of the determinant of B' L'L B.
    """

    solvers: list[Array]
    crosses: list[Array]
    log_determinant: float

    def explained(self, sums: LagSums) -> Array:
        """What the refit takes off the sum of squares, shape (k,)."""
        *solved, shared = (one @ along for one, along in zip(self.solvers, sums.along, strict=True))
        squares = np.zeros_like(sums.squares)
        for cross, own in zip(self.crosses, solved, strict=True):
            squares += np.einsum("ij,ij->j", own, own)
            if len(shared):
                shared = shared - cross @ own
        return np.asarray(squares + np.einsum("ij,ij->j", shared, shared))


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
        carried = self.coefficient
        share = 1.0 + (carried**2 * sums.diagonal - 2 * carried * sums.products) / sums.squares
        stationary = 0.5 * self.sequences.n_stationary
        price = stationary * np.log1p(-(carried**2)) if stationary else 0.0
        least = share - 2.0 * carried**2 * self.sequences.neighbour_squares / df
        counts = price - 0.5 * df * np.log(np.maximum(least, LEAST_SHARE)) > NEGLIGIBLE
        log = price - 0.5 * df * np.log(share)
        if counts.any():
            some = sums if counts.mean() > MAX_FEW else sums.select(counts)
            where = slice(None) if some is sums else counts
            left = share[where] - self._refit.explained(some) / some.squares
            log[where] = price - 0.5 * self._refit.log_determinant - 0.5 * df * np.log(left)
        return np.asarray(log)

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
