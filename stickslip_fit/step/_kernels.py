"""Scalar kernels: friction models, equations of motion, and a Rosenbrock method of order 5.

In sliding, bristles settle within the time z / w, a thousandth of the ramp if they are stiff. Explicit
methods must take steps as short although nothing happens. Rodas5P (G. Steinebach, BIT Numerical Mathematics
63:27, 2023) is L-stable and linearly implicit: eight stages, each a linear system with the Jacobian of the
step's beginning. Bristles act on the rest by their force alone: the system comes down to one equation.

numba compiles the kernels where it is installed; without it they are plain Python, for other solvers to call.
Imported late: numba takes half a second to load.

States y: slider position and velocity; foot extension and its rate, if it has dynamics; base position and
velocity, if it recoils; then the bristles.
Constants c: slider mass, load G, foot mass, piezo stiffness and damping, base mass, stiffness and damping.
Parameters p of a friction model: viscosity; the stiffness, then the damping of each bristle; its own.
The piece's command: position, velocity and acceleration at its beginning.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from math import cos, exp, isfinite, pi, sin
from typing import Any

import numpy as np

from stickslip_fit._typing import Array

COMPILED = find_spec("numba") is not None


def _leave(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return lambda function: function


def _fill_below_diagonal(rows: int, numbers: str) -> Array:
    table = np.zeros((rows, rows - 1))
    table[np.tril_indices(rows, -1, rows - 1)] = np.array(numbers.split(), dtype=float)
    return table


njit: Any = import_module("numba").njit if COMPILED else _leave
compiled = njit(cache=True, error_model="numpy")
inlined = njit(
    cache=True, error_model="numpy", inline="always"
)  # passing arrays on would cost more than the work

LUGRE, ELASTOPLASTIC, DAHL, MAXWELL_SLIP = range(4)
SAFETY, LEAST_FACTOR, MOST_FACTOR = 0.9, 0.2, 5.0
STAGES = 8
# Steinebach's coefficients for stages U: (I / (gamma h) - J) U_i = f(y + sum a_ij U_j) + sum c_ij U_j / h.
GAMMA = 0.21193756319429014
ARGUMENTS = _fill_below_diagonal(
    6,
    """
    3.0
    2.849394379747939 0.45842242204463923
    -6.954028509809101 2.489845061869568 -10.358996098473584
    2.8029986275628964 0.5072464736228206 -0.3988312541770524 -0.04721187230404641
    -7.502846399306121 2.561846144803919 -11.627539656261098 -0.18268767659942256 0.030198172008377946
    """,
)
COUPLINGS = _fill_below_diagonal(
    8,
    """
    -14.155112264123755
    -17.97296035885952 -2.859693295451294
    147.12150275711716 -1.41221402718213 71.68940251302358
    165.43517024871676 -0.4592823456491126 42.90938336958603 -5.961986721573306
    24.854864614690072 -3.0009227002832186 47.4931110020768 5.5814197821558125 -0.6610691825249471
    30.91273214028599 -3.1208243349937974 77.79954646070892 34.28646028294783 -19.097331116725623
    -28.087943162872662
    37.80277123390563 -3.2571969029072276 112.26918849496327 66.9347231244047 -40.06618937091002
    -54.66780262877968 -9.48861652309627
    """,
)
TIMES = np.array([0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1, 1, 1])
TIME_SLOPES = np.zeros(STAGES)
TIME_SLOPES[:3] = GAMMA, -0.42387512638858027, -0.3384627126235924
TIME_SLOPES[3:5] = 1.8046452872882734, 2.325825639765069


@inlined
def flow(
    kind: int, p: Array, own: int, i: int, z: float, w: float, side: float
) -> tuple[float, float, float]:
    """Rate of bristle i in sliding at velocity w, and its derivatives by w and by its deflection z.

    The model's own parameters begin at `own`; `side` is the sign of w, beyond which |w| is continued.
    """
    if kind == MAXWELL_SLIP:
        slips = z * side > 0.0 and abs(z) >= p[own + i]
        return (0.0, 0.0, 0.0) if slips else (w, 1.0, 0.0)
    size_of_w = side * w
    if kind == DAHL:
        left = 1.0 - side * z / p[own]
        size = max(abs(left), 1e-12)  # of which a power may be negative
        share = abs(left) ** p[own + 1] * (1.0 if left >= 0.0 else -1.0)
        return w * share, share, -size_of_w * p[own + 1] * size ** (p[own + 1] - 1.0) / p[own]
    ratio = w / p[own + 2]
    # Beyond 6 vs the exponential is 2e-16.
    more = p[own + 1] * exp(-ratio * ratio) if abs(ratio) < 6.0 and p[own + 1] > 0.0 else 0.0
    steady = p[own] + more
    steady_by_speed = -2.0 * ratio / p[own + 2] * more
    plastic, by_size, by_steady = 1.0, 0.0, 0.0
    if kind == ELASTOPLASTIC:
        size, width = abs(z), steady - p[own + 3]
        if z * side <= 0.0 or size <= p[own + 3]:
            plastic = 0.0
        elif size < steady:
            phase = pi * (size - 0.5 * (steady + p[own + 3])) / width
            plastic = 0.5 + 0.5 * sin(phase)
            by_size = 0.5 * pi * cos(phase) / width
            by_steady = -by_size * (size - p[own + 3]) / width
    relative = z / steady
    by_speed = side * plastic + size_of_w * steady_by_speed * (by_steady - plastic / steady)
    by_deflection = -size_of_w * (plastic + by_size * abs(z)) / steady
    return w - plastic * size_of_w * relative, 1.0 - by_speed * relative, by_deflection


@inlined
def resist(kind: int, p: Array, z: Array, w: float, rates: Array, first: int, side: float) -> float:
    """Resistance to sliding at velocity w; writes the rates of the bristles, which begin at `first`.

    `side` as for `flow`, 0 for that of w.
    """
    n = len(z) - first
    if side == 0.0:
        side = 1.0 if w >= 0.0 else -1.0
    force = p[0] * w
    for i in range(n):
        rates[first + i] = flow(kind, p, 1 + 2 * n, i, z[first + i], w, side)[0]
        force += p[1 + i] * z[first + i] + p[1 + n + i] * rates[first + i]
    return force


@compiled
def resist_all(kind: int, p: Array, states: Array, w: Array, first: int) -> Array:
    """`resist` for each row of states, in sliding at each of the velocities."""
    forces, rates = np.empty(len(states)), np.empty(states.shape[1])
    for i in range(len(states)):
        forces[i] = resist(kind, p, states[i], w[i], rates, first, 0.0)
    return forces


@inlined
def slide(y: Array, speed: float, has_piezo: bool, has_base: bool) -> float:
    """Sliding velocity of a state, `speed` of the waveform; of rates, the sliding acceleration."""
    w = y[1] - (y[3] if has_piezo else speed)
    return w - (y[5 if has_piezo else 3] if has_base else 0.0)


@compiled
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
    side: float,
) -> None:
    """Write the rates of the state, at a time after the piece's beginning; `side` as for `resist`."""
    at_base = 4 if has_piezo else 2
    first = at_base + 2 if has_base else at_base
    base_speed = y[at_base + 1] if has_base else 0.0
    w = slide(y, command[1] + command[2] * t, has_piezo, has_base)
    force = resist(kind, p, y, w, dy, first, side)
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


