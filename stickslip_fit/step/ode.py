"""Motion of the slider with a bristle model of friction, foot dynamics and a base that recoils.

The slider (mass m, load G) feels the resistance F to its sliding on the foot, m dv/dt = -F - m G, and the
foot feels +F. A foot with dynamics (a second-order stage: Goldfarb and Celanovic 1997, Adriaens et al. 2000)
is a mass on a spring whose rest position is the waveform; without, it follows the waveform. The base, a mass
on a spring, takes the reaction of both.

Each piece of the waveform is integrated by itself, so that no solver steps over a jump of the foot's
acceleration: by the Rosenbrock method of `stickslip_fit.step._kernels` where numba is installed, else by
scipy's LSODA (Maxwell-slip, which has jumps, by its explicit RK45).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, pi
from typing import Any, Literal

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError, check_count
from stickslip_fit.step.friction import BristleModel
from stickslip_fit.step.motion import FootMotion

Solver = Literal["compiled", "lsoda"]
MAX_PERIODS = 1000
MAX_SAMPLES = 100_000
MAX_SOLVER_STEPS = 2_000_000  # of all periods


class StepLimitError(InputError):
    """A solver needed more steps than it may take."""


@dataclass(frozen=True)
class Foot:
    """The foot as a mass on the piezo's spring.

    Attributes
    ----------
    mass : float
        kg.
    resonance : float
        Of foot and piezo alone, Hz; infinite for a foot that follows the waveform.
    damping_ratio : float
        Of the critical damping.

    Raises
    ------
    InputError
        For values outside their domain.
    """

    mass: float
    resonance: float = float("inf")
    damping_ratio: float = 0.02

    def __post_init__(self) -> None:
        _check_body("foot", self, self.resonance > 0, "above 0")

    @property
    def is_dynamic(self) -> bool:
        """Whether it has a resonance."""
        return isfinite(self.resonance)


@dataclass(frozen=True)
class RecoilBase:
    """A base that recoils.

    Attributes
    ----------
    mass : float
        kg.
    resonance : float
        Of the base alone on its mount, Hz; 0 for a base that nothing holds.
    damping_ratio : float
        Of the critical damping.

    Raises
    ------
    InputError
        For values outside their domain.
    """

    mass: float
    resonance: float = 0.0
    damping_ratio: float = 0.02

    def __post_init__(self) -> None:
        _check_body("base", self, 0 <= self.resonance < np.inf, "0 or more")


def _check_body(name: str, body: Foot | RecoilBase, has_resonance: bool, resonance: str) -> None:
    if not (0 < body.mass < np.inf and has_resonance and 0 <= body.damping_ratio < 10):
        raise InputError(
            f"the {name}'s mass must be above 0, its resonance {resonance}, its damping ratio 0 to 10"
        )


@dataclass(frozen=True, eq=False)
class BristleMotion:
    """A solution, sampled.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s; the first is 0.
    slider, velocity, foot, base : ndarray, shape (n,)
        Positions of slider, foot (with the base's share) and base, m, and the slider's velocity, m/s.
    friction : ndarray, shape (n,)
        Force on the slider, N.
    steps : ndarray, shape (periods,)
        Displacement of the slider over each period, m.
    solver_steps : int
        Of the Rosenbrock method, or right-hand sides that LSODA evaluated.
    """

    time: Array
    slider: Array
    velocity: Array
    foot: Array
    base: Array
    friction: Array
    steps: Array
    solver_steps: int


def solve_motion(
    motion: FootMotion,
    mass: float,
    model: BristleModel,
    load: float = 0.0,
    *,
    foot: Foot | None = None,
    base: RecoilBase | None = None,
    periods: int = 3,
    samples: int = 0,
    relative: float = 1e-7,
    solver: Solver | None = None,
    max_steps: int = MAX_SOLVER_STEPS,
) -> BristleMotion:
    """Solve the motion over some periods, from rest.

    Parameters
    ----------
    motion : FootMotion
        Of one parameter set; without foot dynamics it must not jump.
    mass : float
        Of the slider, kg.
    model : BristleModel
        Friction.
    load : float
        G, m/s^2.
    foot : Foot, optional
        Follows the waveform if left out; a base needs its mass.
    base : RecoilBase, optional
        Stands if left out.
    periods : int
        The first begins with relaxed bristles, and differs from the others.
    samples : int
        Of each period, evenly; 0 for the ends of the pieces alone.
    relative : float
        Tolerance of each state relative to its size; absolutely, to what the waveform makes of it.
    solver : {'compiled', 'lsoda'}, optional
        The first if numba is installed.
    max_steps : int
        After which the solver gives up; without numba, right-hand sides that it may evaluate.

    Raises
    ------
    StepLimitError
        If the solver would need more steps: the model is too stiff for the time it is solved over.
    InputError
        For input outside its domain.

    Examples
    --------
    >>> from stickslip_fit.step import LuGre, make_motion
    >>> motion = make_motion("ramp", 0.5e-6, 1e-4, 1e-6, 2e-4)
    >>> solved = solve_motion(motion, 1e-3, LuGre(0.1, 0.1, 1e-3, 1e7, 1.0), solver="lsoda")
    >>> float(round(1e9 * solved.steps[-1]))
    464.0
    """
    from stickslip_fit.step import _kernels

    _check(motion, mass, load, model, foot, base)
    check_count("periods", periods)
    check_count("samples", samples, 0)
    check_count("max_steps", max_steps)
    if periods > MAX_PERIODS or samples > MAX_SAMPLES or not 1e-13 <= relative <= 1e-2:
        raise InputError(
            f"give at most {MAX_PERIODS:,} periods and {MAX_SAMPLES:,} samples, and a tolerance from 1e-13 "
            "to 1e-2"
        )
    if solver is None:
        solver = "compiled" if _kernels.COMPILED else "lsoda"
    if solver == "compiled" and not _kernels.COMPILED:
        raise InputError("the compiled solver needs numba: install stickslip-fit[numba], or take lsoda")
    is_dynamic = foot is not None and foot.is_dynamic
    pieces = np.stack(motion.arrays, axis=1)
    intervals = _intervals(pieces[:, 0], samples, periods)
    mechanical = 2 + 2 * is_dynamic + 2 * (base is not None)
    y = np.zeros(mechanical + model.states)
    if is_dynamic:
        y[2] = pieces[0, 1]
    absolute = relative * _scales(motion, model, mechanical)
    constants = _constants(mass, load, foot, base)
    shape = (is_dynamic, base is not None, constants, model.kind, model.parameters)
    states = np.empty((len(intervals), len(y)))
    if solver == "compiled":
        left = _kernels.run(y, pieces, intervals, *shape, relative, absolute, max_steps, states)
        if left < 0:
            raise _too_stiff(max_steps)
        taken = max_steps - left
    else:
        taken = _run_lsoda(y, pieces, intervals, shape, relative, absolute, max_steps, states)
    return _collect(states, pieces, intervals, shape, mechanical, periods, taken)


def _check(
    motion: FootMotion,
    mass: float,
    load: float,
    model: BristleModel,
    foot: Foot | None,
    base: RecoilBase | None,
) -> None:
    if motion.duration.ndim != 1 or not (isfinite(mass) and mass > 0 and isfinite(load)):
        raise InputError("give one motion, a slider mass above 0 and a finite load")
    if mass * abs(load) >= model.limit:
        raise InputError("friction does not hold the load, which is no smaller: the slider runs away")
    ends = motion.ends
    next_positions = np.append(motion.position[1:], motion.position[0])
    is_instant = (motion.duration == 0) & (motion.position != next_positions)
    has_jump = np.any(is_instant) or np.max(np.abs(next_positions - ends)) > 1e-9 * np.ptp(ends)
    if has_jump and not (foot and foot.is_dynamic):
        message = "the foot jumps, which bristles cannot follow"
        raise InputError(f"{message}; give the flyback a time, or the foot a resonance")
    if base is not None and foot is None:
        raise InputError("a base recoils from the foot's mass too: give the foot")


def _intervals(durations: Array, samples: int, periods: int) -> Array:
    """Piece, begin and end of each interval, shape (n, 3), that ends at a sample or with its piece."""
    period = durations.sum()
    rows, start = [], 0.0
    for piece, duration in enumerate(durations):
        if duration > 0:
            times = np.arange(1, samples) * (period / max(samples, 1)) - start
            slack = 1e-9 * duration
            inside = times[(times > slack) & (times < duration - slack)]
            edges = np.concatenate([[0.0], inside, [duration]])
            rows += [(piece, begin, end) for begin, end in pairwise(edges)]
        start += duration
    return np.tile(np.array(rows), (periods, 1))


def _scales(motion: FootMotion, model: BristleModel, mechanical: int) -> Array:
    """What is large for each state."""
    travel = float(np.ptp(motion.position + motion.velocity * motion.duration))
    speed = travel / float(motion.duration[motion.duration > 0].max())
    return np.concatenate([np.tile([travel, speed], mechanical // 2), np.minimum(model.deflections, travel)])


def _constants(mass: float, load: float, foot: Foot | None, base: RecoilBase | None) -> Array:
    c = np.array([mass, load, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    if foot is not None:
        c[2] = foot.mass
        if foot.is_dynamic:
            omega = 2 * pi * foot.resonance
            c[3], c[4] = foot.mass * omega**2, 2 * foot.damping_ratio * foot.mass * omega
    if base is not None:
        omega = 2 * pi * base.resonance
        c[5], c[6], c[7] = base.mass, base.mass * omega**2, 2 * base.damping_ratio * base.mass * omega
    return c


def _too_stiff(max_steps: int) -> StepLimitError:
    return StepLimitError(
        f"the motion is not solved after {max_steps:,} solver steps: the friction is too stiff for the time, "
        "or the motion runs away; lower the stiffness or the number of periods"
    )


def _run_lsoda(
    y: Array,
    pieces: Array,
    intervals: Array,
    shape: tuple,
    relative: float,
    absolute: Array,
    max_steps: int,
    states: Array,
) -> int:
    from scipy.integrate import solve_ivp

    from stickslip_fit.step._kernels import MAXWELL_SLIP, jolt, slope

    # An implicit method finds no solution where an element of Maxwell-slip begins to slip.
    method = "RK45" if shape[3] == MAXWELL_SLIP else "LSODA"
    evaluations, last = 0, 0.0
    edges = np.flatnonzero(intervals[:, 1] == 0.0)
    for first, stop in zip(edges, [*edges[1:], len(intervals)], strict=True):
        piece = pieces[int(intervals[first, 0])]

        def rate(t: float, state: Array, command: Array) -> Array:
            nonlocal evaluations
            evaluations += 1
            if evaluations > max_steps:
                raise _too_stiff(max_steps)
            change = np.empty(len(state))
            slope(t, state, change, *shape, command, 0.0)
            return change

        jolt(y, piece[2] - last, shape[0], shape[1], shape[2])
        ends = intervals[first:stop, 2]
        solve: Any = solve_ivp  # whose stubs reject a function with arguments
        options = {"rtol": max(relative, 1e-13), "atol": absolute, "args": (piece[1:],)}
        solved = solve(rate, (0.0, ends[-1]), y, method, ends, **options)
        if not solved.success:
            raise _too_stiff(max_steps)
        states[first:stop] = solved.y.T
        y[:] = solved.y[:, -1]
        last = piece[2] + piece[3] * piece[0]
    return evaluations


def _collect(
    states: Array, pieces: Array, intervals: Array, shape: tuple, mechanical: int, periods: int, taken: int
) -> BristleMotion:
    from stickslip_fit.step._kernels import resist_all

    is_dynamic, has_base, _, kind, parameters = shape
    if is_dynamic:
        extension, speed = states[:, 2:4].T
    else:
        _, position, velocity, change = pieces[intervals[:, 0].astype(int)].T
        passed = intervals[:, 2]
        extension, speed = position + (velocity + change * passed / 2) * passed, velocity + change * passed
    base, base_speed = states[:, mechanical - 2 : mechanical].T if has_base else np.zeros((2, len(states)))
    friction = -resist_all(kind, parameters, states, states[:, 1] - speed - base_speed, mechanical)
    time = np.cumsum(intervals[:, 2] - intervals[:, 1])
    ends = states[len(states) // periods - 1 :: len(states) // periods, 0]
    zero = np.zeros(1)
    return BristleMotion(
        time=np.concatenate([zero, time]),
        slider=np.concatenate([zero, states[:, 0]]),
        velocity=np.concatenate([zero, states[:, 1]]),
        foot=np.concatenate([pieces[:1, 1], extension + base]),
        base=np.concatenate([zero, base]),
        friction=np.concatenate([zero, friction]),
        steps=np.diff(ends, prepend=0.0),
        solver_steps=taken,
    )
