"""What changed, in a few lines: the verdict, what it means for moves, and one table."""

from __future__ import annotations

from math import isnan

import numpy as np

from stickslip_fit._format import (
    MISSING,
    decimals_for,
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_percent_range,
    format_uncertain,
    format_value,
    join_words,
    pluralize,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.changes.detection import STEP_SIZE, Change, Changes
from stickslip_fit.changes.difference import POWER
from stickslip_fit.changes.stage import read_stage_difference
from stickslip_fit.diagnosis._stage_summary import describe_changes
from stickslip_fit.logs.log import file_names
from stickslip_fit.units import from_si

MAX_ROWS = 14  # of the table; further parameters that show no change are folded
MAX_NAMED = 4  # sessions, and changes
MAX_RELATIVE = 10.0  # change of a step size, above which a bound is no number that anyone reads


@summarize.register
def summarize_changes(changes: Changes) -> Summary:
    """Verdict first; then a table of step sizes and of the parameters that changed."""
    shown = list(changes.changes)
    if len(shown) > MAX_ROWS:
        shown = [one for one in shown if one.name == STEP_SIZE or one.is_significant]
    others = [one for one in changes.changes if one not in shown]
    tables = [_table("Differences", shown, changes)]
    if others:
        tables.append(_table("Parameters that show no change", others, changes, folded=True))
    paragraphs = tuple(changes.not_compared)
    old, new = (file_names(list(one.log_files)) for one in changes.provenance)
    return Summary(
        title=f"Changes from {old} to {new}" if old != new else f"Changes within {old}" if old else "Changes",
        headline=tuple(_headline(changes)),
        sections=(Section(paragraphs=paragraphs, tables=tuple(tables)),),
        flags=tuple(f"{flag.message}." for flag in changes.flags[:MAX_NAMED]),
        provenance=tuple(
            (f"{age}: {name}", value)
            for age, one in zip(("old", "new"), changes.provenance, strict=True)
            for name, value in one.lines()
        ),
    )


def _headline(changes: Changes) -> list[str]:
    old, new = map(_describe_sessions, changes.sessions)
    compared = f"{old} against {new}"
    if not changes.knows_scatter:
        return [
            f"Cannot tell a change from a day's scatter: {compared}. With one session in each log nothing is "
            "known of the scatter from day to day; measure at least one more day.",
            _beyond_traverses(changes),
        ]
    rate = _rate(changes.alpha)
    lines = []
    if not changes.significant:
        lines.append(
            f"No change shows: {compared}, at a rate of false alarms of {rate} over everything below."
        )
        lines.append(_least_detectable(changes))
    else:
        drives = dict.fromkeys((one.joint, one.direction) for one in changes.significant)
        named = join_words([f"joint {joint} {format_direction(direction)}" for joint, direction in drives])
        lines.append(
            f"Changed: {named}, {compared}, at a rate of false alarms of {rate} over everything below."
        )
        lines += [_describe_drive(changes, *drive) for drive in list(drives)[:MAX_NAMED]]
        lines += _describe_stage(changes)
    alone = [len(sessions) == 1 for sessions in changes.sessions]
    if any(alone):
        one, other = ("old", "new") if alone[0] else ("new", "old")
        lines.append(
            f"The {one} log has a single session: the scatter from day to day is that of the {other} log."
        )
    return lines


def _describe_drive(changes: Changes, joint: int, direction: str) -> str:
    """What changed of one drive, and what it means for its moves."""
    own = [one for one in changes.changes if (one.joint, one.direction) == (joint, direction)]
    size = next((one for one in own if one.name == STEP_SIZE), None)
    parameters = [one for one in own if one.name != STEP_SIZE and one.is_significant]
    parts = []
    if size is not None:
        way = "longer" if size.difference.estimate > 0 else "shorter"
        one = size.difference
        decimals = decimals_for(from_si(one.standard_error, "%"))
        extent = _interval(one.low, one.high, "%", decimals)
        parts.append(
            f"steps are {format_value(abs(one.estimate), '%', decimals)} {way} ({extent})"
            if size.is_significant
            else f"the mean step size shows no change ({extent})"
        )
    if parameters:
        parts += [f"{one.name} changed by {_difference(one)}" for one in parameters]
    elif size is not None:
        parts.append("no single parameter can be named for it")
    return f"Joint {joint} {format_direction(direction)}: {'; '.join(parts)}."


def _describe_stage(changes: Changes) -> list[str]:
    """What it would be as one change of the stage, as a sentence or none."""
    found = read_stage_difference(changes)
    if found is None:
        return []
    if not found.credible:
        return ["No single change of friction, mass, voltage or ramp time describes all of it."]
    told = describe_changes(found.credible, intervals=True)
    regime = f" ({found.regime} steps)" if found.regime else ""
    return [f"As one change of the stage that would be: {told}{regime}."]


def _beyond_traverses(changes: Changes) -> str:
    """What differs by more than traverses repeat."""
    differ = [one for one in changes.changes if one.difference.p_within_days < changes.alpha]
    if not differ:
        return "No difference is larger than traverses repeat."
    named = [f"joint {one.joint} {format_direction(one.direction)} {one.name}" for one in differ[:MAX_NAMED]]
    if len(differ) > MAX_NAMED:
        named.append(f"{len(differ) - MAX_NAMED} more")
    return (
        f"By more than traverses repeat within a day differ: {join_words(named)}. Days of one actuator "
        "commonly differ by that much too."
    )


def _least_detectable(changes: Changes) -> str:
    sizes = [one.difference.detectable for one in changes.changes if one.name == STEP_SIZE]
    if not np.isfinite(sizes).any():
        return "What change would have been detected is below."
    low, high = np.nanmin(sizes), np.nanmax(sizes)
    if high > MAX_RELATIVE:
        least = "" if low > MAX_RELATIVE else f"{format_percent(low)} to "
        return (
            "There are too few sessions to know the scatter from day to day: only a change of the step size "
            f"by {least}more than {format_percent(MAX_RELATIVE)} would have been detected with "
            f"{_rate(POWER)} probability. Measure more days."
        )
    extent = format_percent(low) if high < 1.2 * low else f"{format_percent_range(low, high)} %"
    return (
        f"A change of the step size by {extent}, by joint and direction, would have been detected with "
        f"{_rate(POWER)} probability."
    )


def _table(caption: str, shown: list[Change], changes: Changes, *, folded: bool = False) -> Table:
    columns = (*words("joint", "quantity"), *numbers("old", "new", "difference"))
    note = (
        "Step size: mean over the configurations of a calibration, its difference in %. ± one standard error"
    )
    if changes.knows_scatter:
        columns += (Column(f"{_rate(1 - changes.alpha)} interval"), *numbers("p", "detectable"))
        note += (
            ", the scatter from day to day included. The intervals hold all together, and p is adjusted for "
            f"all (Holm). Detectable: what would be found with {_rate(POWER)} probability."
        )
    else:
        note += ", of a day's traverses alone."
    hidden = len(changes.changes) - len(shown)
    if hidden and not folded:
        note += (
            f" {pluralize(hidden, 'parameter')} that {'show' if hidden > 1 else 'shows'} no change: --json."
        )
    rows = tuple(_row(one)[: len(columns)] for one in shown)
    return Table(caption, columns, rows, stubs=2, note=note, folded=folded)


def _row(change: Change) -> tuple[str, ...]:
    difference, unit = change.difference, change.difference_unit
    decimals = decimals_for(from_si(difference.standard_error, unit))
    size = decimals_for(from_si(_size_of_error(change), change.unit))
    return (
        f"{change.joint} {format_direction(change.direction)}",
        change.name,
        format_value(difference.old, change.unit, size),
        format_value(difference.new, change.unit, size),
        _difference(change),
        _interval(difference.low, difference.high, unit, decimals),
        MISSING if isnan(difference.p_adjusted) else format_p_value(difference.p_adjusted),
        _bound(difference.detectable, unit, decimals),
    )


def _interval(low: float, high: float, unit: str, decimals: int) -> str:
    """With its unit, which not all rows have in common."""
    if isnan(low) or isnan(high):
        return MISSING
    return f"{format_number(low, unit, decimals)} to {_bound(high, unit, decimals)}"


def _bound(value: float, unit: str, decimals: int) -> str:
    """An upper bound with its unit; that of a step size is the exponential of one, which may be huge."""
    if unit == "%" and value > MAX_RELATIVE:
        return f"> {format_value(MAX_RELATIVE, unit, 0)}"
    return format_value(value, unit, decimals)


def _difference(change: Change) -> str:
    difference = change.difference
    sign = "+" if difference.estimate > 0 else ""
    return sign + format_uncertain(difference.estimate, difference.standard_error, change.difference_unit)


def _size_of_error(change: Change) -> float:
    """The standard error of the difference in the unit of the quantity."""
    error = change.difference.standard_error
    return error * change.difference.old if change.name == STEP_SIZE else error


def _rate(share: float) -> str:
    """A chosen probability, as it was chosen."""
    return f"{100 * share:g} %"


def _describe_sessions(sessions: tuple[str, ...]) -> str:
    if len(sessions) == 1:
        return f"session {sessions[0]}"
    return f"{pluralize(len(sessions), 'session')} ({sessions[0]} to {sessions[-1]})"
