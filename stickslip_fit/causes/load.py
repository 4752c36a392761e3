"""Causes in the load: side load, nonlinear or hysteretic response, quadratic inertia, cable torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit._format import format_direction, join_words
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.joint_ranges import NOMINAL_TRAVEL, JointRanges, Ranges
from stickslip_fit.causes.kinds import FactorCause, StateCause, TermCause
from stickslip_fit.causes.parameters import (
    CauseParameter,
    Row,
    SizedParameter,
    Sizes,
    candidate_moments,
    changes_since,
    fill_empty,
    is_since,
    missing_column,
    moment_parameter,
    moments_about,
)
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.machine import Machine
from stickslip_fit.units import JOINTS

__all__ = [  # noqa: RUF022
    "SideLoad",
    "LoadNonlinearity",
    "LoadHysteresis",
    "PayloadChange",
    "InertiaQuadratic",
    "CableTorque",
]


@dataclass(frozen=True)
class SideLoad(FactorCause):
    """Joint 3: gamma times 1 - k sqrt(1 - u^2)."""

    name = "side-load"
    phrase = "the step size follows the load across the guide"
    physics = (
        "What of the arm's weight does not act along the guide presses it against its bearing, sqrt(1 - "
        "u^2) of it, and friction grows with that force (Coulomb's law)."
    )
    shows_best = "joint 3 level and upright in orientations that have the same load along the axis"
    sentence = "Joint 3's steps {k:shrink|grow} by {k} where all the load lies across the guide"
    remedy = "calibrating in the orientation that is used"
    needs_geometry = True
    joints = (3,)
    parameters = (CauseParameter("k", "%", "share lost to the full load across the axis"),)
    scale = (0.02,)
    largest_sizes = ((0.2,),)

    def factor(self, state: State, values: list[Array]) -> Array:
        return 1.0 - values[0] * np.sqrt(np.maximum(1.0 - state.load**2, 0.0))


BEND_SHAPES: dict[str, tuple[Callable[[Array], Array], ...]] = {
    "square": (np.square,),
    "cube": (lambda load: load * load * load,),
    "tanh": (lambda load: np.tanh(2.0 * load),),
    "square-and-cube": (np.square, lambda load: load * load * load),
}
BEND_TEXTS = {"square": "u²", "cube": "u³", "tanh": "tanh(2u)", "square-and-cube": "u²"}
PRIOR_SD = 0.05  # of each size of a bend that has two, which few configurations cannot tell apart
BEND_SIZES = {"k": "bend", "cubic": "cubic bend"}
JOINT_DIRECTIONS = tuple((joint, direction) for joint in JOINTS for direction in "+-")


@dataclass(frozen=True)
class LoadNonlinearity(TermCause):
    """gamma plus k a f(u) for joint 3, k gamma0 f(u) for joints 1 and 2; k per joint and direction.

    Attributes
    ----------
    form : {"square", "cube", "tanh", "square-and-cube"}
        u^2, u^3 or tanh(2 u); or k u^2 and a cubic term, both times recoil's factor, as of friction-limited
        steps, which follow (1 - b |cos q2|) (1 - r u) / (1 + r u).
    groups : tuple of (int, str)
        Joints and directions that the log has.
    """

    form: str = "square"
    groups: tuple[tuple[int, str], ...] = JOINT_DIRECTIONS

    name = "load-nonlinearity"
    phrase = "the response to load bends"
    physics = (
        "The law has the step size fall in proportion to the load. Friction, and the elastic part of each "
        "step that it takes up, need not be linear in it: against a large load the slip phase begins later, "
        "so that the response bends."
    )
    shows_best = "joint 3 or 2 at half the full load, upwards and downwards"
    remedy = "calibrating at the loads that are used"
    needs_geometry = True
    forms = tuple(BEND_SHAPES)
    varies_along_traverse = True
    combine_trials = True

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        sd = PRIOR_SD if len(BEND_SHAPES[self.form]) > 1 else np.inf
        return tuple(
            CauseParameter(
                name,
                "%",
                f"{what} of joint {joint} {format_direction(way)}",
                joint=joint,
                direction=way,
                prior_sd=sd,
            )
            for name, what in list(BEND_SIZES.items())[: len(BEND_SHAPES[self.form])]
            for joint, way in self.groups
        )

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (0.02,) * (len(BEND_SHAPES[self.form]) * len(self.groups))

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        present = set(zip(rows["joint"], rows["direction"].astype(str), strict=True))
        return replace(self, groups=tuple(group for group in JOINT_DIRECTIONS if group in present))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        versions = [replace(self, form=form) for form in BEND_SHAPES]
        return [(version, np.diag(version.scale)) for version in versions]

    def largest_plausible(self) -> tuple[Array, ...]:
        return (np.full(len(self.scale), 0.1),)

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        if not parameters:
            return super().describe(parameters)
        clear = [k for k in parameters if not k.size.low < 0.0 < k.size.high] or parameters
        sizes = {k: f"{k:+} for {k.joint} {format_direction(k.direction)}" for k in clear}
        bends, cubic = (
            join_words([text for k, text in sizes.items() if k.name == name]) for name in BEND_SIZES
        )
        shape = BEND_TEXTS[self.form]
        parts = [f"with {shape} by {bends}" if bends else "", f"with u³ by {cubic}" if cubic else ""]
        how = ", and ".join(filter(None, parts))
        return f"The response to load bends, {how} (joint and direction; u is the load)"

    def unload(self, state: State) -> State:
        if len(BEND_SHAPES[self.form]) == 1:
            return super().unload(state)
        return state.with_changes(override_load=np.zeros((len(state.position), 1)))

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        return free * self._bend(state, values)

    def term_slopes(self, free: Array, state: State, values: list[Array]) -> tuple[Array, list[Array]]:
        slopes = [np.zeros((1, 1))] * len(values)
        for k, shape in self._shapes(state).items():
            slopes[k] = free * shape
        return self._bend(state, values), slopes

    def _bend(self, state: State, values: list[Array]) -> Array:
        bend = np.zeros_like(state.direction_sign)
        for k, shape in self._shapes(state).items():
            bend = bend + values[k] * shape
        return bend

    def _shapes(self, state: State) -> dict[int, Array]:
        """By the place of each parameter of this joint, the share of the step size that it adds."""
        ways = {"+": state.direction_sign > 0, "-": state.direction_sign < 0}
        bends = [shape(state.load) for shape in BEND_SHAPES[self.form]]
        places = enumerate((bend, *group) for bend in bends for group in self.groups)
        return {k: ways[way] * bend for k, (bend, joint, way) in places if joint == state.joint}


@dataclass(frozen=True)
class LoadHysteresis(FactorCause):
    """gamma times 1 + k u_before, the mean load of the joint's previous traverse in the session."""

    name = "load-hysteresis"
    phrase = "a joint remembers the load of its previous traverse"
    physics = (
        "Piezoceramics and preloaded contacts creep under load and take time to forget it, so that a "
        "traverse begins in a state that the previous one left behind (H. Jung and D.-G. Gweon, Rev. Sci. "
        "Instrum. 71:1896, 2000, on creep)."
    )
    shows_best = "one configuration after a lifting and after a lowering traverse"
    sentence = "Steps {k:grow|shrink} by {k} after a traverse against full load"
    remedy = "letting a traverse of little load come before each"
    needs_geometry = True
    columns = ("before_load",)
    may_differ_by_joint = True
    parameters = (CauseParameter("k", "%", "change of the step size after a traverse under full load"),)
    scale = (0.01,)
    largest_sizes = ((0.1,),)

    def factor(self, state: State, values: list[Array]) -> Array:
        return 1.0 + values[0] * state.column("before_load")


