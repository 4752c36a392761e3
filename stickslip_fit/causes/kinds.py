"""The four kinds of causes, by the stage at which they act (`base`), and factors of single joints."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import DIFFERENCE_STEP, Cause, ExtendedLaw, extend
from stickslip_fit.causes.parameters import Row, SizedParameter
from stickslip_fit.errors import InputError
from stickslip_fit.laws import State, StepLaw, state_at
from stickslip_fit.machine import Machine


class StateCause(Cause):
    """A cause by which angles, load or recoil differ from what was recorded."""

    acts_at = "state"

    stage: ClassVar[int] = 3
    """1 changes angles, 2 replaces the load or recoil that follows from them, 3 alters load or recoil."""

    @abstractmethod
    def change(self, state: State, values: list[Array]) -> State:
        """The true state; each of `values` has shape (n, 1)."""


class TermCause(Cause):
    """A cause that adds to the step size, as a rule outside recoil's factor."""

    acts_at = "term"

    def unload(self, state: State) -> State:
        """The state in which the law's step size is `free`."""
        zero = np.zeros((len(state.position), 1))
        return state.with_changes(override_load=zero, override_recoil=zero)

    @abstractmethod
    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """What is added, rad or m.

        Parameters
        ----------
        free : array, shape (n, k) or (n, 1)
            Step size in the state of `unload`: without load and recoil.
        state : State
        values : list of array, each shape (n, 1)
        """

    def term_slopes(self, free: Array, state: State, values: list[Array]) -> tuple[Array, list[Array]]:
        """Derivatives of `term` by `free` and by each value; central differences unless overridden."""
        step = DIFFERENCE_STEP * free
        rise = self.term(free + step, state, values) - self.term(free - step, state, values)
        slopes = [np.zeros((1, 1))] * len(values)
        for k, size in enumerate(self.scale):
            if self.parameters[k].joint in (None, state.joint):
                width, (before, own, after) = DIFFERENCE_STEP * size, (values[:k], values[k], values[k + 1 :])
                ends = [self.term(free, state, [*before, own + sign * width, *after]) for sign in (1, -1)]
                slopes[k] = (ends[0] - ends[1]) / (2 * width)
        return rise / (2 * step), slopes


def _joints_of(rows: pd.DataFrame) -> tuple[int, ...]:
    return tuple(sorted({int(joint) for joint in rows["joint"]}))


