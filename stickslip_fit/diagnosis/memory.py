"""Memory: residuals that follow those before them, alternatives that stand for "unknown".

Either noise is a first-order autoregression, or each traverse in one direction follows the residual of the
traverse before it. Both are judged by restricted likelihood (H. Patterson and R. Thompson, Biometrika 58:545,
1971): residuals are those of a calibration that took the noise for independent and followed its slow part,
so that the calibration is fitted again under the correlation. With L the prediction-error filter, B an
orthonormal basis of the calibration and r residuals orthogonal to it, the restricted sum of squares is
|L r|^2 - r' L'L B (B' L'L B)^-1 B' L'L r, and half of log det B' L'L B is the price of the refit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.sparse import csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from stickslip_fit._rows import rank_within
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.proposed import CarryOverTerm
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.logs.fading import previous_rows
from stickslip_fit.logs.history import DEPARTURES

AR1_COEFFICIENTS = (-0.3, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.97)
# Of one direction on the residual before, which may be as far below as above it.
LAG_COEFFICIENTS = (-1.5, -0.8, -0.4, 0.4, 0.8, 1.5)
SHARED_FILL = 0.25  # of the rows, above which a direction of the calibration counts as shared by all
# Nats, below which memory counts for nothing, also if the refit adds twice what it does to white noise: it is
# then left out, since in long logs it takes most of the time.
NEGLIGIBLE, LEAST_SHARE = -30.0, 1e-12
MAX_FEW = 0.2  # of the logs in which it counts, for which sums are made anew
RANK_TOL = 1e-6  # of the square of a direction that rows left out have not determined


@dataclass(frozen=True, eq=False)
class CalibrationParts:
    """Parts of a calibration that have equally many directions; P parts, s rows, p directions.

    Attributes
    ----------
    rows : array of int, shape (P, s)
        -1 beyond the last row of a part.
    basis : array, shape (P, s, p)
        Zero there.
    """

    rows: IntArray
    basis: Array

    def orthonormal(self) -> CalibrationParts:
        """The same directions, orthonormal in each part."""
        return CalibrationParts(self.rows, self.basis @ _orthonormal_turn(self.basis))

    def take(self, values: Array) -> Array:
        """Rows of values, (n, k) -> (P, s, k); any row beyond a part's last, where the basis is 0."""
        return np.asarray(values[self.rows])