@dataclass(frozen=True)
class PayloadChange(StateCause):
    """The load coefficient times 1 + k after one moment of the campaign, or times 1 + k payload.

    Attributes
    ----------
    session : str
        In which the mass was put on or taken off; empty where the log records the payload.
    mean : float
        Payload over the log, kg.
    """

    session: str = ""
    mean: float = 0.0

    name = "payload-change"
    phrase = "the arm carries another mass"
    physics = (
        "A mass at the tip adds its weight to the arm's, so that all loads grow by the same factor, "
        "whatever the configuration, while the step size without load stays what it was. After a session's "
        "end it is part of the next session's calibration."
    )
    max_trial_factor = 5.0
    shows_best = "joint 3 upright before and after, in both directions"
    remedy = "calibrating anew with each payload"
    needs_geometry = True

    @property
    def sentence(self) -> str:  # type: ignore[override]
        when = "{moment} into session {session}: the arm carries another mass"
        return "The effects of load {k:grow|shrink} by {k} " + (when if self.session else "with the payload")

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("session", "session_seconds") if self.session else ("payload",)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (0.1, 600.0) if self.session else (10.0,)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        if self.session == "":
            return (CauseParameter("k", "%/g", "change of the load coefficient per gram"),)
        return (
            CauseParameter("k", "%", "change of the load coefficient", session=self.session),
            moment_parameter(self.session),
        )

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        versions: list[tuple[Cause, Array]] = [
            (replace(self, session=session), np.column_stack([np.full(len(moments), 0.1), moments]))
            for session, moments in candidate_moments(rows)
            if self.session in ("", session)
        ]
        if self.session == "" and missing_column(rows, "payload") is None:
            versions += super().trials(rows)
        return versions

    def finer_trials(self, rows: pd.DataFrame, values: Array) -> Array:
        """See `Cause.finer_trials`: other moments."""
        if self.session == "":
            return super().finer_trials(rows, values)
        moments = moments_about(rows, self.session, values[1])
        return np.column_stack([np.full(len(moments), values[0]), moments])

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        return replace(self, mean=float(rows["payload"].mean()) if rows["payload"].notna().any() else 0.0)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: a traverse is changed entirely or not at all."""
        if self.session == "":
            return super().changes(law, rows, values, trials)
        changes, row = partial(super().changes, law), self.row_values(law, rows)
        return changes_since(changes, row, values, self.session, trials)

    def change(self, state: State, values: list[Array]) -> State:
        if self.session == "":
            payload = fill_empty(state.column("payload"), self.mean)
            return state.with_changes(override_load=state.load * (1.0 + values[0] * payload))
        changed = values[0] * is_since(state, self.session, values[1])
        return state.with_changes(override_load=state.load * (1.0 + changed))


GUIDE_END = 0.012  # m; with the law linear between 0 and here, only the bend between them is new


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
    sentence = "Joint 2's steps at q3 = 6 mm are {half_way:+} off the line between those at 0 and 12 mm"
    remedy = "calibrating joint 2 at the q3 that is used"
    needs_geometry = True
    joints = (2,)
    parameters = (CauseParameter("k", "µrad/mm²", "bend of gamma0 with q3"),)
    scale = (0.02,)
    largest_sizes = ((0.3,),)

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        subset = rows[rows["joint"] == 2]
        if len(subset) and subset["q3"].round(6).nunique() < 3:
            return "joint 2 was driven at fewer than three positions of joint 3"
        return super().explain_missing(rows)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: the bend in the middle, where it is largest."""
        return {"half_way": sizes["k"].times(-((GUIDE_END / 2) ** 2), "µrad")}

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        return values[0] * state.q3 * (state.q3 - GUIDE_END)

    def term_slopes(self, free: Array, state: State, values: list[Array]) -> tuple[Array, list[Array]]:
        return np.zeros_like(free), [state.q3 * (state.q3 - GUIDE_END)]


