"""Scalar kernels: friction models, equations of motion, and Runge-Kutta 5(4) (Dormand and Prince, 1980).

numba compiles them where it is installed; without it they are plain Python, for other solvers to call.
Imported late: numba takes half a second to load.

States y: slider position and velocity; foot extension and its rate, if it has dynamics; base position and
velocity, if it recoils; then the bristles.
Constants c: slider mass, load G, foot mass, piezo stiffness and damping, base mass, stiffness and damping.
The piece's command: position, velocity and acceleration at its beginning.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from math import exp, isfinite, pi, sin
from typing import Any

import numpy as np

from stickslip_fit._typing import Array

COMPILED = find_spec("numba") is not None


def _leave(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return lambda function: function


njit: Any = import_module("numba").njit if COMPILED else _leave

LUGRE, ELASTOPLASTIC, DAHL, MAXWELL_SLIP = range(4)
SAFETY, LEAST_FACTOR, MOST_FACTOR = 0.9, 0.2, 5.0


@njit(cache=True, error_model="numpy")
def resist(kind: int, p: Array, z: Array, w: float, rates: Array, first: int) -> float:
    """Resistance to sliding at velocity w; writes the rates of the bristles, which begin at `first`."""
    if kind == MAXWELL_SLIP:
        n = len(z) - first
        stiffness = 0.0
        for i in range(n):
            stiffness += p[1 + i]
        force = 0.0
        for i in range(n):
            own = p[1 + i] * z[first + i]
            slips = own * w > 0.0 and abs(own) >= p[1 + n + i]
            rates[first + i] = 0.0 if slips else w
            force += own + p[0] * rates[first + i] * p[1 + i] / stiffness
        return force
    if kind == DAHL:
        left = 1.0 - (p[1] * z[first] / p[0] if w >= 0.0 else -p[1] * z[first] / p[0])
        share = abs(left) ** p[2]
        rates[first] = w * (share if left >= 0.0 else -share)
        return p[1] * z[first]
    ratio = w / p[2]
    # Beyond 6 vs the exponential is 2e-16.
    stribeck = exp(-ratio * ratio) if abs(ratio) < 6.0 and p[1] > p[0] else 0.0
    steady = (p[0] + (p[1] - p[0]) * stribeck) / p[3]
    plastic = 1.0
    if kind == ELASTOPLASTIC:
        size = abs(z[first])
        if z[first] * w <= 0.0 or size <= p[6]:
            plastic = 0.0
        elif size < steady:
            plastic = 0.5 + 0.5 * sin(pi * (size - 0.5 * (steady + p[6])) / (steady - p[6]))
    rates[first] = w - plastic * abs(w) * z[first] / steady
    return p[3] * z[first] + p[4] * rates[first] + p[5] * w


@njit(cache=True, error_model="numpy")
def slope(
    t: float,
    y: Array,
    dy: Array,
    has_piezo: bool,
    has_base: bool,
    c: Array,
    kind: int,
    p: Array,
    command: Array,
) -> None:
    """Write the time derivative of the state, at a time after the piece's beginning."""
    at_base = 4 if has_piezo else 2
    first = at_base + 2 if has_base else at_base
    base_speed = y[at_base + 1] if has_base else 0.0
    speed = y[3] if has_piezo else command[1] + command[2] * t
    force = resist(kind, p, y, y[1] - speed - base_speed, dy, first)
    dy[0] = y[1]
    dy[1] = -force / c[0] - c[1]
    drive = 0.0
    if has_piezo:
        target = command[0] + (command[1] + 0.5 * command[2] * t) * t
        drive = c[3] * (target - y[2]) - c[4] * y[3]
    recoil = 0.0
    if has_base:
        held = -c[6] * y[at_base] - c[7] * base_speed
        if has_piezo:  # noqa: SIM108 - two equations of motion
            recoil = (held - drive) / c[5]
        else:
            recoil = (held + force - c[2] * command[2]) / (c[5] + c[2])
        dy[at_base] = base_speed
        dy[at_base + 1] = recoil
    if has_piezo:
        dy[2] = y[3]
        dy[3] = (drive + force) / c[2] - recoil


