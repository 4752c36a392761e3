"""LinearizedFit: whitened residuals and candidate effects, calibration parameters projected out.

Laws are linearized at their fitted values. Residuals and effects are divided by the standard deviation
of the noise, freed from its autocorrelation where it has any (`autocorrelation`), and projected onto the
orthogonal complement of the Jacobian of the nuisance parameters: each law's own parameters by session and
direction, then those that all rows share. `fit_extended` refits laws together with causes by nonlinear least
squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csc_array, csr_array, hstack
from scipy.sparse.linalg import splu

from stickslip_fit._linalg import svd
from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.row_table import RowSubset, RowTable
from stickslip_fit.estimation._block_arrow import share_with_all, shared_covariance, solve_block_arrow
from stickslip_fit.estimation._groups import Groups

RowChanges = tuple[IntArray, Array]
RANK_TOL = 1e-6  # singular values of a block's Jacobian, relative to the largest
MAX_LEVERAGE = 0.8  # for division by 1 - leverage: residuals of rows above it are mostly rounding
EXACT_TOL = 1e-3  # standard deviations, less than which is rounding
MIN_EFFECT = 1e-3  # standard deviations of the noise, of a direction of parameters that the rows see
OFFSET_TOL = 3e-3  # standard errors before the last step
# Of a fit. Causes that cannot do what the data ask for creep to the end of the law's domain.
MAX_STEPS, LEAST_FALL = 100, 0.01


@dataclass(frozen=True, eq=False)
class LawBlock:
    """Rows that one law describes, at its fitted values.

    Attributes
    ----------
    law : object
        With `model`, `predict` and `jacobian` as of a `StepLaw`.
    rows : array of int, shape (m,)
        Positions among all rows.
    block : array of int, shape (m,)
        Which set of own parameters each row uses.
    values : array, shape (m, p)
        Each row's own parameters, then those that all rows of all parts share.
    lower, upper : array, shape (p,), or float
        Bounds of the law's parameters in a fit.
    """

    law: Any
    rows: IntArray
    block: IntArray
    values: Array
    lower: Array | float = -np.inf
    upper: Array | float = np.inf


@dataclass(frozen=True, eq=False)
class LinearizedFit:
    """Residuals and nuisance Jacobian of a fit, whitened; n rows.

    Attributes
    ----------
    scale : array, shape (n,)
        Standard deviation of each response.
    residual : array, shape (n,)
        In units of `scale`, orthogonal to `basis`.
    basis : sparse array, shape (n, number of parameters)
        Orthonormal basis of the nuisance Jacobian: block by block, then what all blocks share.
    blocks : tuple of (array of int, shape (m,), array, shape (m, p))
        Rows of each block and its columns of `basis` there.
    noise_filter : sparse array, shape (n, n), or None
        Prediction-error filter of autocorrelated noise; None for independent noise.
    common : array, shape (n, k), or None
        Whitened slopes by what all blocks share, of which the last columns of `basis` are a basis.
    n_before : int
        Number of columns of `basis` before those.
    """

    table: RowTable
    parts: tuple[LawBlock, ...]
    scale: Array
    residual: Array
    basis: csr_array
    blocks: tuple[tuple[IntArray, Array], ...]
    noise_filter: csr_array | None = None
    common: Array | None = None
    n_before: int = 0

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def rows(self) -> pd.DataFrame:
        """The n rows."""
        return self.table.frame

    @property
    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns of the rows, as arrays."""
        return self.table.columns

    @cached_property
    def tables(self) -> tuple[RowSubset, ...]:
        """As `columns`, for each part's rows."""
        return tuple(self.table.subset(part.rows) for part in self.parts)

    @property
    def df(self) -> int:
        """Rows less calibration parameters."""
        return len(self) - self.basis.shape[1]

    @property
    def fits_exactly(self) -> bool:
        """Whether the laws leave next to nothing of their noise."""
        return len(self) > 0 and float(np.abs(self.residual).max()) < EXACT_TOL

    @cached_property
    def leverage(self) -> Array:
        """Leverage of each row on the calibration parameters, shape (n,)."""
        return np.asarray((self.basis**2).sum(axis=1)).ravel()

    def whiten(self, changes: Array) -> Array:
        """Changes of the responses in units of independent noise of variance 1, shape (n,) or (n, m)."""
        return whiten(changes, self.scale, self.noise_filter)

    def project(self, columns: Array) -> Array:
        """Project columns onto the orthogonal complement of `basis`, shape (n,) or (n, m)."""
        left = self.project_own(columns)
        if not self.shared_basis.shape[1]:
            return left
        # Its columns have entries in all rows: a dense product takes a third of the time.
        return left - self.shared_basis @ (self.shared_basis.T @ columns)

    def absorb(self, effects: Array) -> LinearizedFit:
        """The same with further effects, whitened, shape (n, m), projected out as what all blocks share."""
        assert self.common is not None
        common = np.concatenate([self.common, effects], axis=1)
        if not common.shape[1]:
            return self
        before = self.basis[:, : self.n_before]
        border = _orthonormalize(common - before @ (before.T @ common))
        absorbed = replace(self, basis=csr_array(hstack([before, csr_array(border)])), common=common)
        return replace(absorbed, residual=absorbed.project(self.residual))

    def project_own(self, columns: Array) -> Array:
        """As `project`, but for the columns of `basis` that all blocks share, shape (n, m)."""
        own, transposed = self._own_basis
        return columns - own @ (transposed @ columns)

    def unwhiten(self, columns: Array) -> Array:
        """Changes of the responses from whitened ones: the inverse of `whiten`."""
        scale = self.scale if columns.ndim == 1 else self.scale[:, None]
        return self.recolour(columns) * scale

    def recolour(self, columns: Array) -> Array:
        """Whitened columns in units of each row's noise, autocorrelated again; shape (n,) or (n, m)."""
        return columns if self._solved_filter is None else np.asarray(self._solved_filter.solve(columns))

    @cached_property
    def _solved_filter(self) -> Any:
        return None if self.noise_filter is None else splu(csc_array(self.noise_filter))

    def __getstate__(self) -> dict[str, Any]:
        # A factorization cannot be sent to another process, which makes its own.
        return {name: value for name, value in self.__dict__.items() if name != "_solved_filter"}

    @cached_property
    def _own_basis(self) -> tuple[csr_array, csr_array]:
        own = self.basis[:, : sum(columns.shape[1] for _, columns in self.blocks)]
        return own, csr_array(own.T)

    @cached_property
    def shared_basis(self) -> Array:
        """The columns of `basis` that all blocks share, shape (n, k)."""
        return self.basis[:, self._own_basis[0].shape[1] :].toarray()

    @property
    def shared(self) -> Array | None:
        """As `shared_basis`; None where blocks share nothing."""
        return self.shared_basis if self.shared_basis.shape[1] else None

    @cached_property
    def direction_sign(self) -> Array:
        """1 in rows of traverses in positive direction, -1 in the others, shape (n,)."""
        return np.where((self.rows["direction"] == "+").to_numpy(), 1.0, -1.0)

    @cached_property
    def separates_directions(self) -> bool:
        """Whether no block has rows in both directions."""
        return all(np.ptp(self.direction_sign[rows]) == 0 for rows, _ in self.blocks)

    @cached_property
    def allows_opposite(self) -> bool:
        """Whether effects of opposite sign by direction are as large as the same without, once projected."""
        forward = self.direction_sign > 0
        in_both = np.any(self.shared_basis[forward], axis=0) & np.any(self.shared_basis[~forward], axis=0)
        return self.separates_directions and not in_both.any()

    def select_rows(self, kept: IntArray) -> LinearizedFit:
        """The laws fitted anew to some rows of independent noise, in ascending order, linearized here."""
        assert self.noise_filter is None
        place = np.full(len(self), -1)
        place[kept] = np.arange(len(kept))
        blocks = [
            (place[rows][place[rows] >= 0], _orthonormalize(columns[place[rows] >= 0]))
            for rows, columns in self.blocks
        ]
        blocks = [(rows, columns) for rows, columns in blocks if len(rows)]
        basis, shared = _stack_blocks(len(kept), blocks), self.shared_basis[kept]
        border = _orthonormalize(shared - basis @ (basis.T @ shared))
        smaller = replace(
            self,
            table=RowTable(self.rows.iloc[kept].reset_index(drop=True)),
            parts=select_parts(self.parts, place),
            scale=self.scale[kept],
            residual=self.residual[kept],
            basis=csr_array(hstack([basis, csr_array(border)])),
            blocks=tuple(blocks),
            common=border,
            n_before=basis.shape[1],
        )
        return replace(smaller, residual=smaller.project(smaller.residual))


