"""LinearizedFit: whitened residuals and candidate effects, calibration parameters projected out.

Laws are linearized at their fitted values. Residuals and effects are divided by the standard deviation
of the noise and projected onto the orthogonal complement of the Jacobian of the nuisance parameters:
each law's own parameters by session and direction, then those that all rows share. `fit_extended`
refits laws together with causes by nonlinear least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array, hstack

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.estimation._block_arrow import share_with_all, shared_covariance, solve_block_arrow
from stickslip_fit.estimation._optimize import Groups

# Directions of a block's parameters that its rows show less than this share of the others are not known.
RANK_TOL = 1e-6


@dataclass(frozen=True, eq=False)
class LawBlock:
    """Rows that one law describes, at its fitted values.

    Attributes
    ----------
    law : object
        With `model` and `predict`, as of a `StepLaw`.
    rows : array of int, shape (m,)
        Places in the study.
    block : array of int, shape (m,)
        Which set of own parameters each row uses.
    values : array, shape (m, p)
        Each row's own parameters, then those that all rows of all parts share.
    """

    law: Any
    rows: IntArray
    block: IntArray
    values: Array


@dataclass(frozen=True, eq=False)
class LinearizedFit:
    """What a diagnosis looks at; n rows.

    Attributes
    ----------
    rows : DataFrame
    parts : tuple of Part
    scale : array, shape (n,)
        Standard deviation of each response.
    residual : array, shape (n,)
        In units of `scale`, with all that recalibration would absorb taken out.
    basis : sparse array, shape (n, number of parameters)
        Orthonormal columns: what recalibration can do, block by block, then what all blocks do together.
    blocks : tuple of (array of int, shape (m,), array, shape (m, p))
        Rows of each block and its columns of `basis` there.
    """

    rows: pd.DataFrame
    parts: tuple[LawBlock, ...]
    scale: Array
    residual: Array
    basis: csr_array
    blocks: tuple[tuple[IntArray, Array], ...]

    def __len__(self) -> int:
        return len(self.residual)

    @cached_property
    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns of the rows, as arrays: what is asked for again and again."""
        return {str(name): self.rows[name].to_numpy() for name in self.rows}

    @cached_property
    def tables(self) -> tuple[dict[str, npt.NDArray[Any]], ...]:
        """As `columns`, of each part's rows."""
        return tuple(
            {name: values[part.rows] for name, values in self.columns.items()} for part in self.parts
        )

    @property
    def df(self) -> int:
        """Rows less the parameters that recalibration fits."""
        return len(self) - self.basis.shape[1]

    @property
    def leverage(self) -> Array:
        """Share of each row that recalibration takes up, shape (n,)."""
        return np.asarray((self.basis**2).sum(axis=1)).ravel()

    def project(self, columns: Array) -> Array:
        """Take out of each column what recalibration would absorb, shape (n,) or (n, m)."""
        return columns - self.basis @ (self._basis_transposed @ columns)

    @cached_property
    def shared_basis(self) -> Array:
        """The columns of `basis` that all blocks share, shape (n, k)."""
        return self.basis[:, sum(columns.shape[1] for _, columns in self.blocks) :].toarray()

    @cached_property
    def _basis_transposed(self) -> csr_array:
        return csr_array(self.basis.T)


def linearize_fit(
    rows: pd.DataFrame,
    parts: Sequence[LawBlock],
    responses: Array,
    scale: Array,
    *,
    shared: int = 0,
    absorbed: Array | None = None,
) -> LinearizedFit:
    """Linearise laws about their fitted values.

    Parameters
    ----------
    rows : DataFrame
        n rows.
    parts : sequence of Part
        Between them every row once.
    responses : array, shape (n,)
    scale : array, shape (n,)
        Standard deviation of each response.
    shared : int, optional
        How many of the parameters, the last ones, all parts share.
    absorbed : array, shape (n, m), optional
        Further departures, in units of the noise, that count as taken up.
    """
    n = len(rows)
    residual, together, blocks = np.zeros(n), np.zeros((n, shared)), []
    for part in parts:
        predicted, slopes = part.law.model(rows.iloc[part.rows])(part.values)
        residual[part.rows] = (responses[part.rows] - predicted) / scale[part.rows]
        weighed = slopes / scale[part.rows, None]
        together[part.rows] = weighed[:, slopes.shape[1] - shared :]
        blocks += [
            (part.rows[subset], _orthonormalize(weighed[subset, : slopes.shape[1] - shared]))
            for subset in split_positions(part.block)
        ]
    basis = _stack_blocks(n, blocks)
    further = together if absorbed is None else np.concatenate([together, absorbed], axis=1)
    if further.shape[1]:
        border = _orthonormalize(further - basis @ (basis.T @ further))
        basis = csr_array(hstack([basis, csr_array(border)]))
    linearized = LinearizedFit(rows, tuple(parts), scale, residual, basis, tuple(blocks))
    return replace(linearized, residual=linearized.project(residual))


