"""Forward and inverse kinematics, Jacobian, and the gravity load on each joint.

Denavit-Hartenberg rows (theta, d, a, alpha): (q1, 0, a1, 90 deg), (q2, 0, 0, -90 deg), (0, l2 + q3, 0,
0). With L = l2 + q3 the tip is at the radial distance a1 - L sin q2 from joint 1's axis, at the height
L cos q2. The base is turned by R = Rx(theta) Ry(psi). The vertical in the base's frame is the third row
of R; the load of a joint is its component along the direction in which the joint moves the arm (thesis
A.111 to A.113), as a share of the greatest load possible.
"""

from __future__ import annotations

from math import atan2, ceil, dist, floor, hypot, remainder, tau

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.machine.machine import Machine
from stickslip_fit.units import JOINTS, PRISMATIC, from_si

# A picometre, or a picoradian: far below any step, far above what rounding leaves of a position.
RANGE_TOL = 1e-12


def reach(machine: Machine, q2: npt.ArrayLike, q3: npt.ArrayLike) -> Array:
    """Horizontal distance of the tip from joint 2's axis, rho = -(l2 + q3) sin q2, m; q2, q3 in rad, m.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(reach(load_machine(), q2=-np.pi / 2, q3=0.0))
    0.0375
    """
    machine.require_geometry("the arm's reach")
    return -(machine.l2 + np.asarray(q3, float)) * np.sin(q2)


def forward(machine: Machine, q: npt.ArrayLike) -> Array:
    """The tip in the base's frame, m, at joint positions `q` (rad, rad, m), shape (..., 3) -> (..., 3).

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> forward(load_machine(), [0.0, -np.pi / 2, 0.0]).round(6)
    array([0.05, 0.  , 0.  ])
    """
    machine.require_geometry("the position of the tip")
    q1, q2, q3 = np.moveaxis(np.asarray(q, float), -1, 0)
    radial = machine.a1 + reach(machine, q2, q3)
    height = (machine.l2 + q3) * np.cos(q2)
    return np.stack([np.cos(q1) * radial, np.sin(q1) * radial, height], axis=-1)


def jacobian(machine: Machine, q: npt.ArrayLike) -> Array:
    """The derivatives d(x, y, z) / d(q1, q2, q3) of the tip, shape (..., 3) -> (..., 3, 3).

    Column j is the tip's motion with joint j: m/rad, m/rad, m/m.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> float(jacobian(load_machine(), [0.0, -np.pi / 2, 0.0])[1, 0].round(6))
    0.05
    """
    machine.require_geometry("the motion of the tip")
    q1, q2, q3 = np.moveaxis(np.asarray(q, float), -1, 0)
    radial = machine.a1 + reach(machine, q2, q3)
    radial_by_q2 = -(machine.l2 + q3) * np.cos(q2)
    columns = [
        [-np.sin(q1) * radial, np.cos(q1) * radial, np.zeros_like(radial)],
        [np.cos(q1) * radial_by_q2, np.sin(q1) * radial_by_q2, reach(machine, q2, q3)],
        [-np.cos(q1) * np.sin(q2), -np.sin(q1) * np.sin(q2), np.cos(q2)],
    ]
    return np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)


def inverse(machine: Machine, target: npt.ArrayLike, near: npt.ArrayLike | None = None) -> list[Array]:
    """Every joint position within the ranges that puts the tip at `target`.

    The arm can reach a point with joint 1 turned towards it, or turned away and bent back over joint 1's
    axis; the thesis's A.4 has only the first. In both, q2 = atan2(-d_x, d_y) with d the tip seen from joint
    2 in frame 1, and q3 = |d| - l2. The thesis's A.6, q2 = atan2(d_y, d_x), is off by a quarter turn.

    Parameters
    ----------
    machine : Machine
    target : array_like, shape (3,)
        Tip in the base's frame, m.
    near : array_like, shape (3,), optional
        Present joint positions, rad, rad, m. Used only for a target on joint 1's axis, which any q1
        reaches: q1 then stays, or without `near` is the middle of its range.

    Returns
    -------
    list of array, shape (3,)
        At least one; more where both solutions, or two turns of a wide range, are possible.

    Raises
    ------
    InputError
        If the target is out of reach, with the joints that would leave their ranges and by how much.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> for q1, q2, q3 in inverse(load_machine(), [0.0, 0.002, 0.042]):
    ...     print(f"{np.degrees(q1):.2f} deg, {np.degrees(q2):.2f} deg, {q3 * 1000:.3f} mm")
    90.00 deg, 14.04 deg, 5.793 mm
    -90.00 deg, 19.05 deg, 6.933 mm
    """
    machine.require_geometry("the joints' positions for a target")
    point = _check_three_numbers(target, "a target", "x, y, z in m")
    solutions = _joint_solutions(machine, point, _undetermined_q1(machine, near))
    positions = [
        np.array([q1, q2, q3])
        for solution in solutions
        for q1 in _positions_in_range(machine, 1, solution[0])
        for q2 in _positions_in_range(machine, 2, solution[1])
        for q3 in _positions_in_range(machine, PRISMATIC, solution[2])
    ]
    if not positions:
        raise InputError(_explain_out_of_reach(machine, point, solutions))
    return positions


