"""The response to load bends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, TermCause
from stickslip_fit.laws import State
from stickslip_fit.machine import Machine

BENDS: dict[str, Callable[[Array], Array]] = {
    "square": np.square,
    "cube": lambda load: load**3,
    "tanh": lambda load: np.tanh(2.0 * load),
}
GROUPS = tuple((joint, way) for joint in (1, 2, 3) for way in "+-")


@dataclass(frozen=True)
class LoadNonlinearity(TermCause):
    """gamma plus k a f(u) for joint 3, k gamma0 f(u) for joints 1 and 2; k per joint and direction.

    Attributes
    ----------
    form : {"square", "cube", "tanh"}
        u^2, u^3 or tanh(2 u).
    groups : tuple of (int, str)
        Joints and directions that the log has.
    """

    form: str = "square"
    groups: tuple[tuple[int, str], ...] = GROUPS

    name = "load-nonlinearity"
    phrase = "the response to load bends"
    physics = (
        "The law has the step size fall in proportion to the load. Friction, and the elastic part of each "
        "step that it takes up, need not be linear in it: against a large load the slip phase begins later, "
        "so that the response bends."
    )
    shows_best = "joint 3 or 2 at half the full load, upwards and downwards"
    along = True
    joined = True

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
        return tuple(
            CauseParameter("k", "%", f"bend of joint {joint} {way}", joint=joint, direction=way)
            for joint, way in self.groups
        )

    @property
    def absent(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.0,) * len(self.groups)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.02,) * len(self.groups)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        there = set(zip(rows["joint"], rows["direction"].astype(str), strict=True))
        return replace(self, groups=tuple(group for group in GROUPS if group in there))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(replace(self, form=form), 0.02 * np.eye(len(self.groups))) for form in BENDS]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.full(len(self.groups), 0.1),)

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """See `TermCause.term`."""
        size = dict(zip(self.groups, values, strict=True))
        up, down = (size.get((state.joint, way), np.zeros_like(state.way)) for way in "+-")
        return np.where(state.way > 0, up, down) * free * BENDS[self.form](state.load)