@dataclass(frozen=True, eq=False)
class Calibration:
    """Directions of a calibration, in parts that no sequence connects.

    Attributes
    ----------
    shared : array, shape (n, q)
        Directions that most rows share.
    """

    stacks: tuple[CalibrationParts, ...]
    shared: Array

    @classmethod
    def of(cls, previous: IntArray, basis: csr_array) -> Calibration:
        """The parts of a basis, shape (n, p), for rows of which each follows another or, if -1, none."""
        n, every = len(previous), csc_array(basis)
        is_shared = np.diff(every.indptr) > SHARED_FILL * n
        own, shared = every[:, ~is_shared].tocoo(), every[:, is_shared].toarray()
        width, follows = own.shape[1], np.flatnonzero(previous >= 0)
        edges = np.r_[follows, own.coords[0]], np.r_[previous[follows], n + own.coords[1]]
        graph = csr_array((np.ones(len(edges[0])), edges), shape=(n + width, n + width))
        label: IntArray = np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)
        own_labels, part = np.unique(label[n:], return_inverse=True)
        n_rows, n_columns = np.bincount(label[:n], minlength=label.max() + 1)[own_labels], np.bincount(part)
        row_place, column_place = rank_within(label[:n]), rank_within(part)
        part_of_row = np.full(label.max() + 1, -1)
        part_of_row[own_labels] = np.arange(len(own_labels))
        part_of_row = part_of_row[label[:n]]
        stacks, sizes = [], np.stack([n_columns, np.ceil(np.log2(n_rows)).astype(int)], axis=1)
        for size in np.unique(sizes, axis=0):
            inside = np.all(sizes == size, axis=1)
            place = np.where(inside, np.cumsum(inside) - 1, -1)
            rows = np.full((int(inside.sum()), int(n_rows[inside].max())), -1)
            members = np.flatnonzero((part_of_row >= 0) & inside[part_of_row])
            rows[place[part_of_row[members]], row_place[members]] = members
            blocks = np.zeros((*rows.shape, int(size[0])))
            entries = inside[part[own.coords[1]]]
            row, column = own.coords[0][entries], own.coords[1][entries]
            blocks[place[part[column]], row_place[row], column_place[column]] = own.data[entries]
            stacks.append(CalibrationParts(rows, blocks))
        return cls(tuple(stacks), shared)

    def without(self, place: IntArray) -> Calibration:
        """Of fewer rows, at their new places; `place` of shape (n + 1,), -1 for the others and at its end."""
        stacks = []
        for one in self.stacks:
            rows = place[one.rows]
            stacks.append(CalibrationParts(rows, np.where((rows >= 0)[..., None], one.basis, 0.0)))
        return Calibration(tuple(stacks), self.shared[place[:-1] >= 0])

    @cached_property
    def orthonormal(self) -> Calibration:
        """An orthonormal basis of the same directions."""
        stacks, shared = tuple(one.orthonormal() for one in self.stacks), self.shared.copy()
        for one in stacks:
            along = one.basis @ (one.basis.transpose(0, 2, 1) @ one.take(shared))
            inside = one.rows >= 0
            shared[one.rows[inside]] -= along[inside]
        return Calibration(stacks, shared @ _orthonormal_turn(shared))

    def leverage(self) -> Array:
        """Square of each row of the basis, shape (n,)."""
        squares = np.sum(self.shared**2, axis=1)
        for one in self.stacks:
            inside = one.rows >= 0
            squares[one.rows[inside]] += np.sum(one.basis[inside] ** 2, axis=1)
        return np.asarray(squares)


def _orthonormal_turn(columns: Array) -> Array:
    """What turns columns, (..., s, p), into an orthonormal basis of their span and zeros; (..., p, p)."""
    squares, right = np.linalg.eigh(np.swapaxes(columns, -1, -2) @ columns)
    lengths = np.where(squares > RANK_TOL, np.sqrt(np.maximum(squares, RANK_TOL)), np.inf)
    return np.asarray(right / lengths[..., None, :])


@dataclass(frozen=True, eq=False)
class _Products:
    """Of directions B in part of the rows, with others C in all; see `Sequences` for D and S.

    Attributes
    ----------
    along : array, shape (P, 2 p, s)
        D B and (S + S') B, transposed.
    own, cross : array, shape (2, P, p, p) and (2, P, p, q)
        B' D B and B' (S + S') B, then with C.
    """

    along: Array
    own: Array
    cross: Array


