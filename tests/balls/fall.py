"""Free fall, and free fall with causes in it: a ball's height over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.laws import Parameter

Array = npt.NDArray[np.float64]
Rows = Mapping[str, Any]
Motion = Callable[[Array], Array]

G = 9.80665  # m/s^2
PIXEL = 0.08  # m, far from the camera
OWN = (
    Parameter("height0", "m", "height at release"),
    Parameter("velocity0", "m/s", "velocity at release, upwards"),
)
SIZES = (0.1, 0.1)  # changes of those that matter
STEPS = 12  # of an integration
APART = 1e-3  # of a parameter's size, for slopes


@dataclass(frozen=True)
class Fall:
    """Height in m; values are height and velocity at release, one pair for each drop, then the causes'.

    Attributes
    ----------
    causes : tuple of FallCause
    """

    causes: tuple[Any, ...] = ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (*OWN, *(each for cause in self.causes for each in cause.parameters))

    def response(self, rows: Rows) -> tuple[Array, Array]:
        """The height, and the variance that reading it to the nearest pixel adds."""
        height = np.asarray(rows["height"], float)
        return height, np.full(len(height), PIXEL**2 / 12.0)

    def predict(self, rows: Rows, values: Array) -> Array:
        return self._heights(rows, np.broadcast_to(values, (len(rows["seconds"]), len(self.parameters))))

    def jacobian(self, rows: Rows, values: Array) -> Array:
        return self.model(rows)(values)[1]

    def model(self, rows: Rows) -> Callable[[Array], tuple[Array, Array]]:
        """From values, shape (n, p), to heights and their slopes, all of which are integrated at once."""
        sizes = APART * np.array([*SIZES, *(size for cause in self.causes for size in cause.scale)])
        p, n = len(sizes), len(rows["seconds"])
        apart = np.concatenate([np.zeros((1, p)), np.diag(sizes), -np.diag(sizes)])
        tiled = {name: np.tile(np.asarray(rows[name]), 2 * p + 1) for name in rows}

        def found(values: Array) -> tuple[Array, Array]:
            around = apart[:, None, :] + np.broadcast_to(values, (n, p))
            heights = self._heights(tiled, around.reshape(-1, p)).reshape(2 * p + 1, n)
            ahead, behind = heights[1 : p + 1], heights[p + 1 :]
            return heights[0], ((ahead - behind) / (2 * sizes[:, None])).T

        return found

    def _heights(self, rows: Rows, values: Array) -> Array:
        """What the clock shows, how the ball moves, then what the camera sees."""
        acting, first = [], len(OWN)
        for cause in self.causes:
            acting.append((cause, values[:, first : first + len(cause.parameters)].T))
            first += len(cause.parameters)
        seconds = np.asarray(rows["seconds"], float)
        for cause, sizes in acting:
            seconds = cause.clock(seconds, sizes)

        def acceleration(velocity: Array) -> Array:
            return -G + sum(cause.acceleration(velocity, rows, sizes) for cause, sizes in acting)

        free = not any(cause.moves for cause in self.causes)
        height = (free_fall if free else integrated)(seconds, values[:, 0], values[:, 1], acceleration)
        for cause, sizes in acting:
            height = cause.seen(height, rows, sizes)
        return height


def free_fall(seconds: Array, height: Array, velocity: Array, _: Motion) -> Array:
    """In closed form."""
    return height + velocity * seconds - G / 2 * seconds**2


def integrated(seconds: Array, height: Array, velocity: Array, acceleration: Motion) -> Array:
    """By the classical Runge-Kutta method, each row with steps of its own, shape (n,)."""
    step = seconds / STEPS
    for _ in range(STEPS):
        a1 = acceleration(velocity)
        a2 = acceleration(velocity + step / 2 * a1)
        a3 = acceleration(velocity + step / 2 * a2)
        a4 = acceleration(velocity + step * a3)
        height = height + step * velocity + step**2 / 6 * (a1 + a2 + a3)
        velocity = velocity + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return height
