"""Moves as text for the terminal."""

from __future__ import annotations

import numpy as np

from stickslip_fit._format import format_value
from stickslip_fit._summary import text_table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.moves import Calibrated, Move, Whereabouts, steps_until
from stickslip_fit.moves.calibrated import CERTAIN
from stickslip_fit.units import from_si


def move_text(arm: Calibrated, move: Move) -> str:
    """The legs of a move, and where the tip ends."""
    if not move.legs:
        return "the joints are there already: nothing to drive"
    rows = [
        [
            f"{leg.joint} {leg.direction}",
            joint_value(leg.joint, leg.start),
            joint_value(leg.joint, leg.stop),
            f"{leg.steps:,}",
            f"{leg.low:,.0f} to {leg.high:,.0f}",
            joint_error(leg.joint, leg.error),
        ]
        for leg in move.legs
    ]
    header = ["joint", "from", "to", "steps", "95 % of moves need", "ends within ±"]
    return "\n".join(
        [
            _heading(arm),
            "",
            text_table(header, rows),
            "",
            f"tip at {tip_text(move.tip)}; known to ± {_micrometres(CERTAIN * move.tip_error)} (95 %)",
            "drive the legs in this order: a step depends on where the other joints stand",
        ]
    )


def whereabouts_text(arm: Calibrated, at: Whereabouts, tolerance: float) -> str:
    """Where joints and tip are, and how far one may go on before going back to a stop."""
    rows = [
        [
            f"q{joint}",
            joint_value(joint, at.q[joint - 1]),
            joint_error(joint, at.q_error[joint - 1]),
            "at its stop" if joint in at.at_stop else "",
        ]
        for joint in arm.machine.ranges
    ]
    lines = [
        _heading(arm),
        "",
        text_table(["joint", "stands at", "known to ±", ""], rows),
        "",
        f"tip at {tip_text(at.tip)}; known to ± {_micrometres(CERTAIN * at.tip_error)} (95 %)",
    ]
    if CERTAIN * at.tip_error > tolerance:
        return "\n".join([*lines, f"that is more than {_micrometres(tolerance)}: go back to a stop now"])
    return "\n".join([*lines, "", *_going_on(arm, at, tolerance)])


def tip_text(tip: np.ndarray) -> str:
    """A tip position in mm."""
    return "({}) mm".format(", ".join(f"{from_si(value, 'mm'):.3f}" for value in tip))


def joint_value(joint: int, value: float) -> str:
    """A joint's position in people's units."""
    return format_value(float(value), "mm" if joint == PRISMATIC else "deg", 3)


def joint_error(joint: int, error: float) -> str:
    """A joint's 95 % error in people's units."""
    unit = "µm" if joint == PRISMATIC else "mrad"
    return format_value(CERTAIN * float(error), unit, 2)


def _going_on(arm: Calibrated, at: Whereabouts, tolerance: float) -> list[str]:
    lines = [f"within {_micrometres(tolerance)} (95 %) you may go on for"]
    sessions = {
        (joint, way)
        for joint, fit in arm.result.joints.items()
        for session, way in zip(fit.groups["session"], fit.groups["direction"], strict=True)
        if session == arm.session
    }
    for joint, way in sorted(sessions):
        further = steps_until(arm, at, joint, way, tolerance)
        text = "all the way to its stop" if further is None else f"{further:,} steps, then go back to a stop"
        lines.append(f"  joint {joint} {way}  {text}")
    return lines


def _heading(arm: Calibrated) -> str:
    theta, psi = (format_value(angle, "deg", 1) for angle in (arm.theta, arm.psi))
    return f"calibration of session {arm.session}; base at theta = {theta}, psi = {psi}"


def _micrometres(value: float) -> str:
    return format_value(value, "µm", 2)
