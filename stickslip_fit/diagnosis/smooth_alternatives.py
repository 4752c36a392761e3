"""Smooth unstructured alternatives: in every coordinate, every column of history and log, and in pairs.

Each is a Gaussian process over one carrier (`causes.proposed`): of the whole machine, by direction, by joint,
and independent for each joint and direction; products of two carriers have one direction each. Which carriers
there are and which vary follows from the rows. Effects of single joints are stored for their rows only, and
what is independent for each joint and direction shares their directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LOAD,
    POSITION,
    SMOOTH_SCALE,
    SmoothTerm,
    carrier_values,
)
from stickslip_fit.causes.smooth import cosines, prior_sds
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, Hypothesis
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.laws import state_at
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX

LENGTH = 0.25  # correlation length, of the carrier's range
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)  # of a carrier along a traverse
HISTORY = ("session_seconds", "steps_before", "before_load", BEFORE_DIRECTION)
MIN_SHARE = 1e-3  # of the square of an effect that calibration leaves, below which it is left out
MIN_VARIANCE = 1e-3  # of a hypothesis, below which a direction is left out
PRODUCT = ((1, 1),)


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
    names = (*ANGLES, LOAD, POSITION, *columns, *history)
    values = {name: np.full((n, len(NODES)), np.nan) for name in names}
    for part, table in zip(linearized.parts, linearized.tables, strict=True):
        joint = getattr(part.law, "joint", None)
        if joint is None:
            continue
        start, stop = (np.asarray(table[end], dtype=float)[:, None] for end in ("start", "stop"))
        state = state_at(joint, table, (start + stop) / 2 + (stop - start) / 2 * NODES)
        for name, array in values.items():
            array[part.rows] = carrier_values(state, name)
    carriers = [_make_carrier(name, array) for name, array in values.items()]
    return [carrier for carrier in carriers if carrier is not None]


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
    carriers, builder = find_carriers(linearized), _Builder(linearized)
    hypotheses: list[Hypothesis] = []
    for carrier in carriers:
        sds = prior_sds(LENGTH)[: carrier.distinct - 1]
        orders = tuple((k,) for k in range(1, len(sds) + 1))
        term = SmoothTerm((carrier.name,), ((carrier.low, carrier.high),), orders, tuple(SMOOTH_SCALE * sds))
        columns = traverse_average(carrier.waves(len(sds))) * SMOOTH_SCALE * sds
        if carrier.name == POSITION:
            hypotheses += builder.by_session(term, columns)
        else:
            hypotheses += builder.shapes(carrier.name, term, columns)
    for one, other in combinations(carriers, 2):
        if {one.name, other.name} & {LOAD, POSITION} or {one.name, other.name} <= {*ANGLES}:
            limits = ((one.low, one.high), (other.low, other.high))
            term = SmoothTerm((one.name, other.name), limits, PRODUCT)
            columns = SMOOTH_SCALE * traverse_average(one.waves(1) * other.waves(1))
            name = f"product of {one.name} and {other.name}"
            hypotheses += builder.shapes(name, term, columns)
    return hypotheses


@dataclass(frozen=True, eq=False)
class _Subspace:
    """Orthonormal directions of some effects, their variances, and the rows outside of which they are 0."""

    rows: IntArray | slice
    directions: Array
    variance: Array


class _Builder:
    """From effects of carriers to hypotheses: calibration projected out, in some or all rows."""

    def __init__(self, linearized: LinearizedFit) -> None:
        self.linearized = linearized
        n_own = sum(columns.shape[1] for _, columns in linearized.blocks)
        self.own_basis = linearized.basis[:, :n_own]
        self.own_transposed = self.own_basis.T.tocsr()
        self.sign = np.where((linearized.rows["direction"] == "+").to_numpy(), 1.0, -1.0)
        self.joint = linearized.rows["joint"].to_numpy()
        self.joints = [int(joint) for joint in np.unique(self.joint)]
        session = linearized.rows["session"].astype(object).to_numpy()
        self.session_of = {str(name): session == name for name in dict.fromkeys(session)}

    def shapes(self, name: str, term: SmoothTerm, columns: Array) -> list[Hypothesis]:
        """The ways in which joints and directions may share a function, whose columns have shape (n, m)."""
        opposite = columns * self.sign[:, None]
        found = [
            self.make(name, term, [self.subspace(columns)]),
            self.make(f"{name}, opposite", replace(term, mode="opposite"), [self.subspace(opposite)]),
        ]
        groups = []
        for joint in self.joints:
            inside = self.joint == joint
            both = ((joint, "+"), (joint, "-"))
            own = replace(term, on=both)
            found.append(self.make(f"{name}, joint {joint}", own, [self.subspace(columns, inside)]))
            own, label = replace(own, mode="opposite"), f"{name}, joint {joint}, opposite"
            found.append(self.make(label, own, [self.subspace(opposite, inside)]))
            for group in both:
                way = self.subspace(columns, inside & (self.sign == (1 if group[1] == "+" else -1)))
                label = f"{name}, joint {joint} {group[1]}"
                found.append(self.make(label, replace(term, on=(group,)), [way]))
                if way is not None:
                    groups.append((group, way))
        if len(groups) > 1:
            own = replace(term, on=tuple(group for group, _ in groups), each=True)
            found.append(self.make(f"{name}, each joint and direction", own, [way for _, way in groups]))
        return [one for one in found if one is not None]

    def by_session(self, term: SmoothTerm, columns: Array) -> list[Hypothesis]:
        """Functions of the position that differ from session to session, by joint."""
        found = []
        for joint in self.joints if len(self.session_of) > 1 else ():
            on = ((joint, "+"), (joint, "-"))
            for mode, factor in (("same", np.ones_like(self.sign)), ("opposite", self.sign)):
                effects, own = columns * factor[:, None], dict[str, _Subspace]()
                for session, inside in self.session_of.items():
                    subspace = self.subspace(effects, inside & (self.joint == joint))
                    if subspace is not None:
                        own[session] = subspace
                version = replace(term, on=on, mode=mode, sessions=tuple(own))
                label = f"position, joint {joint}, in each session" + ", opposite" * (mode == "opposite")
                found.append(self.make(label, version, list(own.values())))
        return [one for one in found if one is not None]

    def subspace(self, columns: Array, inside: BoolArray | None = None) -> _Subspace | None:
        """What calibration leaves of columns, (n, m), in some rows; None where that is next to nothing."""
        effects = columns / self.linearized.scale[:, None]
        if inside is not None:
            effects = effects * inside[:, None]
        own = effects - self.own_basis @ (self.own_transposed @ effects)
        shared = self.linearized.shared_basis.T @ own
        variance, right = np.linalg.eigh(own.T @ own - shared.T @ shared)
        total = float(variance.sum())
        if total < max(EFFECT_TOL**2, MIN_SHARE * float(np.sum(effects**2))):
            return None
        kept = variance > MIN_VARIANCE * total
        directions = own @ (right[:, kept] / np.sqrt(variance[kept]))
        rows: IntArray | slice = slice(None)
        if inside is not None and not own[~inside].any():
            rows, directions = np.flatnonzero(inside), directions[inside]
        return _Subspace(rows, directions, variance[kept])

    def make(self, name: str, version: SmoothTerm, parts: list[_Subspace | None]) -> Hypothesis | None:
        """The hypothesis with the directions of all parts, in rows of their own."""
        known = [part for part in parts if part is not None]
        if not known:
            return None
        variance = np.concatenate([part.variance for part in known])
        blocks = tuple((part.rows, part.directions) for part in known)
        length = float(np.sqrt(variance.sum()))
        share = variance / variance.sum()
        return Hypothesis(f"unknown:{name}", version, None, len(self.linearized), blocks, share, length)
