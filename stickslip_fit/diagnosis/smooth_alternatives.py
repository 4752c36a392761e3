"""Smooth unstructured alternatives: in every coordinate, every column of history and log, and in pairs.

Each is a Gaussian process over one carrier (`causes.proposed`): of the whole machine, opposite by direction,
by joint, by direction of a joint, and independent for each of these; products of two carriers have few
directions each. Which carriers there are and which vary follows from the rows. Effects of single joints are
stored for their rows only, and what is independent for each joint and direction shares their directions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import batched
from math import sqrt

import numpy as np
import pandas as pd

from stickslip_fit._linalg import eigh
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.added_steps import STEPS_SCALE, AddedSteps
from stickslip_fit.causes.proposed import (
    ALONG,
    ANGLES,
    LENGTH,
    LOAD,
    POSITION,
    SMOOTH_SCALE,
    SmoothTerm,
    TravelTerm,
)
from stickslip_fit.diagnosis.carrier_functions import (
    WITH_PRODUCTS,
    Function,
    find_functions,
    smooth_functions,
)
from stickslip_fit.diagnosis.carriers import LENGTHS, find_carriers
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    Hypothesis,
    find_rows,
    make_hypothesis,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.session_stacks import MAX_COUPLED_SESSIONS

MIN_SHARE = 1e-3  # of the square of an effect that calibration leaves, below which it is left out
MIN_VARIANCE = 1e-3  # of a hypothesis, below which a direction is left out
MAX_LOST = 0.1  # of the square of several parts, up to which each may lose its own share by itself
COMMON = 0.8  # of the variance of functions of sessions, where they have one in common
# Standard deviation of the logarithm of a joint's counts, from which added steps can be told from a step size
# that varies.
MIN_SPREAD_OF_COUNTS = 0.3
MAX_NESTED = 240  # coefficients of functions around a common one
AT_ONCE = 128  # columns of functions, whose effects then stay in the processor's memory
SIGNS = {"+": 1.0, "-": -1.0}


def build_smooth_alternatives(linearized: LinearizedFit) -> list[Hypothesis]:
    """Gaussian processes over every carrier, and products of two."""
    functions, builder = find_functions(linearized.table), _Builder(linearized)
    hypotheses: list[Hypothesis] = []
    for one in builder.effects_of(one for one in functions.of_carriers if one[0] != LOAD):
        hypotheses += builder.shapes(one)
    for one in builder.effects_of(one for one in functions.of_carriers if one[0] in (*ANGLES, LOAD)):
        hypotheses += builder.by_session(one)
    for one in builder.effects_of(functions.products):
        hypotheses += (builder.broad if {*WITH_PRODUCTS} & {*one.term.carriers} else builder.shapes)(one)
    for one in builder.effects_of(_added_to_counts(linearized)):
        hypotheses += builder.added(one)
    for joint, own in functions.of_lengths:
        for one in builder.effects_of([own]):
            hypotheses += builder.of_joint(joint, one)[0]
    by_shape: dict[tuple[int, str], list[Hypothesis]] = {}
    for place, joint, profile in functions.profiles:
        for effects in builder.effects_of([profile]):
            for ending, found in builder.profiles(joint, effects).items():
                hypotheses.append(found)
                by_shape.setdefault((place, ending), []).append(found)
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


def _added_to_counts(linearized: LinearizedFit) -> Iterator[Function]:
    """Functions of steps that are added to counts; none where each joint's counts are much alike."""
    rows = linearized.rows
    # Those of the law: counts themselves would bring their noise into what is to explain it.
    steps = np.maximum(rows["steps"].to_numpy(float), 1.0) * np.exp(-linearized.unwhiten(linearized.residual))
    if not (pd.Series(np.log(steps)).groupby(rows["joint"]).std() > MIN_SPREAD_OF_COUNTS).any():
        return
    for carrier in find_carriers(linearized.table):
        if carrier.name not in (*ALONG, LENGTH):
            term, columns = smooth_functions(carrier, LENGTHS[0])
            columns = STEPS_SCALE / SMOOTH_SCALE * columns / steps[:, None]
            yield f"steps added by {carrier.name}", AddedSteps.of(term), columns