@dataclass(frozen=True)
class CableTorque(JointRanges, TermCause):
    """Rotary: gamma plus k (q - middle of range), sign opposite in the two directions."""

    ranges: Ranges = NOMINAL_TRAVEL[:2]

    name = "cable-torque"
    phrase = "a cable pulls on a rotary joint like a spring"
    physics = (
        "The cable to the joints further out twists as a joint turns and pulls it back towards the middle "
        "of its range: with the motion in one direction, against it in the other."
    )
    shows_best = "a rotary joint over short stretches at both ends of its range, in both directions"
    sentence = (
        "{whose} steps {k:grow|shrink} by {k} along the range in direction +, and the reverse "
        "in −: a cable pulls"
    )
    remedy = "relieving the cable"
    joints = (1, 2)
    kind = "rotary"
    parameters = (CauseParameter("k", "µrad/deg", "change of the step size per degree"),)
    scale = (0.01e-6 * 180 / np.pi,)
    largest_sizes = ((0.1e-6 * 180 / np.pi,),)
    varies_along_traverse = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: on all rotary joints, and on each alone."""
        return [(version, np.array([self.scale])) for version in self.together_and_alone()]

    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        return values[0] * self._deflection(state)

    def term_slopes(self, free: Array, state: State, values: list[Array]) -> tuple[Array, list[Array]]:
        return np.zeros_like(free), [self._deflection(state)]

    def _deflection(self, state: State) -> Array:
        return state.direction_sign * (state.position - sum(self.ends(state.joint)) / 2.0)
