"""Terms without a cause: what the diagnosis puts into a law for structure that has no name.

A `SmoothTerm` is a smooth function of one carrier, or a product of such functions of two: a position, an
angle, the load, a column of the log, the traverse before. `carrier_values` says what each carrier is. A
`ProposedTerm` is one number times a short expression of them, such as k * sin(q1) * load; a `CarryOverTerm`
follows what the step size of the traverse before had beyond its law.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.carrier_function import CarrierFunction
from stickslip_fit.causes.parameters import CauseParameter, Row
from stickslip_fit.causes.smooth import LinearFactor, LogLinearFactor, cosines, harmonics, wave_products
from stickslip_fit.laws import State, StepLaw, state_at
from stickslip_fit.logs.history import PAUSES
from stickslip_fit.units import from_si, share_per

ANGLES = ("q1", "q2", "q3", "theta", "psi")  # the joint's own excepted, which is the position
POSITION, LOAD, BEFORE_DIRECTION = "position", "load", "before_direction"
LENGTH = "own_length"  # of the traverse, rad or m
ZETA = "zeta"  # psi - q2, by which the published laws of joints 2 and 3 have the load
TRANSVERSE_LOAD = "transverse_load"  # what the load would be a quarter turn on, which presses across it
LOADS = (LOAD, TRANSVERSE_LOAD)
ALONG = (POSITION, ZETA, *LOADS)  # what may change along a traverse
CLOCK_UNITS = {"session_order": "traverses", "joint_travel": "travels of the joint"}
SMOOTH_SCALE = 0.01  # of a smooth function's coefficients
Mode = Literal["same", "opposite"]


def carrier_values(state: State, carrier: str) -> Array:
    """What a carrier is at each position of each traverse, shape (n, k) or (n, 1); NaN where it is unknown.

    The angle of the joint that moves is unknown: along a traverse it is the position.
    """
    if carrier == POSITION:
        return state.position
    if carrier == LOAD:
        return state.load
    if carrier == TRANSVERSE_LOAD:
        return np.asarray(state.transverse_load + np.zeros((len(state.position), 1)))
    if carrier == LENGTH:
        return np.abs(state.column("stop") - state.column("start"))
    if carrier == f"q{state.joint}":
        return np.full((len(state.position), 1), np.nan)
    if carrier == ZETA:
        return np.asarray(state.psi - state.q2 + np.zeros((len(state.position), 1)))
    if carrier in ANGLES:
        return np.asarray(getattr(state, carrier) + np.zeros((len(state.position), 1)))
    if carrier == BEFORE_DIRECTION:
        before = np.asarray(state.row[carrier], dtype=object)[:, None]
        return np.asarray((before == "+") * 1.0 - (before == "-"))
    values = state.column(carrier)  # of a time since something a function follows the logarithm
    return np.log1p(np.maximum(values, 0.0)) if carrier in PAUSES else values


def carrier_columns(carrier: str) -> tuple[str, ...]:
    """The column of a log in which a carrier is; none of what follows from the traverse itself."""
    return () if carrier in (*ANGLES, ZETA, POSITION, *LOADS, LENGTH) else (carrier,)


@dataclass(frozen=True)
class SmoothTerm(LogLinearFactor):
    """gamma times exp of a smooth function of the carriers.

    Attributes
    ----------
    carriers : tuple of str
        One or two, see `carrier_values`.
    limits : tuple of (float, float)
        Range of each carrier; beyond it the function is constant.
    orders : tuple of tuple of int
        Of each function, the order of its cosine in each carrier.
    sds : tuple of float
        Prior standard deviation of each function's coefficient.
    on : tuple of (int, str)
        Joints and directions on which it acts; all if empty.
    mode : {"same", "opposite"}
        Whether it has the other sign in direction ``-``.
    each : bool
        Whether each of `on` has a function of its own.
    sessions : tuple of str
        Sessions with a function of their own; empty for the same in all.
    common : float
        Share of the prior variance that is in a function which all sessions have in common.
    travel : tuple of (int, float, float)
        Joint and range of its positions, where joints have different ones.
    """

    carriers: tuple[str, ...] = (POSITION,)
    limits: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    orders: tuple[tuple[int, ...], ...] = ((1,),)
    sds: tuple[float, ...] = (SMOOTH_SCALE,)
    on: tuple[tuple[int, str], ...] = ()
    mode: Mode = "same"
    each: bool = False
    sessions: tuple[str, ...] = ()
    common: float = 0.0
    travel: tuple[tuple[int, float, float], ...] = ()

    name = "smooth-function"
    phrase = "steps follow something smoothly that no cause describes"
    physics = "Whatever the carrier stands for: the log alone shows that the step size follows it smoothly."
    shows_best = "one configuration at the lowest and at the highest values of the carrier"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        own = [name for carrier in self.carriers for name in carrier_columns(carrier)]
        return tuple(dict.fromkeys([*own, *(("session",) if self.sessions else ())]))

    @property
    def varies_along_traverse(self) -> bool:  # type: ignore[override]
        return any(carrier in ALONG for carrier in self.carriers)

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return tuple(
            CauseParameter(
                f"c{number}",
                "%",
                f"coefficient {number} of a smooth function of {' and '.join(self.carriers)}",
                joint=joint,
                direction=direction,
                session=session,
                prior_sd=sd,
            )
            for session, (joint, direction), number, sd in self._coefficients()
        )

    def _coefficients(self) -> Iterator[tuple[str | None, tuple[int | None, str | None], int, float]]:
        """Of each: session, joint and direction, its number there, prior standard deviation."""
        for session, share in self._functions_of:
            for only in map(_only, self._groups if len(self._groups) > 1 else ((),)):
                for number, sd in enumerate(self.sds, 1):
                    yield session, only, number, float(np.sqrt(share)) * sd

    @property
    def _groups(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        """Joints and directions with a function of their own."""
        return tuple((one,) for one in self.on) if self.each else (self.on,)

    @property
    def _functions_of(self) -> tuple[tuple[str | None, float], ...]:
        """Each session with a function of its own, or None for all, and its share of the prior variance."""
        if not self.sessions:
            return ((None, 1.0),)
        own = tuple((session, 1.0 - self.common) for session in self.sessions)
        return ((None, self.common), *own) if self.common else own

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (SMOOTH_SCALE,) * len(self.parameters)

    def acts_on(self, law: StepLaw) -> bool:
        return not self.on or any(joint == law.joint for joint, _ in self.on)

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with another size: all prior standard deviations times a number."""
        return replace(self, sds=tuple(amplitude * sd for sd in self.sds))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [(self, np.diag([parameter.prior_sd for parameter in self.parameters]))]

    def functions(self, state: State) -> Array:
        values = np.broadcast_arrays(*(carrier_values(state, carrier) for carrier in self.carriers))
        waves = self.waves(values, self.limits_of(state.joint))
        return np.nan_to_num(wave_products(waves, self.orders))

    def null_slopes(self, law: StepLaw, rows: Row, values: Array) -> Array:
        """See `LinearFactor.null_slopes`: of one function for all, where each acts."""
        if self == self.for_all:
            return super().null_slopes(law, rows, values)
        return self.from_alike(law, rows, self.for_all.null_slopes(law, rows, values))

    def from_alike(self, law: StepLaw, rows: Row, alike: Array) -> Array:
        """Derivatives by each parameter, (n, q), from those of one function for all, (n, m)."""
        row = self.row_values(law, rows)
        acts = self.acts(state_at(law.joint, row, row["start"][:, None]))
        return np.asarray((acts[:, :, None] * alike[:, None, :]).reshape(len(acts), -1))

    @property
    def for_all(self) -> SmoothTerm:
        """The same with one function for all, of one sign."""
        return replace(self, on=(), mode="same", each=False, sessions=(), common=0.0)

    def acts(self, state: State) -> Array:
        """See `LinearFactor.acts`: of each session, joint and direction with functions of its own."""
        acts = self._of_groups(state) * _sign(state, self.mode)
        if not self.sessions:
            return acts
        own = self._of_sessions(state, acts)
        return np.concatenate([acts, own], axis=1) if self.common else own

    def _of_groups(self, state: State) -> Array:
        """As `acts`, of joints and directions."""
        if not self.on:
            return np.ones((len(state.position), 1))
        ways = [sum(_acts(state, joint, way) for joint, way in group) for group in self._groups]
        return np.concatenate(ways, axis=1)

    def _of_sessions(self, state: State, acts: Array) -> Array:
        """As `acts`, shape (n, g), of each session by itself, shape (n, sessions g)."""
        inside = np.asarray(state.row["session"], dtype=object)[:, None] == np.array(self.sessions, object)
        own = inside[:, :, None] * acts[:, None, :]
        return np.asarray(own.reshape(len(acts), inside.shape[1] * acts.shape[1]))

    def limits_of(self, joint: int) -> tuple[tuple[float, float], ...]:
        """Range of each carrier where this joint moves."""
        own = {number: (low, high) for number, low, high in self.travel}
        pairs = zip(self.carriers, self.limits, strict=True)
        return tuple(own.get(joint, limits) if name == POSITION else limits for name, limits in pairs)

    def waves(self, values: Sequence[Array], limits: Sequence[tuple[float, float]]) -> list[Array]:
        """Functions of each carrier, from its values, shape (n, k) -> (n, k, highest order)."""
        return [
            cosines(one, low, high, max(order[place] for order in self.orders))
            for place, (one, (low, high)) in enumerate(zip(values, limits, strict=True))
        ]


