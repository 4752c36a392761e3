"""The camera's slant, from the balls whose fall is known best.

The bowling ball's first drop seems to be faster than free fall, which only the camera can make it. That ball
and the baseball are heavy, and not yet as fast as where a sphere's drag drops: drag changes their fall by
little, about as much as any sphere's of their weight and size, and what else they show is the camera. Seen at
a slant, a metre far away is smaller than a metre close by. All balls were filmed from the same place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes import CauseParameter
from tests.balls.cause import Array, FallCause
from tests.balls.causes import AIR, MIDDLE
from tests.balls.fall import Rows
from tests.balls.problem import make_problem

KNOWN = ("bowling-ball", "baseball")
SPHERE = 0.5  # C_D of smooth ones up to about 25 m/s; 0.4 would make the slant a fifth smaller


@dataclass(frozen=True)
class KnownDrag(FallCause):
    """Of a smooth sphere: no parameter is left."""

    name = "known-drag"
    parameters = ()
    scale = ()
    moves = True

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        area = np.asarray(rows["circumference"], float) ** 2 / (4 * np.pi)
        return -SPHERE * AIR * area / (2 * np.asarray(rows["weight"], float)) * velocity * np.abs(velocity)


@dataclass(frozen=True)
class Slant(FallCause):
    """The scale changes along the fall."""

    name = "slant"
    parameters = (CauseParameter("bend", "1/m", "of the scale over height"),)
    scale = tried = (0.001,)

    def seen(self, height: Array, rows: Rows, sizes: Array) -> Array:
        return height + sizes[0] * (height - MIDDLE) ** 2 / 2


def bend(frames: pd.DataFrame) -> float:
    """By how much the scale changes over each metre of height, 1/m."""
    known = frames[frames["ball"].isin(KNOWN)]
    problem, _ = make_problem(known.assign(session=known["ball"] + known["session"]), [])
    return float(problem.fit_extended([KnownDrag(), Slant()], np.zeros(1)).values[0])


def straightened(frames: pd.DataFrame, bend: float) -> pd.DataFrame:
    """Heights as a camera without slant would have seen them."""
    return frames.assign(height=MIDDLE + (np.sqrt(1 + 2 * bend * (frames["height"] - MIDDLE)) - 1) / bend)
