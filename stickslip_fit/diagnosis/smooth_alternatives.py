"""Smooth unstructured alternatives: in every coordinate, every column of history and log, and in pairs.

Each is a Gaussian process over one carrier (`causes.proposed`): of the whole machine, opposite by direction,
by joint, by direction of a joint, and independent for each of these; products of two carriers have one
direction each. Which carriers there are and which vary follows from the rows. Effects of single joints are
stored for their rows only, and what is independent for each joint and direction shares their directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LOAD,
    POSITION,
    SMOOTH_SCALE,
    Mode,
    SmoothTerm,
    carrier_values,
)
from stickslip_fit.causes.smooth import cosines, prior_sds
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, Hypothesis
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.laws import state_at
from stickslip_fit.logs.history import previous_rows
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, has_times, position_columns

LENGTH = 0.25  # correlation length, of the carrier's range
# What follows from the order of the rows: no column of a log, so that a law cannot depend on it.
FOLLOWING = ("length of the traverse before", "joint before", "pause")
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)  # of a carrier along a traverse
HISTORY = ("session_seconds", "steps_before", "before_load", BEFORE_DIRECTION)
MIN_SHARE = 1e-3  # of the square of an effect that calibration leaves, below which it is left out
MIN_VARIANCE = 1e-3  # of a hypothesis, below which a direction is left out


@dataclass(frozen=True, eq=False)
class Carrier:
    """A variable along the traverses of a log.

    Attributes
    ----------
    name : str
    values : array, shape (n, k) or (n, 1)
        NaN where it is unknown.
    low, high : float
        Its range.
    distinct : int
        Number of distinct values, of the first few.
    """

    name: str
    values: Array
    low: float
    high: float
    distinct: int

    def waves(self, number: int) -> Array:
        """Cosines over the range, shape (n, k, number); 0 where it is unknown."""
        return np.nan_to_num(cosines(self.values, self.low, self.high, number))


def traverse_average(functions: Array) -> Array:
    """Functions averaged along each traverse, (n, k, m) -> (n, m)."""
    return functions[:, 0] if functions.shape[1] == 1 else np.einsum("nkm,k->nm", functions, WEIGHTS / 2)


def find_carriers(linearized: LinearizedFit) -> list[Carrier]:
    """The coordinates, history and columns that vary in some rows of a log."""
    rows, n = linearized.rows, len(linearized)
    own = [str(name) for name in rows.columns if str(name).startswith(COVARIATE_PREFIX)]
    columns = [name for name in (*CONDITIONS, *own) if name in rows]
    history = [name for name in HISTORY if name in rows and rows[name].notna().all()]
    # A machine without the published geometry has no gravity load.
    load = (LOAD,) if rows["before_load"].notna().any() else ()
    names = dict.fromkeys((*ANGLES, *position_columns(rows), *load, POSITION, *columns, *history))
    values = {name: np.full((n, len(NODES)), np.nan) for name in names}
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        joint = getattr(part.law, "joint", None)
        if joint is None:
            continue
        start, stop = (np.asarray(table[end], dtype=float)[:, None] for end in ("start", "stop"))
        state = state_at(joint, table, (start + stop) / 2 + (stop - start) / 2 * NODES)
        for name, array in values.items():
            array[part.rows] = carrier_values(state, name)
    following = _follow(rows) if has_times(rows) else {}
    carriers = [_make_carrier(name, array) for name, array in (values | following).items()]
    return [carrier for carrier in carriers if carrier is not None]


def _follow(rows: pd.DataFrame) -> dict[str, Array]:
    """`FOLLOWING` of each traverse, shape (n, 1); lengths over the joint's longest, NaN for the first."""
    session = pd.factorize(rows["session"].astype(object))[0].astype(np.int64)
    joint, seconds = (rows[name].to_numpy(float) for name in ("joint", "session_seconds"))
    length = (rows["stop"] - rows["start"]).abs().groupby(rows["joint"]).transform(lambda x: x / x.max())
    same, last = previous_rows(session * 64 + rows["joint"].to_numpy(np.int64)), previous_rows(session)
    values = (
        np.where(same >= 0, length.to_numpy()[same], np.nan),
        np.where(last >= 0, joint[last], np.nan),
        np.where(last >= 0, np.log1p(np.maximum(seconds - seconds[last], 0.0)), np.nan),
    )
    return {name: column[:, None] for name, column in zip(FOLLOWING, values, strict=True)}