@dataclass(frozen=True)
class JointTerm(SmoothTerm):
    """gamma times exp of a smooth function for each joint.

    Attributes
    ----------
    on : tuple of (int, str)
        As of a `SmoothTerm`; functions are shared by the directions of a joint, or by none if `each`.
    """

    name = "smooth-joint-function"
    phrase = "steps of each joint follow something smoothly that no cause describes"

    @classmethod
    def of(cls, terms: Sequence[SmoothTerm], **attributes: Any) -> Self:
        """The terms of several joints, which have the same functions otherwise, as one."""
        shared = {one.name: getattr(terms[0], one.name) for one in fields(terms[0])}
        shared["on"] = tuple(place for one in terms for place in one.on)
        shared["sessions"] = tuple(dict.fromkeys(name for one in terms for name in one.sessions))
        return cls(**shared | attributes)

    @property
    def _groups(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        return super()._groups if self.each else self._of_joints

    @property
    def _of_joints(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        joints = dict.fromkeys(joint for joint, _ in self.on)
        return tuple(tuple(one for one in self.on if one[0] == joint) for joint in joints)


@dataclass(frozen=True)
class TravelTerm(JointTerm):
    """gamma times exp of a smooth function of the position along each joint's own travel."""

    name = "smooth-travel-function"
    phrase = "steps follow the position along each joint's travel smoothly as no cause describes"


@dataclass(frozen=True)
class NestedTerm(TravelTerm):
    """gamma times exp of smooth functions of one carrier: in common, of directions, of sessions, and of both.

    Attributes
    ----------
    parts : tuple of (bool, {"same", "opposite"}, tuple of float)
        Whether each session has a function of its own, its sign in the two directions, and the prior standard
        deviations of the coefficients, in place of `sds`.
    """

    parts: tuple[tuple[bool, Mode, tuple[float, ...]], ...] = ((False, "same", (SMOOTH_SCALE,)),)

    name = "smooth-functions"
    phrase = SmoothTerm.phrase

    @classmethod
    def of_parts(cls, term: SmoothTerm, parts: Sequence[tuple[bool, Mode, tuple[float, ...]]]) -> Self:
        """A function of the same carrier and joints as another one."""
        shared = {one.name: getattr(term, one.name) for one in fields(term)}
        variances = [(own, float(np.sum(np.square(sds)))) for own, _, sds in parts]
        shared |= {
            "orders": tuple((k,) for k in range(1, len(parts[0][2]) + 1)),
            "sds": parts[0][2],
            "mode": "same",
            "each": any(mode == "opposite" for _, mode, _ in parts),
            "common": sum(one for own, one in variances if not own) / sum(one for _, one in variances),
            "parts": tuple(parts),
        }
        return cls(**shared)

    def _coefficients(self) -> Iterator[tuple[str | None, tuple[int | None, str | None], int, float]]:
        for place, (own, _, sds) in enumerate(self.parts):
            for session in self.sessions if own else (None,):
                for group in self._groups or ((),):
                    for number, sd in enumerate(sds, 1 + place * len(sds)):
                        yield session, (_only(group)[0], None), number, sd

    @property
    def _groups(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        return self._of_joints

    @property
    def for_all(self) -> SmoothTerm:
        return TravelTerm(self.carriers, self.limits, self.orders, self.sds, travel=self.travel)

    def with_amplitude(self, amplitude: float) -> Self:
        parts = [(own, mode, tuple(amplitude * sd for sd in sds)) for own, mode, sds in self.parts]
        return self.of_parts(self, parts)

    def acts(self, state: State) -> Array:
        acts, columns = self._of_groups(state), []
        for own, mode, _ in self.parts:
            signed = acts * _sign(state, mode)
            columns.append(self._of_sessions(state, signed) if own else signed)
        return np.concatenate(columns, axis=1)


@dataclass(frozen=True)
class PeriodicTerm(SmoothTerm):
    """gamma times exp of a wave in time, in the number of traverses or in the joint's own travel.

    Attributes
    ----------
    period : float
        In the unit of the clock, the first of `carriers`; where the load is the second, it is in proportion.
    n_slow : int
        Functions of each session's time by which the wave's size and phase may change in it; 0 for none.
    """

    orders: tuple[tuple[int, ...], ...] = ((1,), (2,))  # the cosine and the sine of each harmonic
    sds: tuple[float, ...] = (SMOOTH_SCALE, SMOOTH_SCALE)
    period: float = 1.0
    n_slow: int = 0

    name = "periodic-function"
    phrase = "steps come and go with a period that no cause describes"
    physics = "Whatever has this period: the log alone shows that the step size follows it."
    shows_best = "one configuration again and again, at most a quarter of the period apart"

    def __str__(self) -> str:
        """Its period in words."""
        if self.carriers[0] == "session_seconds":
            text = f"period of {from_si(self.period, 'min'):.1f} min"
        else:
            text = f"period of {self.period:.1f} {CLOCK_UNITS[self.carriers[0]]}"
        ends = ", by load" * (LOAD in self.carriers) + ", opposite" * (self.mode == "opposite")
        return text + ends + describe_where(self.on, "same")

    def waves(self, values: Sequence[Array], limits: Sequence[tuple[float, float]]) -> list[Array]:
        """See `SmoothTerm.waves`: cosine and sine of each harmonic, each by itself and times slow cosines."""
        (clock, *loads), ((low, high), *_) = values, limits
        fast = harmonics(clock, self.period, len(self.orders) // 2 // (1 + self.n_slow))
        if not self.n_slow:
            return [fast, *(load[..., None] for load in loads)]
        slow = cosines(clock, low, high, self.n_slow)
        slow = np.concatenate([np.ones((*clock.shape, 1)), slow], axis=-1)
        changing = (slow[..., :, None] * fast[..., None, :]).reshape(*clock.shape, -1)
        return [changing, *(load[..., None] for load in loads)]


def _only(group: Sequence[tuple[int, str]]) -> tuple[int | None, str | None]:
    """The joint and the direction that all of a group have; None for several or for all."""
    joints, ways = {joint for joint, _ in group}, {way for _, way in group}
    return (joints.pop() if len(joints) == 1 else None, ways.pop() if len(ways) == 1 else None)


def _sign(state: State, mode: Mode) -> Array:
    """-1 for an effect of opposite sign in direction ``-``, shape (n, 1)."""
    return state.direction_sign if mode == "opposite" else np.ones((len(state.position), 1))


def _acts(state: State, joint: int, way: str) -> Array:
    """1 for the traverses of a joint in a direction, shape (n, 1)."""
    return ((state.direction_sign > 0) == (way == "+")) * float(joint == state.joint)


@dataclass(frozen=True)
class ProposedTerm(LinearFactor):
    """gamma times 1 + k times a product of one or two functions of a carrier each.

    Attributes
    ----------
    factors : tuple of (str, str, float, float, str)
        Each a `CarrierFunction`; files of earlier versions have no unit in which it is shown.
    on, mode
        As of a `SmoothTerm`.
    largest : float
        Size of the product, SI, where it is largest.
    each : bool
        Whether each direction has a size of its own.
    """

    factors: tuple[tuple[Any, ...], ...] = (("x", POSITION, 0.0, 1.0),)
    on: tuple[tuple[int, str], ...] = ()
    mode: Mode = "same"
    largest: float = 1.0
    each: bool = False

    name = "proposed-term"
    phrase = "steps follow a term that no cause describes"
    physics = "Whatever stands behind it: of all short expressions this one describes the log best."
    shows_best = "configurations in which the term is smallest and greatest"

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`: in the unit that makes the formula true."""
        powers = Counter[str]()
        for factor in self.factors:
            powers.update(CarrierFunction(*factor).powers)
        k = CauseParameter("k", share_per(powers), f"size of the proposed term {self.formula}")
        return tuple(replace(k, direction=way) for way in "+-") if self.each else (k,)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (SMOOTH_SCALE / self.largest,) * len(self.parameters)

    @property
    def carriers(self) -> tuple[str, ...]:
        """The carrier of each factor."""
        return tuple(factor[1] for factor in self.factors)

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        return tuple(dict.fromkeys(name for carrier in self.carriers for name in carrier_columns(carrier)))

    @property
    def varies_along_traverse(self) -> bool:  # type: ignore[override]
        return any(carrier in ALONG for carrier in self.carriers)

    @property
    def formula(self) -> str:
        """For people, such as ``k * sin(q1) * load, joint 2, + only``."""
        text = "k * " + " * ".join(str(CarrierFunction(*factor)) for factor in self.factors)
        return text + describe_where(self.on, self.mode) + ", k by direction" * self.each

    def acts_on(self, law: StepLaw) -> bool:
        return not self.on or any(joint == law.joint for joint, _ in self.on)

    def functions(self, state: State) -> Array:
        function = np.prod(
            np.broadcast_arrays(
                *(
                    CarrierFunction(*factor).values(carrier_values(state, factor[1]))
                    for factor in self.factors
                )
            ),
            axis=0,
        )
        function = function * _sign(state, self.mode)
        if self.on:
            function = function * sum(_acts(state, joint, way) for joint, way in self.on)
        return np.asarray(function[..., None])

    def acts(self, state: State) -> Array:
        forward = 1.0 * (state.direction_sign > 0)
        return np.concatenate([forward, 1.0 - forward], axis=1) if self.each else super().acts(state)


@dataclass(frozen=True)
class CarryOverTerm(ProposedTerm):
    """gamma times 1 + k times the departure of the traverse before from its own prediction.

    That departure is relative, of the step size, and 0 where there is no count before. Since a prediction
    has what was carried over to it, what it departs by is new: its innovation.

    Attributes
    ----------
    factors : tuple of (str, str, float, float)
        One, "x" of a column of `DEPARTURES`, a share.
    on : tuple of (int, str)
        As of a `SmoothTerm`.
    """

    factors: tuple[tuple[Any, ...], ...] = (("x", "departure_before", 0.0, 1.0),)

    name = "carry-over-term"
    phrase = "steps follow what the traverse before departed by"
    physics = "Whatever outlasts a traverse: the log alone shows that its departure carries over to the next."
    shows_best = "one configuration again and again, without a pause"
    parameters = (CauseParameter("k", "%", "share of the departure before that carries over"),)
    scale = (1.0,)


def describe_where(on: tuple[tuple[int, str], ...], mode: Mode) -> str:
    """Joints and directions on which a term acts, as the end of its formula; empty for all."""
    joints = sorted({joint for joint, _ in on})
    ways = sorted({way for _, way in on})
    text = f", joint {' and '.join(map(str, joints))}" if joints else ""
    text += f", {ways[0]} only" if len(ways) == 1 else ""
    return text + (", opposite sign in the two directions" if mode == "opposite" else "")