def nearest_solution(machine: Machine, target: npt.ArrayLike, near: npt.ArrayLike) -> Array:
    """The solution of `inverse` with the least motion from the joint positions `near`, shape (3,).

    The motion is the sum over the joints of distance per full range, as joints move one after the other.
    Parameters, units and errors as in `inverse`.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> machine = load_machine()
    >>> q = nearest_solution(machine, [0.05, 0.0, 0.0], near=[0.0, -1.0, 0.0])
    >>> np.degrees(q).round(6)
    array([  0., -90.,   0.])
    """
    machine.require_geometry("the joints' positions for a target")
    present = np.array(_check_three_numbers(near, "the joints' positions", "q1, q2, q3 in rad, rad, m"))
    spans = np.array([machine.span(joint) for joint in JOINTS])
    return min(inverse(machine, target, present), key=lambda q: float(np.sum(np.abs(q - present) / spans)))


def _joint_solutions(machine: Machine, point: list[float], free_q1: float) -> list[list[float]]:
    """Joint positions that put the tip at `point`, regardless of ranges and up to whole turns."""
    x, y, z = point
    radial = hypot(x, y)
    if radial <= RANGE_TOL:
        return [[free_q1, *_solve_arm_plane(machine, 0.0, z)]]
    return [
        [atan2(y, x), *_solve_arm_plane(machine, radial, z)],
        [atan2(-y, -x), *_solve_arm_plane(machine, -radial, z)],
    ]


def _solve_arm_plane(machine: Machine, radial: float, height: float) -> tuple[float, float]:
    """q2 and q3 in the arm's own plane."""
    outward = radial - machine.a1
    return atan2(-outward, height), hypot(outward, height) - machine.l2


def _undetermined_q1(machine: Machine, near: npt.ArrayLike | None) -> float:
    low, high = machine.ranges[1]
    if near is None:
        return (low + high) / 2
    q1, _, _ = _check_three_numbers(near, "the joints' positions", "q1, q2, q3 in rad, rad, m")
    return min(max(q1, low), high)


def _positions_in_range(machine: Machine, joint: int, position: float) -> list[float]:
    """The positions of a joint within its range that equal `position`, up to whole turns if rotary."""
    low, high = machine.ranges[joint]
    if joint == PRISMATIC:
        positions = [position] if low - RANGE_TOL <= position <= high + RANGE_TOL else []
    else:
        first = ceil((low - RANGE_TOL - position) / tau)
        last = floor((high + RANGE_TOL - position) / tau)
        positions = [position + turns * tau for turns in range(first, last + 1)]
    return [min(max(inside, low), high) for inside in positions]


def _explain_out_of_reach(machine: Machine, point: list[float], solutions: list[list[float]]) -> str:
    """Why no solution is within the ranges: the one with the fewest overruns, then the closest tip."""
    tips = [_tip_at_limits(machine, solution) for solution in solutions]
    overruns = [_describe_overruns(machine, solution) for solution in solutions]
    best = min(range(len(solutions)), key=lambda k: (len(overruns[k]), dist(point, tips[k])))
    missed = from_si(dist(point, tips[best]), "mm")
    return (
        f"the target {_format_point(point)} is out of reach: {' and '.join(overruns[best])}. "
        f"At its limits the arm has the tip at {_format_point(tips[best])}, {missed:.4g} mm away; "
        "choose a target within reach"
    )


def _tip_at_limits(machine: Machine, solution: list[float]) -> list[float]:
    q = [_unwind(machine, joint, solution[joint - 1]) for joint in JOINTS]
    limits = np.array([machine.ranges[joint] for joint in JOINTS])
    return [float(x) for x in forward(machine, np.clip(q, limits[:, 0], limits[:, 1]))]


def _describe_overruns(machine: Machine, solution: list[float]) -> list[str]:
    """A phrase for each joint that would leave its range."""
    messages = []
    for joint in JOINTS:
        position, (low, high) = _unwind(machine, joint, solution[joint - 1]), machine.ranges[joint]
        if low - RANGE_TOL <= position <= high + RANGE_TOL:
            continue
        side, limit = ("below its lowest", low) if position < low else ("above its highest", high)
        unit = "mm" if joint == PRISMATIC else "deg"
        at, excess, end = (from_si(x, unit) for x in (position, abs(position - limit), limit))
        messages.append(
            f"joint {joint} would have to stand at {at:.6g} {unit}, "
            f"{excess:.4g} {unit} {side}, {end:.6g} {unit}"
        )
    return messages


