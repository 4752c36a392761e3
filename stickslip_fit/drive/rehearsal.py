"""rehearse_drive: a script of velocities at an emulated rig, and where the tip is said to be and truly is.

What `drive --script --emulate` shows while it runs, for notebooks and studies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.capture.emulator.rig import EmulatedRig
from stickslip_fit.capture.protocols import Clock, Controller, VirtualClock
from stickslip_fit.drive.emulated import emulate_drive, true_joints
from stickslip_fit.drive.loop import DriveLoop
from stickslip_fit.drive.record import BurstRecord
from stickslip_fit.drive.script import ScriptDevice, VelocityScript, check_rows, read_script
from stickslip_fit.drive.state import DriveState, Screen
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.machine import forward
from stickslip_fit.moves import CalibratedArm, DriveReckoning
from stickslip_fit.simulation import LawValues
from stickslip_fit.units import from_si

TOLERANCE = 10e-6  # m


@dataclass(frozen=True, eq=False)
class DriveTrace:
    """A drive as it was shown, ten times a second.

    Attributes
    ----------
    states : tuple of DriveState
    true_tips : array, shape (n, 3)
        Base frame, m, at the same moments.
    """

    states: tuple[DriveState, ...]
    true_tips: Array

    @property
    def errors(self) -> Array:
        """Distance of the true tip from where it was said to be, m, shape (n,)."""
        return np.linalg.norm(self.true_tips - np.array([state.tip for state in self.states]), axis=1)

    @property
    def table(self) -> pd.DataFrame:
        """Columns time_s, x_mm, y_mm, z_mm (as said), radius_um (95 %), error_um (truly), status, advice."""
        tips = from_si(np.array([state.tip for state in self.states]), "mm")
        radius = np.array([state.tip_radius for state in self.states])
        return pd.DataFrame(
            {
                "time_s": [state.time for state in self.states],
                **{f"{axis}_mm": tips[:, number] for number, axis in enumerate("xyz")},
                "radius_um": from_si(radius, "µm"),
                "error_um": from_si(self.errors, "µm"),
                "status": [state.status for state in self.states],
                "advice": [f"joint {state.advice.joint}" if state.advice else "" for state in self.states],
            }
        )

    def plot(self) -> AxesArray:
        """The tip's 95 % radius and its true error over time, beside the tolerance."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.drive import draw_drive

        return collect_axes(draw_drive(self.table, float(from_si(self.states[0].tolerance, "µm"))))


class _Notes(Screen):
    """A screen that notes what it is shown, and where the emulated tip truly is."""

    def __init__(self, rig: EmulatedRig, arm: CalibratedArm) -> None:
        self.rig = rig
        self.arm = arm
        self.states: list[DriveState] = []
        self.true_tips: list[Array] = []

    def show(self, state: DriveState) -> None:
        self.states.append(state)
        self.true_tips.append(forward(self.arm.machine, true_joints(self.rig)))


def rehearse_drive(
    arm: CalibratedArm | Result,
    start: npt.ArrayLike,
    script: str | Path | Sequence[Sequence[float]],
    tolerance: float = TOLERANCE,
    truth: LawValues | None = None,
    seed: int = 0,
) -> DriveTrace:
    """Drive an emulated rig by a script, in no time.

    Parameters
    ----------
    arm : CalibratedArm or Result
        The law that drives; a Result stands for its latest session.
    start : array_like, shape (3,)
        Joint positions, rad, rad, m, taken as exact.
    script : path, or sequence of (time, vx, vy, vz)
        A file as `stickslip-fit drive --script` reads it; or the same numbers, s and µm/s: from each time on
        the tip is to have that velocity, and the last time ends the drive.
    tolerance : float, optional
        Of the tip's 95 % radius, m.
    truth : LawValues, optional
        Laws by which the joints step; drawn from the uncertainty of the calibration without it.
    seed : int, optional
        Of the truth, and of the noise that each joint and direction has for the whole drive.

    Raises
    ------
    InputError
        For a faulty script or start, or a law that is not calibrated.

    Examples
    --------
    >>> from stickslip_fit.estimation import fit_least_squares
    >>> from stickslip_fit.logs import read_log
    >>> fit = fit_least_squares(read_log("data/reference/campaign.csv"))
    >>> trace = rehearse_drive(fit, [0.0, -1.2, 0.004], [(0, 40, 0, 0), (2, 0, 0, 30), (4, 0, 0, 0)])
    >>> last = trace.table.iloc[-1]
    >>> print(f"{last['x_mm'] - trace.table['x_mm'][0]:.2f} mm on, within {last['radius_um']:.1f} µm (95 %)")
    0.08 mm on, within 0.6 µm (95 %)
    """
    velocities = read_script(Path(script)) if isinstance(script, str | Path) else check_rows(script)
    drive, clock = DriveReckoning(arm, start), VirtualClock()
    rig = emulate_drive(drive, truth, clock, seed)
    notes = _Notes(rig, drive.arm)
    follow_script(drive, velocities, rig.controller(lambda message: None), clock, notes, tolerance)
    return DriveTrace(tuple(notes.states), np.array(notes.true_tips))


def follow_script(
    drive: DriveReckoning,
    script: VelocityScript,
    controller: Controller,
    clock: Clock,
    screen: Screen,
    tolerance: float,
) -> DriveLoop:
    """Drive by a script to its end, with no journal; the loop as it was left."""
    loop = DriveLoop(drive, controller, clock, ScriptDevice(script), screen, BurstRecord(), tolerance)
    loop.run()
    return loop
