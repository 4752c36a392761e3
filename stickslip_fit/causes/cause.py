"""What every cause is: a reason why a step size is not what the published law says.

Whatever is known of a traverse goes through the same stations, in this order: the state (angles, then load
and recoil), the law, terms added to the step size, factors on it, the steps over the traverse, steps added
to the count. A cause acts at exactly one of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes.conditions import known_of
from stickslip_fit.laws import Parameter, State, StepLaw, state_at
from stickslip_fit.machine import Machine

if TYPE_CHECKING:
    from stickslip_fit.causes.extended import ExtendedLaw

Array = npt.NDArray[np.float64]
Row = Mapping[str, Any]
"""Quantities of each traverse by name, arrays of shape (n,)."""


@dataclass(frozen=True)
class CauseParameter(Parameter):
    """A parameter of a cause: one number for the whole campaign, or for one joint, direction or session.

    Attributes
    ----------
    joint : int or None
    direction, session : str or None
    sudden : bool
        The response jumps as it changes, so that it is chosen among trials; slopes say nothing of it.
    """

    joint: int | None = None
    direction: str | None = None
    session: str | None = None
    sudden: bool = False


class Cause(ABC):
    """A cause holds no parameter values: they are handed to it, shape (q,) or (n, q), SI.

    Attributes
    ----------
    name : str
        As code, reports and tests call it.
    phrase : str
        What is the matter, to go into a sentence.
    physics : str
        A paragraph on what happens, with its source.
    shows_best : str
        The traverse that would show it best.
    joints : tuple of int
        On which it acts.
    session : str
        The only one in which it acts; empty where it acts in all.
    columns : tuple of str
        Quantities of a traverse that it needs, beside where the joints and the base stand.
    parameters : tuple of CauseParameter
    absent : tuple of float
        Values under which it does nothing.
    scale : tuple of float
        A size of each parameter, or a change of it, that matters.
    along : bool
        Whether it changes along a traverse beyond what the law itself does.
    joined : bool
        Whether a version's trials act in any combination, and not one at a time.
    of_stop : bool
        Whether it is in hearing the stop, and not in the motion on the way there.
    most : float
        Where `largest` is empty: how many times as large as in its trials the first parameter may be.
    widest : float
        Widest panel, rad or m, that still sees it along a traverse.
    """

    name: ClassVar[str]
    phrase: ClassVar[str]
    physics: ClassVar[str]
    shows_best: ClassVar[str]
    joints: ClassVar[tuple[int, ...]] = (1, 2, 3)
    session: str = ""
    columns: ClassVar[tuple[str, ...]] = ()
    parameters: tuple[CauseParameter, ...]
    absent: tuple[float, ...]
    scale: tuple[float, ...]
    along: ClassVar[bool] = False
    joined: ClassVar[bool] = False
    of_stop: ClassVar[bool] = False
    most: ClassVar[float] = 10.0
    widest: float = np.inf

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """What to look for in a log: `scale` itself, unless a cause has more to it.

        Returns
        -------
        list of (Cause, array of shape (m, q))
            Versions of the cause that differ by more than numbers (a session, a form), each with values that
            between them stand for all it may do; sizes are such as a lab may meet.
        """
        return [(self, np.array([self.scale]))]

    def panel(self, values: Array) -> float:
        """As `widest`, for given values, shape (n, q)."""
        return self.widest

    def largest(self) -> tuple[Array, ...]:
        """The largest plausible sizes, each shape (q,): if not even they show in a log, it is untestable.

        Empty where they are those of `trials`, `most` times as large.
        """
        return ()

    def extend(self, law: StepLaw) -> ExtendedLaw:
        """`law` with this cause in it."""
        from stickslip_fit.causes.extended import extend

        return extend(law, self)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """Change of the response that each trial makes, shape (m, q) -> (n, m).

        Parameters
        ----------
        law : StepLaw
        rows : mapping of str to array, shape (n,)
        values : array, shape (n, p)
            The law's parameters.
        trials : array, shape (m, q)
        """
        steps, here = self.extend(law).steps(rows), law.predict(rows, values)
        both = np.concatenate([values, np.empty((len(values), trials.shape[1]))], axis=1)
        found = np.zeros((len(values), len(trials)))
        for k in np.flatnonzero(self._acts_on(law.joint, trials)):
            both[:, values.shape[1] :] = trials[k]
            found[:, k] = np.log(steps(both)) - here
        return found

    def known(self, law: StepLaw, rows: Row) -> dict[str, Any]:
        """What a law with this cause in it has to know of each traverse; see `known_of`."""
        return known_of(rows, self.extend(law).columns)

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Cause:
        """The cause as it acts in a log: with the means and ranges that its equation refers to."""
        return self

    def missing(self, rows: pd.DataFrame) -> str | None:
        """Why a log cannot show it, or None where nothing is missing."""
        if not rows["joint"].isin(self.joints).any():
            return f"the log has no traverse of joint {' or '.join(map(str, self.joints))}"
        return None

    def _acts_on(self, joint: int, trials: Array) -> npt.NDArray[np.bool_]:
        """Which trials give a parameter that concerns a joint another value than that of no effect."""
        mine = [each.joint in (None, joint) for each in self.parameters]
        return np.any((trials != np.array(self.absent)) & mine, axis=1)


class StateCause(Cause):
    """A cause by which angles, load or recoil are not what was written down."""

    turn: ClassVar[int] = 3
    """When: 1 for one that changes angles, 2 that puts a load or a recoil in place of the one that follows
    from them, 3 that alters those as it finds them."""

    @abstractmethod
    def change(self, state: State, values: list[Array]) -> State:
        """The state as it truly is; each of `values` has shape (n, 1)."""


class TermCause(Cause):
    """A cause that adds to the step size, outside recoil's factor."""

    @abstractmethod
    def term(self, free: Array, state: State, values: list[Array]) -> Array:
        """What is added, rad or m.

        Parameters
        ----------
        free : array, shape (n, k) or (n, 1)
            Step size without load and recoil.
        state : State
        values : list of array, each shape (n, 1)
        """


