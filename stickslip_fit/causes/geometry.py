"""Causes in the geometry: base tilt, joint 2's zero, gravity at any q1, axis and shape of the recoil."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from typing import ClassVar

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.kinds import StateCause
from stickslip_fit.causes.parameters import CauseParameter, Sizes
from stickslip_fit.laws import State

__all__ = ["ThetaOffset", "PsiOffset", "Q2Offset", "Q1Gravity", "RecoilAxis", "RecoilShape"]  # noqa: RUF022


@dataclass(frozen=True)
class AngleOffset(StateCause):
    """One angle of the state is not what was written down."""

    angle: ClassVar[str]

    needs_geometry = True
    scale = (radians(1.0),)
    trial_values = np.radians([[1.0], [-1.0], [4.0], [-4.0]])
    largest_sizes = ((radians(10.0),), (radians(-10.0),))
    stage = 1

    def change(self, state: State, values: list[Array]) -> State:
        return state.with_changes(**{self.angle: getattr(state, self.angle) + values[0]})


@dataclass(frozen=True)
class ThetaOffset(AngleOffset):
    """theta is theta + delta."""

    name = "theta-offset"
    phrase = "the base is tilted about x"
    physics = (
        "theta is set by hand or read off a stage; a plate that does not lie flat adds the same angle to "
        "every setting, and gravity acts along another direction than the law believes."
    )
    shows_best = "traverses on both sides of theta = 0, where the load changes most with theta"
    sentence = "The base is tilted by {delta:+} about x (to be added to the logged theta)"
    remedy = "mounting the base straight"
    parameters = (CauseParameter("delta", "deg", "tilt of the base plate about x"),)
    angle = "theta"


@dataclass(frozen=True)
class PsiOffset(AngleOffset):
    """psi is psi + delta, for gravity only."""

    name = "psi-offset"
    phrase = "the base is tilted about y"
    physics = (
        "As a tilt about x, but about y: gravity acts along another direction in the plane of the arm than "
        "the law believes, while recoil, which the arm's own angle decides, is what it was."
    )
    shows_best = "arm level, base level: where the load on joint 3 is 0 and changes most with psi"
    sentence = "The base is tilted by {delta:+} about y (to be added to the logged psi)"
    remedy = "mounting the base straight"
    parameters = (CauseParameter("delta", "deg", "tilt of the base plate about y"),)
    angle = "psi"


@dataclass(frozen=True)
class Q2Offset(AngleOffset):
    """q2 is q2 + delta, for gravity, recoil and reach."""

    name = "q2-offset"
    phrase = "joint 2's zero is off"
    physics = (
        "Without a sensor, joint 2's angle is counted from an end stop whose place is known only so well. "
        "All of gravity, recoil and reach follow the true angle; how far a traverse goes between its stops "
        "does not."
    )
    shows_best = "joint 3 with the arm upright and level, in both orientations of the base"
    sentence = "Joint 2's zero is off by {delta:+} (to be added to the logged q2)"
    remedy = "setting joint 2's zero"
    parameters = (CauseParameter("delta", "deg", "error of joint 2's zero"),)
    angle = "q2"


@dataclass(frozen=True)
class Q1Gravity(StateCause):
    """u is (1 - k) times the published load plus k times the full one; physics says k = 1."""

    name = "q1-gravity"
    phrase = "gravity acts differently where joint 1 is turned"
    physics = (
        "The published loads of joints 2 and 3 hold at q1 = 0. With joint 1 turned, the arm's plane is "
        "another, and gravity's components in it are those of A.112 and A.113 (A. Damani, M.S. "
        "thesis, University of Utah, 2013)."
    )
    shows_best = "joint 3 or 2 at q1 = 90 degrees with theta away from 0"
    sentence = "Gravity acts on a joint as q1 turns it, which the law ignores: {k:+} of what physics says"
    remedy = "calibrating at the q1 that is used"
    joints = (2, 3)
    parameters = (CauseParameter("k", "1", "share of the full load; 1 by physics"),)
    needs_geometry = True
    scale = (0.5,)
    largest_sizes = ((1.0,),)
    stage = 2

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        subset = rows[rows["joint"].isin(self.joints)]
        if len(subset) and not subset["q1"].fillna(0.0).any():
            return "every traverse of joints 2 and 3 was made at q1 = 0"
        return super().explain_missing(rows)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {"k": sizes["k"].times(1.0, "%")}

    def change(self, state: State, values: list[Array]) -> State:
        return state.with_changes(override_load=(1.0 - values[0]) * state.load + values[0] * state.full_load)


@dataclass(frozen=True)
class RecoilAxis(StateCause):
    """Recoil is |cos(q2 - phi)|."""

    name = "recoil-axis"
    phrase = "the arm recoils most in another direction than the law has it"
    physics = (
        "Each step pushes back on the joint that carries the arm. How much of the step that costs depends "
        "on how compliant the joint is in the arm's direction, and the most compliant direction need not be "
        "the upright one: it follows the shape of the bearing's frame."
    )
    shows_best = "joint 3 at q2 = -45 and -135 degrees"
    sentence = "The arm recoils most at q2 = {phi:+}, where the law has it at 0 deg"
    joints = (3,)
    parameters = (CauseParameter("phi", "deg", "most compliant direction", -np.pi / 4, np.pi / 4),)
    needs_geometry = True
    scale = (radians(2.0),)
    trial_values = np.radians([[2.0], [-2.0], [6.0], [-6.0], [15.0], [-15.0]])
    largest_sizes = ((radians(15.0),), (radians(-15.0),))
    stage = 2

    def change(self, state: State, values: list[Array]) -> State:
        return state.with_changes(override_recoil=np.abs(np.cos(state.q2 - values[0])))


@dataclass(frozen=True)
class RecoilShape(StateCause):
    """Recoil is |cos q2|^p."""

    name = "recoil-shape"
    phrase = "recoil does not follow the cosine of q2"
    physics = (
        "That recoil goes with |cos q2| supposes a stiffness that does not depend on how far the joint is "
        "pushed back. Preloaded bearings are stiffer under larger forces, which makes the loss fall off "
        "faster or slower than the cosine on the way from upright to level."
    )
    shows_best = "joint 3 half-way between upright and level, q2 = -45 and -60 degrees"
    sentence = "Recoil follows the cosine of q2 to the power {p:.2f}"
    joints = (3,)
    parameters = (CauseParameter("p", "1", "exponent; 1 in the published law", 0.1, 6.0),)
    needs_geometry = True
    null_values = (1.0,)
    scale = (0.2,)
    trial_values = np.array([[0.6], [0.85], [1.2], [1.8]])
    largest_sizes = ((0.5,), (2.0,))

    def change(self, state: State, values: list[Array]) -> State:
        return state.with_changes(override_recoil=state.recoil ** values[0])