@njit(cache=True, error_model="numpy")
def integrate(
    y: Array,
    begin: float,
    end: float,
    first: float,
    has_piezo: bool,
    has_base: bool,
    c: Array,
    kind: int,
    p: Array,
    command: Array,
    relative: float,
    absolute: Array,
    budget: int,
) -> tuple[float, int]:
    """Integrate y in place from `begin` to `end` of a piece; the next step's width, and the steps left.

    The steps left are negative where the budget ran out, or the state is no longer finite.
    """
    n = len(y)
    k = np.empty((7, n))
    trial = np.empty(n)
    t, h = begin, min(first, end - begin)
    slope(t, y, k[0], has_piezo, has_base, c, kind, p, command)
    while t < end:
        if budget <= 0:
            return h, -1
        budget -= 1
        is_last = t + 1.000001 * h >= end
        if is_last:
            h = end - t
        for i in range(n):
            trial[i] = y[i] + h * (k[0, i] / 5)
        slope(t + h / 5, trial, k[1], has_piezo, has_base, c, kind, p, command)
        for i in range(n):
            trial[i] = y[i] + h * (3 / 40 * k[0, i] + 9 / 40 * k[1, i])
        slope(t + 3 * h / 10, trial, k[2], has_piezo, has_base, c, kind, p, command)
        for i in range(n):
            trial[i] = y[i] + h * (44 / 45 * k[0, i] - 56 / 15 * k[1, i] + 32 / 9 * k[2, i])
        slope(t + 4 * h / 5, trial, k[3], has_piezo, has_base, c, kind, p, command)
        for i in range(n):
            trial[i] = y[i] + h * (
                19372 / 6561 * k[0, i] - 25360 / 2187 * k[1, i] + 64448 / 6561 * k[2, i] - 212 / 729 * k[3, i]
            )
        slope(t + 8 * h / 9, trial, k[4], has_piezo, has_base, c, kind, p, command)
        for i in range(n):
            trial[i] = y[i] + h * (
                9017 / 3168 * k[0, i]
                - 355 / 33 * k[1, i]
                + 46732 / 5247 * k[2, i]
                + 49 / 176 * k[3, i]
                - 5103 / 18656 * k[4, i]
            )
        slope(t + h, trial, k[5], has_piezo, has_base, c, kind, p, command)
        for i in range(n):
            trial[i] = y[i] + h * (
                35 / 384 * k[0, i]
                + 500 / 1113 * k[2, i]
                + 125 / 192 * k[3, i]
                - 2187 / 6784 * k[4, i]
                + 11 / 84 * k[5, i]
            )
        slope(t + h, trial, k[6], has_piezo, has_base, c, kind, p, command)
        total = 0.0
        for i in range(n):
            fault = h * (
                71 / 57600 * k[0, i]
                - 71 / 16695 * k[2, i]
                + 71 / 1920 * k[3, i]
                - 17253 / 339200 * k[4, i]
                + 22 / 525 * k[5, i]
                - 1 / 40 * k[6, i]
            )
            scale = absolute[i] + relative * max(abs(y[i]), abs(trial[i]))
            total = max(total, abs(fault) / scale)
        if not isfinite(total):
            if h < 1e-15 * max(end, 1e-12):
                return h, -1
            h *= LEAST_FACTOR
            continue
        factor = MOST_FACTOR if total == 0.0 else SAFETY * total**-0.2
        factor = min(MOST_FACTOR, max(LEAST_FACTOR, factor))
        if total <= 1.0:
            t = end if is_last else t + h
            for i in range(n):
                y[i] = trial[i]
                k[0, i] = k[6, i]
        h *= factor
    return h, budget


@njit(cache=True, error_model="numpy")
def run(
    y: Array,
    pieces: Array,
    intervals: Array,
    has_piezo: bool,
    has_base: bool,
    c: Array,
    kind: int,
    p: Array,
    relative: float,
    absolute: Array,
    budget: int,
    states: Array,
) -> int:
    """Integrate over intervals, writing the state at the end of each; the steps left, negative for failure.

    `pieces` has duration, position, velocity and acceleration; `intervals` the piece, its begin and its end.
    """
    h = 1e-9
    last = 0.0
    for j in range(len(intervals)):
        piece = pieces[int(intervals[j, 0])]
        if intervals[j, 1] == 0.0:
            jolt(y, piece[2] - last, has_piezo, has_base, c)
            h = min(h, 1e-3 * piece[0])
        h, budget = integrate(
            y,
            intervals[j, 1],
            intervals[j, 2],
            h,
            has_piezo,
            has_base,
            c,
            kind,
            p,
            piece[1:],
            relative,
            absolute,
            budget,
        )
        if budget < 0:
            return budget
        last = piece[2] + piece[3] * piece[0]
        states[j] = y
    return budget


@njit(cache=True, error_model="numpy")
def jolt(y: Array, change: float, has_piezo: bool, has_base: bool, c: Array) -> None:
    """Momentum that a foot without piezo dynamics gives to the base where its speed jumps."""
    if has_base and not has_piezo:
        y[3] -= change * c[2] / (c[5] + c[2])
