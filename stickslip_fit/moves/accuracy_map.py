"""The accuracy of the tip over the workspace: its 95 % error after a move from the nearest stops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._format import format_number, join_words
from stickslip_fit._summary import Column, Section, Summarized, Summary, Table, numbers
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.machine import forward, jacobian
from stickslip_fit.moves.arm import CalibratedArm, as_calibrated_arm, relative_spread
from stickslip_fit.moves.error_ellipsoid import error_radius
from stickslip_fit.units import JOINTS, from_si

GRID = (49, 13)  # places of q2 and q3
TABLE_GRID = (9, 5)
NO_VALUE = "–"


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyMap(Summarized):
    """The tip's 95 % error over the plane of the arm, after a move from the nearest stops.

    Attributes
    ----------
    q2, q3 : array, shape (n2,) and (n3,)
        Positions of joints 2 and 3, rad and m.
    radius, height : array, shape (n2, n3)
        Of the tip: distance from joint 1's axis, and height above its origin, m.
    error : array, shape (n2, n3)
        95 % of the moves end within this distance of the goal, joint 1 being at a stop, m. NaN where a joint
        stalls.
    error_far : array, shape (n2, n3)
        The same with joint 1 halfway between its stops, as far from both as it can be; NaN where joint 1 is
        not calibrated.
    session : str
        Whose calibration it is.
    still : tuple of int
        Joints without a calibration, which are taken to stay where they are.
    """

    q2: Array
    q3: Array
    radius: Array
    height: Array
    error: Array
    error_far: Array
    session: str
    still: tuple[int, ...] = ()

    @property
    def table(self) -> pd.DataFrame:
        """One row for each place: q2_deg, q3_mm, radius_mm, height_mm, error_um, error_far_um."""
        q2, q3 = np.meshgrid(self.q2, self.q3, indexing="ij")
        columns = {
            "q2_deg": from_si(q2, "deg"),
            "q3_mm": from_si(q3, "mm"),
            "radius_mm": from_si(self.radius, "mm"),
            "height_mm": from_si(self.height, "mm"),
            "error_um": from_si(self.error, "µm"),
            "error_far_um": from_si(self.error_far, "µm"),
        }
        return pd.DataFrame({name: values.ravel() for name, values in columns.items()})

    def summary(self) -> Summary:
        """Best, median and worst error, and a coarse table of it."""
        rows, columns = (
            np.unique(np.linspace(0, len(axis) - 1, most).round().astype(int))
            for axis, most in zip((self.q2, self.q3), TABLE_GRID, strict=True)
        )
        heads = (
            Column("q2", "deg"),
            *numbers(*(format_number(self.q3[k], "mm", 0) for k in columns), unit="µm", group="q3 (mm)"),
        )
        cells = tuple(
            (format_number(self.q2[row], "deg", 0), *(_format_error(self.error[row, k]) for k in columns))
            for row in rows
        )
        note = "95 % of the moves end within this distance of the goal; joint 1 stays at its stop."
        table = Table("Error of the tip after a move from the nearest stops", heads, cells, note=note)
        return Summary("Accuracy map", self._headline(), (Section(tables=(table,)),))

    def _headline(self) -> tuple[str, ...]:
        known = self.error[np.isfinite(self.error)]
        if not len(known):
            raise InputError("no place of the workspace can be reached: a joint stalls under this law")
        best, median, worst = (_format_error(value) for value in np.quantile(known, (0.0, 0.5, 1.0)))
        near = (
            f"By the calibration of session {self.session}, 95 % of the moves from the nearest stops end "
            f"within {median} µm of their goal at a typical place, {best} µm at the best and {worst} µm at "
            "the worst, while joint 1 stays at its stop."
        )
        sentences = [near]
        if np.isfinite(self.error_far).any():
            far = _format_error(float(np.nanmedian(self.error_far)))
            sentences.append(f"With joint 1 halfway between its stops it is {far} µm at a typical place.")
        if self.still:
            joints = join_words([str(joint) for joint in self.still])
            one = len(self.still) == 1
            sentences.append(
                f"Joint{'' if one else 's'} {joints} {'has' if one else 'have'} no calibration here and "
                f"{'is' if one else 'are'} left out."
            )
        return (" ".join(sentences),)

    def plot(self) -> AxesArray:
        """The error over the plane of the arm, joint 1 at its stop and halfway between its stops."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.accuracy import draw_accuracy_map

        return collect_axes(draw_accuracy_map(self))


