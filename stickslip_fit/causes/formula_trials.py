"""FormulaTrials: a cause given as a formula, bound to rows; the sizes that are tried are chosen from these.

Parameters in which the effect is linear, and without which there is none, are its amplitudes: they come first
and are tried at a size that shows. The others are tried on a grid within their bounds, fine enough for
neighbours on it to resemble each other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from math import isfinite, prod
from operator import attrgetter
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.cause_formula import CauseFormula
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.zero_limit import ZeroLimit
from stickslip_fit.errors import InputError
from stickslip_fit.laws.table_start import is_linear, spread
from stickslip_fit.units import to_si

# Along each of so many parameters that are no amplitudes, to begin with; and of all places together.
NUMBER_OF_PLACES, MAX_PLACES = {0: 1, 1: 9, 2: 7, 3: 4}, 150
# Of an effect's square by its neighbour's: one halfway then shares three quarters with both.
MIN_SHARED = 0.25
MAX_LEVELS = 100  # values of a column with parameters of their own
STATE_FACTORS = (1.0, 10.0, -10.0)
NULL_TOL, LIMIT_TOL = 1e-9, 1e-4  # of an effect's size; of a limit, which is extrapolated
_PHRASES = {
    "+": "the law lacks {}",
    "*": "the law is off by the factor {}",
    "=": "{1} in truth is {0}",
    "steps +": "counts are off by {}",
}

Place = tuple[float, ...]
"""Values of the parameters that are no amplitudes."""


@dataclass(frozen=True, kw_only=True)
class FormulaTrials(Cause):
    """What formulas share as causes, of a table or of a log.

    Attributes
    ----------
    order : tuple of str
        The formula's parameters, amplitudes first.
    levels : tuple
        Values of the column `source.by`, for each of which there is one set of parameters; else None alone.
    sizes : tuple of (tuple of float, tuple of float)
        Of each place that is tried, the values there of what is no amplitude, and the amplitudes' sizes.
    unresolved : tuple of str
        Parameters with which the effect changes too fast for the places that are tried.
    """

    source: CauseFormula
    order: tuple[str, ...]
    levels: tuple[Any, ...]
    parameters: tuple[CauseParameter, ...]
    null_values: tuple[float, ...] = ()
    scale: tuple[float, ...]
    columns: tuple[str, ...]  # type: ignore[misc]
    sizes: tuple[tuple[Place, Place], ...] = ()
    unresolved: tuple[str, ...] = ()

    @cached_property
    def limited(self) -> ZeroLimit:
        """The formula's effect, with its limit where all parameters are 0."""
        scale = [abs(one) or 1.0 for one in self.scale[:: len(self.levels)]]
        return ZeroLimit(self.source.effect, dict(zip(self.order, scale, strict=True)))

    name = property(attrgetter("source.name"))
    physics = property(attrgetter("source.physics"))
    sentence = property(attrgetter("source.sentence"))
    remedy = property(attrgetter("source.remedy"))
    shows_best = property(attrgetter("source.shows_best"))

    @property
    def search_note(self) -> str:  # type: ignore[override]
        if not self.unresolved:
            return ""
        number = len({place for place, _ in self.sizes})
        return (
            f"The search for {self.name} has gaps: its effect changes so fast with "
            f"{' and '.join(self.unresolved)} that it can be missed between two of the {number} places that "
            "are tried; give narrower bounds."
        )

    @property
    def max_trial_factor(self) -> float:  # type: ignore[override]
        """See `Cause`: what is tried has the size of the scatter, or of a guess."""
        return 10.0 if self.source.operation == "=" else 100.0

    @property
    def phrase(self) -> str:  # type: ignore[override]
        text = self.source.effect.text.strip()
        return self.source.phrase or _PHRASES[self.source.operation].format(text, self.source.target)

    @property
    def combine_trials(self) -> bool:  # type: ignore[override]
        return len(self.sizes) > 0 and (len(self.sizes[0][1]) > 1 or len(self.levels) > 1)

    @property
    def start_values(self) -> tuple[float, ...]:
        """See `Cause`: where there is no amplitude, the place in the middle of those tried."""
        if not self._lacks_amplitude:
            return self.null_values
        place, first = self.sizes[len(self.sizes) // 2]
        return tuple(np.repeat([*first, *place], len(self.levels)).tolist())

    @property
    def _lacks_amplitude(self) -> bool:
        """Whether each level has parameters in which the effect is not linear, alone."""
        return self.combine_trials and len(self.sizes[0][1]) < len(self.levels)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Self, Array]]:  # type: ignore[override]
        """See `Cause.trials`: a version for each place where several amplitudes act together.

        Without amplitudes each level is tried at each place, the others absent.
        """
        if not self.combine_trials:
            return [(self, np.array([[*amplitudes, *place] for place, amplitudes in self.sizes]))]
        if self._lacks_amplitude:
            each = np.eye(len(self.levels))
            places = [np.array([*first, *place]) for place, first in self.sizes]
            return [(self, np.array([np.kron(place, level) for place in places for level in each]))]
        versions = []
        for place, amplitudes in self.sizes:
            null = np.concatenate([np.zeros(len(amplitudes)), np.repeat(place, len(self.levels))])
            trials = np.tile(null, (len(amplitudes), 1))
            trials[:, : len(amplitudes)] = np.diag(amplitudes)
            version = replace(self, null_values=tuple(null.tolist()), sizes=((place, amplitudes),))
            versions.append((version, trials))
        return versions

    def own_places(self, labels: npt.ArrayLike | None, n: int) -> tuple[IntArray, BoolArray]:
        """Where each parameter's value stands among the cause's, (n, number), and which rows have one.

        `labels` are the rows' values of the column `source.by`; a row with another than `levels` has none.
        """
        level, inside = np.zeros(n, dtype=np.intp), np.ones(n, dtype=bool)
        if self.source.by:
            # As objects: that these are strings is not found out anew each time.
            given = pd.Index(np.asarray(labels), dtype=object)
            level = pd.Index(self.levels, dtype=object).get_indexer(given)
            inside = level >= 0
        places = np.maximum(level, 0)[:, None] + len(self.levels) * np.arange(len(self.order))
        return places, inside


