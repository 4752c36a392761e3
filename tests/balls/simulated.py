"""Two drops of a ball whose truth is known; written without the law that is tested on them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.integrate import solve_ivp

Array = npt.NDArray[np.float64]

FRAME, NUMBER, NOISE = 1 / 15, 46, 0.05  # s, frames of a drop, m
RELEASED = ((47.5, -0.4), (46.8, -0.9))  # m, m/s


def fall(height: float, velocity: float, acceleration: Callable[[float], float]) -> Array:
    """Height in each frame, by an adaptive integrator of high order."""
    seconds = FRAME * np.arange(NUMBER)
    found = solve_ivp(
        lambda _, y: [y[1], acceleration(y[1])], (0.0, seconds[-1]), [height, velocity],
        method="DOP853", t_eval=seconds, rtol=1e-10, atol=1e-10,
    )  # fmt: skip
    return np.asarray(found.y[0])


def drops(falls: list[Array], rng: np.random.Generator) -> pd.DataFrame:
    """Frames as they are measured: a basketball's weight and size are written down with them."""
    one = [
        pd.DataFrame({"session": f"drop {k}", "seconds": FRAME * np.arange(len(each)), "height": each})
        for k, each in enumerate(falls, start=1)
    ]
    rows = pd.concat(one, ignore_index=True).assign(weight=0.45, circumference=0.75)
    return rows.assign(height=rows["height"] + NOISE * rng.standard_normal(len(rows)))
