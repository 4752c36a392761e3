"""StepTable: a step that takes a differential equation, interpolated between points that are solved.

Working points are covered by cells, each with a polynomial through five Chebyshev points in every quantity
that varies. Where its last coefficients exceed `TOLERANCE`, or it is off by more at points of its own, a cell
is halved along the quantity that bends most, so that cells are small about a change of regime and large
elsewhere. Cells lie on a grid that does not depend on the points, and what is solved is kept: later calls
cost what is new in them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.errors import InputError

TOLERANCE = 5e-5  # of the step; half of what is promised, since it is measured at a few points
ORDER = 4
NODES = np.cos(np.pi * np.arange(ORDER, -1, -1) / ORDER)  # -1 to 1
WEIGHTS = np.array([0.5, -1.0, 1.0, -1.0, 0.5])  # barycentric
# Between nodes, where a polynomial is worst; a row for each test, a column for each quantity.
TESTS = np.array(
    [[-0.87, 0.41, -0.4, 0.88, 0.43], [0.42, -0.86, 0.85, -0.41, -0.87], [-0.38, -0.45, -0.9, -0.85, 0.9]]
)
CELL_LOAD = 5.0  # m/s^2
CELL_SHARE = 0.1  # of any other quantity
MAX_HALVINGS = 9
MAX_SOLVED = 5_000
MAX_SETS = 12  # of the other quantities, for which load is interpolated alone


class StepTable:
    """Steps by working point.

    Parameters
    ----------
    solve : callable
        From a load and the other quantities, all above 0, of one point to its step.
    is_held : callable
        From points, shape (n, d), to whether the stage has a step there, shape (n,).

    Attributes
    ----------
    solved : dict
        Steps of the points that were solved.
    """

    def __init__(self, solve: Callable[[Array], float], is_held: Callable[[Array], BoolArray]) -> None:
        self._solve = solve
        self._is_held = is_held
        self.solved: dict[tuple[float, ...], float] = {}
        self._alone: Counter[tuple[Any, ...]] = Counter()

    def steps(self, points: Array) -> Array:
        """Steps of points, shape (n, d), the load first -> (n,); nan where there is none.

        Raises
        ------
        InputError
            If too many points would have to be solved.
        """
        steps = np.full(len(points), np.nan)
        held = np.flatnonzero(self._is_held(points))
        if not len(held):
            return steps
        unique, index = np.unique(points[held], axis=0, return_inverse=True)
        sets, which = np.unique(unique[:, 1:], axis=0, return_inverse=True)
        found = np.empty(len(unique))
        if len(sets) <= MAX_SETS:
            for number in range(len(sets)):
                own = np.flatnonzero(which.ravel() == number)
                found[own] = self._interpolate(unique[own], np.array([0]))
        else:
            varied = np.flatnonzero(np.ptp(unique, axis=0) > 0)
            found = self._interpolate(unique, varied)
        steps[held] = found[index.ravel()]
        return steps

    def _interpolate(self, points: Array, varied: IntArray) -> Array:
        """Steps of points that differ in the quantities `varied` only."""
        scaled = self._scale(points, varied)
        place = np.floor(scaled)
        found = np.empty(len(points))
        cells, which = np.unique(place, axis=0, return_inverse=True)
        for number, cell in enumerate(cells):
            own = np.flatnonzero(which.ravel() == number)
            found[own] = self._fill(points[own], scaled[own], varied, cell, np.ones(len(varied)), 0)
        return found

    def _fill(
        self, points: Array, scaled: Array, varied: IntArray, low: Array, width: Array, halvings: int
    ) -> Array:
        """Steps of the points of one cell."""
        d = len(varied)
        if halvings >= MAX_HALVINGS * d or self._few(points, varied, (*low, *width)):
            return np.array([self._step_of(point) for point in points])
        axes = [low[k] + width[k] * (NODES + 1) / 2 for k in range(d)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
        nodes = self._unscale(grid, varied, points[0])
        is_held = bool(self._is_held(nodes).all())
        axis = int(np.argmax(width))
        if is_held:
            steps = np.array([self._step_of(node) for node in nodes]).reshape((len(NODES),) * d)
            allowed, bends = TOLERANCE * np.abs(steps).min(), _last_coefficients(steps)
            if bends.max() <= allowed:
                tests = low + width * (TESTS[:, :d] + 1) / 2
                true = [self._step_of(each) for each in self._unscale(tests, varied, points[0])]
                if np.abs(_evaluate(steps, axes, tests) - true).max() <= allowed:
                    return _evaluate(steps, axes, scaled)
            axis = int(np.argmax(bends))
        found = np.empty(len(points))
        half = width.copy()
        half[axis] /= 2
        upper = scaled[:, axis] >= low[axis] + half[axis]
        for above in (False, True):
            own = np.flatnonzero(upper == above)
            corner = low.copy()
            corner[axis] += half[axis] * above
            if len(own):
                found[own] = self._fill(points[own], scaled[own], varied, corner, half, halvings + 1)
        return found

    def _few(self, points: Array, varied: IntArray, place: tuple[float, ...]) -> bool:
        """Whether these points of a cell take fewer solutions than a polynomial, with those before them."""
        cell = (*varied, *place, *np.delete(points[0], varied))
        new = sum(tuple(map(float, point)) not in self.solved for point in points)
        few = self._alone[cell] + new <= len(NODES) ** len(varied) + len(TESTS)
        self._alone[cell] += new if few else 0
        return few

    def _step_of(self, point: Array) -> float:
        key = tuple(map(float, point))
        if key not in self.solved:
            if len(self.solved) >= MAX_SOLVED:
                raise InputError(
                    f"more than {MAX_SOLVED:,} steps of a stage's contact model would have to be solved; "
                    'let fewer quantities vary, or choose model = "coulomb"'
                )
            self.solved[key] = self._solve(point)
        return self.solved[key]

    def _scale(self, points: Array, varied: IntArray) -> Array:
        """Quantities in widths of cells."""
        columns = [points[:, k] / CELL_LOAD if k == 0 else np.log(points[:, k]) / CELL_SHARE for k in varied]
        return np.stack(columns, axis=-1)

    def _unscale(self, scaled: Array, varied: IntArray, others: Array) -> Array:
        points = np.tile(others, (len(scaled), 1))
        for column, k in enumerate(varied):
            own = scaled[:, column]
            points[:, k] = CELL_LOAD * own if k == 0 else np.exp(CELL_SHARE * own)
        return points


def _evaluate(steps: Array, axes: list[Array], points: Array) -> Array:
    """The polynomial through the steps at the nodes, at points of shape (n, d) -> (n,)."""
    values = np.broadcast_to(steps, (len(points), *steps.shape))
    for k, nodes in enumerate(axes):
        gap = points[:, k, None] - nodes
        at_node = gap == 0
        weights = WEIGHTS / np.where(at_node, 1.0, gap)
        weights = np.where(at_node.any(axis=1, keepdims=True), at_node, weights)
        weights = weights / weights.sum(axis=1, keepdims=True)
        values = np.einsum("nj,nj...->n...", weights, values)
    return values


LAST_COEFFICIENT = np.linalg.inv(np.polynomial.chebyshev.chebvander(NODES, ORDER))[-1]


def _last_coefficients(steps: Array) -> Array:
    """The largest last Chebyshev coefficient along each axis."""
    axes = range(steps.ndim)
    return np.array([np.abs(np.tensordot(LAST_COEFFICIENT, steps, axes=(0, axis))).max() for axis in axes])