class FactorCause(Cause):
    """A cause that multiplies the step size."""

    acts_at = "factor"

    may_differ_by_joint: ClassVar[bool] = False
    """Whether each joint may have a size of its own: the first parameter, in which the factor is linear."""

    def restricted(self, rows: pd.DataFrame) -> list[Cause]:
        """See `Cause.restricted`: each joint alone, and all with sizes of their own."""
        joints = _joints_of(rows)
        if not self.may_differ_by_joint or len(joints) < 2:
            return []
        return [OfJoints(self, own) for own in (*((joint,) for joint in joints), joints)]

    @abstractmethod
    def factor(self, state: State, values: list[Array]) -> Array:
        """The factor, shape (n, k) or (n, 1); each of `values` has shape (n, 1)."""

    def factor_slopes(self, state: State, values: list[Array]) -> Array | None:
        """Derivatives of the factor, shape (n, k, q) or (n, 1, q); None for central differences."""
        return None

    def factor_of(self, state: State, values: Array) -> Array:
        """As `factor`, from values of shape (n, q): of many parameters a list takes long."""
        return self.factor(state, list(values.T[:, :, None]))

    def local_slopes(self, state: State, values: Array) -> Array | None:
        """As `factor_slopes`, but by m numbers of each traverse that `spread` turns into values."""
        return self.factor_slopes(state, list(values.T[:, :, None]))

    def spread(self, state: State, slopes: Array) -> Array:
        """Derivatives by the values, (n, k, q), from `local_slopes`, (n, k, m): the same as a rule."""
        return slopes

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: a factor that is constant along a traverse divides its steps."""
        before, row = extend(law), self.row_values(law, rows)
        if self.under(before.law) is not self:
            return super().changes(law, rows, values, trials)
        ends = state_at(law.joint, row, np.stack([row["start"], row["stop"]], axis=-1))
        state, one = before.true_state(ends, values), np.ones((len(values), 1))
        factors = [self.factor(state, [size * one for size in trial]) for trial in trials]
        if any(factor.shape[1] > 1 for factor in factors):
            return super().changes(law, rows, values, trials)
        factor = np.concatenate([*factors, one], axis=1)[:, :-1]
        return beside_steps_added(before, rows, values, ends, -np.log(factor))


def beside_steps_added(law: ExtendedLaw, rows: Row, values: Array, ends: State, changes: Array) -> Array:
    """Changes of the response, (n, m), by those of the logarithm of the steps that count causes add to."""
    added = law.steps_added(ends, values)[:, None]
    if not added.any():
        return changes
    steps = np.exp(law.predict(rows, values))[:, None]
    return np.asarray(np.log((steps - added) * np.exp(changes) + added) - np.log(steps))


_OF_CAUSE = (
    *("name", "phrase", "physics", "shows_best", "remedy", "kind", "needs_geometry", "columns"),
    *("max_panel", "varies_along_traverse", "affects_stop_only"),
)


@dataclass(frozen=True)
class OfJoints(FactorCause):
    """A factor that acts on some joints, on each with a size of its own.

    Its parameters are the sizes, joint by joint, then the other ones of the cause, which the joints share.

    Parameters
    ----------
    cause : FactorCause
        One whose size may differ by joint (`FactorCause.may_differ_by_joint`).
    on : tuple of int
        The joints.
    others : tuple of float, optional
        Values of the other parameters where trials of its sizes act in combination.

    Raises
    ------
    InputError
        For a cause whose size is not one number for all joints, or no joint.
    """

    cause: Any
    on: tuple[int, ...]
    others: tuple[float, ...] = ()

    is_restricted = True

    def __post_init__(self) -> None:
        if not (isinstance(self.cause, FactorCause) and self.cause.may_differ_by_joint and self.on):
            raise InputError(f"{self.cause!r} has no size that could differ by joint, or no joint was given")
        own = {name: getattr(self.cause, name) for name in _OF_CAUSE}
        (size, *more), n = self.cause.parameters, len(self.on)
        own["parameters"] = (*(replace(size, joint=joint) for joint in self.on), *more)
        own["scale"] = self._spread(self.cause.scale)
        absent, *usual = self.cause.null_values
        own["null_values"] = self._spread((absent, *(self.others or usual)))
        own["combine_trials"] = n > 1
        own["session"] = self.cause.session if n == 1 else ""  # trials of one session do not act together
        for name, value in own.items():
            object.__setattr__(self, name, value)

    def _spread(self, values: Sequence[float]) -> tuple[float, ...]:
        """Values of the cause as those of this one: its size on every joint."""
        return (*[values[0]] * len(self.on), *values[1:])

    @property
    def start_values(self) -> tuple[float, ...]:
        """See `Cause.start_values`: without a size nothing else would matter."""
        return (*self.scale[: len(self.on)], *self.null_values[len(self.on) :])

    def acts_on(self, law: StepLaw) -> bool:
        return law.joint in self.on

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: the sizes of each trial of the cause in any combination."""
        if (n := len(self.on)) == 1:
            return [(replace(self, cause=one), trials) for one, trials in self.cause.trials(rows)]
        return [
            (
                replace(self, cause=one, others=tuple(own[1:].tolist())),
                np.column_stack([own[0] * np.eye(n), np.tile(own[1:], (n, 1))]),
            )
            for one, trials in self.cause.trials(rows)
            for own in trials
        ]

    def finer_trials(self, rows: pd.DataFrame, values: Array) -> Array:
        """See `Cause.finer_trials`: with the sizes given."""
        n = len(self.on)
        finer = self.cause.finer_trials(rows, values[n - 1 :])
        return np.column_stack([np.tile(values[:n], (len(finer), 1)), finer[:, 1:]])

    def combine(self, shares: Array, trials: Array) -> Array:
        n = len(self.on)
        return np.concatenate([shares @ trials[:, :n], trials[0, n:]])

    def largest_plausible(self) -> tuple[Array, ...]:
        return tuple(np.array(self._spread(own.tolist())) for own in self.cause.largest_plausible())

    def factor(self, state: State, values: list[Array]) -> Array:
        return self.cause.factor(state, [values[self.on.index(state.joint)], *values[len(self.on) :]])

    def under(self, law: StepLaw) -> Cause:
        own: Any = self.cause.under(law)
        return self if own is self.cause else own.with_cause(self)

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        described = self.cause.describe(parameters)
        if len(self.on) > 1:
            return described
        return described.replace("Steps ", f"The steps of joint {self.on[0]} ", 1)

    def readable(self, parameters: Sequence[SizedParameter]) -> tuple[SizedParameter, ...]:
        return self.cause.readable(parameters)

    def bind(self, rows: pd.DataFrame, machine: Machine) -> OfJoints:
        return replace(self, cause=self.cause.bind(rows, machine))

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return self.cause.explain_missing(rows[rows["joint"].isin(self.on)])


@dataclass(frozen=True)
class OnSomeJoints(Cause):
    """A cause that may act on one joint alone, as an end-stop detector that stands at that joint does.

    Attributes
    ----------
    on : tuple of int
        The joints; empty for all.
    """

    on: tuple[int, ...] = field(default=(), kw_only=True)

    @property
    def is_restricted(self) -> bool:
        return bool(self.on)

    def acts_on(self, law: StepLaw) -> bool:
        return (not self.on or law.joint in self.on) and super().acts_on(law)

    def restricted(self, rows: pd.DataFrame) -> list[Cause]:
        """See `Cause.restricted`: each joint alone."""
        joints = _joints_of(rows)
        return [] if self.on or len(joints) < 2 else [replace(self, on=(joint,)) for joint in joints]

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        """See `Cause.describe`; with the joint."""
        described = super().describe(parameters)
        return f"{described}, at joint {self.on[0]} only" if self.on else described


class CountCause(Cause):
    """A cause that adds steps to the count."""

    acts_at = "count"

    @abstractmethod
    def steps(self, state: State, values: list[Array]) -> Array:
        """Steps added, shape (n, 1); each of `values` has shape (n, 1)."""