def select_parts(parts: Sequence[LawBlock], place: IntArray) -> tuple[LawBlock, ...]:
    """The laws of some rows, at their new places; `place`, shape (n,), is -1 for the others."""
    selected = []
    for part in parts:
        inside = place[part.rows] >= 0
        rows = place[part.rows][inside]
        selected.append(replace(part, rows=rows, block=part.block[inside], values=part.values[inside]))
    return tuple(selected)


def whiten(changes: Array, scale: Array, noise_filter: csr_array | None) -> Array:
    """Changes over the standard deviation of the noise, its autocorrelation removed; (n,) or (n, m)."""
    scaled = changes / (scale if changes.ndim == 1 else scale[:, None])
    return scaled if noise_filter is None else np.asarray(noise_filter @ scaled)


def select_filter(noise_filter: csr_array | None, rows: IntArray) -> csr_array | None:
    """The filter of some rows, none of whose sequences goes on in other rows."""
    return None if noise_filter is None else csr_array(noise_filter[rows][:, rows])


def linearize_fit(
    table: RowTable,
    parts: Sequence[LawBlock],
    responses: Array,
    scale: Array,
    *,
    shared: int = 0,
    noise_filter: csr_array | None = None,
    prior_sd: Array | None = None,
    at_bound: BoolArray | None = None,
    uncertain: Sequence[RowChanges] = (),
) -> LinearizedFit:
    """Linearize laws about their fitted values.

    Parameters
    ----------
    table : RowTable
        n rows.
    parts : sequence of LawBlock
        Between them every row once.
    responses : array, shape (n,)
    scale : array, shape (n,)
        Standard deviation of each response.
    shared : int, optional
        How many of the parameters, the last ones, all parts share.
    noise_filter : sparse array, shape (n, n), optional
        As of `LinearizedFit`; its sequences do not leave a block.
    prior_sd : array, shape (q,), optional
        Of the last q shared parameters, see `ExtendedFit`: directions about which the data say less than the
        prior are not projected out.
    at_bound : array of bool, shape (q,), optional
        Of the same parameters: those that a bound holds are not projected out.
    uncertain : sequence of (array of int, array of shape (m, k)), optional
        Changes of the responses of some rows that a law's own choice leaves open, to project out; no row is
        in two of them.
    """
    n = len(table)
    residual, common, blocks = np.zeros(n), np.zeros((n, shared)), []
    for part in parts:
        predicted, slopes = part.law.model(table.subset(part.rows))(part.values)
        own_filter = select_filter(noise_filter, part.rows)
        residual[part.rows] = whiten(responses[part.rows] - predicted, scale[part.rows], own_filter)
        whitened, own = whiten(slopes, scale[part.rows], own_filter), slopes.shape[1] - shared
        common[part.rows] = whitened[:, own:]
        blocks += [
            (part.rows[places], _orthonormalize(whitened[places, :own]))
            for places in split_positions(part.block)
        ]
    basis = _stack_blocks(n, blocks)
    for places, changes in uncertain:
        open_changes = np.zeros((n, changes.shape[1]))
        open_changes[places] = whiten(changes, scale[places], select_filter(noise_filter, places))
        # One after the other, so that none of them reaches beyond its own rows.
        basis = csr_array(
            hstack([basis, csr_array(_orthonormalize(open_changes - basis @ (basis.T @ open_changes)))])
        )
    if prior_sd is not None and at_bound is not None:
        kept = np.append(np.ones(shared - len(at_bound), dtype=bool), ~at_bound)
        common, prior_sd = common[:, kept], prior_sd[~at_bound]
    if prior_sd is not None and np.isfinite(prior_sd).any():
        common = _keep_determined(common, basis, prior_sd)
    known = tuple(parts), scale, residual, basis, tuple(blocks), noise_filter, common[:, :0], basis.shape[1]
    linearized = LinearizedFit(table, *known)
    return replace(linearized, residual=linearized.project(residual)).absorb(common)


