"""Terms without a cause: what the diagnosis puts into a law for structure that has no name.

A `SmoothTerm` is a smooth function of one carrier, or a product of such functions of two: a position, an
angle, the load, a column of the log, the traverse before. `carrier_values` says what each carrier is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.parameters import CauseParameter
from stickslip_fit.causes.smooth import LinearFactor, cosines
from stickslip_fit.laws import State, StepLaw

ANGLES = ("q1", "q2", "q3", "theta", "psi")  # the joint's own excepted, which is the position
POSITION, LOAD, BEFORE_DIRECTION = "position", "load", "before_direction"
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
    if carrier == f"q{state.joint}":
        return np.full((len(state.position), 1), np.nan)
    if carrier in ANGLES:
        return np.asarray(getattr(state, carrier) + np.zeros((len(state.position), 1)))
    if carrier == BEFORE_DIRECTION:
        before = np.asarray(state.row[carrier], dtype=object)[:, None]
        return np.asarray((before == "+") * 1.0 - (before == "-"))
    return state.column(carrier)


def carrier_columns(carrier: str) -> tuple[str, ...]:
    """The column of a log in which a carrier is; none of what follows from the pose and the joint."""
    return () if carrier in (*ANGLES, POSITION, LOAD) else (carrier,)


@dataclass(frozen=True)
class SmoothTerm(LinearFactor):
    """gamma times 1 + a smooth function of the carriers.

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
    """

    carriers: tuple[str, ...] = (POSITION,)
    limits: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    orders: tuple[tuple[int, ...], ...] = ((1,),)
    sds: tuple[float, ...] = (SMOOTH_SCALE,)
    on: tuple[tuple[int, str], ...] = ()
    mode: Mode = "same"
    each: bool = False
    sessions: tuple[str, ...] = ()

    name = "smooth-term"
    phrase = "steps follow something smoothly that no cause describes"
    physics = "Whatever the carrier stands for: the log alone shows that the step size follows it smoothly."
    shows_best = "one configuration at the lowest and at the highest values of the carrier"
    scale_of_each: ClassVar[float] = SMOOTH_SCALE

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `Cause`."""
        own = [name for carrier in self.carriers for name in carrier_columns(carrier)]
        return tuple(dict.fromkeys([*own, *(("session",) if self.sessions else ())]))

    @property
    def varies_along_traverse(self) -> bool:  # type: ignore[override]
        """See `Cause`."""
        return any(carrier in (POSITION, LOAD) for carrier in self.carriers)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
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
            for session in self.sessions or (None,)
            for joint, direction in (self.on if self.each else ((None, None),))
            for number, sd in enumerate(self.sds, 1)
        )

    @property
    def null_values(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.0,) * len(self.parameters)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (self.scale_of_each,) * len(self.parameters)

    def acts_on(self, law: StepLaw) -> bool:
        """See `Cause.acts_on`."""
        return not self.on or any(joint == law.joint for joint, _ in self.on)

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with another size: all prior standard deviations times a number."""
        return replace(self, sds=tuple(amplitude * sd for sd in self.sds))

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [(self, np.diag([parameter.prior_sd for parameter in self.parameters]))]

    def functions(self, state: State) -> Array:
        """See `LinearFactor.functions`."""
        values = np.broadcast_arrays(*(carrier_values(state, carrier) for carrier in self.carriers))
        waves = [
            cosines(one, low, high, max(order[place] for order in self.orders))
            for place, (one, (low, high)) in enumerate(zip(values, self.limits, strict=True))
        ]
        functions = np.stack(
            [
                np.prod([wave[..., k - 1] for wave, k in zip(waves, order, strict=True)], axis=0)
                for order in self.orders
            ],
            axis=-1,
        )
        sign = state.direction_sign[..., None]
        functions = np.nan_to_num(functions) * (sign if self.mode == "opposite" else 1.0)
        if self.on:
            acts = np.stack(
                [((sign > 0) == (way == "+")) * float(joint == state.joint) for joint, way in self.on], axis=-1
            )
            acts = acts if self.each else acts.sum(axis=-1, keepdims=True)
            functions = (functions[..., None, :] * acts.transpose(0, 1, 3, 2)).reshape(
                *functions.shape[:2], -1
            )
        if self.sessions:
            names = np.asarray(state.row["session"], dtype=object)[:, None] == np.array(self.sessions, object)
            functions = (names[:, None, :, None] * functions[:, :, None, :]).reshape(*functions.shape[:2], -1)
        return np.asarray(functions)
