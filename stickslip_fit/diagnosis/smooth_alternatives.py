"""Smooth unstructured alternatives: in every coordinate, every column of history and log, and in pairs.

Each is a Gaussian process over one carrier (`causes.proposed`): of the whole machine, opposite by direction,
by joint, by direction of a joint, and independent for each of these; products of two carriers have few
directions each. Which carriers there are and which vary follows from the rows. Effects of single joints are
stored for their rows only, and what is independent for each joint and direction shares their directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LENGTH,
    LOAD,
    LOADS,
    POSITION,
    SMOOTH_SCALE,
    TRANSVERSE_LOAD,
    ZETA,
    SmoothTerm,
    TravelTerm,
    carrier_values,
)
from stickslip_fit.causes.smooth import cosine_sequence, cosines, prior_sds
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    MAX_COUPLED_SESSIONS,
    Hypothesis,
    find_rows,
    make_hypothesis,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.laws import State, state_at
from stickslip_fit.logs.history import FURTHER_HISTORY, JOINT_NET_USE, LATE_TEMPERATURE, NET_USE
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, position_columns

LENGTHS = (0.25, 0.1)  # correlation lengths, of the carrier's range
BEYOND = 0.15  # of a range of positions, by which that of its functions is wider on either side
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)  # of a carrier along a traverse
HISTORY = ("session_seconds", "steps_before", "before_load", BEFORE_DIRECTION)
FURTHER_OF_TRAVERSE = tuple(name for name in FURTHER_HISTORY if name != "session_order")
# With which a load or a column of the log may count more or less.
ALONE = ("before_joint", *NET_USE, *JOINT_NET_USE, *LATE_TEMPERATURE)
WITH_PRODUCTS = tuple(name for name in FURTHER_OF_TRAVERSE if name not in ALONE)
MIN_SHARE = 1e-3  # of the square of an effect that calibration leaves, below which it is left out
MIN_VARIANCE = 1e-3  # of a hypothesis, below which a direction is left out
MAX_LOST = 0.1  # of the square of several parts, up to which each may lose its own share by itself
COMMON = 0.8  # of the variance of functions of sessions, where they have one in common
# Correlation, above which a late temperature would only stand beside that of the room as its rival.
MAX_LIKE_ROOM = 0.95
SOME_VALUES = 1000  # of a carrier, among which distinct ones are counted first
MIN_LENGTHS = 4  # distinct ones of a joint's traverses, of which a function is looked for
MAX_NESTED = 240  # coefficients of such functions
# Orders of products, and of a coordinate with which a load may count.
LOWEST, LOW, LOAD_ORDERS = ((1, 1),), ((1, 1), (1, 2), (2, 1), (2, 2)), 4
# Distinct values of a carrier with which it has all functions.
ENOUGH_DISTINCT = 2 + len(prior_sds(min(LENGTHS) / (1.0 + 2.0 * BEYOND)))


@dataclass(frozen=True, eq=False)
class Carrier:
    """A variable along the traverses of a log.

    Attributes
    ----------
    values : array, shape (n, k) or (n, 1)
        NaN where it is unknown.
    low, high : float
        Its range.
    distinct : int
        Number of distinct values; where there are `ENOUGH_DISTINCT`, of a part of them.
    """

    name: str
    values: Array
    low: float
    high: float
    distinct: int

    def waves(self, number: int) -> Array:
        """Cosines over the range, averaged along each traverse, shape (n, number); 0 where it is unknown."""
        waves, known = np.empty((len(self.values), number)), np.isfinite(self.values)
        values = np.where(known, self.values, self.low)
        for k, cosine in enumerate(cosine_sequence(values, self.low, self.high, number)):
            waves[:, k] = traverse_average(cosine * known)
        return waves

    def wave(self, order: int) -> Array:
        """A cosine along each traverse, shape (n, k) or (n, 1); 0 where it is unknown."""
        if order not in self._waves:
            self._waves[order] = np.nan_to_num(cosines(self.values, self.low, self.high, order)[..., -1])
        return self._waves[order]

    @cached_property
    def _waves(self) -> dict[int, Array]:
        return {}


def traverse_average(values: Array) -> Array:
    """A function averaged along each traverse, (n, k) or (n, 1) -> (n,)."""
    return values[:, 0] if values.shape[1] == 1 else values @ (WEIGHTS / 2)


def find_carriers(linearized: LinearizedFit) -> list[Carrier]:
    """The coordinates, history and columns that vary in some rows of a log."""
    rows = linearized.rows
    own = [str(name) for name in rows.columns if str(name).startswith(COVARIATE_PREFIX)]
    columns = [name for name in (*CONDITIONS, *own) if name in rows]
    history = [name for name in HISTORY if name in rows and rows[name].notna().all()]
    history += [name for name in FURTHER_OF_TRAVERSE if name in rows and rows[name].notna().any()]
    history = [name for name in history if name not in LATE_TEMPERATURE or _is_late(rows, name)]
    # Where one joint moves, what it did is what all did: of columns that are the same one is enough.
    history = list({rows[name].to_numpy().tobytes(): name for name in reversed(history)}.values())[::-1]
    # A machine without the published geometry has no gravity load.
    load = LOADS if rows["before_load"].notna().any() else ()
    # Where one of the two angles never changes, zeta is the other one.
    zeta = (ZETA,) if load and rows["psi"].nunique() > 1 and rows["q2"].nunique() > 1 else ()
    coordinates = (*ANGLES, *zeta, *position_columns(rows), *load, POSITION, LENGTH)
    names = dict.fromkeys((*coordinates, *columns, *history))
    states = list(_states_along(linearized))
    carriers = (_make_carrier(name, _along_traverses(len(rows), states, name)) for name in names)
    return [carrier for carrier in carriers if carrier is not None]


def find_load(linearized: LinearizedFit) -> Carrier | None:
    """The load along the traverses of a log; None where there is none."""
    if linearized.rows["before_load"].isna().all():
        return None
    states = list(_states_along(linearized))
    return _make_carrier(LOAD, _along_traverses(len(linearized), states, LOAD))


def _states_along(linearized: LinearizedFit) -> Iterator[tuple[IntArray, State]]:
    """The machine along the traverses of each joint, with their rows."""
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        joint = getattr(part.law, "joint", None)
        if joint is not None:
            start, stop = (np.asarray(table[end], dtype=float)[:, None] for end in ("start", "stop"))
            yield part.rows, state_at(joint, table, (start + stop) / 2 + (stop - start) / 2 * NODES)


def _along_traverses(n: int, states: Sequence[tuple[IntArray, State]], name: str) -> Array:
    """A carrier along n traverses, shape (n, k) or (n, 1); NaN where it is unknown."""
    known = [(places, carrier_values(state, name)) for places, state in states]
    values = np.full((n, max((each.shape[1] for _, each in known), default=1)), np.nan)
    for places, each in known:
        values[places] = each
    return values


def _is_late(rows: pd.DataFrame, name: str) -> bool:
    """Whether the temperature that follows late is clearly another than that of the room, in its sessions."""
    session = rows["session"].astype(object)
    both = [rows[one] - rows[one].groupby(session).transform("mean") for one in ("temperature", name)]
    return bool(abs(both[0].corr(both[1])) < MAX_LIKE_ROOM)


def _make_carrier(name: str, values: Array) -> Carrier | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, high = float(known.min()), float(known.max())
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    along = np.ptp(values[np.isfinite(values).all(axis=1)], axis=1).max(initial=0.0) > 0
    distinct = len(np.unique(known[:: len(known) // SOME_VALUES + 1].round(9)))
    if distinct < ENOUGH_DISTINCT:
        distinct = len(np.unique(known.round(9)))
    return Carrier(name, values if along else values[:, :1], low, high, distinct)


def build_smooth_alternatives(linearized: LinearizedFit) -> list[Hypothesis]:
    """Gaussian processes over every carrier, and products of two."""
    carriers = find_carriers(linearized)
    shapes = [
        # A function of the load, different in each joint and direction, is nonlinearity of the load.
        *(
            (carrier.name, *_smooth_functions(carrier, length))
            for carrier in carriers
            if carrier.name not in (POSITION, TRANSVERSE_LOAD, LENGTH)
            for length in _lengths(carrier)
        ),
    ]
    of_joints = list(_of_each_joint(linearized, carriers, POSITION))
    travel = tuple((joint, carrier.low, carrier.high) for joint, carrier in of_joints)
    scaled = [_as_share(carrier, of_joints) if carrier.name == POSITION else carrier for carrier in carriers]
    products = [
        (f"product of {one.name} and {other.name}", *_product(one, other, orders, travel))
        for one, other in combinations(scaled, 2)
        for orders in _interactions(one.name, other.name)
    ]
    profiles = [
        (place, joint, *_smooth_functions(carrier, length))
        for joint, carrier in of_joints
        for place, length in enumerate(_lengths(carrier))
    ]
    builder = _Builder(linearized)
    hypotheses: list[Hypothesis] = []
    for name, term, functions in shapes:
        effects = builder.effects(functions)
        hypotheses += builder.shapes(name, term, effects) if name != LOAD else []
        hypotheses += builder.by_session(name, term, effects) if name in (*ANGLES, LOAD) else []
    for name, term, functions in products:
        own = {*WITH_PRODUCTS} & {*term.carriers}
        hypotheses += (builder.broad if own else builder.shapes)(name, term, builder.effects(functions))
    for joint, carrier in _of_each_joint(linearized, carriers, LENGTH):
        # Of few lengths any function is as good as the few steps that a late stop adds to each count.
        if carrier.distinct >= MIN_LENGTHS:
            for length in _lengths(carrier):
                term, functions = _smooth_functions(carrier, length)
                hypotheses += builder.of_joint(joint, LENGTH, term, builder.effects(functions))[0]
    by_shape: dict[tuple[int, str], list[Hypothesis]] = {}
    for place, joint, term, functions in profiles:
        for ending, one in builder.profiles(joint, term, builder.effects(functions)).items():
            hypotheses.append(one)
            by_shape.setdefault((place, ending), []).append(one)
    together = (_join_profiles(ending, ones) for (_, ending), ones in by_shape.items() if len(ones) > 1)
    return [*hypotheses, *(one for one in together if one is not None)]


def _join_profiles(ending: str, profiles: Sequence[Hypothesis]) -> Hypothesis | None:
    """The profiles of several joints at once; None where they have not the same functions.

    As a cause in position acts on every joint, so may what is each session's own.
    """
    terms = [one.version for one in profiles]
    if len({(one.orders, one.sds) for one in terms}) > 1:
        return None
    travel = tuple((one.on[0][0], *one.limits[0]) for one in terms)
    return replace(
        profiles[0],
        cause=f"unknown:{POSITION}, each joint, in each session{ending}",
        version=TravelTerm.of(terms, travel=travel),
        blocks=tuple(block for one in profiles for block in one.blocks),
        prior_share=np.concatenate([one.length**2 * one.prior_share for one in profiles])
        / sum(one.length**2 for one in profiles),
        length=float(np.sqrt(sum(one.length**2 for one in profiles))),
        shared=next((one.shared for one in profiles if one.shared is not None), None),
    )


def _of_each_joint(
    linearized: LinearizedFit, carriers: Sequence[Carrier], name: str
) -> Iterator[tuple[int, Carrier]]:
    """The position of each joint or the length of its traverses, over its own range."""
    joint = linearized.rows["joint"].to_numpy()
    for carrier in carriers:
        for number in map(int, np.unique(joint)) if carrier.name == name else ():
            own = np.where((joint == number)[:, None], carrier.values, np.nan)
            if (of_joint := _make_carrier(name, own)) is not None:
                yield number, of_joint


def _lengths(carrier: Carrier) -> tuple[float, ...]:
    """Correlation lengths of functions of a carrier; the longest where it has few values."""
    return LENGTHS if carrier.distinct - 1 > len(prior_sds(LENGTHS[0])) else LENGTHS[:1]


def _smooth_functions(carrier: Carrier, length: float) -> tuple[SmoothTerm, Array]:
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

    Of history on which no published cause depends, those with a load and with a column of the log.
    """
    both = {one, other}
    if both & {LENGTH, ZETA}:
        return False
    if not both & {*FURTHER_HISTORY}:
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