def _keep_determined(common: Array, basis: csr_array, prior_sd: Array) -> Array:
    """Whitened slopes (n, k), of penalised parameters only in directions that the data determine."""
    penalised = np.flatnonzero(np.isfinite(prior_sd)) + common.shape[1] - len(prior_sd)
    scaled = common[:, penalised] * prior_sd[np.isfinite(prior_sd)]
    projected = scaled - basis @ (basis.T @ scaled)
    free = np.delete(common, penalised, axis=1)
    return np.concatenate([free, scaled @ seen_directions(projected, 1.0)], axis=1)


def cause_jacobian(table: RowTable, parts: Sequence[LawBlock], q: int) -> Array:
    """Derivatives of the responses by the last q parameters of the laws, those of the causes; (n, q)."""
    slopes = np.zeros((len(table), q))
    for part in parts:
        own = part.law.jacobian(table.subset(part.rows), part.values)
        slopes[part.rows] = own[:, own.shape[1] - q :]
    return slopes


def seen_directions(effects: Array, least: float) -> Array:
    """Orthonormal directions of q unit parameters whose effect, by (n, q), is longer than `least`; (q, r)."""
    if len(effects) >= effects.shape[1]:
        squares, axes = np.linalg.eigh(effects.T @ effects)
        return np.asarray(axes[:, squares > least**2])
    squares, left = np.linalg.eigh(effects @ effects.T)
    kept = squares > least**2
    return np.asarray(effects.T @ (left[:, kept] / np.sqrt(squares[kept])))