@dataclass(frozen=True, eq=False)
class TrialSearch(ABC):
    """The choice of amplitudes, places and sizes of a formula in rows.

    Attributes
    ----------
    declared : mapping of str to CauseParameter
        Its parameters, bounds in the units that it computes in.
    """

    cause: CauseFormula
    declared: Mapping[str, CauseParameter]
    levels: tuple[Any, ...]

    @abstractmethod
    def evaluate(self, order: Sequence[str], values: Array) -> tuple[Array, Array]:
        """The effect at values of the formula's parameters, (n,), and its derivatives, (n, number)."""

    @abstractmethod
    def absent(self) -> tuple[Array, float]:
        """The effect where there is none, and the size beside which a difference is rounding."""

    @abstractmethod
    def sizes_at(self, bound: FormulaTrials, place: Place, amplitudes: Sequence[str]) -> Array:
        """Of each amplitude, level by level, a size that shows."""

    def moderate(self, order: Sequence[str], places: Sequence[Place]) -> list[Place]:
        """Of places of parameters without amplitudes those that are worth a trial."""
        return [place for place in places if any(place)]

    def choose(self, make: Callable[..., FormulaTrials]) -> FormulaTrials:
        """The cause, bound, with its trials; `make` builds it from the attributes found here."""
        names = list(self.declared)
        amplitudes = self._choose_amplitudes(names)
        others = [name for name in names if name not in amplitudes]
        if unbounded := [name for name in others if not self._is_bounded(name)]:
            raise self.error(
                f"it is not linear in {' and '.join(unbounded)}, so that trials need bounds, e.g. "
                f"bounds={{{unbounded[0]!r}: (low, high)}}"
            )
        if len(others) not in NUMBER_OF_PLACES:
            most = max(NUMBER_OF_PLACES)
            raise self.error(f"it is not linear in {', '.join(others)}; at most {most} can be searched")
        bound = self._with_order(make, (*amplitudes, *others), len(amplitudes))
        places, unresolved = self._choose_places(amplitudes, others)
        if amplitudes:
            sizes = tuple(pair for place in places for pair in self._pairs(bound, place, amplitudes))
        else:
            sizes = tuple((place[1:], place[:1]) for place in self.moderate(others, places))
        middle = self._own_sizes(bound, places[len(places) // 2], amplitudes) if amplitudes else sizes[0][1]
        scale = (*middle, *bound.scale[len(middle) :])
        return replace(bound, sizes=sizes, scale=scale, unresolved=unresolved)

    def error(self, reason: str) -> InputError:
        """The InputError for a fault of the cause."""
        return InputError(f"the cause {self.cause.name}: {reason}")

    def _choose_amplitudes(self, names: Sequence[str]) -> tuple[str, ...]:
        """The largest set in which the effect is linear and without which there is none."""
        sets = [some for size in range(len(names), -1, -1) for some in combinations(names, size)]
        unbounded = {name for name in names if not self._is_bounded(name)}
        sets.sort(key=lambda some: (-len(some), not unbounded <= set(some)))
        for some in sets:
            if self._are_amplitudes(some, [name for name in names if name not in some]):
                return some
        neutral = {"*": "'* (1 + k*x)' in place of '* k*x'", "=": "'x = x + k' in place of 'x = k'"}
        raise self.error(
            "with its parameters at 0 it still has an effect; write it so that 0 means none, e.g. "
            + neutral.get(self.cause.operation, "'+ k*x' in place of '+ 1 + k*x'")
        )

    def _are_amplitudes(self, some: Sequence[str], others: Sequence[str]) -> bool:
        """Whether the effect is linear in some of the parameters, and absent where they are 0."""
        start = np.array([*np.zeros(len(some)), *(self._middle(name) if some else 0.0 for name in others)])

        def evaluate(values: Array) -> tuple[Array, Array]:
            return self.evaluate((*some, *others), values)

        without, places = evaluate(start)[0], list(range(len(some)))
        if not some and not np.isfinite(without).all():
            row = first_row(~np.isfinite(without))
            raise self.error(f"its effect is no number in row {row}, with {' = '.join(others)} = 0")
        absent, size = self.absent()
        vanishes = bool(np.all(np.abs(without - absent) <= (NULL_TOL if some else LIMIT_TOL) * size))
        return vanishes and (not some or is_linear(evaluate, start, places))

    @cached_property
    def limited(self) -> ZeroLimit:
        """The formula's effect, with its limit where all parameters are 0."""
        return ZeroLimit(self.cause.effect, {name: abs(self._middle(name)) or 1.0 for name in self.declared})

    def _is_bounded(self, name: str) -> bool:
        return isfinite(self.declared[name].upper - self.declared[name].lower)

    def _middle(self, name: str) -> float:
        one = self.declared[name]
        return float(spread(one.lower, one.upper, 1)[0]) if self._is_bounded(name) else 1.0

    def _with_order(
        self, make: Callable[..., FormulaTrials], order: tuple[str, ...], amplitudes: int
    ) -> FormulaTrials:
        parameters, null, scale = [], [], []
        for k, name in enumerate(order):
            one, middle = self.declared[name], self._middle(name)
            for level in self.levels:
                parameters.append(replace(one, name=name if level is None else f"{name}[{level}]"))
                null.append(0.0 if k < amplitudes or not amplitudes else middle)
                scale.append(abs(middle) or 1.0)
        return make(
            source=self.cause, order=order, levels=self.levels, parameters=tuple(parameters),
            null_values=tuple(null), scale=tuple(scale),
        )  # fmt: skip

    def _choose_places(
        self, amplitudes: Sequence[str], others: Sequence[str]
    ) -> tuple[list[Place], tuple[str, ...]]:
        """Places on a grid, and the parameters along which it is too coarse with as many as it may have."""
        numbers = dict.fromkeys(others, NUMBER_OF_PLACES[len(others)])
        while True:
            along = [
                spread(self.declared[name].lower, self.declared[name].upper, numbers[name]) for name in others
            ]
            places = [tuple(map(float, place)) for place in product(*along)]
            coarse = self._find_coarse(amplitudes, others, places, tuple(numbers.values()))
            finer = numbers | {name: 2 * numbers[name] for name in coarse}
            if not coarse or prod(finer.values()) > MAX_PLACES:
                return places, coarse
            numbers = finer

    def _find_coarse(
        self,
        amplitudes: Sequence[str],
        others: Sequence[str],
        places: Sequence[Place],
        shape: tuple[int, ...],
    ) -> tuple[str, ...]:
        """The parameters along which neighbours on a grid of some shape have too little in common."""
        bases = [self._shape_at(amplitudes, others, place) for place in places]
        number = np.arange(len(places)).reshape(shape)
        coarse = []
        for axis, name in enumerate(others):
            ordered = np.moveaxis(number, axis, 0)
            pairs = zip(ordered[:-1].ravel().tolist(), ordered[1:].ravel().tolist(), strict=True)
            shared = [
                np.sum((bases[one].T @ bases[other]) ** 2) / rank
                for one, other in pairs
                if (rank := min(bases[one].shape[1], bases[other].shape[1]))
            ]
            if min(shared, default=1.0) < MIN_SHARED:
                coarse.append(name)
        return tuple(coarse)

    def _shape_at(self, amplitudes: Sequence[str], others: Sequence[str], place: Place) -> Array:
        """Orthonormal directions of the effect at a place, without its mean; none where it is no number."""
        value, slopes = self.evaluate((*amplitudes, *others), np.array([*np.zeros(len(amplitudes)), *place]))
        effects = slopes[:, : len(amplitudes)] if amplitudes else (value - self.absent()[0])[:, None]
        if not np.isfinite(effects).all():
            return np.zeros((len(effects), 0))
        left, singular, _ = svd(effects - effects.mean(axis=0))
        return np.asarray(left[:, singular > NULL_TOL * np.abs(effects).max(initial=0.0)])

    def _pairs(
        self, bound: FormulaTrials, place: Place, amplitudes: Sequence[str]
    ) -> list[tuple[Place, Place]]:
        """A place with the sizes that are tried there.

        What is put in place of a column may act in another way when it is large, so that one amplitude is
        tried at several sizes; a term and a factor act in proportion.
        """
        sizes = [self._own_sizes(bound, place, amplitudes)]
        if self.cause.operation == "=" and len(sizes[0]) == 1:
            (shows,) = self.sizes_at(bound, place, amplitudes).tolist()
            sizes += [(factor * shows,) for factor in STATE_FACTORS]
        return [(place, own) for own in dict.fromkeys(sizes)]

    def _own_sizes(self, bound: FormulaTrials, place: Place, amplitudes: Sequence[str]) -> Place:
        """Of each amplitude the size that the user gives, else one that shows."""
        sizes = self.sizes_at(bound, place, amplitudes)
        by_name = self.cause.size
        if not isinstance(by_name, Mapping):
            by_name = {} if by_name is None else {self.cause.declared[0].name: by_name}
        for k, name in enumerate(amplitudes):
            if name in by_name:
                own = slice(k * len(self.levels), (k + 1) * len(self.levels))
                sizes[own] = to_si(float(by_name[name]), self.declared[name].unit)
        return tuple(sizes.tolist())


def first_row(rows: BoolArray) -> int:
    """The number of the first row that is true."""
    return int(np.argmax(rows)) + 1