@dataclass(frozen=True, eq=False)
class _Subspace:
    """Orthonormal directions of some effects, their variances, and the rows outside of which they are 0.

    `lost` are the squares that other effects, which all rows share, have taken.
    """

    rows: IntArray | slice
    directions: Array
    variance: Array
    lost: float = 0.0


def _orthonormalize(
    rows: IntArray | slice, effects: Array, products: Array, least: Array, lost: Array
) -> list[_Subspace | None]:
    """The subspaces of P times m effects in s rows, (P, m, s), by their products; None of too small ones.

    `least` and `lost`, shape (P,), are the least sum of squares, and what `_Subspace` has.
    """
    variance, right = eigh(products)
    total = variance.sum(axis=1)
    kept = variance > MIN_VARIANCE * np.maximum(total, EFFECT_TOL**2)[:, None]
    scaled = right / np.sqrt(np.where(kept, variance, np.inf))[:, None, :]
    directions, whole = scaled.transpose(0, 2, 1) @ effects, kept.all(axis=1)
    return [
        _Subspace(rows, (own if whole[k] else own[kept[k]]).T, variance[k][kept[k]], float(lost[k]))
        if total[k] >= least[k]
        else None
        for k, own in enumerate(directions)
    ]


@dataclass(frozen=True, eq=False)
class _Batch:
    """Whitened effects of P functions, shape (n, P, m), and what each block's own calibration leaves of them.

    Attributes
    ----------
    whitened, own : array, shape (n, P, m)
    known : dict
        Subspaces of all functions, by group of rows and whether they are opposite by direction.
    """

    whitened: Array
    own: Array
    known: dict[tuple[_Group, bool], list[_Subspace | None]]


@dataclass(frozen=True, eq=False)
class _Effects:
    """The effects of one function of a batch."""

    name: str
    term: SmoothTerm
    batch: _Batch
    place: int


@dataclass(frozen=True)
class _Group:
    """Rows of a joint, a direction or a session; of all where these are None."""

    joint: int | None = None
    direction: str | None = None
    session: str | None = None


EVERY_ROW = _Group()