def _format_error(value: float) -> str:
    """In µm; a tenth is the least that matters beside a step."""
    size = from_si(value, "µm")
    return f"{size:,.{0 if size >= 10 else 1}f}" if np.isfinite(size) else NO_VALUE


def map_accuracy(arm: CalibratedArm | Result, grid: tuple[int, int] = GRID) -> AccuracyMap:
    """The tip's 95 % error over the workspace.

    Each joint is driven from the stop nearest to its goal, in the order 1, 2, 3, as `plan_move` does. Errors
    are those of the law's parameters, the repeatability, and the rounding to whole steps.

    Parameters
    ----------
    arm : CalibratedArm or Result
        A Result stands for its latest session, see `calibrated_arm`.
    grid : (int, int), optional
        Places of joints 2 and 3 along their travel.

    Raises
    ------
    InputError
        If no joint is calibrated, or the machine has no published geometry.
    """
    arm = as_calibrated_arm(arm)
    machine = arm.machine
    q2, q3 = (np.linspace(*machine.ranges[joint], number) for joint, number in zip((2, 3), grid, strict=True))
    goals = np.stack(np.meshgrid([machine.ranges[1][0]], q2, q3, indexing="ij"), axis=-1).reshape(-1, 3)
    far = goals.copy()
    far[:, 0] = sum(machine.ranges[1]) / 2
    still = tuple(joint for joint in JOINTS if joint not in arm.result.joints)
    if len(still) == len(JOINTS):
        raise InputError("this result has no calibrated joint")
    tips = forward(machine, goals * [0, 1, 1])  # with q1 = 0 the arm lies in the plane of x and z
    shape = (len(q2), len(q3))
    near_errors = _move_errors(arm, goals, still)
    far_errors = np.full(len(far), np.nan) if 1 in still else _move_errors(arm, far, still)
    return AccuracyMap(
        q2,
        q3,
        tips[:, 0].reshape(shape),
        tips[:, 2].reshape(shape),
        near_errors.reshape(shape),
        far_errors.reshape(shape),
        arm.session,
        still,
    )


def _move_errors(arm: CalibratedArm, goals: Array, still: tuple[int, ...]) -> Array:
    """95 % errors of moves from the nearest stops to `goals`, shape (n, 3) -> (n,)."""
    machine, q = arm.machine, goals.copy()
    for joint in set(JOINTS) - set(still):
        low, high = machine.ranges[joint]
        goal = goals[:, joint - 1]
        q[:, joint - 1] = np.where(goal - low <= high - goal, low, high)
    variance = np.zeros(goals.shape)
    for joint in JOINTS:
        if joint not in still:
            variance[:, joint - 1] = _drive_variance(arm, q, joint, goals[:, joint - 1])
            q[:, joint - 1] = goals[:, joint - 1]
    slope = jacobian(machine, goals)
    return error_radius(np.einsum("nij,nj,nkj->nik", slope, variance, slope))


def _drive_variance(arm: CalibratedArm, q: Array, joint: int, goal: Array) -> Array:
    """Variance of a joint's position after drives from `q` to `goal`, (n,), rad^2 or m^2."""
    variance, start = np.zeros(len(q)), q[:, joint - 1]
    for direction, moves in (("+", goal > start), ("-", goal < start)):
        if not moves.any():
            continue
        law, values, covariance, repeatability = arm.law(joint, direction)
        rows = arm.drive_rows(q[moves], joint, direction, goal[moves])
        counts, slopes = law.counts(rows, values)
        spread = relative_spread(slopes / counts[:, None], covariance, repeatability)
        last = law.step_size(rows, goal[moves][:, None], values)[:, 0]
        variance[moves] = (spread * (goal - start)[moves]) ** 2 + last**2 / 12.0
    return variance
