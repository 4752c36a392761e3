"""Cause: a systematic effect that a published law leaves out, and its four kinds.

The model of a traverse is evaluated in a fixed order: state (angles, then load and recoil), law, terms
added to the step size, factors on it, steps over the traverse, steps added to the count. A cause acts
at exactly one of these stages. A sudden change has its time as a parameter; candidate times lie between
traverses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes._integration import AdaptiveCounter
from stickslip_fit.causes.parameters import (
    CauseParameter,
    Row,
    SizedParameter,
    Sizes,
    known_of,
    plain_description,
)
from stickslip_fit.laws import Configuration, Rows, State, StepLaw, float_column, state_at
from stickslip_fit.laws.base import Counter
from stickslip_fit.machine import Machine

# Of the scale of each parameter, for derivatives by central differences: good to some ten digits.
APART = 1e-5


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
    affects_stop_only : bool
        Whether it is in hearing the stop, and not in the motion on the way there.
    most : float
        Where `largest` is empty: how many times as large as in its trials the first parameter may be.
    max_panel : float
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
    affects_stop_only: ClassVar[bool] = False
    most: ClassVar[float] = 10.0
    max_panel: float = np.inf

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
        return self.max_panel

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

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Cause:
        """The cause as it acts in a log: with the means and ranges that its equation refers to."""
        return self

    def missing(self, rows: pd.DataFrame) -> str | None:
        """Why a log cannot show it, or None where nothing is missing."""
        if not rows["joint"].isin(self.joints).any():
            return f"the log has no traverse of joint {' or '.join(map(str, self.joints))}"
        return None

    def departures(self, values: Array, misfire_draws: Array) -> Array:
        """Log steps by which counts are off by chance, (n, q) and (n, 3) -> (n,); none unless overridden."""
        return np.zeros(len(values))

    def _acts_on(self, joint: int, trials: Array) -> npt.NDArray[np.bool_]:
        """Which trials give a parameter that concerns a joint another value than that of no effect."""
        subset = [each.joint in (None, joint) for each in self.parameters]
        return np.any((trials != np.array(self.absent)) & subset, axis=1)


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


class Composition(StepLaw):
    """What a published law and causes make together of a state.

    Parameters
    ----------
    law : StepLaw
    causes : sequence of Cause
        Bound to a log; see `Cause.bound`.

    Attributes
    ----------
    common : tuple of CauseParameter
        The causes' parameters, the last of all: one number each for the whole campaign.
    """

    def __init__(self, law: StepLaw, causes: Sequence[Cause]) -> None:
        self.law = law
        self.causes = tuple(causes)
        self.joint = law.joint
        self.common = tuple(_named(cause, each) for cause in causes for each in cause.parameters)
        self.parameters = (*law.parameters, *self.common)

    @cached_property
    def active_causes(self) -> tuple[tuple[Cause, range], ...]:
        """The causes that act on the joint, each with the places of its parameters."""
        found, first = [], len(self.law.parameters)
        for cause in self.causes:
            places = range(first, first + len(cause.parameters))
            first = places.stop
            if self.joint in cause.joints:
                found.append((cause, places))
        return tuple(found)

    @property
    def affects_joint(self) -> BoolArray:
        """Which parameters say anything of this joint, shape (p,)."""
        places = {k for _, places in self.active_causes for k in places}
        own = len(self.law.parameters)
        subset = [
            each.joint in (None, self.joint) and own + k in places for k, each in enumerate(self.common)
        ]
        return np.array([True] * own + subset)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        true = self.true_state(state, values)
        return self._before_factors(true, values) * self._factor(true, values)

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`; by the causes' parameters from central differences."""
        true = self.true_state(state, values)
        before, factor = self._before_factors(true, values), self._factor(true, values)
        own = self._own_slopes(true, values) * factor[..., None]
        slopes = [*np.moveaxis(own, -1, 0), *np.zeros((len(self.common), len(values), 1))]
        ways: dict[type[Any], Callable[[Array], Array]] = {
            StateCause: lambda there: self.gamma(state, there),
            TermCause: lambda there: self._before_factors(true, there) * factor,
            FactorCause: lambda there: before * self._factor(true, there),
        }
        for kind, function in ways.items():
            for _, places in self.by_stage[kind]:
                for k in places:
                    slopes[k] = self.difference(function, values, k)
        return np.stack(np.broadcast_arrays(*slopes), axis=-1)

    def true_state(self, state: State, values: Array) -> State:
        """The state as the causes have it: angles, then what follows from them, then what alters that."""
        for cause, places in self.by_stage[StateCause]:
            state = cause.change(state, _sizes(values, places))
        return state

    def steps_added(self, state: State, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,); `state` where it begins."""
        added = [
            cause.steps(state, _sizes(values, places))[:, 0] for cause, places in self.by_stage[CountCause]
        ]
        return np.sum(added, axis=0) if added else np.zeros(len(values))

    @cached_property
    def by_stage(self) -> dict[type[Any], list[tuple[Any, range]]]:
        """The acting causes by the station at which they act; states in the order of their turns."""
        found: dict[type[Any], list[tuple[Any, range]]] = {
            kind: [(cause, places) for cause, places in self.active_causes if isinstance(cause, kind)]
            for kind in (TermCause, FactorCause, CountCause)
        }
        states = [(cause, places) for cause, places in self.active_causes if isinstance(cause, StateCause)]
        return found | {StateCause: sorted(states, key=lambda acting: acting[0].turn)}

    def _before_factors(self, true: State, values: Array) -> Array:
        """The law and the terms added to it."""
        own = values[:, : len(self.law.parameters)]
        gamma, terms = self.law.gamma(true, own), self.by_stage[TermCause]
        free = self.law.gamma(_unloaded(true), own) if terms else gamma
        return gamma + sum(cause.term(free, true, _sizes(values, places)) for cause, places in terms)

    def _factor(self, true: State, values: Array) -> Array:
        factor = np.ones((len(values), 1))
        for cause, places in self.by_stage[FactorCause]:
            factor = factor * cause.factor(true, _sizes(values, places))
        return factor

    def _own_slopes(self, true: State, values: Array) -> Array:
        """Derivatives of `_before_factors` by the law's own parameters; terms follow the free step size."""
        own = values[:, : len(self.law.parameters)]
        slopes, terms = self.law.gamma_slopes(true, own), self.by_stage[TermCause]
        if terms:
            free, by_free = self.law.gamma(_unloaded(true), own), self.law.gamma_slopes(_unloaded(true), own)
            for cause, places in terms:
                sizes, step = _sizes(values, places), APART * free
                rise = cause.term(free + step, true, sizes) - cause.term(free - step, true, sizes)
                slopes = slopes + (rise / (2 * step))[..., None] * by_free
        return slopes

    def difference(self, function: Callable[[Array], Array], values: Array, k: int) -> Array:
        """Derivative of a function of the values by that of one of a cause's parameters."""
        step = APART * self.sizes[k - len(self.law.parameters)]
        ahead, behind = values.copy(), values.copy()
        ahead[:, k] += step
        behind[:, k] -= step
        return (function(ahead) - function(behind)) / (2 * step)

    @property
    def sizes(self) -> Array:
        """A size of each of the causes' parameters that matters, shape (q,)."""
        return np.array([size for cause in self.causes for size in cause.scale], dtype=float)


