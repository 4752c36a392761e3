"""Why a ball does not seem to fall freely: what moves it, the clock, and the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit.causes import CauseParameter
from tests.balls.cause import Array, FallCause
from tests.balls.drag import Drag
from tests.balls.fall import G, Rows

AIR = 1.2  # kg/m^3
MIDDLE = 30.0  # m, of what the camera sees


@dataclass(frozen=True)
class QuadraticDrag(Drag):
    """Deceleration k v^2; in 1 / k = 2 m / (rho C_D area) a ball that flies by itself loses its speed."""

    name = "quadratic-drag"
    phrase = "air drag grows with the square of speed"
    parameters = (CauseParameter("k", "1/m", "drag over mass", lower=0.0, upper=1.0),)
    scale = (0.005,)
    tried = (0.0005,)

    def largest_plausible(self) -> tuple[Array, ...]:
        return (np.array([0.1]),)

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        return -sizes[0] * velocity * np.abs(velocity)


@dataclass(frozen=True)
class LinearDrag(Drag):
    """Deceleration r v, as in a thick fluid."""

    name = "linear-drag"
    phrase = "drag grows linearly with speed"
    parameters = (CauseParameter("r", "1/s", "drag over mass", lower=0.0, upper=10.0),)
    scale = (0.05,)
    tried = (0.005,)

    def largest_plausible(self) -> tuple[Array, ...]:
        return (np.array([1.0]),)

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        return -sizes[0] * velocity


@dataclass(frozen=True)
class AnotherG(FallCause):
    """Gravity is not what it is taken for."""

    name = "another-g"
    phrase = "gravity is not 9.80665 m/s^2"
    parameters = (CauseParameter("change", "m/s^2", "of g"),)
    scale = tried = (0.1,)
    moves = True

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        return np.broadcast_to(-sizes[0], velocity.shape)


@dataclass(frozen=True)
class Buoyancy(FallCause):
    """The air carries a share of the weight; its density is the parameter."""

    name = "buoyancy"
    phrase = "the air carries part of the weight"
    parameters = (CauseParameter("rho", "kg/m^3", "density of the air"),)
    scale = (0.1,)
    tried = (AIR,)
    max_trial_factor = 1.1
    moves = True

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        unknown = rows[["weight", "circumference"]].isna().any(axis=None)
        return "the ball's weight and circumference were not written down" if unknown else None

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        volume = np.asarray(rows["circumference"], float) ** 3 / (6 * np.pi**2)
        return G * sizes[0] * volume / np.asarray(rows["weight"], float)


@dataclass(frozen=True)
class ClockOffset(FallCause):
    """The film begins a little earlier or later than its time says."""

    name = "clock-offset"
    phrase = "the clock starts early or late"
    parameters = (CauseParameter("offset", "s", "of the clock"),)
    scale = tried = (0.01,)

    def clock(self, seconds: Array, sizes: Array) -> Array:
        return seconds + sizes[0]


@dataclass(frozen=True)
class CameraScale(FallCause):
    """Metres to a pixel are off by a share, in all drops alike or in each by its own."""

    drops: tuple[str, ...] = ()

    name = "camera-scale"
    phrase = "the camera's scale is off"
    combine_trials = True

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        return tuple(
            CauseParameter("share", "%", "error of the scale", session=drop) for drop in self.drops or (None,)
        )

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (0.01,) * len(self.parameters)

    def trials(self, rows: pd.DataFrame) -> list[tuple[FallCause, Array]]:
        each = replace(self, drops=tuple(sorted(set(map(str, rows["session"])))))
        return [(version, 0.01 * np.eye(len(version.parameters))) for version in (self, each)]

    def seen(self, height: Array, rows: Rows, sizes: Array) -> Array:
        share = sizes[0]
        if self.drops:
            drop = np.asarray(rows["session"], dtype=str)
            share = sum((drop == name) * size for name, size in zip(self.drops, sizes, strict=True))
        return height + share * (height - MIDDLE)


def library() -> tuple[FallCause, ...]:
    """What may be wrong with a drop, from what is left of it."""
    return QuadraticDrag(), LinearDrag(), AnotherG(), CameraScale(), ClockOffset(), Buoyancy()