class _Builder:
    """From functions of carriers to hypotheses, calibration projected out."""

    def __init__(self, linearized: LinearizedFit) -> None:
        self.linearized = linearized
        self.shared_basis = linearized.shared_basis
        self.sign = linearized.direction_sign
        self.joint = linearized.rows["joint"].to_numpy()
        self.joints = [int(number) for number in np.unique(self.joint)]
        session = linearized.rows["session"].astype(object).to_numpy()
        self.session_of = {str(name): session == name for name in dict.fromkeys(session)}
        self._rows: dict[_Group, IntArray | slice] = {EVERY_ROW: slice(None)}

    def rows_of(self, group: _Group) -> IntArray | slice:
        """The rows of a group, one and the same array each time."""
        if group not in self._rows:
            inside = np.ones(len(self.sign), dtype=bool)
            if group.joint is not None:
                inside &= self.joint == group.joint
            if group.direction is not None:
                inside &= self.sign == SIGNS[group.direction]
            if group.session is not None:
                inside &= self.session_of[group.session]
            self._rows[group] = np.flatnonzero(inside)
        return self._rows[group]

    def effects_of(self, functions: Iterable[Function]) -> Iterator[_Effects]:
        """Of functions, with their names and terms, shape (n, m) each: equally many columns in one batch."""
        alike: dict[int, list[Function]] = {}
        for one in functions:
            alike.setdefault(one[2].shape[1], []).append(one)
        for width, ones in alike.items():
            for some in batched(ones, max(AT_ONCE // width, 1)):
                whitened = np.concatenate([one[2] for one in some], axis=1) / self.linearized.scale[:, None]
                shape = len(whitened), len(some), width
                own = self.linearized.project_own(whitened).reshape(shape)
                batch = _Batch(whitened.reshape(shape), own, {})
                for place, (name, term, _) in enumerate(some):
                    yield _Effects(name, term, batch, place)

    def shapes(self, effects: _Effects) -> list[Hypothesis]:
        """The ways in which joints and directions may share some functions."""
        name, term = effects.name, effects.term
        found = [*self.of_all(effects), *self.of_each_way(effects)]
        groups: dict[tuple[int, str], _Subspace] = {}
        for joint in self.joints:
            ways, own = self.of_joint(joint, effects)
            found += ways
            groups |= own
        if len(groups) > 1:
            each = replace(term, on=tuple(groups), each=True)
            found.append(self.make(f"{name}, each joint and direction", each, list(groups.values())))
        return [one for one in found if one is not None]

    def broad(self, effects: _Effects) -> list[Hypothesis]:
        """As `shapes`, without those of one direction."""
        found = [*self.of_all(effects), *self.of_single_joints(effects)]
        return [one for one in found if one is not None]

    def added(self, effects: _Effects) -> list[Hypothesis]:
        """Functions of all joints, of each direction and of each joint."""
        whole = self.make(effects.name, effects.term, [self.subspace(effects, EVERY_ROW)])
        found = [whole, *self.of_each_way(effects), *self.of_single_joints(effects)]
        return [one for one in found if one is not None]

    def of_each_way(self, effects: _Effects) -> Iterator[Hypothesis | None]:
        """Functions of all joints in one direction."""
        for direction in SIGNS:
            on = replace(effects.term, on=tuple((joint, direction) for joint in self.joints))
            one_way = self.subspace(effects, _Group(direction=direction))
            yield self.make(f"{effects.name}, {direction} only", on, [one_way])

    def of_single_joints(self, effects: _Effects) -> Iterator[Hypothesis | None]:
        """Functions of one joint of several, in both directions."""
        for joint in self.joints if len(self.joints) > 1 else ():
            on = replace(effects.term, on=((joint, "+"), (joint, "-")))
            own = self.subspace(effects, _Group(joint))
            yield self.make(f"{effects.name}, joint {joint}", on, [own])

    def of_all(self, effects: _Effects) -> list[Hypothesis | None]:
        """Functions of all joints, opposite by direction and alike."""
        name, term, whole = effects.name, effects.term, self.subspace(effects, EVERY_ROW)
        opposite = replace(term, mode="opposite")
        turned = (
            self.make(f"{name}, opposite", opposite, [whole], self.sign)
            if self.linearized.allows_opposite
            else self.make(f"{name}, opposite", opposite, [self.subspace(effects, EVERY_ROW, opposite=True)])
        )
        return [turned, self.make(name, term, [whole])]

    def of_joint(
        self, joint: int, effects: _Effects
    ) -> tuple[list[Hypothesis], dict[tuple[int, str], _Subspace]]:
        """The same of one joint, in both directions and in each; the latter also by themselves."""
        label, term, both = f"{effects.name}, joint {joint}", effects.term, ((joint, "+"), (joint, "-"))
        found = [self.make(label, replace(term, on=both), [self.subspace(effects, _Group(joint))])]
        own = {}
        for group in both:
            way = self.subspace(effects, _Group(*group))
            found.append(self.make(f"{label} {group[1]}", replace(term, on=(group,)), [way]))
            if way is not None:
                own[group] = way
        if len(own) > 1:
            each = replace(term, on=tuple(own), each=True)
            found.append(self.make(f"{label}, each direction", each, list(own.values())))
        return [one for one in found if one is not None], own

    def by_session(self, effects: _Effects) -> list[Hypothesis]:
        """Functions that differ from session to session, by joint."""
        found = []
        for joint in self.joints if len(self.session_of) > 1 else ():
            on = replace(effects.term, on=((joint, "+"), (joint, "-")))
            version, parts = self.of_sessions(effects, [_Group(joint)], on)
            found.append(self.make(f"{effects.name}, joint {joint}, in each session", version, parts))
        return [one for one in found if one is not None]

    def profiles(self, joint: int, effects: _Effects) -> dict[str, Hypothesis]:
        """The same of a joint's position, by direction, too, and around what the sessions have in common.

        By the end of their names.
        """
        found: dict[str, Hypothesis | None] = {}
        label, term = f"{POSITION}, joint {joint}, in each session", effects.term
        if len(self.session_of) > 1:
            on, whole = ((joint, "+"), (joint, "-")), [_Group(joint)]
            ways = [_Group(joint, direction) for direction in SIGNS]
            for ending, own, groups in (
                ("", replace(term, on=on), whole),
                (", opposite", replace(term, on=on, mode="opposite"), whole),
                (", each direction", replace(term, on=on, each=True), ways),
            ):
                version, parts = self.of_sessions(effects, groups, own)
                found[ending] = self.make(label + ending, version, parts)
                if nested := self.nested(effects, groups, version):
                    found[f"{ending}, in part"] = self.make(f"{label}{ending}, in part", *nested)
        return {ending: one for ending, one in found.items() if one is not None}

    def of_sessions(
        self, effects: _Effects, groups: Sequence[_Group], term: SmoothTerm
    ) -> tuple[SmoothTerm, list[_Subspace | None]]:
        """A term with functions of each session, and their effects in some groups of rows."""
        own = {
            session: [
                self.subspace(effects, replace(group, session=session), opposite=term.mode == "opposite")
                for group in groups
            ]
            for session in self.session_of
        }
        own = {session: parts for session, parts in own.items() if any(parts)}
        return replace(term, sessions=tuple(own)), [part for parts in own.values() for part in parts]

    def nested(
        self, effects: _Effects, groups: Sequence[_Group], version: SmoothTerm
    ) -> tuple[SmoothTerm, list[_Subspace | None]] | None:
        """Functions of sessions around one that they have in common; None where there are too many."""
        whitened = effects.batch.whitened[:, effects.place]
        number = len(groups) * whitened.shape[1] * (1 + len(version.sessions))
        if not version.sessions or number > MAX_NESTED:
            return None
        columns = []
        for group in groups:
            common, rows = np.zeros_like(whitened), self.rows_of(group)
            common[rows] = whitened[rows]
            common *= self.sign[:, None] if version.mode == "opposite" else 1.0
            own = [common * self.session_of[name][:, None] for name in version.sessions]
            columns += [np.sqrt(COMMON) * common, *(np.sqrt(1.0 - COMMON) * one for one in own)]
        projected = self.linearized.project(np.concatenate(columns, axis=1))
        rows = find_rows(projected)
        across = projected[rows].T[None]
        products = across @ across.transpose(0, 2, 1)
        found = _orthonormalize(rows, across, products, np.array([EFFECT_TOL**2]), np.zeros(1))
        return (replace(version, common=COMMON), found) if any(found) else None

    def subspace(self, effects: _Effects, group: _Group, *, opposite: bool = False) -> _Subspace | None:
        """What calibration leaves of effects in a group of rows; None where that is next to nothing."""
        known, key = effects.batch.known, (group, opposite)
        if key not in known:
            known[key] = self.subspaces(effects.batch, self.rows_of(group), opposite=opposite)
        return known[key][effects.place]

    def subspaces(self, batch: _Batch, subset: IntArray | slice, *, opposite: bool) -> list[_Subspace | None]:
        """The same of all functions of a batch."""
        separate, shape = self.linearized.separates_directions, batch.own.shape
        before = np.einsum("npm,npm->p", batch.whitened[subset], batch.whitened[subset])
        own = (batch.own if separate else batch.whitened)[subset]
        own = own * self.sign[subset, None, None] if opposite else own
        if not separate:  # then what calibration leaves has rows in both
            signed = np.zeros(shape)
            signed[subset] = own
            own = self.linearized.project_own(signed.reshape(len(signed), -1)).reshape(shape)
            subset = slice(None)
        across = own.transpose(1, 2, 0)
        products, lost = across @ across.transpose(0, 2, 1), np.zeros(shape[1])
        if self.shared_basis.shape[1]:
            shared = across @ self.shared_basis[subset]
            products -= shared @ shared.transpose(0, 2, 1)
            lost = np.einsum("pmk,pmk->p", shared, shared)
        return _orthonormalize(subset, across, products, np.maximum(EFFECT_TOL**2, MIN_SHARE * before), lost)

    def make(
        self, name: str, version: SmoothTerm, parts: Sequence[_Subspace | None], sign: Array | None = None
    ) -> Hypothesis | None:
        """The hypothesis with the directions of all parts, in rows of their own, times a sign."""
        known = [part for part in parts if part is not None]
        if not known:
            return None
        if self.is_coupled(version, known):
            return self.couple(f"unknown:{name}", version, known, sign)
        variance = known[0].variance if len(known) == 1 else np.concatenate([one.variance for one in known])
        blocks, total = tuple((part.rows, part.directions) for part in known), float(variance.sum())
        n, shared = len(self.linearized), self.linearized.shared
        return Hypothesis(
            f"unknown:{name}",
            version,
            None,
            n,
            blocks,
            variance / total,
            sqrt(total),
            sign=sign,
            shared=shared,
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
