r"""The gravity load on each joint, as the share of the greatest load that the joint can see.

The base is turned by R = Rx(theta) Ry(psi). Up, in the base's own frame, is R's third row, and the
load is its component along the direction in which the joint moves the arm (thesis A.111 to A.113).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def up_in_base(theta: npt.ArrayLike, psi: npt.ArrayLike) -> Array:
    """The vertical, seen from the base, for base orientations in rad.

    Returns
    -------
    array, shape (..., 3)

    Examples
    --------
    >>> up_in_base(0.0, 0.0)
    array([-0.,  0.,  1.])
    """
    theta, psi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(psi, float))
    return np.stack([-np.cos(theta) * np.sin(psi), np.sin(theta), np.cos(theta) * np.cos(psi)], axis=-1)


def published_load(
    joint: int, q1: npt.ArrayLike, q2: npt.ArrayLike, theta: npt.ArrayLike, psi: npt.ArrayLike
) -> Array:
    """The load of the published laws: joints 2 and 3 know nothing of q1 (thesis Eq. 4.5, 6.10).

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
        Where the traverse begins and ends, rad or m; equal ends give the load there.
    q1, q2 : array_like
        Where the other joints stand, rad; the moving joint's own is ignored and may be NaN.
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
    """The load at any q1 (thesis A.111 to A.113); parameters as in `published_load`.

    Raises
    ------
    ValueError
        For a joint other than 1, 2 or 3.
    """
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
