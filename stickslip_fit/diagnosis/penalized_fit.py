"""Laws fitted together with smooth functions that have more coefficients than the log has rows.

To first order n rows see at most n directions of a function's coefficients, those of its slopes; along all
others the penalty alone decides, and leaves them at zero. The fit is therefore for the coefficients of these
directions, and found anew about its own minimum until the directions stay (the representer theorem, G.
Kimeldorf and G. Wahba, J. Math. Anal. Appl. 33:82, 1971, applied step by step as in Gauss-Newton).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array

from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.base import extend
from stickslip_fit.causes.parameters import CauseParameter, Row
from stickslip_fit.causes.smooth import LinearFactor
from stickslip_fit.diagnosis.linearized import (
    MIN_EFFECT,
    ExtendedFit,
    LawBlock,
    SeenCovariance,
    cause_jacobian,
    fit_extended,
    seen_directions,
    split_positions,
    whiten,
)
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.laws import State, StepLaw

MIN_COEFFICIENTS = 40  # of a function, with fewer of which all are fitted
MAX_ROUNDS = 6
MAX_OUTSIDE = 1e-2  # prior standard deviations by which coefficients may lie outside the directions


@dataclass(frozen=True, eq=False)
class PartialFactor(LinearFactor):
    """A factor with smooth functions, along some directions of its coefficients.

    Attributes
    ----------
    whole : LinearFactor
        With q coefficients.
    directions : array, shape (q, r)
        Coefficients of `whole` for each unit parameter, whose prior standard deviation is 1.
    """

    whole: LinearFactor
    directions: Array

    name = "partial-factor"

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return tuple(
            CauseParameter(f"d{number}", "1", "", prior_sd=1.0) for number in range(self.directions.shape[1])
        )

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (1.0,) * self.directions.shape[1]

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.whole.columns

    @property
    def varies_along_traverse(self) -> bool:  # type: ignore[override]
        return self.whole.varies_along_traverse

    def acts_on(self, law: StepLaw) -> bool:
        return self.whole.acts_on(law)

    def panel(self, values: Array, joint: int) -> float:
        # Functions are as smooth whatever their coefficients.
        return self.whole.panel(np.zeros((1, len(self.directions))), joint)

    def row_values(self, law: StepLaw, rows: Row) -> dict[str, Any]:
        return self.whole.row_values(law, rows)

    def functions(self, state: State) -> Array:
        return self.whole.functions(state)

    def acts(self, state: State) -> Array:
        return self.whole.acts(state)

    def mix(self, state: State, values: Array) -> Array:
        mixed = np.empty((len(values), self._functions_in(state)[0].shape[2]))
        for places, matrix in self._matrices(state):
            mixed[places] = values[places] @ matrix.T
        return mixed

    def spread(self, state: State, slopes: Array) -> Array:
        spread = np.empty((*slopes.shape[:2], self.directions.shape[1]))
        for places, matrix in self._matrices(state):
            spread[places] = slopes[places] @ matrix
        return spread

    def _matrices(self, state: State) -> Iterator[tuple[IntArray, Array]]:
        """Traverses on which the same functions act, and these functions' coefficients by all, (m, r)."""
        functions, acts = self._functions_in(state)
        ways, of_row = unique_rows(acts)
        for way, places in zip(ways, split_positions(of_row), strict=True):
            if (key := way.tobytes()) not in self._known:
                directions = self.directions.reshape(len(way), functions.shape[2], -1)
                acting = np.flatnonzero(way)  # few of the functions of many sessions
                self._known[key] = np.tensordot(way[acting], directions[acting], 1)
            yield places, self._known[key]

    @cached_property
    def _known(self) -> dict[bytes, Array]:
        """Matrices by the way that they are for: a fit asks for them again and again."""
        return {}

    def sum_of(self, functions: Array, coefficients: Array) -> Array:
        return self.whole.sum_of(functions, coefficients)

    def slopes_of(self, functions: Array, coefficients: Array) -> Array:
        return self.whole.slopes_of(functions, coefficients)

    def of_sum(self, total: Array) -> tuple[Array, Array | float]:
        return self.whole.of_sum(total)


