"""Short expressions that a law may lack: one direction of effects each, tried on sets of rows.

A log's are functions of the carriers of `smooth_alternatives`, on every set of joints and directions; a
table's are built in `table_alternatives`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, replace
from itertools import combinations
from math import floor, log10
from typing import Any

import numpy as np

from stickslip_fit._format import coordinate_unit, position_unit
from stickslip_fit._typing import Array, BoolArray, IntArray, JointKinds
from stickslip_fit.causes.carrier_function import CarrierFunction
from stickslip_fit.causes.proposed import (
    BEFORE_DIRECTION,
    LENGTH,
    LOADS,
    POSITION,
    ZETA,
    Mode,
    ProposedTerm,
)
from stickslip_fit.diagnosis.carrier_functions import interact
from stickslip_fit.diagnosis.carriers import Carrier, find_carriers, traverse_average
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.smooth_alternatives import MIN_SHARE
from stickslip_fit.logs.history import unit_of
from stickslip_fit.logs.schema import is_coordinate
from stickslip_fit.units import from_si, to_si, unit_of_difference

# A label, another clock, and what has another unit in each joint.
WITHOUT_EXPRESSION = ("before_joint", "session_order", LENGTH)
DIGITS = 3  # of numbers in formulas
MODES: tuple[Mode, ...] = ("same", "opposite")
Places = tuple[tuple[int, str], ...]
"""Joints and directions; none for all."""
OF_ANGLES = ("sin(x)", "cos(x)", "sin(2 x)", "cos(2 x)", "sin(3 x)", "cos(3 x)")


class Dictionary:
    """Effects of m expressions on p sets of rows: their squares and inner products.

    Parameters
    ----------
    linearized : LinearizedFit
        n rows.
    columns : array, shape (n, m)
        Change of each response by each expression.
    groups : sequence of array of int
        Rows, which no two groups share.
    combine : array, shape (p, number of groups)
        By what the effects in each group are multiplied in each set.
    excluded : array of bool, shape (p, m)
        Expressions that are not tried on a set.
    make : callable
        From a place, an expression, and the coefficients of its effects, to the term and its start values. A
        place is a set with one coefficient, or, after these, a pair of sets with one each.
    n_factors : array of int, shape (m,)
    pairs : sequence of (int, int), optional
        Of sets which share no rows.
    n_single : int, optional
        The first sets, which have one coefficient; all without it.
    """

    def __init__(
        self,
        linearized: LinearizedFit,
        columns: Array,
        groups: Sequence[IntArray],
        combine: Array,
        excluded: BoolArray,
        make: Callable[[int, int, Array], tuple[Any, Array]],
        n_factors: Array,
        pairs: Sequence[tuple[int, int]] = (),
        n_single: int | None = None,
    ) -> None:
        whitened = linearized.whiten(columns)
        self.columns = linearized.project_own(whitened)
        self.groups, self.combine, self.make, self.n_factors = groups, combine, make, n_factors
        each = np.stack([np.sum(self.columns[rows] ** 2, axis=0) for rows in groups])
        shared = np.stack([linearized.shared_basis[rows].T @ self.columns[rows] for rows in groups])
        of_sets = np.tensordot(combine, shared, axes=1)
        squares = combine**2 @ each - np.sum(of_sets**2, axis=1)
        self.pairs, self.n_single = pairs, len(combine) if n_single is None else n_single
        self.cross = [-np.sum(of_sets[one] * of_sets[other], axis=0) for one, other in pairs]
        plain = np.stack([np.sum(whitened[rows] ** 2, axis=0) for rows in groups])
        too_small = squares < np.maximum(MIN_SHARE * (combine**2 @ plain), EFFECT_TOL**2)
        self.squares = np.where(too_small | excluded, np.inf, squares)

    @property
    def n_coefficients(self) -> IntArray:
        """Of each place."""
        return np.repeat([1, 2], [self.n_single, len(self.pairs)])

    def explained(self, residuals: Array) -> Array:
        """Of the squares of residuals, (n, k), by each place, (places, m, k)."""
        along = self._along(residuals)
        single = along**2 / self.squares[..., None]
        both = [
            single[one] + second**2 / left
            for (one, other), cross in zip(self.pairs, self.cross, strict=True)
            for second, left in [self._beside(one, other, cross, along)]
        ]
        return np.concatenate([single[: self.n_single], np.reshape(both, (len(both), *along.shape[1:]))])

    def coefficients(self, place: int, best: int, residual: Array) -> Array:
        """Of an expression in a place, (1,) or (2,), by residuals, (n,)."""
        along = self._along(residual[:, None])
        if place < self.n_single:
            return along[place, best] / self.squares[place, best]
        (one, other), cross = self.pairs[place - self.n_single], self.cross[place - self.n_single]
        second, left = self._beside(one, other, cross, along)
        own = second[best] / left[best]
        return np.concatenate([(along[one, best] - cross[best] * own) / self.squares[one, best], own])

    def _beside(self, one: int, other: int, cross: Array, along: Array) -> tuple[Array, Array]:
        """Of another set's effects without what is along one's: inner products, (m, k), squares, (m, 1)."""
        share = (cross / self.squares[one])[:, None]
        squares = self.squares[other]
        left = squares - cross * share[:, 0]
        missing = ~np.isfinite(self.squares[one] + squares) | (left < MIN_SHARE * squares)
        return along[other] - share * along[one], np.where(missing, np.inf, left)[:, None]

    def _along(self, residuals: Array) -> Array:
        """Inner products with residuals, (n, k) -> (p, m, k)."""
        each = np.stack([self.columns[rows].T @ residuals[rows] for rows in self.groups])
        return np.tensordot(self.combine, each, axes=1)


def build_log_dictionary(linearized: LinearizedFit, machine: JointKinds) -> Dictionary | None:
    """Products of one or two functions, of at most three symbols; None where nothing varies.

    A function of the position is tried on one joint at a time: a rotary and a prismatic joint have no unit
    in common. Only an angle has harmonics.
    """
    single = [
        (factor, factor.values(carrier.values))
        for carrier in find_carriers(linearized.table)
        if carrier.name not in WITHOUT_EXPRESSION
        for factor in _functions(carrier, machine)
    ]
    products: list[tuple[CarrierFunction, ...]] = [(factor,) for factor, _ in single]
    columns = [values for _, values in single]
    for (one, values), (other, others) in combinations(single, 2):
        if one.carrier == other.carrier or not interact(one.carrier, other.carrier):
            continue
        if "x" in (one.expression, other.expression):
            products.append((one, other))
            columns.append(values * others)
    if not products:
        return None
    forward, joint = linearized.direction_sign > 0, linearized.rows["joint"].to_numpy()
    joints = [int(number) for number in np.unique(joint)]
    groups = [(number, way) for number in joints for way in "+-"]
    signs = np.array([1.0 if way == "+" else -1.0 for _, way in groups])

    def place_on(on: Places, mode: Mode = "same") -> tuple[Places, Mode, Array]:
        acts = np.array([float(not on or group in on) for group in groups])
        return on, mode, acts * signs if mode == "opposite" else acts

    of_joint: list[Places] = [tuple((number, way) for way in "+-") for number in joints]
    places = [place_on(on, mode) for on in ((), *of_joint) for mode in MODES]
    places += [place_on((group,)) for group in groups]
    n_single = len(places)
    # With a size for each direction: a joint's two groups, and all joints'.
    pairs = [(one, one + 1) for one in range(n_single - len(groups), n_single, 2)]
    by_direction: list[Places] = [()]
    if len(joints) > 1:
        by_direction = [*of_joint, ()]
        pairs.append((n_single, n_single + 1))
        places += [place_on(tuple(group for group in groups if group[1] == way)) for way in "+-"]
    moved = [{one for one, _ in on or groups} for on, *_ in places]
    together = np.array([len(own) > 1 for own in moved])
    slides = np.array([any(map(machine.is_prismatic, own)) for own in moved])
    along = [[factor.expression for factor in product if factor.carrier == POSITION] for product in products]
    of_position = np.array([len(own) > 0 for own in along])
    of_turn = np.array([not {*OF_ANGLES}.isdisjoint(own) for own in along])
    effects = np.stack([traverse_average(column) for column in columns], axis=1)
    largest = np.maximum(np.abs(effects).max(axis=0), np.finfo(float).tiny)

    def make(place: int, best: int, coefficients: Array) -> tuple[ProposedTerm, Array]:
        each, mode = bool(place >= n_single), places[place][1] if place < n_single else "same"
        on = by_direction[place - n_single] if each else places[place][0]
        own = position_unit(min({one for one, _ in on or groups}), machine)
        factors = [
            replace(factor, shown=own) if factor.carrier == POSITION else factor for factor in products[best]
        ]
        size = float(largest[best])
        term = ProposedTerm(tuple(map(astuple, factors)), on, mode, size, each)
        return term, -coefficients / size  # a larger step makes fewer

    return Dictionary(
        linearized,
        effects / largest,
        [np.flatnonzero((joint == number) & (forward == (way == "+"))) for number, way in groups],
        np.array([weights for *_, weights in places]),
        (together[:, None] & of_position) | (slides[:, None] & of_turn),
        make,
        np.array([len(product) for product in products]),
        pairs,
        n_single,
    )


def _functions(carrier: Carrier, machine: JointKinds) -> Iterator[CarrierFunction]:
    """Functions of one carrier; of an angle also its harmonics.

    What they are shifted and divided by has as many digits as a formula shows, so that it is what it says.
    """
    name, plain = carrier.name, ("x", "x^2", "|x|")
    if name in (POSITION, ZETA) or is_coordinate(name):
        units = {POSITION: "", ZETA: "deg"}
        shown = units[name] if name in units else coordinate_unit(name, machine)
        for expression in (*plain, *(() if shown == "mm" else OF_ANGLES)):
            yield CarrierFunction(expression, name, shown=shown)
    elif name == BEFORE_DIRECTION:
        yield CarrierFunction("x", name)
    elif name in (*LOADS, "before_load"):
        yield from (CarrierFunction(expression, name) for expression in plain)
    elif name in ("session_seconds", "steps_before"):
        shown = "h" if name == "session_seconds" else ""
        unit = _round(float(np.median(carrier.values)) or carrier.high, shown)
        for expression in ("x", "x^2", "log(1 + x)"):
            is_time = shown and expression != "log(1 + x)"
            yield CarrierFunction(expression, name, 0.0, 1.0 if is_time else unit, shown)
    else:
        shown = unit_of(name)
        apart = unit_of_difference(shown)
        unit = _round((carrier.high - carrier.low) / 2, apart)
        middle = _round(float(np.nanmean(carrier.values)), shown, _from_si(unit, apart))
        yield from (CarrierFunction(expression, name, middle, unit, shown) for expression in plain)


def _round(value: float, shown: str, compared: float = 0.0) -> float:
    """An SI value to three significant digits of itself, or of a size, in the unit in which it is shown."""
    number = _from_si(value, shown)
    rounded = round(number, DIGITS - 1 - floor(log10(abs(compared or number))))
    return float(to_si(rounded, shown)) if shown else rounded


def _from_si(value: float, shown: str) -> float:
    return float(from_si(value, shown)) if shown else value