@compiled
def linearize(
    t: float,
    y: Array,
    has_piezo: bool,
    has_base: bool,
    c: Array,
    kind: int,
    p: Array,
    command: Array,
    side: float,
    bristles: Array,
    by_time: Array,
) -> float:
    """Derivatives at a state: of bristle rates by w and z, of the force by z, and of `slope` by time.

    Writes them to the rows of `bristles` and to `by_time`; the derivative of the force by w.
    """
    at_base = 4 if has_piezo else 2
    first = at_base + 2 if has_base else at_base
    n = len(y) - first
    w = slide(y, command[1] + command[2] * t, has_piezo, has_base)
    force_by_speed = p[0]
    for i in range(n):
        _, bristles[0, i], bristles[1, i] = flow(kind, p, 1 + 2 * n, i, y[first + i], w, side)
        bristles[2, i] = p[1 + i] + p[1 + n + i] * bristles[1, i]
        force_by_speed += p[1 + n + i] * bristles[0, i]
    by_time[:] = 0.0
    if has_piezo:
        push = c[3] * (command[1] + command[2] * t)
        by_time[3] = push / c[2]
        if has_base:
            by_time[3] += push / c[5]
            by_time[5] = -push / c[5]
    else:
        by_time[1] = command[2] * force_by_speed / c[0]
        if has_base:
            by_time[3] = -command[2] * force_by_speed / (c[5] + c[2])
        for i in range(n):
            by_time[first + i] = -command[2] * bristles[0, i]
    return force_by_speed


