"""When to go back to a stop: the tip's 95 % radius as it will grow at the present velocity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit.drive.state import HomingAdvice
from stickslip_fit.machine import jacobian
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.moves.error_ellipsoid import error_radius
from stickslip_fit.units import JOINTS

ADVICE_SHARE = 0.75  # of the tolerance; the error exceeds it then in some 1 % of drives
FARTHEST = 1e5  # s
BISECTIONS = 12  # to a four-thousandth of the time


def advise_homing(
    drive: DriveReckoning, seconds: float, joint_velocity: Sequence[float], tolerance: float
) -> HomingAdvice | None:
    """Which joint to bring to its stop, and how soon; None while the tip is known well enough.

    Parameters
    ----------
    seconds : float
        Since the drive began.
    joint_velocity : sequence of float
        rad/s, rad/s, m/s; steps are counted at this velocity, or if the joint does not move, on its way home.
    tolerance : float
        Of the tip's 95 % radius, m.
    """
    slope = jacobian(drive.arm.machine, drive.q)
    covariance = drive.joint_covariance()
    radius = float(error_radius(slope @ covariance @ slope.T))
    if radius < ADVICE_SHARE * tolerance:
        return None
    shares = np.sum(slope**2, axis=0) * np.diag(covariance)
    joint = JOINTS[int(np.argmax(shares))]
    position, (low, high) = drive.q[joint - 1], drive.arm.machine.ranges[joint]
    direction = "-" if position - low <= high - position else "+"
    to_stop = abs((low if direction == "-" else high) - position)
    steps_to_stop = round(to_stop / drive.step_size(joint, direction, seconds))
    if radius >= tolerance:
        return HomingAdvice(joint, direction, steps_to_stop, 0)
    if not joint_velocity[joint - 1]:  # how far it could go home by itself
        alone = drive.step_size(joint, direction, seconds) * (1.0 if direction == "+" else -1.0)
        joint_velocity = [alone if number == joint else 0.0 for number in JOINTS]
    rate = joint_velocity[joint - 1]
    size = drive.step_size(joint, "+" if rate > 0 else "-", seconds)
    time = _seconds_until(drive, seconds, joint_velocity, tolerance, covariance)
    return HomingAdvice(joint, direction, steps_to_stop, int(abs(rate) * time / size))


def _seconds_until(
    drive: DriveReckoning,
    seconds: float,
    joint_velocity: Sequence[float],
    tolerance: float,
    covariance: np.ndarray,
) -> float:
    """Time until the radius is the tolerance if the joints go on like that, the Jacobian as it is, s."""
    slope = jacobian(drive.arm.machine, drive.q)

    def radius_after(time: float) -> float:
        later = covariance.copy()
        for joint, rate in zip(JOINTS, joint_velocity, strict=True):
            if rate:
                later[joint - 1, joint - 1] = drive.variance_after(joint, rate * time, seconds)
        return float(error_radius(slope @ later @ slope.T))

    low, high = 0.0, 1.0
    while radius_after(high) < tolerance:
        low, high = high, 2.0 * high
        if high > FARTHEST:
            return FARTHEST
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if radius_after(middle) < tolerance else (low, middle)
    return low