@dataclass(frozen=True, eq=False)
class Sequences:
    """Which row follows which, and a calibration; n rows.

    L'L = 1 + c^2 D - c (S + S') with c the coefficient, S the row before each row, and D = 1 for rows that
    one follows, less 1 for the first ones of a stationary sequence, whose variance is that of all.

    Attributes
    ----------
    previous : array of int, shape (n,)
        The row before each row, -1 for the first of a sequence.
    calibration : Calibration
        In parts that no such sequence connects.
    onto : array of bool, shape (n,), or None
        Rows that follow the row before them. None for all, which then are stationary sequences.
    """

    previous: IntArray
    calibration: Calibration
    onto: BoolArray | None = None

    @classmethod
    def of(cls, previous: IntArray, basis: csr_array, onto: BoolArray | None = None) -> Sequences:
        """Sequences and a calibration whose basis has shape (n, p)."""
        return cls(previous, Calibration.of(previous, basis), onto)

    @cached_property
    def before(self) -> IntArray:
        """The row that each row follows, -1 where it follows none, shape (n,)."""
        return self.previous if self.onto is None else np.where(self.onto, self.previous, -1)

    @property
    def n_stationary(self) -> int:
        """Number of stationary sequences."""
        return int(np.sum(self.previous < 0)) if self.onto is None else 0

    @cached_property
    def _n_after(self) -> Array:
        """How many rows follow each row, shape (n,)."""
        return np.bincount(self.before[self.before >= 0], minlength=len(self.before)).astype(float)

    @cached_property
    def diagonal(self) -> Array:
        """D, shape (n,)."""
        return self._n_after - (self.before < 0) if self.onto is None else self._n_after

    @cached_property
    def neighbour_squares(self) -> float:
        """At least the squares that a refit takes off white noise, over c^2: |(S + S') B|^2."""
        n_neighbours = self._n_after + (self.before >= 0)
        return 2.0 * float(n_neighbours @ self.calibration.leverage())

    def _add_neighbours(self, rows: IntArray, columns: Array) -> Array:
        """(S + S') on columns in some rows, which have all of their neighbours; (s, p), 0 in rows -1."""
        place = np.full(len(self.before) + 1, -1)
        place[rows] = np.arange(len(rows))
        place[-1] = -1
        before = np.where(rows >= 0, place[np.where(rows >= 0, self.before[rows], -1)], -1)
        after, sums = np.flatnonzero(before >= 0), np.zeros_like(columns)
        sums[after] = columns[before[after]]
        sums[before[after]] += columns[after]
        return sums

    @cached_property
    def _products(self) -> tuple[list[_Products], Array, Array]:
        """Of each stack of parts; what all rows share: D C and (S + S') C, transposed, and C' times both."""
        calibration = self.calibration.orthonormal
        shared = calibration.shared
        both = self.diagonal[:, None] * shared, self._add_neighbours(np.arange(len(shared)), shared)
        products = []
        for one in calibration.stacks:
            n_parts, n_rows, width = one.basis.shape
            turned = one.basis.transpose(0, 2, 1)
            flat = self._add_neighbours(one.rows.ravel(), one.basis.reshape(-1, width))
            moved = self.diagonal[one.rows][..., None] * one.basis, flat.reshape(n_parts, n_rows, width)
            along = np.concatenate(moved, axis=2).transpose(0, 2, 1)
            crosses = np.stack([turned @ one.take(part) for part in both])
            products.append(_Products(along, np.stack([turned @ part for part in moved]), crosses))
        return products, np.concatenate(both, axis=1).T, np.stack([shared.T @ part for part in both])

    def sum_along(self, residuals: Array) -> list[Array]:
        """Of each stack D B and (S + S') B with residuals, (n, k) -> (P, 2 p, k); of the shared (2 q, k)."""
        products, shared, _ = self._products
        stacks = zip(products, self.calibration.stacks, strict=True)
        return [*(own.along @ one.take(residuals) for own, one in stacks), shared @ residuals]

    @cached_property
    def _refits(self) -> dict[float, CalibrationRefit]:
        return {}

    def refit(self, coefficients: Iterable[float]) -> list[CalibrationRefit]:
        """The calibration under the correlation of each coefficient; those not known yet side by side."""
        wanted = list(coefficients)
        if new := [one for one in wanted if one not in self._refits]:
            self._refits.update(zip(new, self._refit_each(new), strict=True))
        return [self._refits[one] for one in wanted]

    def _refit_each(self, coefficients: list[float]) -> Iterator[CalibrationRefit]:
        products, _, together = self._products
        solvers, crosses, each = [], [], np.array(coefficients)[:, None, None]
        log_determinant = np.zeros(len(coefficients))

        def weigh(both: Array) -> Array:
            own = each if both.ndim == 3 else each[..., None]
            return np.asarray(own**2 * both[0] - own * both[1])

        def factorize(both: Array) -> tuple[Array, Array]:
            factor = np.linalg.cholesky(both)
            logs = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).reshape(len(both), -1)
            inverse = np.linalg.inv(factor)
            own = each if both.ndim == 3 else each[..., None]
            solvers.append(np.concatenate([own**2 * inverse, -own * inverse], axis=-1))
            return inverse, 2.0 * logs.sum(axis=1)

        left = np.eye(together.shape[-1]) + weigh(together)
        for one in products:
            inverse, log = factorize(np.eye(one.own.shape[-1]) + weigh(one.own))
            n_columns = inverse.shape[1] * inverse.shape[2]
            crosses.append((inverse @ weigh(one.cross)).reshape(len(each), n_columns, left.shape[-1]))
            left -= crosses[-1].mT @ crosses[-1]
            log_determinant += log
        inverse, log = factorize(left)
        crosses, log_determinant = [inverse @ one.mT for one in crosses], log_determinant + log
        for number, price in enumerate(log_determinant.tolist()):
            yield CalibrationRefit([one[number] for one in solvers], [one[number] for one in crosses], price)


