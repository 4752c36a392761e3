"""Functions of the carriers of a log's rows: smooth ones of each, and products of two.

They depend on the rows alone; what the law leaves of them makes hypotheses (`smooth_alternatives`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.proposed import (
    ANGLES,
    LENGTH,
    LOAD,
    LOADS,
    POSITION,
    SMOOTH_SCALE,
    TRANSVERSE_LOAD,
    ZETA,
    SmoothTerm,
)
from stickslip_fit.causes.smooth import prior_sds
from stickslip_fit.diagnosis.carriers import (
    BEYOND,
    FURTHER_OF_TRAVERSE,
    HISTORY,
    LENGTHS,
    Carrier,
    find_carriers,
    of_each_joint,
    traverse_average,
)
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.logs.history import FURTHER_HISTORY, JOINT_NET_USE, MOVES, NET_USE, PAST, condition_of
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX

# With which a load or a column of the log may count more or less.
ALONE = ("before_joint", *NET_USE, *JOINT_NET_USE, *PAST)
WITH_PRODUCTS = tuple(name for name in FURTHER_OF_TRAVERSE if name not in ALONE)
MIN_LENGTHS = 4  # distinct ones of a joint's traverses, of which a function is looked for
# Orders of products, and of a coordinate with which a load may count.
LOWEST, LOW, LOAD_ORDERS = ((1, 1),), ((1, 1), (1, 2), (2, 1), (2, 2)), 4

Function = tuple[str, SmoothTerm, Array]
"""What the hypotheses of it are called, the function, and its columns, shape (n, m)."""


@dataclass(frozen=True, eq=False)
class CarrierFunctions:
    """The functions of the carriers of some rows, the same whatever the law and its noise.

    Attributes
    ----------
    of_carriers, products : tuple of Function
    profiles : tuple of (int, int, Function)
        Of each joint's position: which of the correlation lengths, and the joint.
    of_lengths : tuple of (int, Function)
        Of the length of each joint's traverses.
    """

    of_carriers: tuple[Function, ...]
    products: tuple[Function, ...]
    profiles: tuple[tuple[int, int, Function], ...]
    of_lengths: tuple[tuple[int, Function], ...]


def find_functions(table: RowTable) -> CarrierFunctions:
    """The functions of the carriers of some rows of a log."""
    return table.once(_find_functions)


def _find_functions(table: RowTable) -> CarrierFunctions:
    carriers = find_carriers(table)
    of_joints = list(of_each_joint(table, POSITION))
    travel = tuple((joint, carrier.low, carrier.high) for joint, carrier in of_joints)
    scaled = [_as_share(carrier, of_joints) if carrier.name == POSITION else carrier for carrier in carriers]
    return CarrierFunctions(
        # A function of the load, different in each joint and direction, is nonlinearity of the load.
        of_carriers=tuple(
            (carrier.name, *smooth_functions(carrier, length))
            for carrier in carriers
            if carrier.name not in (POSITION, TRANSVERSE_LOAD, LENGTH)
            for length in _lengths(carrier)
        ),
        products=tuple(
            (f"product of {one.name} and {other.name}", *_product(one, other, orders, travel))
            for one, other in combinations(scaled, 2)
            for orders in _interactions(one.name, other.name)
        ),
        profiles=tuple(
            (place, joint, (POSITION, *smooth_functions(carrier, length)))
            for joint, carrier in of_joints
            for place, length in enumerate(_lengths(carrier))
        ),
        of_lengths=tuple(
            (joint, (LENGTH, *smooth_functions(carrier, length)))
            for joint, carrier in of_each_joint(table, LENGTH)
            # Of few lengths any function is as good as the few steps that a late stop adds to each count.
            if carrier.distinct >= MIN_LENGTHS
            for length in _lengths(carrier)
        ),
    )


def _lengths(carrier: Carrier) -> tuple[float, ...]:
    """Correlation lengths of functions of a carrier; the longest where it has few values."""
    return LENGTHS if carrier.distinct - 1 > len(prior_sds(LENGTHS[0])) else LENGTHS[:1]


def smooth_functions(carrier: Carrier, length: float) -> tuple[SmoothTerm, Array]:
    """A Gaussian process over a carrier, and its columns, shape (n, m)."""
    # Cosines are level at the ends of their range, which a step size along a travel need not be.
    beyond = BEYOND * (carrier.high - carrier.low) if carrier.name == POSITION else 0.0
    carrier = replace(carrier, low=carrier.low - beyond, high=carrier.high + beyond)
    share = length / (1.0 + 2.0 * BEYOND) if beyond else length
    sds = SMOOTH_SCALE * prior_sds(share)[: carrier.distinct - 1]
    orders = tuple((k,) for k in range(1, len(sds) + 1))
    term = SmoothTerm((carrier.name,), ((carrier.low, carrier.high),), orders, tuple(map(float, sds)))
    return term, carrier.waves(len(sds)) * sds


def _interactions(one: str, other: str) -> Sequence[tuple[tuple[int, int], ...]]:
    """Orders of the products of two carriers' functions that are looked for.

    Of any carrier with a coordinate or a load, and of columns of the log with each other and with history,
    that of the lowest functions; without history all of the lowest two, as what turns with two joints,
    cos(q1 + q2), or is largest in the middle has. A load that counts more at some positions has more along
    the joint's own travel.
    """
    both = {one, other}
    if not interact(one, other):
        return ()
    if POSITION in both and both & {*ANGLES}:
        return LOWEST, LOW
    if both == {LOAD, POSITION}:
        return LOWEST, tuple((1, k) if one == LOAD else (k, 1) for k in range(1, LOAD_ORDERS + 1))
    if not (both & {*LOADS, POSITION, *ANGLES} or is_of_log(one) or is_of_log(other)):
        return ()
    return (LOWEST,) if both & {*HISTORY, *FURTHER_HISTORY} else (LOWEST, LOW)


def interact(one: str, other: str) -> bool:
    """Whether products of two carriers are looked for.

    Of history on which no published cause depends, those with a load and with a column of the log; of how an
    angle has changed also that with the angle itself.
    """
    both = {one, other}
    if both & {LENGTH, ZETA}:
        return False
    if any(condition_of(name) in both for name in both & {*MOVES}):
        return True
    if not both & {*FURTHER_OF_TRAVERSE}:
        return True
    partner = both - {*WITH_PRODUCTS}
    return len(partner) == 1 and all(name in LOADS or is_of_log(name) for name in partner)


def is_of_log(name: str) -> bool:
    """Whether a carrier is a column that a lab wrote down."""
    return name in CONDITIONS or name.startswith(COVARIATE_PREFIX)


def _as_share(position: Carrier, of_joints: Sequence[tuple[int, Carrier]]) -> Carrier:
    """The position along each joint's own range, from 0 to 1: joints have it in other units."""
    share = np.full_like(position.values, np.nan)
    for _, carrier in of_joints:
        own = np.isfinite(carrier.values)
        share[own] = ((carrier.values - carrier.low) / (carrier.high - carrier.low))[own]
    return replace(position, values=share, low=0.0, high=1.0)


def _product(
    one: Carrier,
    other: Carrier,
    orders: tuple[tuple[int, int], ...],
    travel: tuple[tuple[int, float, float], ...],
) -> tuple[SmoothTerm, Array]:
    """Products of functions of two carriers, and their columns, shape (n, number of orders)."""
    limits = ((one.low, one.high), (other.low, other.high))
    term = SmoothTerm((one.name, other.name), limits, orders, (SMOOTH_SCALE,) * len(orders))
    term = replace(term, travel=travel) if POSITION in term.carriers else term
    columns = [traverse_average(one.wave(first) * other.wave(second)) for first, second in orders]
    return term, SMOOTH_SCALE * np.stack(columns, axis=1)