@compiled
def factorize(
    g: float, has_piezo: bool, has_base: bool, c: Array, bristles: Array, force_by_speed: float, f: Array
) -> None:
    """Prepare `solve` for g I - J, with J from `linearize`.

    All velocities are linear in the change of the force, and the force in that of w: one equation.
    """
    by_w = force_by_speed
    for i in range(bristles.shape[1]):
        bristles[3, i] = 1.0 / (g - bristles[1, i])
        by_w += bristles[2, i] * bristles[0, i] * bristles[3, i]
    drag, whole, foot_by, base_by = 0.0, 0.0, 0.0, 0.0
    if has_base:
        whole = 1.0 / ((c[5] if has_piezo else c[5] + c[2]) * g + c[6] / g + c[7])
        base_by = whole
    if has_piezo:
        drag = c[3] / g + c[4]
        foot_by = 1.0 / (c[2] * g + drag + (c[2] * g * drag * whole if has_base else 0.0))
        base_by = drag * foot_by * whole
    change_by = -1.0 / (g * c[0]) - foot_by - base_by
    f[0], f[1], f[2], f[3], f[4], f[5] = g, 1.0 / g, drag, whole, foot_by, base_by
    f[6], f[7], f[8] = change_by, by_w, 1.0 / (1.0 - by_w * change_by)


@inlined
def solve(
    r: Array, u: Array, k: int, has_piezo: bool, has_base: bool, c: Array, bristles: Array, f: Array
) -> None:
    """Write the solution of (g I - J) u = r to row k of u."""
    at_base = 4 if has_piezo else 2
    first = at_base + 2 if has_base else at_base
    n = bristles.shape[1]
    g, passed, drag, whole, foot_by, base_by, change_by, by_w, share = f
    # Velocities without a change of the force.
    slider, foot, base = r[1] * passed, 0.0, 0.0
    if has_piezo:
        push = -c[3] * r[2] * passed
        forced = c[2] * r[3] + push
        if has_base:
            held = c[5] * r[5] - c[6] * r[4] * passed - push
            forced += c[2] * (r[5] - g * held * whole)
        foot = forced * foot_by
        if has_base:
            base = (held + drag * foot) * whole
    elif has_base:
        base = ((c[5] + c[2]) * r[3] - c[6] * r[2] * passed) * whole
    change = slider - foot - base
    force = by_w * change
    for i in range(n):
        force += bristles[2, i] * bristles[3, i] * r[first + i]
    force *= share
    w = change + change_by * force
    u[k, 1] = slider - passed / c[0] * force
    if has_piezo:
        u[k, 3] = foot + foot_by * force
    if has_base:
        u[k, at_base + 1] = base + base_by * force
    for i in range(0, first, 2):
        u[k, i] = (r[i] + u[k, i + 1]) * passed
    for i in range(n):
        u[k, first + i] = (r[first + i] + bristles[0, i] * w) * bristles[3, i]


