"""Rotational inertia grows with the square of q3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, TermCause
from stickslip_fit.laws import State

FAR = 0.012  # m; with the law linear between 0 and here, only the bend between them is new


@dataclass(frozen=True)
class InertiaQuadratic(TermCause):
    """Joint 2: gamma0 gains k q3 (q3 - 12 mm)."""

    name = "inertia-quadratic"
    phrase = "joint 2 feels the arm's moment of inertia"
    physics = (
        "The arm's moment of inertia about joint 2 grows with the square of its length, and the slip phase "
        "turns the less the larger the inertia it leaves behind. The published law is linear in q3; what is "
        "left is quadratic and 0 at both ends of the range."
    )
    shows_best = "joint 2 at q3 = 6 mm"
    joints = (2,)
    parameters = (CauseParameter("k", "µrad/mm²", "bend of gamma0 with q3"),)
    absent = (0.0,)
    scale = (0.02,)

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        mine = rows[rows["joint"] == 2]
        if len(mine) and mine["q3"].round(6).nunique() < 3:
            return "joint 2 was driven at fewer than three positions of joint 3"
        return super().missing(rows)

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([0.3]),)

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """See `TermCause.term`."""
        return values[0] * state.q3 * (state.q3 - FAR)