def split_positions(kinds: npt.NDArray[np.integer[Any]]) -> list[IntArray]:
    """Where each kind stands, kinds in ascending order."""
    order = np.argsort(kinds, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1) if len(order) else []


def _stack_blocks(n: int, blocks: Sequence[tuple[IntArray, Array]]) -> csr_array:
    width, places, columns, numbers = 0, [], [], []
    for subset, q in blocks:
        places.append(np.repeat(subset, q.shape[1]))
        columns.append(np.tile(np.arange(width, width + q.shape[1]), len(subset)))
        numbers.append(q.ravel())
        width += q.shape[1]
    where = (np.concatenate(places), np.concatenate(columns))
    return csr_array((np.concatenate(numbers), where), shape=(n, width))


def _orthonormalize(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    return left[:, singular > RANK_TOL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)]


OFFSET_TOL = 3e-3  # standard errors before the last step
MAX_STEPS = 100


@dataclass(frozen=True, eq=False)
class ExtendedFit:
    """Laws and causes fitted together.

    Attributes
    ----------
    parts : tuple of Part
        With the extended laws and their values.
    values : array, shape (q,)
        Of the causes' parameters, one after the other.
    covariance : array, shape (q, q)
    residual : array, shape (n,)
        Response less prediction.
    converged : bool
    """

    parts: tuple[LawBlock, ...]
    values: Array
    covariance: Array
    residual: Array
    converged: bool


def fit_extended(
    rows: pd.DataFrame,
    parts: Sequence[LawBlock],
    responses: Array,
    scale: Array,
    causes: Sequence[Any],
    start: Array,
) -> ExtendedFit:
    """Fit published laws and causes by least squares.

    Parameters
    ----------
    rows : DataFrame
        n rows.
    parts : sequence of Part
        Laws without the causes, at values to begin with.
    responses, scale : array, shape (n,)
    causes : sequence of object
        Bound to the rows.
    start : array, shape (q,)
        Of their parameters.
    """
    extended = [_extend_law(part.law, causes) for part in parts]
    widest, shared = max(part.values.shape[1] for part in parts), len(start)
    blocks = _group_blocks(rows, parts)
    models = [law.model(rows.iloc[part.rows]) for law, part in zip(extended, parts, strict=True)]

    def model(values: Array) -> tuple[Array, Array]:
        predicted, slopes = np.empty(len(rows)), np.zeros((len(rows), widest + shared))
        for part, one in zip(parts, models, strict=True):
            own = part.values.shape[1]
            columns = np.r_[np.arange(own), widest + np.arange(shared)]
            predicted[part.rows], found = one(values[np.ix_(part.rows, columns)])
            slopes[np.ix_(part.rows, columns)] = found
        return predicted, slopes

    first, scales = np.zeros((len(blocks), widest + shared)), np.ones((len(blocks), widest + shared))
    for part in parts:
        of_block = blocks.of_row[part.rows]
        own = part.values.shape[1]
        first[of_block, :own] = part.values
        scales[of_block, :own] = np.maximum(np.abs(part.values), np.abs(part.values[:, :1]) * 0.1)
    first[:, widest:] = start
    scales[:, widest:] = [size for cause in causes for size in cause.scale]
    bounds = [(-np.inf, np.inf)] * widest
    bounds += [(each.lower, each.upper) for cause in causes for each in cause.parameters]
    lower, upper = np.array(bounds).T
    sharing = share_with_all(np.arange(widest + shared) >= widest, blocks)
    found = solve_block_arrow(
        model, responses, 1.0 / scale**2, blocks, sharing, first, scales,
        lower=lower, upper=upper, tolerance=0.0, offset_tol=OFFSET_TOL, most=MAX_STEPS,
    )  # fmt: skip
    taken = tuple(
        LawBlock(
            law, part.rows, part.block, _select_columns(found.values[blocks.of_row[part.rows]], part, widest)
        )
        for law, part in zip(extended, parts, strict=True)
    )
    covariance = shared_covariance(found, sharing, scales)
    return ExtendedFit(
        taken, found.values[0, widest:], covariance, found.residual, bool(found.converged.all())
    )


def _extend_law(law: Any, causes: Sequence[Any]) -> Any:
    for cause in causes:
        law = cause.extend(law)
    return law


def _group_blocks(rows: pd.DataFrame, parts: Sequence[LawBlock]) -> Groups:
    keys = np.empty((len(rows), 2), dtype=np.intp)
    for number, part in enumerate(parts):
        keys[part.rows] = np.column_stack([np.full(len(part.rows), number), part.block])
    kinds, of_row = np.unique(keys, axis=0, return_inverse=True)
    return Groups(pd.DataFrame(kinds), of_row.ravel())


def _select_columns(values: Array, part: LawBlock, widest: int) -> Array:
    return np.concatenate([values[:, : part.values.shape[1]], values[:, widest:]], axis=1)
