"""The response to load bends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, TermCause
from stickslip_fit.laws import State

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
    """

    form: str = "square"

    name = "load-nonlinearity"
    phrase = "the response to load bends"
    physics = (
        "The law has the step size fall in proportion to the load. Friction, and the elastic part of each "
        "step that it takes up, need not be linear in it: against a large load the slip phase begins later, "
        "so that the response bends."
    )
    shows_best = "joint 3 or 2 at half the full load, upwards and downwards"
    columns = ("q1", "q2", "q3", "theta", "psi")
    parameters = tuple(
        CauseParameter("k", "%", f"bend of joint {joint} {way}", joint=joint, direction=way)
        for joint, way in GROUPS
    )
    absent = (0.0,) * len(GROUPS)
    scale = (0.02,) * len(GROUPS)
    along = True
    joined = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        there = set(zip(rows["joint"], rows["direction"].astype(str), strict=True))
        sizes = 0.02 * np.eye(len(GROUPS))[[group in there for group in GROUPS]]
        return [(replace(self, form=form), sizes) for form in BENDS]

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.full(len(GROUPS), 0.1),)

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """See `TermCause.term`."""
        first = GROUPS.index((state.joint, "+"))
        size = np.where(state.way > 0, values[first], values[first + 1])
        return size * free * BENDS[self.form](state.load)
