"""The step size of a law with causes in it: from state to step size, station by station."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from stickslip_fit.causes.cause import Cause, CauseParameter, CountCause, FactorCause, StateCause, TermCause
from stickslip_fit.causes.counting import Mask
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.laws.law import Array

# Of the scale of each parameter, for derivatives by central differences: good to some ten digits.
APART = 1e-5


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
    def acting(self) -> tuple[tuple[Cause, range], ...]:
        """The causes that act on the joint, each with the places of its parameters."""
        found, first = [], len(self.law.parameters)
        for cause in self.causes:
            places = range(first, first + len(cause.parameters))
            first = places.stop
            if self.joint in cause.joints:
                found.append((cause, places))
        return tuple(found)

    @property
    def concerned(self) -> Mask:
        """Which parameters say anything of this joint, shape (p,)."""
        places = {k for _, places in self.acting for k in places}
        own = len(self.law.parameters)
        mine = [each.joint in (None, self.joint) and own + k in places for k, each in enumerate(self.common)]
        return np.array([True] * own + mine)

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
            for _, places in self.by_station[kind]:
                for k in places:
                    slopes[k] = self.difference(function, values, k)
        return np.stack(np.broadcast_arrays(*slopes), axis=-1)

    def true_state(self, state: State, values: Array) -> State:
        """The state as the causes have it: angles, then what follows from them, then what alters that."""
        for cause, places in self.by_station[StateCause]:
            state = cause.change(state, _sizes(values, places))
        return state

    def steps_added(self, state: State, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,); `state` where it begins."""
        added = [
            cause.steps(state, _sizes(values, places))[:, 0] for cause, places in self.by_station[CountCause]
        ]
        return np.sum(added, axis=0) if added else np.zeros(len(values))

    @cached_property
    def by_station(self) -> dict[type[Any], list[tuple[Any, range]]]:
        """The acting causes by the station at which they act; states in the order of their turns."""
        found: dict[type[Any], list[tuple[Any, range]]] = {
            kind: [(cause, places) for cause, places in self.acting if isinstance(cause, kind)]
            for kind in (TermCause, FactorCause, CountCause)
        }
        states = [(cause, places) for cause, places in self.acting if isinstance(cause, StateCause)]
        return found | {StateCause: sorted(states, key=lambda acting: acting[0].turn)}

    def _before_factors(self, true: State, values: Array) -> Array:
        """The law and the terms added to it."""
        own = values[:, : len(self.law.parameters)]
        gamma, terms = self.law.gamma(true, own), self.by_station[TermCause]
        free = self.law.gamma(_unloaded(true), own) if terms else gamma
        return gamma + sum(cause.term(free, true, _sizes(values, places)) for cause, places in terms)

    def _factor(self, true: State, values: Array) -> Array:
        factor = np.ones((len(values), 1))
        for cause, places in self.by_station[FactorCause]:
            factor = factor * cause.factor(true, _sizes(values, places))
        return factor

    def _own_slopes(self, true: State, values: Array) -> Array:
        """Derivatives of `_before_factors` by the law's own parameters; terms follow the free step size."""
        own = values[:, : len(self.law.parameters)]
        slopes, terms = self.law.gamma_slopes(true, own), self.by_station[TermCause]
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
    return state.but(given_load=still, given_recoil=still)
