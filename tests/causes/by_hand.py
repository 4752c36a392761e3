"""Steps over one traverse, one number at a time: plain formulas and scipy's quadrature."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import cos, pi, sin
from types import SimpleNamespace
from typing import Any

import pandas as pd
from scipy.integrate import quad

DEG, MM = pi / 180, 1e-3
FIRST, SECOND = "Monday", "Tuesday"
L2 = 37.5e-3

VALUES = {
    (1, "+"): (97e-6, -5e-5, -1e-6, -3.5e-4),
    (1, "-"): (96e-6, -4e-5, 1.2e-6, 4.5e-4),
    (2, "+"): (95e-6, 90e-6, -15e-6, -19.85e-6),
    (2, "-"): (94e-6, 91e-6, 19.6e-6, 25.91e-6),
    (3, "+"): (976e-9, 0.30, 438e-9),
    (3, "-"): (903e-9, 0.27, -405e-9),
}


def _row(joint: int, start: float, stop: float, where: tuple[float, ...], **known: Any) -> dict[str, Any]:
    unit = MM if joint == 3 else DEG
    q1, q2, q3, theta, psi = where
    row = {"q1": q1 * DEG, "q2": q2 * DEG, "q3": q3 * MM, "theta": theta * DEG, "psi": psi * DEG}
    row |= {f"q{joint}": float("nan"), "start": start * unit, "stop": stop * unit}
    row |= {"joint": joint, "direction": "+" if stop > start else "-", "session": FIRST, "steps_before": 0}
    row |= {"session_seconds": 0.0, "before_direction": "", "before_load": 0.0, "payload": 0.0}
    row |= {"temperature": 293.0, "humidity": 0.40, "supply": 150.0, "step_period": 0.010}
    return row | {"covariate:pressure": 1000.0} | known


WARM = {"session_seconds": 2400.0, "steps_before": 80_000, "before_direction": "-", "before_load": 0.8}
LATE = {"session": SECOND, "session_seconds": 9000.0, "steps_before": 3_000_000, "before_direction": "+"}
HOT = {"temperature": 299.0, "humidity": 0.55, "supply": 147.0, "step_period": 0.004, "payload": 0.005}
COLD = {"temperature": 288.0, "humidity": 0.28, "supply": 155.0, "step_period": 0.020}
HIGH, LOW = {"covariate:pressure": 1030.0}, {"covariate:pressure": 985.0}
ROWS = pd.DataFrame(
    [
        _row(3, 0, 12, (0, -90, 0, 0, 0)),
        _row(3, 12, 0, (20, -30, 0, -45, 10), **WARM, **HOT),
        _row(3, 2, 7, (-60, -150, 0, 30, -20), **LATE, **COLD, **HIGH),
        _row(3, 9, 4, (0, 0, 0, 0, 0), **WARM, **LOW),
        _row(2, 30, -210, (0, 0, 0, 0, 0), **LATE, **HOT),
        _row(2, -210, 30, (45, 0, 12, -30, 25), **WARM, **LOW),
        _row(2, -20, -80, (-70, 0, 6, 15, -40), **WARM, **COLD),
        _row(2, -100, -40, (0, 0, 3, -90, 0), before_load=-0.4),
        _row(1, -120, 120, (0, -90, 0, -90, 0), **LATE),
        _row(1, 120, -120, (0, -45, 6, 20, 50), **WARM, **HOT, **HIGH),
        _row(1, 10, 70, (0, -150, 12, -60, -30), before_direction="-", before_load=0.2),
    ]
)


def load(s: SimpleNamespace) -> float:
    """The published gravity load."""
    if s.joint == 1:
        return cos(s.theta) * sin(s.psi) * sin(s.q1) + sin(s.theta) * cos(s.q1)
    return (sin if s.joint == 2 else cos)(s.psi - s.q2) * cos(s.theta)


def full_load(s: SimpleNamespace) -> float:
    """The gravity load with q1 in its place."""
    if s.joint == 2:
        return (
            sin(s.psi) * cos(s.q1) * cos(s.q2) * cos(s.theta)
            - sin(s.q1) * cos(s.q2) * sin(s.theta)
            - cos(s.psi) * sin(s.q2) * cos(s.theta)
        )
    return (
        sin(s.psi) * cos(s.q1) * sin(s.q2) * cos(s.theta)
        - sin(s.q1) * sin(s.q2) * sin(s.theta)
        + cos(s.psi) * cos(s.q2) * cos(s.theta)
    )


def law(s: SimpleNamespace, u: float, recoil: float) -> float:
    """The published step size."""
    if s.joint == 3:
        a, b, c = s.values
        return (1 - b * recoil) * (a - c * u)
    if s.joint == 2:
        near, far, d_near, d_far = s.values
        out = s.q3 / (12 * MM)
        return near + (far - near) * out + (d_near + (d_far - d_near) * out) * u
    zero, per_m, d_zero, d_per_m = s.values
    reach = -(L2 + s.q3) * sin(s.q2)
    return zero + per_m * reach + (d_zero + d_per_m * reach) * u


PANELS = 20  # the same counts as with 60, to rounding
Angles = Callable[..., dict[str, float]]
Number = Callable[..., float]


@dataclass(frozen=True)
class Effect:
    """What a cause does at each stage, of a state `s` and its parameters; nothing where not given.

    `s` has the row's columns, `way`, `q` (the moving joint's position), and from the stage on where it is
    known `u`, `recoil`, `free` (the step size without both) and `unloaded` (without `u`).
    """

    angles: Angles | None = None
    load: Number | None = None
    recoil: Number | None = None
    term: Number | None = None
    factor: Number | None = None
    count: Number | None = None


def steps(row: dict[str, Any], acting: list[tuple[Effect, tuple[float, ...]]]) -> float:
    """Steps over a traverse with any number of effects at work."""
    way = 1 if row["stop"] > row["start"] else -1
    known = SimpleNamespace(**row, way=way, values=VALUES[row["joint"], row["direction"]])

    def stage(name: str) -> list[tuple[Any, tuple[float, ...]]]:
        return [(getattr(effect, name), p) for effect, p in acting if getattr(effect, name)]

    names = ("angles", "load", "recoil", "term", "factor")
    angles, loads, recoils, terms, factors = map(stage, names)
    own = f"q{row['joint']}"

    def rate(q: float) -> float:
        s = SimpleNamespace(**vars(known))
        s.q = q
        setattr(s, own, q)
        for change, p in angles:
            vars(s).update(change(s, *p))
        s.u, s.recoil = load(s), abs(cos(s.q2))
        for change, p in loads:
            s.u = change(s, *p)
        for change, p in recoils:
            s.recoil = change(s, *p)
        s.free, s.unloaded = law(s, 0.0, 0.0), law(s, 0.0, s.recoil)
        gamma = law(s, s.u, s.recoil) + sum(term(s, *p) for term, p in terms)
        for factor, p in factors:
            gamma *= factor(s, *p)
        return 1 / gamma

    seams = [row["start"] + (row["stop"] - row["start"]) * k / PANELS for k in range(PANELS + 1)]
    whole = abs(sum(quad(rate, *panel, epsabs=0, epsrel=1e-12)[0] for panel in pairwise(seams)))
    return whole + sum(count(known, *p) for count, p in stage("count"))