def leave_out_rows(every: Iterable[Sequences], rows: IntArray) -> dict[int, Sequences]:
    """The sequences of the other rows, which go on after the rows left out, by the `id` of each."""
    unique = {id(one): one for one in every}
    calibrations: dict[int, Calibration] = {}
    found = {}
    for key, one in unique.items():
        n = len(one.previous)
        is_out = np.zeros(n + 1, dtype=bool)
        is_out[rows] = True
        kept, place = np.flatnonzero(~is_out[:n]), np.full(n + 1, -1)
        place[kept] = np.arange(len(kept))
        previous = one.previous[kept]
        while np.any(inside := is_out[previous]):
            previous = np.where(inside, one.previous[previous], previous)
        if id(one.calibration) not in calibrations:
            calibrations[id(one.calibration)] = one.calibration.without(place)
        onto = None if one.onto is None else one.onto[kept]
        found[key] = Sequences(place[previous], calibrations[id(one.calibration)], onto)
    return found


@dataclass(frozen=True, eq=False)
class LagSums:
    """Sums over the rows of k logs.

    Attributes
    ----------
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


@dataclass(frozen=True, eq=False)
class CalibrationRefit:
    """A calibration under a correlation.

    Attributes
    ----------
    solvers : list of array, shape (P, p, 2 p); the last (q, 2 q)
        Of each stack of parts, then of what all rows share: sums to B' L'L r, solved by the factor of
        B' L'L B.
    crosses : list of array, shape (q, P p)
        What all rows share loses by each stack.
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
        for cross, parts in zip(self.crosses, solved, strict=True):
            own = parts.reshape(-1, parts.shape[-1])
            squares += np.einsum("ij,ij->j", own, own)
            shared = shared - cross @ own
        return np.asarray(squares + np.einsum("ij,ij->j", shared, shared))


