"""Steps over traverses under an extended law, and their derivatives.

`AdaptiveCounter` takes the cheapest method that is accurate: a constant step size along the traverse,
one sinusoid of a rotary joint's position (closed form), or Gauss-Legendre panels, halved until the last
Legendre coefficients are negligible. Each method needs the step size at its nodes only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.laws import State, state_at
from stickslip_fit.laws.integration import harmonic_counts

SINE_TOL = 1e-9  # relative; far above rounding
GAUSS_ORDER = 10
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_ORDER)
# The last two Legendre coefficients of a panel, as sums over its nodes.
TAIL_COEFFICIENTS = np.arange(GAUSS_ORDER - 2, GAUSS_ORDER) + 0.5
TAIL_COEFFICIENTS = TAIL_COEFFICIENTS * np.polynomial.legendre.legvander(GAUSS_NODES, GAUSS_ORDER - 1)[:, -2:]
TAIL_COEFFICIENTS *= GAUSS_WEIGHTS[:, None]
# An n-point rule is wrong by about coefficient 2 n, which is about the square of coefficient n.
TAIL_TOL = 3e-7
LAST_TOL = 1e-5  # of the narrowest panels, which a curvature that jumps needs: the count is as accurate
KINK_TOL = 0.02  # of a panel with a kink, one of many and narrow: the count is off by some 1e-5


class StepCounter(ABC):
    """A method that counts the steps over n traverses from the step size at k positions of each.

    Attributes
    ----------
    positions : array, shape (n, k)
    """

    positions: Array

    @abstractmethod
    def is_exact(self, gamma: Array) -> BoolArray:
        """Whether each count is accurate, shape (n,), by the step sizes, shape (n, k) or (n, 1)."""

    @abstractmethod
    def counts(self, gamma: Array) -> Array:
        """Steps, shape (n,); NaN where a joint stalls."""

    @abstractmethod
    def derivatives(self, gamma: Array) -> Array:
        """Derivative of the steps by the step size at each position, shape (n, k)."""


class UniformCounter(StepCounter):
    """Length over step size, for traverses with one step size; start and stop of shape (n,)."""

    def __init__(self, start: Array, stop: Array) -> None:
        self.length = np.abs(stop - start)
        self.positions = np.stack([start, stop], axis=-1)

    def is_exact(self, gamma: Array) -> BoolArray:
        """See `StepCounter.is_exact`: the step size is given as independent of the position."""
        return np.full(len(gamma), gamma.shape[1] == 1)

    def counts(self, gamma: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(gamma[:, 0] > 0, self.length / gamma[:, 0], np.nan)

    def derivatives(self, gamma: Array) -> Array:
        return (-self.counts(gamma) / gamma[:, 0])[:, None]


class SinusoidalCounter(StepCounter):
    """A step size that is a sinusoid of a rotary joint's position; closed form of `harmonic_counts`.

    Three positions, a third of a turn apart, give mean, cosine and sine; two more check the sinusoid.
    start and stop have shape (n,).
    """

    ANGLES = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3, 0.8, 2.9])
    HARMONICS = np.stack([np.ones(5), np.cos(ANGLES), np.sin(ANGLES)])
    HARMONICS_INVERSE = np.linalg.inv(HARMONICS[:, :3].T)

    def __init__(self, start: Array, stop: Array) -> None:
        self.start, self.stop = start, stop
        self.positions = np.broadcast_to(self.ANGLES, (len(start), 5))

    def is_exact(self, gamma: Array) -> BoolArray:
        residual = gamma - self._harmonics(gamma) @ self.HARMONICS
        return np.all(np.abs(residual) <= SINE_TOL * np.abs(gamma).max(axis=1, keepdims=True), axis=1)

    def counts(self, gamma: Array) -> Array:
        return harmonic_counts(*self._amplitude_and_phase(gamma), self.start, self.stop)[0]

    def derivatives(self, gamma: Array) -> Array:
        mean, amplitude, phase = self._amplitude_and_phase(gamma)
        _, by_mean, by_amplitude = harmonic_counts(mean, amplitude, phase, self.start, self.stop)
        first, last = self.start - phase, self.stop - phase
        ends = (mean + amplitude * np.cos(first)) * (mean + amplitude * np.cos(last))
        # The integral of sin(q - phase) / gamma^2, in closed form.
        by_phase = -np.sign(self.stop - self.start) * (np.cos(first) - np.cos(last)) / ends
        by_cosine = by_amplitude * np.cos(phase) - by_phase * np.sin(phase)
        by_sine = by_amplitude * np.sin(phase) + by_phase * np.cos(phase)
        slopes = np.zeros((len(mean), 5))
        slopes[:, :3] = np.stack([by_mean, by_cosine, by_sine], axis=-1) @ self.HARMONICS_INVERSE
        return slopes

    def _harmonics(self, gamma: Array) -> Array:
        """Mean, cosine and sine of the step size over a turn, shape (n, 3)."""
        return np.broadcast_to(gamma, self.positions.shape)[:, :3] @ self.HARMONICS_INVERSE.T

    def _amplitude_and_phase(self, gamma: Array) -> tuple[Array, Array, Array]:
        mean, cosine, sine = self._harmonics(gamma).T
        return mean, np.hypot(cosine, sine), np.arctan2(sine, cosine)


class PanelCounter(StepCounter):
    """Any step size: `n_panels` Gauss-Legendre panels of equal width on each traverse."""

    def __init__(self, start: Array, stop: Array, n_panels: int, tolerance: float) -> None:
        self.n_panels = n_panels
        self.tolerance = tolerance
        half = (stop - start)[:, None] / (2 * n_panels)
        middles = start[:, None] + half * (2 * np.arange(n_panels) + 1)
        self.positions = (middles[:, :, None] + half[:, :, None] * GAUSS_NODES).reshape(len(start), -1)
        self.weights = np.abs(half) * np.tile(GAUSS_WEIGHTS, n_panels)
        self._last: tuple[Array, Array] | None = None

    def is_exact(self, gamma: Array) -> BoolArray:
        """See `StepCounter.is_exact`: negligible last Legendre coefficients, or a joint that stalls."""
        rate = self._rate(gamma)
        tail = np.abs(rate.reshape(len(rate), self.n_panels, GAUSS_ORDER) @ TAIL_COEFFICIENTS)
        return ~(tail.max(axis=(1, 2)) > self.tolerance * rate.mean(axis=1))

    def counts(self, gamma: Array) -> Array:
        return np.einsum("nk,nk->n", self.weights, self._rate(gamma))

    def derivatives(self, gamma: Array) -> Array:
        return -self.weights * self._rate(gamma) ** 2

    def _rate(self, gamma: Array) -> Array:
        if self._last is None or self._last[0] is not gamma:  # is asked for twice
            with np.errstate(divide="ignore"):
                rate = np.broadcast_to(np.where(gamma > 0, 1.0 / gamma, np.nan), self.positions.shape)
            self._last = gamma, rate
        return self._last[1]


ChainedSlopes = Callable[[State, Array, Array], Array]
"""A state, values, (n, p), and derivatives of the steps by the step size at each place, (n, k), to (n, q)."""
MAX_PANEL_HALVINGS = 7  # a step size that needs more is not smooth
KINK_HALVINGS = 3


class CountableLaw(Protocol):
    """A law whose steps `AdaptiveCounter` counts; members as of `ExtendedLaw` and `StepLaw`."""

    joint: int

    @property
    def prismatic(self) -> bool:
        """See `StepLaw`."""

    @property
    def has_kinks(self) -> bool:
        """See `StepLaw`."""

    def panel(self, values: Array) -> float:
        """Widest panel, rad or m, that resolves the step size along a traverse."""

    @property
    def varies_along_traverse(self) -> bool:
        """Whether the step size varies along a traverse beyond what the published law does."""

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""

    def chained_slopes(self, state: State, values: Array, by_place: Array) -> Array:
        """Derivatives of the steps by the values, (n, p), from those by the step size, (n, k)."""


def chain(by_place: Array, by_value: Array) -> Array:
    """Derivatives of the steps by values, (n, p): those by the step size, (n, k), and its, (n, k or 1, p)."""
    return np.einsum("nk,nkp->np", by_place, np.broadcast_to(by_value, (*by_place.shape, by_value.shape[2])))


class AdaptiveCounter:
    """Traverses of one joint, counted in the simplest counter that is right.

    Traverses that need more panels than the others get them alone: a step size that is nearly 0 in one place
    would otherwise cost as much in all.

    Parameters
    ----------
    row_values : dict of str to array, shape (n,)
        start, stop and the columns that the law needs.
    halvings : int
        Of the panels; 0 also tries the simple counters.
    """

    def __init__(self, law: CountableLaw, row_values: dict[str, Any], halvings: int = 0) -> None:
        self.law = law
        self.row_values = row_values
        self.halvings = halvings
        self._prepared: dict[tuple[Any, ...], tuple[StepCounter, State]] = {}
        self._simple_counters: list[type[StepCounter]] = [] if halvings else [UniformCounter]
        if not halvings and not law.prismatic and not law.varies_along_traverse:
            self._simple_counters.append(SinusoidalCounter)
        self._finer: tuple[IntArray, AdaptiveCounter] | None = None

    @property
    def _most_halvings(self) -> int:
        return (KINK_HALVINGS if self.law.has_kinks else MAX_PANEL_HALVINGS) - 1

    @cached_property
    def start_state(self) -> State:
        """Where each traverse begins."""
        return state_at(self.law.joint, self.row_values, self.row_values["start"][:, None])

    def counts(self, values: Array) -> Array:
        """Steps over each traverse, shape (n, p) -> (n,); NaN where the step size is not above 0."""
        counter, _, gamma, exact = self._select_counter(values)
        counts = np.where(exact, counter.counts(gamma), np.nan)
        if len(rows := np.flatnonzero(~exact)) and self.halvings < self._most_halvings:
            counts[rows] = self._refine(rows).counts(values[rows])
        return counts

    def counts_and_slopes(
        self, values: Array, chained_slopes: ChainedSlopes | None = None
    ) -> tuple[Array, Array]:
        """Steps, shape (n,), and their derivatives by the values, shape (n, p).

        `chained_slopes` are the law's, unless only some of them are wanted.
        """
        by_values = chained_slopes or self.law.chained_slopes
        counter, state, gamma, exact = self._select_counter(values)
        counts, by_place = np.where(exact, counter.counts(gamma), np.nan), counter.derivatives(gamma)
        if exact.all():
            return counts, by_values(state, values, by_place)
        known, rows = np.flatnonzero(exact), np.flatnonzero(~exact)
        own = by_values(self._select(state, known), values[known], by_place[known])
        slopes = np.full((len(values), own.shape[1]), np.nan)
        slopes[known] = own
        if self.halvings < self._most_halvings:
            counts[rows], slopes[rows] = self._refine(rows).counts_and_slopes(values[rows], chained_slopes)
        return counts, slopes

    def _select(self, state: State, rows: IntArray) -> State:
        """A state of all traverses, of some of them."""
        own = {name: column[rows] for name, column in self.row_values.items()}
        selected = state_at(self.law.joint, own, state.position[rows])
        for key, (cause, *kept) in state.functions.items():
            selected.functions[key] = cause, *(x[rows] for x in kept)
        return selected

    def _refine(self, rows: IntArray) -> AdaptiveCounter:
        """Some rows with panels of half the width."""
        if self._finer is None or not np.array_equal(self._finer[0], rows):
            own = {name: column[rows] for name, column in self.row_values.items()}
            self._finer = rows, AdaptiveCounter(self.law, own, self.halvings + 1)
        return self._finer[1]

    def _select_counter(self, values: Array) -> tuple[StepCounter, State, Array, BoolArray]:
        """A counter, its nodes and step sizes there, and the rows for which it is accurate."""
        while self._simple_counters:
            counted = self._try_counter(values, self._simple_counters[0])
            if counted[-1].all():
                return counted
            self._simple_counters.pop(0)  # Other values are likely to need more, too.
        longest = np.abs(self.row_values["stop"] - self.row_values["start"]).max(initial=0.0)
        doublings = int(np.ceil(np.log2(max(longest / self.law.panel(values), 1.0))))
        is_last = self.halvings == self._most_halvings
        tolerance = (KINK_TOL if self.law.has_kinks else LAST_TOL) if is_last else TAIL_TOL
        return self._try_counter(values, PanelCounter, 2 ** (doublings + self.halvings), tolerance)

    def _try_counter(
        self, values: Array, kind: Any, *arguments: float
    ) -> tuple[StepCounter, State, Array, BoolArray]:
        if (kind, *arguments) not in self._prepared:
            counter = kind(self.row_values["start"], self.row_values["stop"], *arguments)
            self._prepared[kind, *arguments] = (
                counter,
                state_at(self.law.joint, self.row_values, counter.positions),
            )
        counter, state = self._prepared[kind, *arguments]
        gamma = self.law.gamma(state, values)
        return counter, state, gamma, counter.is_exact(gamma)
