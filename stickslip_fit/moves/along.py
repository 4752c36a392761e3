"""The drives that take the tip along a path, by a session's calibration."""

from __future__ import annotations

import numpy as np

from stickslip_fit.errors import InputError
from stickslip_fit.moves.calibrated import Calibrated
from stickslip_fit.moves.command import whole_steps
from stickslip_fit.moves.path import Paths
from stickslip_fit.moves.where import Drive


def drives_along(arm: Calibrated, path: Paths) -> tuple[Drive, ...]:
    """What to command for a straight move; `where_after` says where that takes the tip, and how sure.

    Parameters
    ----------
    arm : Calibrated
    path : Paths
        Of one move, see `straight_path`; the base stands as `arm` has it.

    Raises
    ------
    InputError
        If a law is not known, or stalls on the way.

    Examples
    --------
    A millimetre upwards, in two legs, by the latest session of the reference campaign:

    >>> from stickslip_fit.fit import least_squares
    >>> from stickslip_fit.logs import read_log
    >>> from stickslip_fit.moves import calibrated, straight_path, where_after
    >>> arm = calibrated(least_squares(read_log("data/reference/campaign.csv")))
    >>> path = straight_path(arm.machine, [0.0, -1.2, 0.004], [0.0, 0.0, 1.0], 1e-3, legs=2)
    >>> drives = drives_along(arm, path)
    >>> for drive in drives:
    ...     print(f"joint {drive.joint}: {drive.steps} steps in {drive.direction}")
    joint 2: 143 steps in +
    joint 3: 258 steps in +
    joint 2: 141 steps in +
    joint 3: 267 steps in +
    >>> found = where_after(arm, path.stands[0, 0], drives)
    >>> off = np.linalg.norm(found.tip - path.tips[0, -1])
    >>> print(f"{off * 1e6:.1f} µm off for whole steps, and ± {found.tip_error * 1e6:.1f} µm (1 sd)")
    0.7 µm off for whole steps, and ± 2.0 µm (1 sd)
    """
    if len(path) != 1:
        raise InputError(f"drives are worked out for one move at a time, not for {len(path)}")
    owed, drives = np.zeros(3), []
    for part in path.parts:
        way = arm.traverse(path.stands[0, part.drive], part.joint, float(part.stop[0]))
        steps, left = whole_steps(np.array(way.counts), part.stop - part.start, owed[part.joint - 1])
        owed[part.joint - 1] = left[0]
        drives.append(Drive(part.joint, part.direction, int(steps[0])))
        arm = arm.driven(way.row, drives[-1].steps)
    return tuple(drives)
