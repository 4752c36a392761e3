"""What findings say of the stage: a sentence for each, and a table of how steps changed under load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit._format import (
    MISSING,
    format_direction,
    format_p_value,
    format_percent,
    format_percent_range,
    format_uncertain,
    join_words,
)
from stickslip_fit._summary import Column, Section, Table
from stickslip_fit.diagnosis.stage_change import StageChange, StageReading

WORDS = {
    "friction": "friction or preload",
    "mass": "the moving mass",
    "voltage": "the drive voltage",
    "ramp time": "the ramp time",
}
UNKNOWN_ERROR = 0.5  # of a change, beyond which a fingerprint says nothing of it


def stage_sections(readings: Sequence[StageReading]) -> tuple[Section, ...]:
    """A section, or none where nothing was read."""
    if not readings:
        return ()
    tables = tuple(_fingerprint_table(reading) for reading in readings)
    return (
        Section("What changed in the stage", tuple(map(describe_reading, readings)), tables, key="stage"),
    )


def describe_reading(reading: StageReading) -> str:
    """Which change of the stage findings stand for, as a sentence or two."""
    causes = join_words(reading.causes)
    if not reading.suffices:
        p_value = format_p_value(reading.p_value, relation=True)
        acts = "acts" if len(reading.causes) == 1 else "act"
        return (
            f"Under load {causes} {acts} as no single change of friction, mass, voltage or ramp time would "
            f"(p {p_value})."
        )
    credible = reading.credible
    told = join_words([_describe_change(change) for change in credible], "or")
    regime = f"; the steps are {reading.regime}" if reading.regime else ""
    text = f"In the stage, {causes} {'is' if len(reading.causes) == 1 else 'are'} {told}{regime}."
    if {change.quantity for change in credible} == {"friction", "mass"}:
        return f"{text} Counts cannot tell friction from mass."
    if len(credible) > 1:
        return f"{text} Counts cannot tell which ({_probabilities(credible)})."
    return text


def _describe_change(change: StageChange) -> str:
    size = change.size
    least, most = sorted(map(abs, (size.low, size.high)))
    verb = "growing" if size.estimate > 0 else "falling"
    by = f"{format_percent(abs(size.estimate))} ({format_percent_range(least, most)} %)"
    if size.low * size.high < 0:
        by = f"{format_percent(abs(size.estimate))} ({format_percent_range(size.low, size.high)} %)"
    return f"{WORDS[change.quantity]} {verb} by {by}"


def _probabilities(changes: Sequence[StageChange]) -> str:
    return ", ".join(f"{change.quantity} {format_percent(change.probability)}" for change in changes)


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
        "follows friction, the response to load does not; velocity-limited: the reverse, and the step follows "
        "the voltage."
    )
    return Table(f"How steps change with {join_words(reading.causes)}", columns, rows, note=note, folded=True)


def _change(value: float, error: float) -> str:
    if not np.isfinite(error) or error > UNKNOWN_ERROR:
        return MISSING
    return format_uncertain(value, error, "%", with_unit=False)
