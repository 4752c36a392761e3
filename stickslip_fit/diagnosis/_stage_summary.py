"""What findings say of the stage: a sentence for each, and a table of how steps changed under load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit._format import (
    MISSING,
    format_direction,
    format_p_value,
    format_percent,
    format_share,
    format_uncertain,
    join_words,
)
from stickslip_fit._summary import Column, Section, Table
from stickslip_fit.diagnosis.stage_change import StageChange, StageReading
from stickslip_fit.units import Interval

WORDS = {
    "friction": "friction or preload",
    "mass": "moving mass",
    "voltage": "drive voltage",
    "ramp time": "ramp time",
}
MAX_ODDS = 10.0  # of two changes that a log does not tell apart
UNKNOWN_ERROR = 0.5  # of a change, beyond which a fingerprint says nothing of it


def stage_sections(readings: Sequence[StageReading]) -> tuple[Section, ...]:
    """A section, or none where nothing was read."""
    if not readings:
        return ()
    told = [f"{describe_reading(reading)}{_describe_left_out(reading)}" for reading in readings]
    tables = tuple(map(_fingerprint_table, readings))
    return (Section("What changed in the stage", tuple(told), tables, key="stage"),)


def _describe_left_out(reading: StageReading) -> str:
    if not reading.left_out:
        return ""
    joints = join_words([str(joint) for joint in reading.left_out])
    one = len(reading.left_out) == 1
    return (
        f" {'Joint' if one else 'Joints'} {joints} {'is' if one else 'are'} left out: "
        f"{'its' if one else 'their'} counts do not follow the physical law."
    )


def describe_reading(reading: StageReading, *, intervals: bool = True) -> str:
    """Which change of the stage findings stand for, as a sentence or two."""
    causes = join_words(reading.causes)
    if not reading.suffices:
        p_value = format_p_value(reading.p_value, relation=True)
        acts = "acts" if len(reading.causes) == 1 else "act"
        return (
            f"Under load {causes} {acts} as no single change of friction, mass, voltage or ramp time would "
            f"(p {p_value})."
        )
    changes = reading.credible
    told = describe_changes(changes, intervals=intervals)
    regime = f" ({reading.regime} steps)" if reading.regime else ""
    text = f"As a change of the stage, {causes} would be, where it acts most: {told}{regime}."
    if len(reading.causes) > 1:
        text = (
            f"One change of the stage explains {causes} together, so that there is one fault to look for: "
            f"where it acts most, {told}{regime}."
        )
    if intervals and {change.quantity for change in changes} == {"friction", "mass"}:
        return f"{text} Counts cannot tell friction from mass."
    if intervals and _is_friction_or_ramp_time(changes):
        return (
            f"{text} Friction and ramp time cannot be told apart in this log: traverses at a higher drive "
            "voltage, at which friction limits the step, or the ramp on an oscilloscope would."
        )
    if intervals and len(changes) > 1:
        shares = ", ".join(f"{one.quantity} {100 * one.probability:.0f} %" for one in changes)
        return f"{text} Counts cannot tell which of them: {shares}."
    return text


def _is_friction_or_ramp_time(changes: Sequence[StageChange]) -> bool:
    """Whether it is one of these two, about as likely, as in velocity-limited steps."""
    total = {one.trace: 0.0 for one in changes}
    for one in changes:
        total[one.trace] += one.probability
    if set(total) != {"friction", "ramp time"}:
        return False
    return max(total.values()) < MAX_ODDS * min(total.values())


def describe_changes(changes: Sequence[StageChange], *, intervals: bool) -> str:
    """Changes of which one is the true one."""
    return join_words([_describe_change(change, intervals) for change in changes], "or")


def _describe_change(change: StageChange, intervals: bool) -> str:
    size = change.size
    sign = -1.0 if size.estimate < 0 else 1.0
    by = format_percent(abs(size.estimate))
    if intervals:
        low, high = sorted((sign * size.low, sign * size.high))
        by = format_share(Interval(abs(size.estimate), low, high))
    return f"{by} {'more' if sign > 0 else 'less'} {WORDS[change.quantity]}"


def _fingerprint_table(reading: StageReading) -> Table:
    columns = (
        Column("joint", text=True),
        Column("without load", "%", "change of the step size"),
        Column("response to load", "%", "change of the step size"),
        Column("friction-limited", "%", "probability"),
    )
    rows = tuple(
        (
            f"{row.joint} {format_direction(row.direction)}",
            _change(row.unloaded, row.unloaded_error),
            _change(row.response, row.response_error),
            f"{100 * row.friction_limited:.0f}",
        )
        for row in reading.fingerprint.itertuples(index=False)
    )
    note = (
        "± one standard error, where the change is at its largest. Friction-limited: the step without load "
        "follows friction, the response to load does not; velocity-limited: the reverse, and the step "
        "follows the voltage."
    )
    return Table(f"How steps change with {join_words(reading.causes)}", columns, rows, note=note, folded=True)


def _change(value: float, error: float) -> str:
    if not np.isfinite(error) or error > UNKNOWN_ERROR:
        return MISSING
    return format_uncertain(value, error, "%", with_unit=False)
