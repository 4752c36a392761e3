"""The published step-size laws and the counts they make, written anew from the equations alone.

SI throughout. Arrays over traverses and quadrature nodes have shape (n, m), or (n, 1) where nothing changes
along a traverse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DEG, MM = np.pi / 180, 1e-3
L2, STROKE = 37.5 * MM, 12 * MM
FULL = {1: (-120 * DEG, 120 * DEG), 2: (-210 * DEG, 30 * DEG), 3: (0.0, STROKE)}
PARAMETERS = {
    3: ("a", "b", "c"),
    2: ("near", "far", "d_near", "d_far"),
    1: ("zero", "per_m", "d_zero", "d_per_m"),
}
# Panels and Gauss points in each: the guide's are fine enough for a worn spot 0.1 mm wide.
PANELS = {1: (4, 6), 2: (4, 6), 3: (40, 4)}


def published_load(joint: int, q1: Array, q2: Array, theta: Array, psi: Array) -> Array:
    """The load of the published laws, which joints 2 and 3 take at q1 = 0."""
    if joint == 1:
        return np.cos(theta) * np.sin(psi) * np.sin(q1) + np.sin(theta) * np.cos(q1)
    zeta = psi - q2
    return (np.sin(zeta) if joint == 2 else np.cos(zeta)) * np.cos(theta)


def full_load(joint: int, q1: Array, q2: Array, theta: Array, psi: Array) -> Array:
    """The load with q1 in its place; joint 1's has it already."""
    if joint == 1:
        return published_load(1, q1, q2, theta, psi)
    s1, c1, s2, c2 = np.sin(q1), np.cos(q1), np.sin(q2), np.cos(q2)
    st, ct, sp, cp = np.sin(theta), np.cos(theta), np.sin(psi), np.cos(psi)
    if joint == 2:
        return sp * c1 * c2 * ct - s1 * c2 * st - cp * s2 * ct
    return sp * c1 * s2 * ct - s1 * s2 * st + cp * c2 * ct


@dataclass(frozen=True)
class Place:
    """The traverses of one joint at their nodes: what the step size may depend on."""

    joint: int
    rows: npt.NDArray[np.int64]  # where they stand in the log
    angles: Mapping[str, Array]  # q1, q2, theta, psi
    q3: Array
    load: Array
    recoil: Array
    reach: Array
    weights: Array  # dx at each node
    values: Mapping[str, Array]  # the law's parameters
    forward: Array  # +1 or -1
    pace: Callable[[Place], Array] | None = None  # step size, where it is not the published law's

    def of(self, column: Array) -> Array:
        """A column of the whole log at these traverses, shape (n, 1)."""
        return column[self.rows, None]

    def at(self, **angles: Array) -> Place:
        """The same traverses at other angles, with all that follows from them."""
        there = {**self.angles, **angles}
        return replace(
            self,
            angles=there,
            load=published_load(self.joint, **there),
            recoil=np.abs(np.cos(there["q2"])),
            reach=-(L2 + self.q3) * np.sin(there["q2"]),
        )

    @property
    def own(self) -> Array:
        """Position of the joint that moves."""
        return {1: self.angles["q1"], 2: self.angles["q2"], 3: self.q3}[self.joint]

    @property
    def unloaded(self) -> Array:
        """a or gamma0: the step size without load or recoil."""
        v = self.values
        if self.pace is not None:
            return replace(self, load=0 * self.load, recoil=0 * self.recoil).step_size()
        if self.joint == 3:
            return v["a"]
        if self.joint == 2:
            return v["near"] + (v["far"] - v["near"]) * (self.q3 / STROKE)
        return v["zero"] + v["per_m"] * self.reach

    def step_size(self) -> Array:
        """Step size of the published law, or of `pace`."""
        v = self.values
        if self.pace is not None:
            return self.pace(self)
        if self.joint == 3:
            return (1 - v["b"] * self.recoil) * (v["a"] - v["c"] * self.load)
        if self.joint == 2:
            return self.unloaded + (v["d_near"] + (v["d_far"] - v["d_near"]) * (self.q3 / STROKE)) * self.load
        return self.unloaded + (v["d_zero"] + v["d_per_m"] * self.reach) * self.load

    def counts(self, step_size: Array) -> Array:
        """Steps of each traverse, shape (n,); NaN where the joint would come to a halt."""
        steps = np.sum(self.weights / step_size, axis=1)
        return np.where(np.min(step_size, axis=1) > 0, steps, np.nan)

    def mean_load(self) -> Array:
        """Load averaged over positions, shape (n,)."""
        return np.sum(self.weights * self.load, axis=1) / np.sum(self.weights, axis=1)


def place(
    joint: int,
    rows: npt.NDArray[np.int64],
    positions: Mapping[str, Array],
    values: Mapping[str, Array],
    forward: Array,
    pace: Callable[[Place], Array] | None = None,
) -> Place:
    """Put a joint's traverses on their nodes.

    `positions` holds q1, q2, q3, theta, psi, low and high of these traverses, `values` the law's parameters
    and `forward` the sign of the direction, each of shape (n,).
    """
    column = {name: value[:, None] for name, value in positions.items()}
    x, w = _nodes(*PANELS[joint])
    length = column["high"] - column["low"]
    column[f"q{joint}"] = column["low"] + length * x
    angles = {name: column[name] for name in ("q1", "q2", "theta", "psi")}
    nothing = np.zeros((len(rows), 1))
    unplaced = Place(
        joint,
        rows,
        angles,
        column["q3"],
        nothing,
        nothing,
        nothing,
        length * w,
        {name: value[:, None] for name, value in values.items()},
        forward[:, None],
        pace,
    )
    return unplaced.at()


@cache
def _nodes(panels: int, points: int) -> tuple[Array, Array]:
    """Composite Gauss-Legendre nodes and weights on 0 to 1."""
    x, w = np.polynomial.legendre.leggauss(points)
    inside = (np.arange(panels)[:, None] + (x + 1) / 2) / panels
    return inside.ravel(), np.tile(w / (2 * panels), panels)
