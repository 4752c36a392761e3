"""What every cause is: a reason why a step size is not what the published law says.

Whatever is known of a traverse goes through the same stations, in this order: the state (angles, then load
and recoil), the law, terms added to the step size, factors on it, the steps over the traverse, steps added
to the count. A cause acts at exactly one of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import capitalize_first, format_estimate, format_number
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.laws import Parameter, Rows, State, StepLaw, column, state_at
from stickslip_fit.logs.columns import CONDITIONS, COVARIATE
from stickslip_fit.machine import Machine
from stickslip_fit.units import Interval

if TYPE_CHECKING:
    from stickslip_fit.causes.extended_law import ExtendedLaw

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

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


@dataclass(frozen=True)
class SizedParameter:
    """A parameter of a cause that acts in a log, SI, with its interval of 95 %.

    In ``sentence.format(k=...)`` ``{k}`` is its size with its unit, ``{k:+}`` the same with its sign,
    ``{k:.2f}`` the bare number, and of ``{k:grow|shrink}`` the first word if it is above 0, else the second.

    Attributes
    ----------
    name, unit : str
        The unit is the one people read it in.
    size : Interval
    joint : int or None
    direction, session : str or None
    """

    name: str
    unit: str
    size: Interval
    joint: int | None = None
    direction: str | None = None
    session: str | None = None

    def times(self, factor: float, unit: str = "") -> SizedParameter:
        """The parameter times a factor, read in another unit if one is given."""
        return replace(self, size=self.size.times(factor), unit=unit or self.unit)

    def __format__(self, form: str) -> str:
        positive, either, other = form.partition("|")
        if either:
            return positive if self.size.estimate > 0 else other
        if form.endswith("f"):
            return format_number(self.size.estimate, self.unit, int(form[1:-1]))
        return format_estimate(self.size, self.unit, signed=form == "+")


Sizes = Mapping[str, SizedParameter]
"""Parameters of a cause by name."""


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
    sentence : str
        What it does in a log, with `quantities` in braces as `SizedParameter` says; no full stop. Empty where
        its phrase and the numbers say it all.
    remedy : str
        What a lab can do about it, to begin a sentence with ("waiting until it is warm"); empty where nothing
        helps but a law that knows of it.
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
    forms : tuple of str
        Shapes between which it chooses by its field `form`.
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
    sentence: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    joints: ClassVar[tuple[int, ...]] = (1, 2, 3)
    session: str = ""
    columns: ClassVar[tuple[str, ...]] = ()
    parameters: tuple[CauseParameter, ...]
    absent: tuple[float, ...]
    scale: tuple[float, ...]
    forms: ClassVar[tuple[str, ...]] = ()
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

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        """What it does in a log, by the sizes of its parameters, without a full stop.

        Parameters
        ----------
        parameters : sequence of SizedParameter
            Where the sentence takes more than is known, the phrase and what is known.
        """
        try:
            known = self.quantities({each.name: each for each in parameters})
            return self.sentence.format_map(known) or plain_description(self.phrase, parameters)
        except KeyError:
            return plain_description(self.phrase, parameters)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """What `sentence` may have in braces, by name: the parameters and the session, unless overridden.

        A KeyError says that a size which it takes is not known.
        """
        return {**sizes, "session": self.session}

    def extend(self, law: StepLaw) -> ExtendedLaw:
        """`law` with this cause in it."""
        from stickslip_fit.causes.extended_law import extend

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
        from stickslip_fit.causes.extended_law import extend_by

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


def plain_description(phrase: str, parameters: Sequence[SizedParameter]) -> str:
    """A cause by its phrase, with the sizes of its parameters.

    Examples
    --------
    >>> plain_description("the moon shines", [SizedParameter("k", "%", Interval(0.02, 0.01, 0.03))])
    'The moon shines (k = 2 %)'
    """
    sizes = ", ".join(f"{each.name} = {each:+}" for each in parameters)
    return capitalize_first(phrase) + (f" ({sizes})" if sizes else "")


def missing_column(rows: pd.DataFrame, name: str) -> str | None:
    """Why a column cannot explain anything, or None: it is empty, or the same within every session."""
    label = CONDITIONS[name].label if name in CONDITIONS else f"column {name.removeprefix(COVARIATE)}"
    values = pd.to_numeric(rows[name], errors="coerce") if name in rows else pd.Series(dtype=float)
    if not values.notna().any():
        return f"the log has no {label}"
    by_session = values.groupby(rows["session"])
    if not (by_session.max() > by_session.min()).any():
        return f"{label} is the same within every session, and each session is calibrated by itself"
    return None


def filled(values: Array, mean: float) -> Array:
    """Empty cells count as the mean, and so do nothing."""
    return np.where(np.isnan(values), mean, values)


# A joint's first traverse of a session follows none.
FIRST = {"before_direction": "", "before_load": 0.0}
NEEDED = {
    "session": "the session's name",
    "session_seconds": "the time since the session's first traverse, s",
    "steps_before": "the steps that the joint has made so far",
}


def known_of(rows: Rows, columns: Iterable[str]) -> dict[str, Any]:
    """Start, stop and the given columns of each traverse, as arrays of shape (n,).

    A joint that nothing is said of follows no other traverse, under the log's mean conditions (as an empty
    cell does). How long a session has run and how many steps a joint has made have no such value.

    Raises
    ------
    InputError
        For a column that is not there and has none.

    Examples
    --------
    >>> known_of({"start": [0.0], "stop": [0.012]}, ["temperature"])["temperature"]
    array([nan])
    """
    known: dict[str, Any] = {"start": column(rows, "start"), "stop": column(rows, "stop")}
    lacking = [name for name in columns if name in NEEDED and name not in rows]
    if lacking:
        raise InputError([Problem(f"the law needs {NEEDED[name]}: give it", column=name) for name in lacking])
    for name in columns:
        stands_in = np.full(len(known["start"]), FIRST.get(name, np.nan))
        known[name] = np.asarray(rows[name]) if name in rows else stands_in
    return known


# In a session, in a log, and as many as a session has in any case: between two of them a change is seen
# nearly as well.
MOST, ABOUT, LEAST = 120, 700, 6
FEWEST = 3  # traverses on either side


def moments(rows: pd.DataFrame) -> list[tuple[str, Array]]:
    """Halfway between traverses, for each session that has enough of them; s from its first."""
    found, every = [], len(rows) / ABOUT
    for session, mine in rows.groupby(rows["session"].astype(object), sort=False):
        seconds = np.unique(mine["session_seconds"].to_numpy(float))
        between = ((seconds[1:] + seconds[:-1]) / 2)[FEWEST - 1 : 1 - FEWEST]
        if len(between):
            apart = max(len(between) / MOST, min(every, len(between) / LEAST))
            found.append((str(session), between[:: int(np.ceil(apart))]))
    return found


def moment_of(session: str) -> CauseParameter:
    """The parameter that says when, in a session, something changed for good."""
    meaning = "when, from the session's first traverse"
    return CauseParameter("moment", "min", meaning, lower=0.0, session=session, sudden=True)


def since(state: State, session: str, moment: Array) -> Mask:
    """Whether each traverse is one of a session and begins at its moment or later; (n, 1) -> (n, 1)."""
    mine = np.asarray(state.row["session"], dtype=object) == session
    return mine[:, None] & (state.column("session_seconds") >= moment)


def changes_since(
    changes: Callable[[dict[str, Any], Array, Array], Array],
    known: dict[str, Any],
    values: Array,
    session: str,
    trials: Array,
) -> Array:
    """Changes by trials (size, moment): those that a size makes at all times, from its moment on.

    Parameters
    ----------
    changes : callable
        As `Cause.changes`, of a cause that changes a traverse by the whole or not at all.
    known : dict of str to array, shape (n,)
    values : array, shape (n, p)
    session : str
    trials : array, shape (m, 2)

    Returns
    -------
    array, shape (n, m)
    """
    found = np.zeros((len(values), len(trials)))
    mine = np.flatnonzero(np.asarray(known["session"], dtype=object) == session)
    sizes, which = np.unique(trials[:, 0], return_inverse=True)
    at_all_times = np.column_stack([sizes, np.full(len(sizes), -np.inf)])
    there = {name: of[mine] for name, of in known.items()}
    after = there["session_seconds"][:, None] >= trials[:, 1]
    found[mine] = changes(there, values[mine], at_all_times)[:, which] * after
    return found