@dataclass(frozen=True, eq=False)
class AR1:
    """An autoregression of the residuals, or what one direction keeps of the row before.

    Attributes
    ----------
    coefficient : float
        The share.
    term : CarryOverTerm or None
        With which a law of a log follows it.
    """

    cause: str
    sequences: Sequences
    coefficient: float
    term: CarryOverTerm | None = None
    version: None = None
    values: None = None

    @property
    def before(self) -> IntArray:
        """As of the `sequences`."""
        return self.sequences.before

    def log_evidence(self, sums: LagSums, df: int, price: float, share: Array, counts: BoolArray) -> Array:
        """Log restricted likelihood ratio to white noise, the size of the noise unknown; shape (k,).

        `price`, `share` and `counts` are those of `without_refit`.
        """
        log = price - 0.5 * df * np.log(share)
        if counts.any():
            some = sums if counts.mean() > MAX_FEW else sums.select(counts)
            where = slice(None) if some is sums else counts
            (refit,) = self.sequences.refit([self.coefficient])
            left = share[where] - refit.explained(some) / some.squares
            # A refit whose equations are nearly singular may explain more than there is: no evidence.
            log[where] = np.where(
                left > LEAST_SHARE,
                price - 0.5 * refit.log_determinant - 0.5 * df * np.log(np.maximum(left, LEAST_SHARE)),
                -np.inf,
            )
        return np.asarray(log)

    def without_refit(self, sums: LagSums, df: int) -> tuple[float, Array, BoolArray]:
        """Price of a stationary start, share of the squares that is left, and logs in which memory counts."""
        carried = self.coefficient
        share = 1.0 + (carried**2 * sums.diagonal - 2 * carried * sums.products) / sums.squares
        stationary = 0.5 * self.sequences.n_stationary
        price = stationary * float(np.log1p(-(carried**2))) if stationary else 0.0
        least = share - 2.0 * carried**2 * self.sequences.neighbour_squares / df
        return price, share, price - 0.5 * df * np.log(np.maximum(least, LEAST_SHARE)) > NEGLIGIBLE

    def shape(self, residuals: Array) -> Array:
        """Prediction of each residual from the one before, shape (n,) or (n, q)."""
        carried = np.where(self.before >= 0, self.coefficient, 0.0)
        return np.asarray((carried * residuals[self.before].T).T)

    def whitener(self, basis: csr_array) -> Callable[[Array], Array]:
        """What takes from columns, (n,) or (n, q), the memory and then the calibration, basis (n, p).

        Of the residuals of another calibration, one that knows of the memory would explain a part.
        """
        n, follows = len(self.before), np.flatnonzero(self.before >= 0)
        own = np.ones(n)
        if self.sequences.n_stationary:
            own[self.before < 0] = np.sqrt(1.0 - self.coefficient**2)
        entries = np.r_[own, np.full(len(follows), -self.coefficient)]
        places = np.r_[np.arange(n), follows], np.r_[np.arange(n), self.before[follows]]
        noise_filter = csr_array((entries, places), shape=(n, n))
        calibration = csc_array(noise_filter @ basis)
        solve = splu(csc_array(calibration.T @ calibration)).solve

        def whiten(columns: Array) -> Array:
            filtered = noise_filter @ columns
            return np.asarray(filtered - calibration @ solve(calibration.T @ filtered))

        return whiten

    def correlate(self, columns: Array) -> Array:
        """Columns whose products are those of (n, q) under stationary memory's correlations, (n, q)."""
        summed = columns.copy()
        for row in np.flatnonzero(self.before >= 0)[::-1]:
            summed[self.before[row]] += self.coefficient * summed[row]
        rest = np.where(self.before >= 0, np.sqrt(1.0 - self.coefficient**2), 1.0)
        return np.asarray(summed * rest[:, None])


def log_memory_evidence(ar1s: Sequence[AR1], residuals: Array, df: int) -> list[Array]:
    """The evidence of each, shape (k,), in residuals, shape (n, k)."""
    sums = sum_lags((one.sequences for one in ar1s), residuals)
    known = [one.without_refit(sums[id(one.sequences)], df) for one in ar1s]
    together: dict[int, list[AR1]] = {}
    for one, (_, _, counts) in zip(ar1s, known, strict=True):
        if counts.any():
            together.setdefault(id(one.sequences), []).append(one)
    for own in together.values():
        own[0].sequences.refit(one.coefficient for one in own)
    return [one.log_evidence(sums[id(one.sequences)], df, *own) for one, own in zip(ar1s, known, strict=True)]


def memory_alternatives(linearized: LinearizedFit) -> Iterator[AR1]:
    """Memory from traverse to traverse and of each joint, then onto traverses in one direction only."""
    rows, sign = linearized.rows, linearized.direction_sign
    session, joint = pd.factorize(rows["session"].astype(object))[0], rows["joint"].to_numpy()
    chains = ("", session), (" of each joint", 10 * session + joint)
    for column, (name, group) in zip(DEPARTURES, chains, strict=True):
        before = previous_rows(group.astype(np.int64)).astype(np.intp)
        both = Sequences.of(before, linearized.basis)
        term = CarryOverTerm((("x", column, 0.0, 1.0),))
        yield from (AR1(f"unknown:memory{name}", both, carried, term) for carried in AR1_COEFFICIENTS)
        for direction, own in (("+", sign > 0), ("-", sign < 0)):
            # Of each direction's noise its own estimate is known, so that the variances need not agree.
            one_way = Sequences(before, both.calibration, own)
            label = f"unknown:memory-by-direction{name}, {direction} only"
            on = tuple((int(number), direction) for number in np.unique(joint))
            onto = replace(term, on=on)
            yield from (AR1(label, one_way, carried, onto) for carried in LAG_COEFFICIENTS)