def split_positions(kinds: npt.NDArray[np.integer[Any]]) -> list[IntArray]:
    """Positions of each kind, kinds in ascending order."""
    order = np.argsort(kinds, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1) if len(order) else []


def _stack_blocks(n: int, blocks: Sequence[tuple[IntArray, Array]]) -> csr_array:
    width, rows, columns, entries = 0, [], [], []
    for places, q in blocks:
        rows.append(np.repeat(places, q.shape[1]))
        columns.append(np.tile(np.arange(width, width + q.shape[1]), len(places)))
        entries.append(q.ravel())
        width += q.shape[1]
    positions = (np.concatenate(rows), np.concatenate(columns))
    return csr_array((np.concatenate(entries), positions), shape=(n, width))


def _orthonormalize(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    left, singular, _ = svd(columns / np.where(length > 0, length, 1.0))
    return left[:, singular > RANK_TOL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)]


@dataclass(frozen=True, eq=False)
class SeenCovariance:
    """Covariance of q parameters of which the data tell r directions, the prior alone all others.

    Kept in place of the (q, q) matrix, which each fold has one of.

    Attributes
    ----------
    units : array, shape (q,)
        Prior standard deviations of the parameters, 1 for those without.
    axes : array, shape (q, r)
        Orthonormal directions of the parameters in these units.
    along : array, shape (r, r)
        Covariance along them.
    """

    units: Array
    axes: Array
    along: Array

    def toarray(self) -> Array:
        """The whole covariance, shape (q, q)."""
        scaled = self.units[:, None] * self.axes
        covariance = scaled @ (self.along - np.eye(len(self.along))) @ scaled.T
        covariance[np.diag_indices_from(covariance)] += self.units**2
        return covariance


@dataclass(frozen=True, eq=False)
class ExtendedFit:
    """Laws and causes fitted together.

    Attributes
    ----------
    parts : tuple of LawBlock
        With the extended laws and their values.
    values : array, shape (q,)
        Of the causes' parameters, one cause after the other.
    errors : array, shape (q, q), or SeenCovariance
        The covariance of `values`.
    residual : array, shape (n,)
        Response less prediction.
    prior_sd : array, shape (q,)
        Standard deviation of each parameter's normal prior about zero; infinite without one.
    at_bound : array of bool, shape (q,)
        Parameters that a bound holds: the fit would be better beyond it.
    """

    parts: tuple[LawBlock, ...]
    values: Array
    errors: Array | SeenCovariance
    residual: Array
    converged: bool
    prior_sd: Array
    at_bound: BoolArray

    @property
    def covariance(self) -> Array:
        """Covariance of `values`, shape (q, q)."""
        return self.errors.toarray() if isinstance(self.errors, SeenCovariance) else self.errors


