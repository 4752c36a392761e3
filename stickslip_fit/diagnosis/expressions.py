"""Short expressions that a law may lack: one direction of effects each, tried on sets of rows.

A log's are functions of the carriers of `smooth_alternatives`, on every set of joints and directions; a
table's are built in `table_alternatives`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple
from itertools import combinations
from typing import Any

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LOAD,
    POSITION,
    CarrierFunction,
    Mode,
    ProposedTerm,
)
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.smooth_alternatives import MIN_SHARE, Carrier, find_carriers, traverse_average
from stickslip_fit.logs.history import FURTHER_HISTORY

WITHOUT_EXPRESSION = ("before_joint", "session_order")  # a label, and another clock
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
        From a set, an expression, and the coefficient of its effect to the term and its start values.
    n_factors : array of int, shape (m,)
    """

    def __init__(
        self,
        linearized: LinearizedFit,
        columns: Array,
        groups: Sequence[IntArray],
        combine: Array,
        excluded: BoolArray,
        make: Callable[[int, int, float], tuple[Any, Array]],
        n_factors: Array,
    ) -> None:
        whitened = linearized.whiten(columns)
        self.columns = linearized.project_own(whitened)
        self.groups, self.combine, self.make, self.n_factors = groups, combine, make, n_factors
        each = np.stack([np.sum(self.columns[rows] ** 2, axis=0) for rows in groups])
        shared = np.stack([linearized.shared_basis[rows].T @ self.columns[rows] for rows in groups])
        absorbed = np.sum(np.tensordot(combine, shared, axes=1) ** 2, axis=1)
        squares = combine**2 @ each - absorbed
        plain = np.stack([np.sum(whitened[rows] ** 2, axis=0) for rows in groups])
        too_small = squares < np.maximum(MIN_SHARE * (combine**2 @ plain), EFFECT_TOL**2)
        self.squares = np.where(too_small | excluded, np.inf, squares)

    def along(self, residuals: Array) -> Array:
        """Inner products with residuals, (n, k) -> (p, m, k)."""
        each = np.stack([self.columns[rows].T @ residuals[rows] for rows in self.groups])
        return np.tensordot(self.combine, each, axes=1)


def build_log_dictionary(linearized: LinearizedFit) -> Dictionary | None:
    """Products of one or two functions, of at most three symbols; None where nothing varies.

    A function of the position is tried on one joint at a time: a rotary and a prismatic joint have no unit
    in common.
    """
    single = [
        (factor, factor.values(carrier.values))
        for carrier in find_carriers(linearized)
        if carrier.name not in WITHOUT_EXPRESSION
        for factor in _functions(carrier)
    ]
    products: list[tuple[CarrierFunction, ...]] = [(factor,) for factor, _ in single]
    columns = [values for _, values in single]
    for (one, values), (other, others) in combinations(single, 2):
        if {one.carrier, other.carrier} & {*FURTHER_HISTORY}:
            continue
        if one.carrier != other.carrier and "x" in (one.expression, other.expression):
            products.append((one, other))
            columns.append(values * others)
    if not products:
        return None
    forward, joint = linearized.direction_sign > 0, linearized.rows["joint"].to_numpy()
    joints = [int(number) for number in np.unique(joint)]
    groups = [(number, way) for number in joints for way in "+-"]
    signs = np.array([1.0 if way == "+" else -1.0 for _, way in groups])
    places: list[tuple[tuple[tuple[int, str], ...], Mode]] = [((), "same"), ((), "opposite")]
    combine = [np.ones(len(groups)), signs]
    for number in joints:
        own = np.array([float(number == other) for other, _ in groups])
        both = ((number, "+"), (number, "-"))
        places += [(both, "same"), (both, "opposite")]
        combine += [own, own * signs]
    places += [((group,), "same") for group in groups]
    together = np.array([len({one for one, _ in on or groups}) > 1 for on, _ in places])
    of_position = np.array([any(factor.carrier == POSITION for factor in product) for product in products])

    def make(place: int, best: int, coefficient: float) -> tuple[ProposedTerm, Array]:
        on, mode = places[place]
        term = ProposedTerm(tuple(astuple(factor) for factor in products[best]), on, mode)
        return term, np.array([-coefficient])  # a larger step makes fewer

    return Dictionary(
        linearized,
        np.stack([traverse_average(column) for column in columns], axis=1),
        [np.flatnonzero((joint == number) & (forward == (way == "+"))) for number, way in groups],
        np.concatenate([combine, np.eye(len(groups))]),
        together[:, None] & of_position,
        make,
        np.array([len(product) for product in products]),
    )


def _functions(carrier: Carrier) -> Iterator[CarrierFunction]:
    """Functions of one carrier; of an angle also its harmonics."""
    largest = max(abs(carrier.low), abs(carrier.high))
    if carrier.name in (LOAD, BEFORE_DIRECTION, "before_load"):
        expressions, middle, unit = ["x", "x^2", "|x|"], 0.0, 1.0
    elif carrier.name in (POSITION, *ANGLES):
        expressions = ["x", "x^2", "|x|", *(OF_ANGLES if carrier.name != "q3" else ())]
        middle, unit = 0.0, largest if carrier.name == "q3" else 1.0
    elif carrier.name in ("session_seconds", "steps_before"):
        expressions, middle, unit = ["x", "x^2", "log(1 + x)"], 0.0, float(np.median(carrier.values)) or 1.0
    else:
        expressions = ["x", "x^2", "|x|"]
        middle, unit = float(np.nanmean(carrier.values)), (carrier.high - carrier.low) / 2
    return (CarrierFunction(expression, carrier.name, middle, unit) for expression in expressions)