def fit_penalized(
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
    """As `fit_extended`; smooth functions of many coefficients along the directions that the rows see."""
    options: Any = {"n_shared": n_shared, "noise_filter": noise_filter}
    if not any(map(_has_many, causes)):
        return fit_extended(table, parts, responses, scale, causes, start, **options)
    values, before = start, parts
    for _ in range(MAX_ROUNDS):
        with np.errstate(all="ignore"):
            slopes = cause_jacobian(table, _extend(before, causes, values), len(values))
        if not np.isfinite(slopes).all():
            return fit_extended(table, parts, responses, scale, causes, start, **options)
        seen = _find_directions(causes, whiten(slopes, scale, noise_filter))
        first = seen.project(values)
        if before is not parts and np.linalg.norm((values - seen.expand(first)) / seen.units) < MAX_OUTSIDE:
            break
        fit = fit_extended(table, before, responses, scale, seen.causes, first, **options)
        values, found = seen.expand(fit.values), seen
        before = [
            replace(part, values=fitted.values[:, : part.values.shape[1]])
            for part, fitted in zip(parts, fit.parts, strict=True)
        ]
    return found.complete(fit, values, causes, before)


@dataclass(frozen=True, eq=False)
class _Directions:
    """Causes of q parameters in all, along r directions of these.

    Attributes
    ----------
    causes : tuple of Cause
        With r parameters in all.
    axes : array, shape (q, r)
        Orthonormal, of the parameters in their units.
    units : array, shape (q,)
        Prior standard deviations of the parameters of which not every direction is here, 1 for others.
    """

    causes: tuple[Any, ...]
    axes: Array
    units: Array

    def project(self, values: Array) -> Array:
        """Parameters along the directions, (q,) -> (r,)."""
        return self.axes.T @ (values / self.units)

    def expand(self, values: Array) -> Array:
        """All parameters, (r,) -> (q,)."""
        return self.units * (self.axes @ values)

    def complete(
        self, fit: ExtendedFit, values: Array, causes: Sequence[Any], parts: Sequence[LawBlock]
    ) -> ExtendedFit:
        """The fit as one of all parameters: what the rows do not see is as the prior has it."""
        return ExtendedFit(
            _extend(parts, causes, values),
            values,
            SeenCovariance(self.units, self.axes, fit.covariance),
            fit.residual,
            fit.converged,
            np.array([parameter.prior_sd for cause in causes for parameter in cause.parameters]),
            (np.abs(self.axes) > 0) @ fit.at_bound > 0,
        )


def _has_many(cause: Any) -> bool:
    """Whether a cause is fitted along some directions of its coefficients."""
    many = isinstance(cause, LinearFactor) and len(cause.parameters) >= MIN_COEFFICIENTS
    return (
        many
        and cause.acts_at == "factor"
        and all(np.isfinite(parameter.prior_sd) for parameter in cause.parameters)
    )


def _extend(parts: Sequence[LawBlock], causes: Sequence[Any], values: Array) -> tuple[LawBlock, ...]:
    """Laws with causes in them, whose parameters are `values`, shape (q,)."""
    return tuple(
        replace(
            part,
            law=extend(part.law, *causes),
            values=np.column_stack([part.values, np.tile(values, (len(part.values), 1))]),
        )
        for part in parts
    )


def _find_directions(causes: Sequence[Any], slopes: Array) -> _Directions:
    """The directions of smooth functions' coefficients that whitened slopes, shape (n, q), see."""
    fewer, axes, units, first = [], [], [], 0
    for cause in causes:
        own = slopes[:, first : first + len(cause.parameters)]
        first += len(cause.parameters)
        if not _has_many(cause):
            fewer.append(cause)
            axes.append(np.eye(own.shape[1]))
            units.append(np.ones(own.shape[1]))
            continue
        units.append(np.array([parameter.prior_sd for parameter in cause.parameters]))
        effects = own * units[-1]
        axes.append(seen_directions(effects[np.any(effects, axis=1)], MIN_EFFECT))
        fewer.append(PartialFactor(cause, units[-1][:, None] * axes[-1]))
    return _Directions(tuple(fewer), block_diag(*axes), np.concatenate(units))