def _make_carrier(name: str, values: Array) -> Carrier | None:
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    low, high = float(known.min()), float(known.max())
    if not high - low > 1e-9 * max(abs(low), abs(high)):
        return None
    along = np.ptp(values[np.isfinite(values).all(axis=1)], axis=1).max(initial=0.0) > 0
    distinct = len(np.unique(known.round(9)))
    return Carrier(name, values if along else values[:, :1], low, high, distinct)


def build_smooth_alternatives(linearized: LinearizedFit) -> list[Hypothesis]:
    """Gaussian processes over every carrier, and products of two."""
    carriers = find_carriers(linearized)
    shapes = [
        # A function of the load, different in each joint and direction, is nonlinearity of the load.
        *((carrier.name, *_smooth_functions(carrier)) for carrier in carriers if carrier.name != LOAD),
        *(
            (f"product of {one.name} and {other.name}", *_product(one, other))
            for one, other in combinations(carriers, 2)
            if other.name not in FOLLOWING
            and ({one.name, other.name} & {LOAD, POSITION} or {one.name, other.name} <= {*ANGLES})
        ),
    ]
    columns = [np.zeros((len(linearized), 0)), *(own for _, _, own in shapes)]
    builder, last = _Builder(linearized, np.concatenate(columns, axis=1)), 0
    hypotheses: list[Hypothesis] = []
    for name, term, own in shapes:
        place = slice(last, last := last + own.shape[1])
        found = (builder.by_session if name == POSITION else builder.shapes)(name, term, place)
        hypotheses += [replace(one, version=None) for one in found] if name in FOLLOWING else found
    return hypotheses


def _smooth_functions(carrier: Carrier) -> tuple[SmoothTerm, Array]:
    """A Gaussian process over a carrier, and its columns, shape (n, m)."""
    sds = SMOOTH_SCALE * prior_sds(LENGTH)[: carrier.distinct - 1]
    orders = tuple((k,) for k in range(1, len(sds) + 1))
    term = SmoothTerm((carrier.name,), ((carrier.low, carrier.high),), orders, tuple(map(float, sds)))
    return term, traverse_average(carrier.waves(len(sds))) * sds


def _product(one: Carrier, other: Carrier) -> tuple[SmoothTerm, Array]:
    """The product of the lowest function of two carriers, and its column, shape (n, 1)."""
    limits = ((one.low, one.high), (other.low, other.high))
    term = SmoothTerm((one.name, other.name), limits, ((1, 1),))
    return term, SMOOTH_SCALE * traverse_average(one.waves(1) * other.waves(1))


@dataclass(frozen=True, eq=False)
class _Subspace:
    """Orthonormal directions of some effects, their variances, and the rows outside of which they are 0."""

    rows: IntArray | slice
    directions: Array
    variance: Array


