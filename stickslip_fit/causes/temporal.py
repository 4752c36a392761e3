"""Causes that act over time or use: warm-up, drift, a jump within a session, wear."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import log, log10
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.friction import FRICTION, RAMP_TIME, STEP, VOLTAGE, StageCause, distinct_changes
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.parameters import (
    CauseParameter,
    Row,
    Sizes,
    candidate_moments,
    changes_since,
    is_since,
    moment_parameter,
    moments_about,
)
from stickslip_fit.laws import State, StepLaw

__all__ = ["ThermalWarmUp", "Drift", "SessionJump", "Wear"]  # noqa: RUF022 (the library's order)

TIME_CONSTANTS = 60.0 * np.array([2.0, 4.0, 7.0, 12.0, 20.0, 35.0, 60.0])


@dataclass(frozen=True)
class ThermalWarmUp(FactorCause):
    """gamma times 1 + A (1 - exp(-t / tau)), t from the session's first traverse."""

    name = "thermal-warm-up"
    phrase = "the drive warms up"
    physics = (
        "Each step dissipates part of the piezo's electrical energy as heat, by its dielectric loss and by "
        "friction. The drive warms towards a balance with its surroundings, exponentially with the time "
        "constant of its heat capacity, and the piezo's stroke grows with temperature on the way."
    )
    shows_best = "one configuration, again and again from a session's first minute on"
    sentence = (
        "Steps {A:grow|shrink} by {A} as a session runs, with a time constant of {tau}: the drive warms up"
    )
    remedy = "waiting until it is warm"
    may_differ_by_joint = True
    columns = ("session_seconds",)
    parameters = (
        CauseParameter("A", "%", "change of the step size once warm"),
        CauseParameter("tau", "min", "time constant of warming up", lower=30.0, upper=3 * 3600.0),
    )
    null_values = (0.0, 600.0)
    scale = (0.01, 600.0)
    trial_values = np.column_stack([np.full(len(TIME_CONSTANTS), 0.01), TIME_CONSTANTS])
    largest_sizes = tuple((0.1, tau) for tau in TIME_CONSTANTS)

    def factor(self, state: State, values: list[Array]) -> Array:
        size, tau = values
        return 1.0 - size * np.expm1(-state.column("session_seconds") / tau)


SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True)
class Drift(FactorCause):
    """gamma times 1 + k t, t from the session's first traverse."""

    name = "drift"
    phrase = "steps drift through each session"
    physics = (
        "Clamping forces relax, the piezo creeps and the room changes over hours, longer than a session "
        "lasts, so that over a session the step size changes in proportion to time."
    )
    shows_best = "one configuration at a session's beginning, middle and end"
    sentence = "Steps {k:grow|shrink} by {k} through each session"
    remedy = "recalibrating within the session"
    may_differ_by_joint = True
    columns = ("session_seconds",)
    parameters = (CauseParameter("k", "%/h", "change of the step size per hour"),)
    scale = (0.01 / SECONDS_PER_HOUR,)
    largest_sizes = ((0.1 / SECONDS_PER_HOUR,),)

    def factor(self, state: State, values: list[Array]) -> Array:
        return 1.0 + values[0] * state.column("session_seconds")


@dataclass(frozen=True)
class SessionJump(StageCause):
    """gamma times 1 + A from one moment of one session on.

    Attributes
    ----------
    session : str
        In which it happens; empty for any.
    form : {"step", "friction", "voltage", "ramp time", ""}
        What is multiplied under a physical law, see `causes.friction`; empty for any.
    """

    session: str = ""
    form: str = STEP

    name = "session-jump"
    phrase = "something jumped within a session"
    physics = (
        "A knock against the table, a cable that is moved or a screw that gives changes the preload of the "
        "sliding surfaces from one traverse to the next, and it stays changed until the session's end."
    )
    shows_best = "the configurations of before the jump once more, after it"
    remedy = "calibrating anew after it"
    may_differ_by_joint = True
    columns = ("session", "session_seconds")
    scale = (0.01, 600.0)
    forms = (STEP, FRICTION, VOLTAGE, RAMP_TIME)

    @property
    def sentence(self) -> str:  # type: ignore[override]
        subject = "Steps {A:grow|shrink}" if self.form == STEP else f"The {self.form} {{A:grows|falls}}"
        return subject + " by {A} {moment} into session {session}, and stay so"

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        what = "step size" if self.form == STEP else self.form
        return (
            CauseParameter("A", "%", f"change of the {what}", session=self.session),
            moment_parameter(self.session),
        )

    @property
    def quantity(self) -> str:
        return self.form

    def with_quantity(self, quantity: str) -> Self:
        return replace(self, form=quantity)

    def for_laws(self, laws: Iterable[StepLaw]) -> Self:
        """See `Cause.for_laws`: of what laws know, anything may jump."""
        if self.form != STEP or len(tried := distinct_changes(laws)) == 1:
            return self
        return replace(self, tried=tried)

    def own_trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [
            (replace(self, session=session), np.column_stack([np.full(len(moments), 0.01), moments]))
            for session, moments in candidate_moments(rows)
            if self.session in ("", session)
        ]

    def finer_trials(self, rows: pd.DataFrame, values: Array) -> Array:
        """See `Cause.finer_trials`: other moments."""
        moments = moments_about(rows, self.session, values[1])
        return np.column_stack([np.full(len(moments), values[0]), moments])

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        changes, row = partial(super().changes, law), self.row_values(law, rows)
        return changes_since(changes, row, values, self.session, trials)

    def factor(self, state: State, values: list[Array]) -> Array:
        size, moment = values
        return 1.0 + size * is_since(state, self.session, moment)


WEAR_SCALES = np.array([1e4, 1e5, 1e6])


@dataclass(frozen=True)
class Wear(StageCause):
    """gamma times 1 + k log(1 + n / n0), n the joint's own logged steps so far, not reset by a session."""

    name = "wear"
    phrase = "the joints wear"
    physics = (
        "What the sliding surfaces lose grows with the way slid (J. F. Archard, J. Appl. Phys. 24:981, "
        "1953). Fresh ones change fast, worn-in ones ever more slowly, so that the step size follows about "
        "the logarithm of the steps made. It goes on from session to session, and a calibration at a "
        "session's beginning ages as the session goes on."
    )
    shows_best = "one configuration before and after as many steps as the joint has made so far"
    sentence = (
        "Steps {k:grow|shrink} by {k} for every tenfold of the steps that a joint has made, "
        "from {begin} on: the joints wear"
    )
    remedy = "calibrating more often"
    may_differ_by_joint = True
    columns = ("steps_before",)
    parameters = (
        CauseParameter("k", "%", "change of the step size per e-fold of steps"),
        CauseParameter("n0", "steps", "steps after which wear has slowed down", lower=1e3, upper=1e7),
    )
    null_values = (0.0, 1e5)
    scale = (0.005, 1e5)
    trial_values = np.column_stack([np.full(len(WEAR_SCALES), 0.005), WEAR_SCALES])
    largest_sizes = tuple((0.05, scale) for scale in WEAR_SCALES)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: for a tenfold of steps, and where it began to the order of magnitude."""
        begin = 10 ** round(log10(sizes["n0"].size.estimate))
        return {"k": sizes["k"].times(log(10)), "begin": f"{begin:,}"}

    def factor(self, state: State, values: list[Array]) -> Array:
        size, scale = values
        return 1.0 + size * np.log1p(state.column("steps_before") / scale)
