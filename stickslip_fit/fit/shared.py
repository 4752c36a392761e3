"""Least squares where some parameters are one for many groups: a block-arrow system, solved by its blocks.

Each group's own parameters are a block of the system, the shared ones its border. For given shared values
every block is minimised by itself; the shared slopes, with what a block's own parameters can follow taken
out of them, then drive the border (variable projection: G. H. Golub and V. Pereyra, SIAM J. Numer. Anal.
10:413, 1973, as simplified by L. Kaufman, BIT 15:49, 1975). Time and memory grow linearly with the groups.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.identifiability import known_parameters
from stickslip_fit.fit.levenberg_marquardt import SMALLEST, Minimum, Part, minimise
from stickslip_fit.laws.law import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]

# The cost carries the rounding of every block's own search, and so cannot tell much smaller offsets apart.
REST = 1e-5


@dataclass(frozen=True)
class Sharing:
    """Which parameters are shared, and by which groups.

    Attributes
    ----------
    parameters : array of bool, shape (p,)
    sets : Groups
        Groups that use the same shared values: its `of_row` gives the set, of h, of each group.
    """

    parameters: Mask
    sets: Groups

    def mean(self, values: Array) -> Array:
        """Mean of the shared columns over the groups of each set, shape (g, p) -> (h, q)."""
        columns = [self.sets.sums(column) for column in values[:, self.parameters].T]
        return np.stack(columns, axis=-1) / self.sets.sizes[:, None]

    def merged[T: np.generic](self, own: npt.NDArray[T], shared: npt.NDArray[T]) -> npt.NDArray[T]:
        """Own and shared columns in the parameters' order, shapes (m, p - q) and (m, q) -> (m, p)."""
        both = np.empty((len(own), len(self.parameters)), dtype=own.dtype)
        both[:, ~self.parameters], both[:, self.parameters] = own, shared
        return both


def share_by_direction(names: tuple[str, ...], shared: tuple[str, ...], groups: Groups) -> Sharing:
    """Parameters that have one value in each direction, whatever the session."""
    set_of_group, directions = pd.factorize(groups.table["direction"])
    sets = Groups(pd.DataFrame({"direction": directions}), set_of_group)
    return Sharing(np.array([name in shared for name in names]), sets)


def minimise_shared(
    model: Model,
    y: Array,
    weight: Array,
    groups: Groups,
    sharing: Sharing,
    start: Array,
    scales: Array,
    *,
    part: Part | None = None,
    lower: Array,
    upper: Array,
    tolerance: float = 1e-8,
    most: int = 2000,
) -> Minimum:
    """Minimise the sum of weight (y - model)^2 over each group's own and the shared parameters.

    Parameters
    ----------
    model : callable
        Values of each row's group, shape (n, p), to responses and derivatives; see `StepLaw.model`.
    y, weight : array, shape (n,)
    groups : Groups
    sharing : Sharing
    start, scales : array, shape (g, p)
        Shared parameters begin at the mean over their groups.
    part : callable, optional
        See `minimise`.
    lower, upper : array, shape (g, p)
    tolerance, most : float, int, optional
        See `minimise`.

    Returns
    -------
    Minimum
        As of `minimise`; shared values stand in each of their groups, `curvature` is that of
        `shared_curvature`, and the rank of the shared ones is dealt out over the groups of a set.
    """
    common, own = sharing.parameters, ~sharing.parameters
    set_of_row = sharing.sets.of_row[groups.of_row]
    border = Groups(sharing.sets.table, set_of_row)

    latest = start[:, own]

    def blocks(shared: Array) -> Minimum:
        """Every block at its best for the shared values of each row, shape (n, q)."""
        nonlocal latest

        def alone(model: Model, shared: Array) -> Model:
            def own_values(values: Array) -> tuple[Array, Array]:
                predicted, slopes = model(sharing.merged(values, shared))
                return predicted, slopes[:, own]

            return own_values

        found = minimise(
            alone(model, shared), y, weight, groups, latest, scales[:, own],
            part=None if part is None else lambda some: alone(part(some), shared[some]),
            lower=lower[:, own], upper=upper[:, own], damping=0.0, tolerance=tolerance, most=most,
        )  # fmt: skip
        # The best for other shared values is not far from here.
        latest = np.where(found.converged[:, None], found.values, latest)
        return found

    def profiled(shared: Array) -> tuple[Array, Array]:
        found = blocks(shared)
        predicted, slopes = model(sharing.merged(found.values[groups.of_row], shared))
        slopes[:, own] *= ~found.at_bound[groups.of_row]
        _, follow = _eliminate(_products(slopes, weight, groups), sharing, scales)
        followed = np.einsum("ni,nij->nj", slopes[:, own], follow[groups.of_row])
        return predicted, _seen(
            slopes[:, common] - followed, slopes * scales[groups.of_row], weight, border, sharing.mean(scales)
        )

    outer = minimise(
        profiled, y, weight, border, sharing.mean(start), sharing.mean(scales),
        lower=sharing.mean(lower), upper=sharing.mean(upper), damping=0.0, rest=REST,
        tolerance=tolerance, most=most,
    )  # fmt: skip
    inner = blocks(outer.values[set_of_row])
    each = sharing.sets.of_row
    values = sharing.merged(inner.values, outer.values[each])
    return Minimum(
        values=values,
        curvature=shared_curvature(model(values[groups.of_row])[1], weight, groups, sharing, scales),
        residual=inner.residual,
        converged=inner.converged & outer.converged[each],
        rank=inner.rank + _dealt_out(outer.rank, sharing.sets, groups.sizes),
        at_bound=sharing.merged(inner.at_bound, outer.at_bound[each]),
        iterations=outer.iterations,
    )