def _unwind(machine: Machine, joint: int, position: float) -> float:
    """A rotary position in the turn that comes closest to the joint's range."""
    if joint == PRISMATIC:
        return position
    low, high = machine.ranges[joint]
    middle = (low + high) / 2
    return middle + remainder(position - middle, tau)


def _format_point(point: list[float]) -> str:
    # Rounded to a nanometre, so that no rounding error is shown; + 0.0 turns -0.0 into 0.0.
    x, y, z = (f"{round(from_si(coordinate, 'mm'), 6) + 0.0:.6g}" for coordinate in point)
    return f"({x}, {y}, {z}) mm"


def _check_three_numbers(values: npt.ArrayLike, what: str, meaning: str) -> list[float]:
    numbers = np.asarray(values, float)
    if numbers.shape != (3,) or not np.all(np.isfinite(numbers)):
        raise InputError(f"{what} is three finite numbers, {meaning}, not {numbers.tolist()}")
    return [float(x) for x in numbers]


def published_load(
    joint: int, q1: npt.ArrayLike, q2: npt.ArrayLike, theta: npt.ArrayLike, psi: npt.ArrayLike
) -> Array:
    """The load of the published laws: for joints 2 and 3 without the effect of q1 (thesis Eq. 4.5, 6.10).

    Parameters
    ----------
    joint : {1, 2, 3}
    q1, q2 : array_like
        Joint positions, rad; joint 1 ignores q2, joints 2 and 3 ignore q1.
    theta, psi : array_like
        Orientation of the base, rad.

    Returns
    -------
    array
        Dimensionless, between -1 and 1; above 0 where moving in `+` lifts the arm.

    Raises
    ------
    ValueError
        For a joint other than 1, 2 or 3.

    Examples
    --------
    >>> float(published_load(3, q1=0.0, q2=0.0, theta=0.0, psi=0.0))
    1.0
    """
    if joint == 1:
        return full_load(1, q1, q2, theta, psi)
    swing = {2: np.sin, 3: np.cos}.get(joint)
    if swing is None:
        raise ValueError(f"joint {joint} is none of 1, 2, 3")
    zeta = np.asarray(psi, float) - np.asarray(q2, float)
    return swing(zeta) * np.cos(np.asarray(theta, float))


def mean_load(
    joint: int,
    start: npt.ArrayLike,
    stop: npt.ArrayLike,
    q1: npt.ArrayLike,
    q2: npt.ArrayLike,
    theta: npt.ArrayLike,
    psi: npt.ArrayLike,
) -> Array:
    """The published load of a traverse, averaged over the moving joint's positions.

    A rotary joint's load swings as a sine of its position, and the mean of a sine over an interval is
    its value in the middle times sin(h) / h, h being half the interval. Joint 3's does not change.

    Parameters
    ----------
    joint : {1, 2, 3}
    start, stop : array_like
        Ends of the traverse, rad or m; equal ends give the load there.
    q1, q2 : array_like
        Positions of the other joints, rad; the moving joint's own is ignored and may be NaN.
    theta, psi : array_like
        Orientation of the base, rad. All arrays broadcast.

    Returns
    -------
    array
        Dimensionless, between -1 and 1.

    Raises
    ------
    ValueError
        For a joint other than 1, 2 or 3.

    Examples
    --------
    >>> lifted_from_level = mean_load(2, -np.pi / 2, 0.0, q1=0.0, q2=np.nan, theta=0.0, psi=0.0)
    >>> round(float(lifted_from_level), 6)
    0.63662
    """
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    middle, half = (start + stop) / 2, (stop - start) / 2
    if joint == 1:
        return published_load(1, middle, q2, theta, psi) * np.sinc(half / np.pi)
    if joint == 2:
        return published_load(2, q1, middle, theta, psi) * np.sinc(half / np.pi)
    return published_load(joint, q1, q2, theta, psi) * np.ones_like(half)


def full_load(
    joint: int, q1: npt.ArrayLike, q2: npt.ArrayLike, theta: npt.ArrayLike, psi: npt.ArrayLike
) -> Array:
    """The load at any q1 (thesis A.111 to A.113); parameters and errors as in `published_load`."""
    q1, q2, theta, psi = (np.asarray(angle, float) for angle in (q1, q2, theta, psi))
    tilt = np.cos(theta) * np.sin(psi)
    if joint == 1:
        return tilt * np.sin(q1) + np.sin(theta) * np.cos(q1)
    upright = np.cos(theta) * np.cos(psi)
    outward = tilt * np.cos(q1) - np.sin(theta) * np.sin(q1)
    if joint == 2:
        return outward * np.cos(q2) - upright * np.sin(q2)
    if joint == 3:
        return outward * np.sin(q2) + upright * np.cos(q2)
    raise ValueError(f"joint {joint} is none of 1, 2, 3")