class FactorCause(Cause):
    """A cause that multiplies the step size."""

    @abstractmethod
    def factor(self, state: State, values: list[Array]) -> Array:
        """The factor, shape (n, k) or (n, 1); each of `values` has shape (n, 1)."""

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: a factor that stays the same along a traverse divides its steps."""
        from stickslip_fit.causes.extended import extend_by

        before, known = extend_by(law, ()), self.known(law, rows)
        ends = state_at(law.joint, known, np.stack([known["start"], known["stop"]], axis=-1))
        state, one = before.true_state(ends, values), np.ones((len(values), 1))
        factors = [self.factor(state, [size * one for size in trial]) for trial in trials]
        if any(factor.shape[1] > 1 for factor in factors):
            return super().changes(law, rows, values, trials)
        factor = np.concatenate([*factors, one], axis=1)[:, :-1]
        added = before.steps_added(ends, values)[:, None]
        if not added.any():
            return -np.log(factor)
        whole = np.exp(law.predict(rows, values))[:, None]
        return np.log((whole - added) / factor + added) - np.log(whole)


class CountCause(Cause):
    """A cause that adds steps to the count."""

    @abstractmethod
    def steps(self, state: State, values: list[Array]) -> Array:
        """Steps added, shape (n, 1); each of `values` has shape (n, 1)."""


def missing_column(rows: pd.DataFrame, name: str, called: str) -> str | None:
    """Why a column cannot explain anything, or None: it is empty, or the same within every session."""
    values = pd.to_numeric(rows[name], errors="coerce") if name in rows else pd.Series(dtype=float)
    if not values.notna().any():
        return f"the log has no {called}"
    by_session = values.groupby(rows["session"])
    if not (by_session.max() > by_session.min()).any():
        return f"{called} is the same within every session, and each session is calibrated by itself"
    return None


def filled(values: Array, mean: float) -> Array:
    """Empty cells count as the mean, and so do nothing."""
    return np.where(np.isnan(values), mean, values)
