"""Traverses whose steps are counted again and again under one law, each time as closely as it takes."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Protocol

import numpy as np

from stickslip_fit.causes.counting import Array, Counting, Even, Mask, Panels, Swinging
from stickslip_fit.laws import State, state_at
from stickslip_fit.machine import PRISMATIC

FINEST = 7  # times that panels are halved before a step size counts as no smooth function


class Stepping(Protocol):
    """What a law has to tell."""

    joint: int

    def panel(self, values: Array) -> float:
        """Widest panel, rad or m, that still sees every feature of the step size along a traverse."""

    @property
    def along(self) -> bool:
        """Whether the step size changes along a traverse in a way of its own."""

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`."""


class Traverses:
    """Traverses of one joint, counted in the simplest way that is right.

    Parameters
    ----------
    law : Stepping
    known : dict of str to array, shape (n,)
        start, stop and the columns that the law needs.
    """

    def __init__(self, law: Stepping, known: dict[str, Any]) -> None:
        self.law = law
        self.known = known
        self._prepared: dict[tuple[Any, ...], tuple[Counting, State]] = {}
        self._simple: list[type[Counting]] = [Even]
        if law.joint != PRISMATIC and not law.along:
            self._simple.append(Swinging)
        self._halved = 0

    @cached_property
    def here(self) -> State:
        """Where each traverse begins."""
        return state_at(self.law.joint, self.known, self.known["start"][:, None])

    def counts(self, values: Array) -> Array:
        """Steps over each traverse, shape (n, p) -> (n,); NaN where the step size is not above 0."""
        way, _, gamma, right = self._settled(values)
        return np.where(right, way.counts(gamma), np.nan)

    def counts_and_slopes(self, values: Array) -> tuple[Array, Array]:
        """Steps, shape (n,), and their derivatives by the values, shape (n, p)."""
        way, state, gamma, right = self._settled(values)
        by_place, by_value = way.slopes(gamma), self.law.gamma_slopes(state, values)
        by_value = np.broadcast_to(by_value, (*by_place.shape, values.shape[1]))
        slopes = np.einsum("nk,nkp->np", by_place, by_value)
        return np.where(right, way.counts(gamma), np.nan), slopes

    def _settled(self, values: Array) -> tuple[Counting, State, Array, Mask]:
        """A way of counting that is right, the step size where it needs it, and for which rows it is."""
        while self._simple:
            found = self._tried(values, self._simple[0])
            if found[-1].all():
                return found
            self._simple.pop(0)  # Other values are likely to need more, too.
        longest = np.abs(self.known["stop"] - self.known["start"]).max(initial=0.0)
        fewest = int(np.ceil(np.log2(max(longest / self.law.panel(values), 1.0))))
        for halved in range(self._halved, FINEST):
            found = self._tried(values, Panels, 2 ** (fewest + halved))
            if found[-1].all():
                self._halved = halved
                break
        return found

    def _tried(self, values: Array, kind: Any, *arguments: int) -> tuple[Counting, State, Array, Mask]:
        if (kind, *arguments) not in self._prepared:
            way = kind(self.known["start"], self.known["stop"], *arguments)
            self._prepared[kind, *arguments] = way, state_at(self.law.joint, self.known, way.positions)
        way, state = self._prepared[kind, *arguments]
        gamma = self.law.gamma(state, values)
        return way, state, gamma, way.fits(gamma)
