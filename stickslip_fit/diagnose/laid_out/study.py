"""A log under a law, linearised: residuals and effects in units of their noise, recalibration taken out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array, hstack

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Directions of a block's parameters that its rows show less than this share of the others are not known.
SEEN = 1e-6


@dataclass(frozen=True, eq=False)
class Part:
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
    rows: Indices
    block: Indices
    values: Array


@dataclass(frozen=True, eq=False)
class Study:
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
    parts: tuple[Part, ...]
    scale: Array
    residual: Array
    basis: csr_array
    blocks: tuple[tuple[Indices, Array], ...]

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
    def freedom(self) -> int:
        """Rows less the parameters that recalibration fits."""
        return len(self) - self.basis.shape[1]

    @property
    def leverage(self) -> Array:
        """Share of each row that recalibration takes up, shape (n,)."""
        return np.asarray((self.basis**2).sum(axis=1)).ravel()

    def project(self, columns: Array) -> Array:
        """Take out of each column what recalibration would absorb, shape (n,) or (n, m)."""
        return columns - self.basis @ (self._across @ columns)

    @cached_property
    def together(self) -> Array:
        """The columns of `basis` that all blocks share, shape (n, k)."""
        return self.basis[:, sum(columns.shape[1] for _, columns in self.blocks) :].toarray()

    @cached_property
    def _across(self) -> csr_array:
        return csr_array(self.basis.T)


def study_of(
    rows: pd.DataFrame,
    parts: Sequence[Part],
    responses: Array,
    scale: Array,
    *,
    shared: int = 0,
    absorbed: Array | None = None,
) -> Study:
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
            (part.rows[mine], _orthonormal(weighed[mine, : slopes.shape[1] - shared]))
            for mine in places_of(part.block)
        ]
    basis = _side_by_side(n, blocks)
    further = together if absorbed is None else np.concatenate([together, absorbed], axis=1)
    if further.shape[1]:
        border = _orthonormal(further - basis @ (basis.T @ further))
        basis = csr_array(hstack([basis, csr_array(border)]))
    study = Study(rows, tuple(parts), scale, residual, basis, tuple(blocks))
    return replace(study, residual=study.project(residual))


def places_of(kinds: npt.NDArray[np.integer[Any]]) -> list[Indices]:
    """Where each kind stands, kinds in ascending order."""
    order = np.argsort(kinds, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(kinds[order])) + 1) if len(order) else []


def _side_by_side(n: int, blocks: Sequence[tuple[Indices, Array]]) -> csr_array:
    width, places, columns, numbers = 0, [], [], []
    for mine, q in blocks:
        places.append(np.repeat(mine, q.shape[1]))
        columns.append(np.tile(np.arange(width, width + q.shape[1]), len(mine)))
        numbers.append(q.ravel())
        width += q.shape[1]
    where = (np.concatenate(places), np.concatenate(columns))
    return csr_array((np.concatenate(numbers), where), shape=(n, width))


def _orthonormal(columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    left, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    return left[:, singular > SEEN * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)]