class _Builder:
    """From effects of carriers, shape (n, M), to hypotheses, calibration projected out."""

    def __init__(self, linearized: LinearizedFit, columns: Array) -> None:
        self.linearized = linearized
        self.whitened = columns / linearized.scale[:, None]
        n_own = sum(block.shape[1] for _, block in linearized.blocks)
        self.basis = linearized.basis[:, :n_own]
        self.shared_basis = linearized.shared_basis
        self.own = self.project(self.whitened)
        self.sign = np.where((linearized.rows["direction"] == "+").to_numpy(), 1.0, -1.0)
        # Otherwise what calibration leaves of the effect in one direction has rows in both.
        self.by_direction = all(np.ptp(self.sign[rows]) == 0 for rows, _ in linearized.blocks)
        joint = linearized.rows["joint"].to_numpy()
        self.rows_of = {int(number): np.flatnonzero(joint == number) for number in np.unique(joint)}
        session = linearized.rows["session"].astype(object).to_numpy()
        self.session_of = {str(name): session == name for name in dict.fromkeys(session)}

    def project(self, columns: Array) -> Array:
        """Each block's own calibration projected out, shape (n, m)."""
        return columns - self.basis @ (self.basis.T @ columns)

    def shapes(self, name: str, term: SmoothTerm, place: slice) -> list[Hypothesis]:
        """The ways in which joints and directions may share the functions in some columns."""
        opposite = replace(term, mode="opposite")
        found = [self.make(f"{name}, opposite", opposite, [self.subspace(place, self.sign)])]
        found.append(self.make(name, term, [self.subspace(place)]))
        groups: dict[tuple[int, str], _Subspace] = {}
        for joint, rows in self.rows_of.items():
            both, label = ((joint, "+"), (joint, "-")), f"{name}, joint {joint}"
            found.append(self.make(label, replace(term, on=both), [self.subspace(place, None, rows)]))
            own = {}
            for group, sign in zip(both, (1.0, -1.0), strict=True):
                way = self.subspace(place, None, rows[self.sign[rows] == sign])
                found.append(self.make(f"{label} {group[1]}", replace(term, on=(group,)), [way]))
                if way is not None:
                    own[group] = way
            if len(own) > 1:
                each = replace(term, on=tuple(own), each=True)
                found.append(self.make(f"{label}, each direction", each, list(own.values())))
            groups |= own
        if len(groups) > 1:
            each = replace(term, on=tuple(groups), each=True)
            found.append(self.make(f"{name}, each joint and direction", each, list(groups.values())))
        return [one for one in found if one is not None]

    def by_session(self, name: str, term: SmoothTerm, place: slice) -> list[Hypothesis]:
        """Functions that differ from session to session, by joint."""
        found = []
        for joint, rows in self.rows_of.items() if len(self.session_of) > 1 else ():
            modes: tuple[tuple[Mode, Array | None], ...] = (("same", None), ("opposite", self.sign))
            for mode, sign in modes:
                own = {
                    session: subspace
                    for session, inside in self.session_of.items()
                    if (subspace := self.subspace(place, sign, rows[inside[rows]])) is not None
                }
                on, sessions = ((joint, "+"), (joint, "-")), tuple(own)
                version = replace(term, on=on, mode=mode, sessions=sessions)
                label = f"{name}, joint {joint}, in each session" + ", opposite" * (sign is not None)
                found.append(self.make(label, version, list(own.values())))
        return [one for one in found if one is not None]

    def subspace(
        self, place: slice, sign: Array | None = None, rows: IntArray | None = None
    ) -> _Subspace | None:
        """What calibration leaves of columns in some rows; None where that is next to nothing."""
        subset: IntArray | slice = slice(None) if rows is None else rows
        before, own = self.whitened[subset, place], self.own[subset, place]
        if not self.by_direction:
            effects = np.zeros((len(self.own), before.shape[1]))
            effects[subset] = before if sign is None else before * sign[subset, None]
            own, subset = self.project(effects), slice(None)
        elif sign is not None:
            own = own * sign[subset, None]
        shared = self.shared_basis[subset].T @ own
        products = own.T @ own - shared.T @ shared
        variance, right = (products[0], np.ones((1, 1))) if len(products) == 1 else np.linalg.eigh(products)
        total = float(variance.sum())
        if total < max(EFFECT_TOL**2, MIN_SHARE * float(np.sum(before**2))):
            return None
        kept = variance > MIN_VARIANCE * total
        return _Subspace(subset, own @ (right[:, kept] / np.sqrt(variance[kept])), variance[kept])

    def make(self, name: str, version: SmoothTerm, parts: Sequence[_Subspace | None]) -> Hypothesis | None:
        """The hypothesis with the directions of all parts, in rows of their own."""
        known = [part for part in parts if part is not None]
        if not known:
            return None
        variance = np.concatenate([part.variance for part in known])
        blocks = tuple((part.rows, part.directions) for part in known)
        length, share = float(np.sqrt(variance.sum())), variance / variance.sum()
        return Hypothesis(f"unknown:{name}", version, None, len(self.linearized), blocks, share, length)
