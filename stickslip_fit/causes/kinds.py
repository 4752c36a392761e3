"""The four kinds of causes, by the stage at which they act; see `base`."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import DIFFERENCE_STEP, Cause, extend
from stickslip_fit.causes.parameters import Row
from stickslip_fit.laws import State, StepLaw, state_at


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


class FactorCause(Cause):
    """A cause that multiplies the step size."""

    acts_at = "factor"

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
        added = before.steps_added(ends, values)[:, None]
        if not added.any():
            return -np.log(factor)
        steps = np.exp(law.predict(rows, values))[:, None]
        return np.log((steps - added) / factor + added) - np.log(steps)


class CountCause(Cause):
    """A cause that adds steps to the count."""

    acts_at = "count"

    @abstractmethod
    def steps(self, state: State, values: list[Array]) -> Array:
        """Steps added, shape (n, 1); each of `values` has shape (n, 1)."""
