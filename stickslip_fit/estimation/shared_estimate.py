"""Covariances of many groups' parameters, of which the last are the same for all: kept by their parts.

Of thousands of coefficients of smooth functions the covariance of each group would fill the memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from stickslip_fit._typing import Array, BoolArray, IntArray

NEGATIVE_TOL = 1e-6  # of a correlation matrix's eigenvalues, relative to its size


@dataclass(frozen=True, eq=False)
class SharedCovariance:
    """Covariances of g groups' parameters, the last q of which all share; stands for an array (g, p, p).

    Attributes
    ----------
    own : array, shape (g, p - q, p - q)
    across : array, shape (g, p - q, q)
    shared : array, shape (q, q)
    unknown : array of bool, shape (g,)
        Groups without error bars.
    """

    own: Array
    across: Array
    shared: Array
    unknown: BoolArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """That of the array."""
        p = self.own.shape[1] + len(self.shared)
        return len(self.own), p, p

    def __len__(self) -> int:
        return len(self.own)

    def __iter__(self) -> Iterator[Array]:
        return (self[group] for group in range(len(self)))

    def __getitem__(self, place: Any) -> Any:
        """A group's covariance, (p, p); any other part of the array after all of it was made."""
        if not isinstance(place, int | np.integer):
            return np.asarray(self)[place]
        if self.unknown[place]:
            return np.full(self.shape[1:], np.nan)
        return np.block([[self.own[place], self.across[place]], [self.across[place].T, self.shared]])

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> Array:
        return np.stack([*self])

    @property
    def variances(self) -> Array:
        """Of each parameter, shape (g, p)."""
        own = np.diagonal(self.own, axis1=1, axis2=2)
        variances = np.concatenate([own, np.tile(np.diag(self.shared), (len(self), 1))], axis=1)
        variances[self.unknown] = np.nan
        return variances

    @property
    def columns(self) -> Array:
        """Covariances of all parameters with the own ones, shape (g, p, p - q)."""
        columns = np.concatenate([self.own, self.across.swapaxes(1, 2)], axis=1)
        columns[self.unknown] = np.nan
        return columns

    def select(self, groups: slice, own: IntArray) -> SharedCovariance:
        """Of some groups and some of the own parameters."""
        block = self.own[groups][:, own[:, None], own]
        return SharedCovariance(block, self.across[groups][:, own], self.shared, self.unknown[groups])

    def with_shared(self, places: IntArray, variance: Array) -> SharedCovariance:
        """With other variances of some shared parameters, which are independent of all others."""
        across, shared = self.across.copy(), self.shared.copy()
        across[:, :, places] = 0.0
        shared[places] = shared[:, places] = 0.0
        shared[places, places] = variance
        return replace(self, across=across, shared=shared)

    def is_covariance(self) -> bool:
        """Whether own parameters, given the shared ones, have covariances; `shared` is one."""
        known = ~self.unknown
        scale = np.sqrt(np.maximum(np.diag(self.shared), np.finfo(float).tiny))
        correlation = self.shared / scale / scale[:, None]
        correlation[np.diag_indices_from(correlation)] += NEGATIVE_TOL
        sd = np.sqrt(np.maximum(np.diagonal(self.own, axis1=1, axis2=2)[known], np.finfo(float).tiny))
        own = self.own[known] / sd[:, :, None] / sd[:, None, :]
        along = (self.across[known] / sd[:, :, None] / scale).reshape(-1, len(scale))
        try:
            root = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError:
            return False
        explained = solve_triangular(root, along.T, lower=True).T.reshape(*own.shape[:2], -1)
        left = own - explained @ explained.swapaxes(1, 2)
        even = np.abs(own - own.swapaxes(1, 2)).max(initial=0.0) <= NEGATIVE_TOL
        return bool(even and np.linalg.eigvalsh(left).min(initial=0.0) >= -NEGATIVE_TOL * self.shape[1])


Covariances = Array | SharedCovariance
"""Of g groups' parameters, shape (g, p, p)."""


def find_variances(covariance: Covariances) -> Array:
    """Of each parameter of each group, shape (g, p)."""
    if isinstance(covariance, SharedCovariance):
        return covariance.variances
    return np.diagonal(covariance, axis1=1, axis2=2)