@compiled
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
    n, q = len(y), p.copy()
    first_bristle = (4 if has_piezo else 2) + (2 if has_base else 0)
    u = np.empty((STAGES, n))
    rates, trial, r, by_time = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    bristles, factors = np.empty((4, n - first_bristle)), np.empty(9)
    limits = len(p) - (n - first_bristle)  # of the elements of Maxwell-slip
    t, h, planned, is_new = begin, min(first, end - begin), 0.0, True
    while t < end:
        if budget <= 0:
            return h, -1
        budget -= 1
        is_last = t + 1.000001 * h >= end
        if is_last:
            h = end - t
        if is_new:
            slope(t, y, rates, has_piezo, has_base, c, kind, p, command, 0.0)
            w = slide(y, command[1] + command[2] * t, has_piezo, has_base)
            gain = slide(rates, command[2], has_piezo, has_base)
            side = 1.0 if (gain if w * w <= absolute[first_bristle] * abs(gain) else w) >= 0.0 else -1.0
            if kind == MAXWELL_SLIP:  # over one step, an element either holds or slips
                for i in range(n - first_bristle):
                    slack = absolute[first_bristle + i]
                    slips = side * y[first_bristle + i] >= p[limits + i] - slack
                    q[limits + i] = 0.0 if slips else np.inf
            if kind == MAXWELL_SLIP or side * w < 0.0:
                slope(t, y, rates, has_piezo, has_base, c, kind, q, command, side)
            force_by_speed = linearize(
                t, y, has_piezo, has_base, c, kind, q, command, side, bristles, by_time
            )
            is_new = False
        g = 1.0 / (GAMMA * h)
        factorize(g, has_piezo, has_base, c, bristles, force_by_speed, factors)
        for stage in range(STAGES):
            for i in range(n):
                if stage < 6:
                    moved = y[i]
                    for j in range(stage):
                        moved += ARGUMENTS[stage, j] * u[j, i]
                    trial[i] = moved
                else:
                    trial[i] += u[stage - 1, i]
            if stage == 0:
                r[:] = rates
            else:
                slope(t + TIMES[stage] * h, trial, r, has_piezo, has_base, c, kind, q, command, side)
            for i in range(n):
                coupled = 0.0
                for j in range(stage):
                    coupled += COUPLINGS[stage, j] * u[j, i]
                r[i] += coupled * GAMMA * g + h * TIME_SLOPES[stage] * by_time[i]
            solve(r, u, stage, has_piezo, has_base, c, bristles, factors)
        total = 0.0
        for i in range(n):
            trial[i] += u[STAGES - 1, i]
            scale = absolute[i] + relative * max(abs(y[i]), abs(trial[i]))
            total = max(total, abs(u[STAGES - 1, i]) / scale)
        if not isfinite(total):
            if h < 1e-15 * max(end, 1e-12):
                return h, -1
            h *= LEAST_FACTOR
            continue
        factor = MOST_FACTOR if total == 0.0 else SAFETY * total**-0.2
        factor = min(MOST_FACTOR, max(LEAST_FACTOR, factor))
        if total <= 1.0:
            ahead = slide(trial, command[1] + command[2] * (t + h), has_piezo, has_base)
            sooner = h
            if ahead * side < 0.0 and ahead * ahead * h > absolute[first_bristle] * abs(ahead - w):
                sooner = turn(side * w, side * gain, side * ahead, h)
            if kind == MAXWELL_SLIP:
                for i in range(first_bristle, n):
                    limit = p[limits + i - first_bristle]
                    if q[limits + i - first_bristle] > 0.0 and side * trial[i] > limit + absolute[i]:
                        left = turn(limit - side * y[i], -side * rates[i], limit - side * trial[i], h)
                        sooner = min(sooner, left)
            if sooner < h:  # rates bend where sliding changes sides, or an element slips: the step ends there
                h, planned = sooner, max(planned, h)
                continue
            t = end if is_last else t + h
            for i in range(n):
                y[i] = trial[i]
            is_new = True
            h, planned = max(h * factor, planned), 0.0
        else:
            h *= factor
    return h, budget


@compiled
def turn(w: float, gain: float, ahead: float, h: float) -> float:
    """When a velocity of 0 or more is 0 that has this acceleration, and is `ahead` below 0 after h."""
    bend = (ahead - w - gain * h) / (h * h)
    root = max(gain * gain - 4.0 * bend * w, 0.0) ** 0.5
    time = 2.0 * w / (root - gain) if gain < 0.0 else (gain + root) / (-2.0 * bend)
    return min(max(time, 1e-3 * h), 0.999 * h) if isfinite(time) else 0.5 * h


@compiled
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


@compiled
def jolt(y: Array, change: float, has_piezo: bool, has_base: bool, c: Array) -> None:
    """Momentum that a foot without piezo dynamics gives to the base where its speed jumps."""
    if has_base and not has_piezo:
        y[3] -= change * c[2] / (c[5] + c[2])
