"""Where everything stands along a traverse: what a step size depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.machine import full_load, published_load

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """The manipulator at k positions of each of n traverses of one joint.

    Arrays have shape (n, k), or (n, 1) where they do not change along a traverse.

    Attributes
    ----------
    joint : {1, 2, 3}
    position : array
        Of the moving joint, rad or m.
    q1, q2, q3 : array
        Joint positions, the moving joint's own included.
    theta, psi : array
        Orientation of the base.
    row : mapping of str to array, shape (n,)
        Everything else that is known of each traverse, e.g. ``session_seconds``.
    given_load, given_recoil : array or None
        In place of what the angles say.
    """

    joint: int
    position: Array
    q1: Array
    q2: Array
    q3: Array
    theta: Array
    psi: Array
    row: Mapping[str, Any]
    given_load: Array | None = None
    given_recoil: Array | None = None

    @cached_property
    def load(self) -> Array:
        """The published gravity load on the joint, unless something has put another in its place."""
        if self.given_load is not None:
            return self.given_load
        return published_load(self.joint, self.q1, self.q2, self.theta, self.psi)

    @property
    def way(self) -> Array:
        """1 where the joint moves in `+`, -1 where in `-`, shape (n, 1)."""
        return np.sign(self.column("stop") - self.column("start"))

    @cached_property
    def full_load(self) -> Array:
        """The gravity load with q1 taken into account."""
        return full_load(self.joint, self.q1, self.q2, self.theta, self.psi)

    @cached_property
    def recoil(self) -> Array:
        """How much of the arm's length stands in the way of recoil: |cos q2|, unless replaced."""
        return np.abs(np.cos(self.q2)) if self.given_recoil is None else self.given_recoil

    def column(self, name: str) -> Array:
        """A quantity of each traverse, shape (n, 1)."""
        return np.asarray(self.row[name], dtype=float)[:, None]

    def but(self, **changed: Any) -> State:
        """Another state, in which load and recoil follow the angles unless they are given."""
        return replace(self, **changed)


def state_at(joint: int, row: Mapping[str, Any], position: Array) -> State:
    """The state with a joint at `position`, shape (n, k); columns that `row` lacks are NaN."""
    unknown = np.full(1, np.nan)

    def column(name: str) -> Array:
        return np.asarray(row.get(name, unknown), dtype=float)[:, None]

    place = {name: column(name) for name in ("q1", "q2", "q3", "theta", "psi")}
    place[f"q{joint}"] = position
    return State(joint, position, **place, row=row)