@dataclass(frozen=True, eq=False)
class _Subspace:
    """Orthonormal directions of some effects, their variances, and the rows outside of which they are 0.

    `lost` are the squares that other effects, which all rows share, have taken.
    """

    rows: IntArray | slice
    directions: Array
    variance: Array
    lost: float = 0.0

    @classmethod
    def of(
        cls, rows: IntArray | slice, effects: Array, products: Array, least: float, lost: float = 0.0
    ) -> _Subspace | None:
        """Of effects in some rows, (s, m), by their products; None where these come to less than `least`."""
        variance, right = (products[0], np.ones((1, 1))) if len(products) == 1 else np.linalg.eigh(products)
        total = float(variance.sum())
        if total < least:
            return None
        kept = variance > MIN_VARIANCE * total
        return cls(rows, effects @ (right[:, kept] / np.sqrt(variance[kept])), variance[kept], lost)


@dataclass(frozen=True, eq=False)
class _Effects:
    """Whitened effects, shape (n, m), what each block's own calibration leaves, and each row's square."""

    whitened: Array
    own: Array
    squares: Array


class _Builder:
    """From functions of carriers to hypotheses, calibration projected out."""

    def __init__(self, linearized: LinearizedFit) -> None:
        self.linearized = linearized
        self.shared_basis = linearized.shared_basis
        self.sign = linearized.direction_sign
        joint = linearized.rows["joint"].to_numpy()
        self.rows_of = {int(number): np.flatnonzero(joint == number) for number in np.unique(joint)}
        session = linearized.rows["session"].astype(object).to_numpy()
        self.session_of = {str(name): session == name for name in dict.fromkeys(session)}

    def effects(self, functions: Array) -> _Effects:
        """Of functions, shape (n, m)."""
        whitened = functions / self.linearized.scale[:, None]
        return _Effects(whitened, self.linearized.project_own(whitened), np.sum(whitened**2, axis=1))

    def shapes(self, name: str, term: SmoothTerm, effects: _Effects) -> list[Hypothesis]:
        """The ways in which joints and directions may share some functions."""
        found = self.of_all(name, term, effects)
        for direction, sign in (("+", 1.0), ("-", -1.0)):
            on = tuple((joint, direction) for joint in self.rows_of)
            one_way = self.subspace(effects, None, np.flatnonzero(self.sign == sign))
            found.append(self.make(f"{name}, {direction} only", replace(term, on=on), [one_way]))
        groups: dict[tuple[int, str], _Subspace] = {}
        for joint in self.rows_of:
            ways, own = self.of_joint(joint, name, term, effects)
            found += ways
            groups |= own
        if len(groups) > 1:
            each = replace(term, on=tuple(groups), each=True)
            found.append(self.make(f"{name}, each joint and direction", each, list(groups.values())))
        return [one for one in found if one is not None]

    def broad(self, name: str, term: SmoothTerm, effects: _Effects) -> list[Hypothesis]:
        """As `shapes`, without those of one direction."""
        found = self.of_all(name, term, effects)
        for joint, rows in self.rows_of.items() if len(self.rows_of) > 1 else ():
            on = replace(term, on=((joint, "+"), (joint, "-")))
            found.append(self.make(f"{name}, joint {joint}", on, [self.subspace(effects, None, rows)]))
        return [one for one in found if one is not None]

    def of_all(self, name: str, term: SmoothTerm, effects: _Effects) -> list[Hypothesis | None]:
        """Functions of all joints, opposite by direction and alike."""
        opposite, whole = replace(term, mode="opposite"), self.subspace(effects)
        turned = (
            self.make(f"{name}, opposite", opposite, [whole], self.sign)
            if self.linearized.allows_opposite
            else self.make(f"{name}, opposite", opposite, [self.subspace(effects, self.sign)])
        )
        return [turned, self.make(name, term, [whole])]

    def of_joint(
        self, joint: int, name: str, term: SmoothTerm, effects: _Effects
    ) -> tuple[list[Hypothesis], dict[tuple[int, str], _Subspace]]:
        """The same of one joint, in both directions and in each; the latter also by themselves."""
        rows, both, label = self.rows_of[joint], ((joint, "+"), (joint, "-")), f"{name}, joint {joint}"
        found = [self.make(label, replace(term, on=both), [self.subspace(effects, None, rows)])]
        own = {}
        for group, sign in zip(both, (1.0, -1.0), strict=True):
            way = self.subspace(effects, None, rows[self.sign[rows] == sign])
            found.append(self.make(f"{label} {group[1]}", replace(term, on=(group,)), [way]))
            if way is not None:
                own[group] = way
        if len(own) > 1:
            each = replace(term, on=tuple(own), each=True)
            found.append(self.make(f"{label}, each direction", each, list(own.values())))
        return [one for one in found if one is not None], own

    def by_session(self, name: str, term: SmoothTerm, effects: _Effects) -> list[Hypothesis]:
        """Functions that differ from session to session, by joint."""
        found = []
        for joint, rows in self.rows_of.items() if len(self.session_of) > 1 else ():
            version, parts = self.of_sessions(
                effects, None, [rows], replace(term, on=((joint, "+"), (joint, "-")))
            )
            found.append(self.make(f"{name}, joint {joint}, in each session", version, parts))
        return [one for one in found if one is not None]

    def profiles(self, joint: int, term: SmoothTerm, effects: _Effects) -> dict[str, Hypothesis]:
        """The same of a joint's position, by direction, too, and around what the sessions have in common.

        By the end of their names.
        """
        found: dict[str, Hypothesis | None] = {}
        rows, label = self.rows_of[joint], f"{POSITION}, joint {joint}, in each session"
        if len(self.session_of) > 1:
            on = ((joint, "+"), (joint, "-"))
            ways = [rows[self.sign[rows] > 0], rows[self.sign[rows] < 0]]
            for ending, whole, groups, sign in (
                ("", replace(term, on=on), [rows], None),
                (", opposite", replace(term, on=on, mode="opposite"), [rows], self.sign),
                (", each direction", replace(term, on=on, each=True), ways, None),
            ):
                version, parts = self.of_sessions(effects, sign, groups, whole)
                found[ending] = self.make(label + ending, version, parts)
                if nested := self.nested(effects, sign, groups, version):
                    found[f"{ending}, in part"] = self.make(f"{label}{ending}, in part", *nested)
        return {ending: one for ending, one in found.items() if one is not None}

    def of_sessions(
        self, effects: _Effects, sign: Array | None, groups: Sequence[IntArray], term: SmoothTerm
    ) -> tuple[SmoothTerm, list[_Subspace | None]]:
        """A term with functions of each session, and their effects in some groups of rows."""
        own = {
            session: [self.subspace(effects, sign, group[inside[group]]) for group in groups]
            for session, inside in self.session_of.items()
        }
        own = {session: parts for session, parts in own.items() if any(parts)}
        return replace(term, sessions=tuple(own)), [part for parts in own.values() for part in parts]

    def nested(
        self, effects: _Effects, sign: Array | None, groups: Sequence[IntArray], version: SmoothTerm
    ) -> tuple[SmoothTerm, list[_Subspace]] | None:
        """Functions of sessions around one that they have in common; None where there are too many."""
        number = len(groups) * effects.own.shape[1] * (1 + len(version.sessions))
        if not version.sessions or number > MAX_NESTED:
            return None
        columns = []
        for group in groups:
            common = np.zeros_like(effects.whitened)
            common[group] = effects.whitened[group] * (1.0 if sign is None else sign[group, None])
            own = [common * self.session_of[name][:, None] for name in version.sessions]
            columns += [np.sqrt(COMMON) * common, *(np.sqrt(1.0 - COMMON) * one for one in own)]
        projected = self.linearized.project(np.concatenate(columns, axis=1))
        rows = find_rows(projected)
        projected = projected[rows]
        found = _Subspace.of(rows, projected, projected.T @ projected, EFFECT_TOL**2)
        return (replace(version, common=COMMON), [found]) if found else None

    def subspace(
        self, effects: _Effects, sign: Array | None = None, rows: IntArray | None = None
    ) -> _Subspace | None:
        """What calibration leaves of effects in some rows; None where that is next to nothing."""
        subset: IntArray | slice = slice(None) if rows is None else rows
        before = float(np.sum(effects.squares[subset]))
        own = (effects.own if self.linearized.separates_directions else effects.whitened)[subset]
        own = own if sign is None else own * sign[subset, None]
        if not self.linearized.separates_directions:  # then what calibration leaves has rows in both
            signed = np.zeros_like(effects.whitened)
            signed[subset] = own
            own, subset = self.linearized.project_own(signed), slice(None)
        products, lost = own.T @ own, 0.0
        if self.shared_basis.shape[1]:
            shared = self.shared_basis[subset].T @ own
            products -= shared.T @ shared
            lost = float(np.sum(shared**2))
        return _Subspace.of(subset, own, products, max(EFFECT_TOL**2, MIN_SHARE * before), lost)

    def make(
        self, name: str, version: SmoothTerm, parts: Sequence[_Subspace | None], sign: Array | None = None
    ) -> Hypothesis | None:
        """The hypothesis with the directions of all parts, in rows of their own, times a sign."""
        known = [part for part in parts if part is not None]
        if not known:
            return None
        if self.is_coupled(version, known):
            return self.couple(f"unknown:{name}", version, known, sign)
        variance = np.concatenate([part.variance for part in known])
        blocks = tuple((part.rows, part.directions) for part in known)
        length, share = float(np.sqrt(variance.sum())), variance / variance.sum()
        n, shared = len(self.linearized), self.linearized.shared
        return Hypothesis(
            f"unknown:{name}", version, None, n, blocks, share, length, sign=sign, shared=shared
        )

    def is_coupled(self, version: SmoothTerm, parts: Sequence[_Subspace]) -> bool:
        """Whether all parts together have to be without what they share with other effects."""
        if not self.shared_basis.shape[1] or len(parts) < 2 or len(version.sessions) > MAX_COUPLED_SESSIONS:
            return False
        lost, left = sum(part.lost for part in parts), sum(float(part.variance.sum()) for part in parts)
        return len(version.sessions) > 1 or lost > MAX_LOST * (lost + left)

    def couple(
        self, name: str, version: SmoothTerm, parts: Sequence[_Subspace], sign: Array | None
    ) -> Hypothesis | None:
        """As `make`, with what all sessions share projected out of all parts together.

        Part by part, what one loses to a shared parameter would count in the others.
        """
        columns = np.zeros((len(self.linearized), sum(len(part.variance) for part in parts)))
        first = 0
        for part in parts:
            last = first + len(part.variance)
            columns[part.rows, first:last] = part.directions * np.sqrt(part.variance)
            first = last
        columns = columns if sign is None else columns * sign[:, None]
        return make_hypothesis(name, version, None, self.linearized.project(columns))
