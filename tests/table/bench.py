"""A motor's friction bench, simulated by plain numpy: what a table's diagnosis has to get right."""

import numpy as np
import pandas as pd

import stickslip_fit as ssf

TRUE = {"M": 0.8, "Fv": 4.0, "Fc": 1.2, "offset": 0.3, "dFv": 1.5}
UNITS = {"F": "N", "M": "kg", "Fv": "N s/m", "Fc": "N", "offset": "N", "vel": "m/s", "acc": "m/s²"}
LAW = ssf.Law("F ~ M*acc + Fv*vel + Fc*sign(vel) + offset", units=UNITS)
BY_DIRECTION = ssf.Cause(
    "viscous-by-direction",
    "+ dFv*abs(vel)",
    "dFv in N s/m",
    phrase="viscous friction differs between directions",
)
CUBIC = ssf.Cause("cubic", "+ c*vel**3", "c in N s³/m³")


def bench(
    seed: int = 0, n: int = 300, *, difference: float = 1.5, sd: float = 0.2, phi: float = 0.0
) -> pd.DataFrame:
    """A drive that swings to and fro; `phi` is the correlation of the noise from row to row."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(n)
    q = 0.1 * np.sin(2 * np.pi * t / 2.3) + 0.04 * np.sin(2 * np.pi * t / 0.71)
    vel = np.gradient(q, t)
    acc = np.gradient(vel, t)
    noise = rng.standard_normal(n) * np.where(np.arange(n) > 0, np.sqrt(1 - phi**2), 1.0)
    for row in range(1, n):
        noise[row] += phi * noise[row - 1]
    true = TRUE | {"dFv": difference}
    force = true["M"] * acc + true["Fv"] * vel + true["Fc"] * np.sign(vel) + true["offset"]
    return pd.DataFrame(
        {"t": t, "q": q, "vel": vel, "acc": acc, "F": force + true["dFv"] * np.abs(vel) + sd * noise}
    )


def design(frame: pd.DataFrame, *, extended: bool) -> np.ndarray:
    """The law's terms as columns, written by hand; with viscous friction by direction or without."""
    vel = frame["vel"].to_numpy()
    terms = [frame["acc"].to_numpy(), vel, np.sign(vel), np.ones(len(frame))]
    return np.column_stack([*terms, *([np.abs(vel)] if extended else [])])