def _named(cause: Cause, parameter: CauseParameter) -> CauseParameter:
    only = f"{parameter.joint or ''}{parameter.direction or ''}{parameter.session or ''}"
    name = f"{cause.name}.{parameter.name}" + (f"[{only}]" if only else "")
    return replace(parameter, name=name)


def _sizes(values: Array, places: range) -> list[Array]:
    """A cause's own values, each of shape (n, 1)."""
    return [values[:, k, None] for k in places]


def _unloaded(state: State) -> State:
    still = np.zeros((len(state.position), 1))
    return state.with_changes(override_load=still, override_recoil=still)


POSE = ("q1", "q2", "q3", "theta", "psi")
AT_ONCE = 4096  # rows; with all the positions that a worn spot takes, arrays stay small


class ExtendedLaw(Composition):
    """A published law and the causes by which a joint departs from it.

    Its parameters are the law's own, then those of each cause under ``cause.parameter``, followed by the
    joint, direction or session in brackets where it is that of one only.
    """

    name = "extended"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`; rows may lack those for which `known_of` has something to stand in."""
        needed = [
            *POSE,
            *self.law.columns,
            *(name for cause, _ in self.active_causes for name in cause.columns),
        ]
        return tuple(dict.fromkeys(needed))

    @property
    def max_panel(self) -> float:  # type: ignore[override]
        """See `StepLaw.widest`."""
        return min([self.law.max_panel, *(cause.max_panel for cause, _ in self.active_causes)])

    def panel(self, values: Array) -> float:
        """As `widest`, for given values, shape (n, p)."""
        seen = (cause.panel(values[:, places.start : places.stop]) for cause, places in self.active_causes)
        return min([self.law.max_panel, *seen])

    @cached_property
    def along(self) -> bool:
        """Whether a cause makes the step size change along a traverse otherwise than the law itself does."""
        return any(cause.along for cause, _ in self.active_causes)

    @property
    def absent(self) -> Array:
        """Values of the causes' parameters under which the law is the published one, shape (q,)."""
        return np.array([value for cause in self.causes for value in cause.absent], dtype=float)

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; NaN where the step size is not above 0."""
        parts = self.parts(rows)

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(float_column(rows, "start")), len(self.parameters)))
            found = [self._counted(part, values[subset]) for subset, part in parts]
            counts, slopes = zip(*found, strict=True)
            return np.concatenate(counts), np.concatenate(slopes)

        return count

    def predict(self, rows: Rows, values: Array) -> Array:
        """See `StepLaw.predict`; without the derivatives, which take most of the time."""
        values = np.broadcast_to(values, (len(float_column(rows, "start")), len(self.parameters)))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(self.steps(rows)(values))

    def steps(self, rows: Rows) -> Callable[[Array], Array]:
        """Steps over each traverse as a function of the values, shape (n, p) -> (n,)."""
        parts = self.parts(rows)

        def count(values: Array) -> Array:
            return np.concatenate(
                [
                    part.counts(values[subset]) + self.steps_added(part.here, values[subset])
                    for subset, part in parts
                ]
            )

        return count

    def parts(self, rows: Rows) -> list[tuple[slice, AdaptiveCounter]]:
        """The traverses, so many at once as keep memory small."""
        known = known_of(rows, self.columns)
        ends = range(0, max(len(known["start"]), 1), AT_ONCE)
        slices = [slice(first, first + AT_ONCE) for first in ends]
        return [
            (subset, AdaptiveCounter(self, {name: of[subset] for name, of in known.items()}))
            for subset in slices
        ]

    def step_size(self, rows: Rows, position: Array, values: Array) -> Array:
        """See `StepLaw.step_size`."""
        return super().step_size(known_of(rows, self.columns), position, values)

    def in_motion(self, values: Array) -> Array:
        """Values with all that is in hearing the stop left out, shape (p,) or (n, p)."""
        moving = np.array(values, dtype=float)
        for cause, places in self.active_causes:
            if cause.affects_stop_only:
                moving[..., places.start : places.stop] = cause.absent
        return moving

    def added(self, rows: Rows, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,)."""
        return np.concatenate(
            [self.steps_added(part.here, values[subset]) for subset, part in self.parts(rows)]
        )

    def misfires(self, values: Array, misfire_draws: Array) -> Array:
        """Log steps by which counts are off, (n, p) and (n, 3) -> (n,); see `EndStopMisfire.departures`."""
        off = [
            cause.departures(values[:, places.start : places.stop], misfire_draws)
            for cause, places in self.active_causes
        ]
        return np.sum(off, axis=0) if off else np.zeros(len(values))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`: the law's own, with the causes absent."""
        return _beside(self.law.start_values(mean_step), self.absent)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return _beside(self.law.scales(mean_step), self.sizes)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of the law, and every number that a cause looks at."""
        known = known_of(rows, self.columns)
        seen = [values.astype(float) for values in known.values() if values.dtype.kind in "fiu"]
        return np.column_stack([self.law.features(rows), *seen])

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: that of the law itself."""
        return self.law.calibration()

    def _counted(self, part: AdaptiveCounter, values: Array) -> tuple[Array, Array]:
        counts, slopes = part.counts_and_slopes(values)
        for _, places in self.by_stage[CountCause]:
            for k in places:
                slopes[:, k] += self.difference(lambda there: self.steps_added(part.here, there), values, k)
        return counts + self.steps_added(part.here, values), slopes


def extend(law: StepLaw, cause: Cause) -> ExtendedLaw:
    """A law with one cause more.

    Parameters
    ----------
    law : StepLaw
        Published or already extended.
    cause : Cause
        Bound to a log.
    """
    return extend_by(law, (cause,))


def extend_by(law: StepLaw, causes: Sequence[Cause]) -> ExtendedLaw:
    """A law with any number of causes more, none included."""
    if isinstance(law, ExtendedLaw):
        return ExtendedLaw(law.law, (*law.causes, *causes))
    return ExtendedLaw(law, causes)


def _beside(own: Array, same: Array) -> Array:
    """Columns of the law's own and, the same for every group, those of the causes."""
    return np.concatenate([own, np.broadcast_to(same, (len(own), len(same)))], axis=1)