def shared_curvature(slopes: Array, weight: Array, groups: Groups, sharing: Sharing, scales: Array) -> Array:
    """What all rows together say of each group's parameters, the other groups' own eliminated.

    Parameters
    ----------
    slopes : array, shape (n, p)
        Derivatives of the responses by each row's own parameters.
    weight : array, shape (n,)
        Inverse variance.
    groups : Groups
    sharing : Sharing
    scales : array, shape (g, p)

    Returns
    -------
    array, shape (g, p, p)
        Its inverse is the covariance of the group's own and the shared parameters.
    """
    products = _products(slopes, weight, groups)
    reduced, _ = _eliminate(products, sharing, scales)
    total = np.zeros((len(sharing.sets), *reduced.shape[1:]))
    np.add.at(total, sharing.sets.of_row, reduced)
    border = np.ix_(
        np.arange(len(products)), sharing.parameters.nonzero()[0], sharing.parameters.nonzero()[0]
    )
    # A set's curvature beside this group's own share of it, which its rows keep uneliminated.
    products[border] += total[sharing.sets.of_row] - reduced
    return products


def _dealt_out(rank: Indices, sets: Groups, sizes: Indices) -> Indices:
    """The rank of each set in whole numbers for its groups, as nearly by their rows as may be."""
    dealt = np.zeros(len(sizes), dtype=np.intp)
    for number, whole in enumerate(rank):
        mine = np.flatnonzero(sets.of_row == number)
        due = np.round(np.cumsum(sizes[mine]) / sizes[mine].sum() * whole)
        dealt[mine] = np.diff(due, prepend=0.0)
    return dealt


def _seen(reduced: Array, effects: Array, weight: Array, border: Groups, scales: Array) -> Array:
    """The reduced slopes, but 0 for shared parameters that matter next to nothing beside all others.

    Parameters
    ----------
    reduced : array, shape (n, q)
    effects : array, shape (n, p)
        What a change of each parameter that matters does to each response.
    weight : array, shape (n,)
    border : Groups
    scales : array, shape (h, q)
    """

    def lengths(columns: Array) -> Array:
        return np.sqrt(np.stack([border.sums(weight * column**2) for column in columns.T], axis=-1))

    enough = lengths(reduced) * scales > SMALLEST * lengths(effects).max(axis=1, keepdims=True)
    return reduced * enough[border.of_row]


def _products(slopes: Array, weight: Array, groups: Groups) -> Array:
    """J' W J of each group, shape (g, p, p)."""
    p = slopes.shape[1]
    products = np.empty((len(groups), p, p))
    for i in range(p):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = groups.sums(weight * slopes[:, i] * slopes[:, j])
    return products


def _eliminate(products: Array, sharing: Sharing, scales: Array) -> tuple[Array, Array]:
    """The shared parameters' curvature in each group, its own parameters eliminated, and how these follow.

    Returns
    -------
    reduced : array, shape (g, q, q)
    follow : array, shape (g, p - q, q)
        Change of the own parameters that makes the best of a change of the shared ones, sign reversed.
    """
    common, own = sharing.parameters, ~sharing.parameters
    across = products[:, own][:, :, common]
    _, _, inverse = known_parameters(products[:, own][:, :, own], scales[:, own])
    follow = inverse @ across
    return products[:, common][:, :, common] - across.swapaxes(1, 2) @ follow, follow