def fit_extended(
    table: RowTable,
    parts: Sequence[LawBlock],
    responses: Array,
    scale: Array,
    causes: Sequence[Any],
    start: Array,
    *,
    n_shared: int = 0,
    noise_filter: csr_array | None = None,
) -> ExtendedFit:
    """Fit laws and causes together by least squares, with a penalty on parameters that have a prior.

    `parts` are the laws without the causes, at start values, of whose parameters all rows share the last
    `n_shared`; `causes` are bound to the rows, and `start`, shape (q,), are start values of their parameters.
    `noise_filter` is as of `linearize_fit`.
    """
    extended = [reduce(lambda law, cause: cause.extend(law), causes, part.law) for part in parts]
    widest, shared = max(part.values.shape[1] for part in parts) - n_shared, n_shared + len(start)
    columns_of = [np.r_[: part.values.shape[1] - n_shared, widest : widest + shared] for part in parts]
    prior_sd = np.array([parameter.prior_sd for cause in causes for parameter in cause.parameters])
    blocks, n = _group_blocks(len(table), parts), len(table)
    models = [law.model(table.subset(part.rows)) for law, part in zip(extended, parts, strict=True)]

    def model(values: Array) -> tuple[Array, Array]:
        predicted, slopes = np.empty(n), np.zeros((n, widest + shared))
        for part, part_model, columns in zip(parts, models, columns_of, strict=True):
            block = np.ix_(part.rows, columns)
            predicted[part.rows], slopes[block] = part_model(values[block])
        return predicted, slopes

    def whitened_model(values: Array) -> tuple[Array, Array]:
        predicted, slopes = model(values)
        return whiten(predicted, scale, noise_filter), whiten(slopes, scale, noise_filter)

    first, scales, lower, upper = _prepare_start(parts, columns_of, blocks, causes, start)
    last = slice(widest + n_shared, None)
    sharing = share_with_all(np.arange(widest + shared) >= widest, blocks)
    options: Any = {"offset_tol": OFFSET_TOL, "least_fall": LEAST_FALL, "most": MAX_STEPS}
    options["precision"] = np.concatenate([np.zeros(n_shared), 1.0 / prior_sd**2])
    data = (
        (model, responses, 1.0 / scale**2)
        if noise_filter is None
        else (whitened_model, whiten(responses, scale, noise_filter), np.ones(n))
    )
    if not any(hasattr(part.law, "joint") for part in parts):
        slopes = data[0](first[blocks.of_row])[1]
        scales = _equal_lengths(slopes, data[2], blocks, scales, options["precision"])
    options |= {"lower": lower, "upper": upper, "tolerance": 0.0}
    minimum = solve_block_arrow(*data, blocks, sharing, first, scales, **options)
    fitted = tuple(
        replace(part, law=law, values=minimum.values[np.ix_(blocks.of_row[part.rows], columns)])
        for law, part, columns in zip(extended, parts, columns_of, strict=True)
    )
    residual = minimum.residual
    if noise_filter is not None:
        residual = responses - model(minimum.values[blocks.of_row])[0]
    covariance = shared_covariance(minimum, sharing, scales)[n_shared:, n_shared:]
    values, at_bound = minimum.values[0, last], minimum.at_bound[0, last]
    converged = bool(minimum.converged.all())
    return ExtendedFit(fitted, values, covariance, residual, converged, prior_sd, at_bound)


def _prepare_start(
    parts: Sequence[LawBlock],
    columns_of: Sequence[IntArray],
    blocks: Groups,
    causes: Sequence[Any],
    start: Array,
) -> tuple[Array, Array, Array, Array]:
    """Start values and scales of all parameters of g blocks, (g, p), the causes' last, and bounds, (p,).

    `columns_of` are the places of each part's own parameters and of those that all rows share.
    """
    shape = len(blocks), 1 + max(int(columns.max()) for columns in columns_of)
    first, scales = np.zeros(shape), np.ones(shape)
    lower, upper = np.full(shape[1], -np.inf), np.full(shape[1], np.inf)
    for part, columns in zip(parts, columns_of, strict=True):
        block, law_columns = blocks.of_row[part.rows], columns[: part.values.shape[1]]
        first[block[:, None], law_columns] = part.values
        size = np.maximum(np.abs(part.values), np.abs(part.values[:, :1]) * 0.1)
        largest = np.abs(part.values).max(initial=0.0) or 1.0
        scales[block[:, None], law_columns] = np.where(size > 0, size, largest)
        lower[law_columns], upper[law_columns] = part.lower, part.upper
    last = slice(shape[1] - len(start), None)
    first[:, last] = start
    scales[:, last] = [size for cause in causes for size in cause.scale]
    lower[last] = [parameter.lower for cause in causes for parameter in cause.parameters]
    upper[last] = [parameter.upper for cause in causes for parameter in cause.parameters]
    return first, scales, lower, upper


def _equal_lengths(slopes: Array, weight: Array, blocks: Groups, scales: Array, precision: Array) -> Array:
    """Scales with which every column is as long, in each block: the units of a table have nothing in common.

    The `precision` of priors of the last parameters counts in the first block. What the rows say nothing of
    keeps its scale.
    """
    squares = np.stack([blocks.sums(weight * column**2) for column in slopes.T], axis=1)
    squares[0, squares.shape[1] - len(precision) :] += precision
    return np.where(squares > 0, 1.0 / np.sqrt(np.where(squares > 0, squares, 1.0)), scales)


def _group_blocks(n: int, parts: Sequence[LawBlock]) -> Groups:
    keys = np.empty((n, 2), dtype=np.intp)
    for number, part in enumerate(parts):
        keys[part.rows] = np.column_stack([np.full(len(part.rows), number), part.block])
    labels, of_row = unique_rows(keys)
    return Groups(pd.DataFrame(labels), of_row)


def rms(values: Array) -> float:
    """Root of the mean square of numbers."""
    return float(np.sqrt(np.mean(values**2)))
