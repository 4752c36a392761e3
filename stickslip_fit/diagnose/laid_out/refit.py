"""A law with causes in it, fitted anew: each block's own parameters and those of the causes together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.laid_out.study import Part
from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.shared import share_with_all, shared_covariance, solve_block_arrow

Array = npt.NDArray[np.float64]

OFFSET_TOL = 3e-3  # standard errors before the last step
MAX_STEPS = 100


@dataclass(frozen=True, eq=False)
class Refit:
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

    parts: tuple[Part, ...]
    values: Array
    covariance: Array
    residual: Array
    converged: bool


def refit(
    rows: pd.DataFrame,
    parts: Sequence[Part],
    responses: Array,
    scale: Array,
    causes: Sequence[Any],
    start: Array,
) -> Refit:
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
    extended = [_extended(part.law, causes) for part in parts]
    widest, shared = max(part.values.shape[1] for part in parts), len(start)
    blocks = _blocks(rows, parts)
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
        Part(law, part.rows, part.block, _columns(found.values[blocks.of_row[part.rows]], part, widest))
        for law, part in zip(extended, parts, strict=True)
    )
    covariance = shared_covariance(found, sharing, scales)
    return Refit(taken, found.values[0, widest:], covariance, found.residual, bool(found.converged.all()))


def _extended(law: Any, causes: Sequence[Any]) -> Any:
    for cause in causes:
        law = cause.extend(law)
    return law


def _blocks(rows: pd.DataFrame, parts: Sequence[Part]) -> Groups:
    keys = np.empty((len(rows), 2), dtype=np.intp)
    for number, part in enumerate(parts):
        keys[part.rows] = np.column_stack([np.full(len(part.rows), number), part.block])
    kinds, of_row = np.unique(keys, axis=0, return_inverse=True)
    return Groups(pd.DataFrame(kinds), of_row.ravel())


def _columns(values: Array, part: Part, widest: int) -> Array:
    return np.concatenate([values[:, : part.values.shape[1]], values[:, widest:]], axis=1)
