"""Figures of residuals: against every covariate, and before and after each finding.

Periodic findings are drawn folded by their period.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import coordinate_unit, format_percent, joint_name, pluralize
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.position import is_reversed
from stickslip_fit.diagnosis import Finding
from stickslip_fit.diagnosis._unknown_summary import LENGTH, POSITION, name_carriers
from stickslip_fit.diagnosis.extension import SelectedCause
from stickslip_fit.diagnosis.finding import LogInfo
from stickslip_fit.diagnosis.linearized import rms
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import ResidualComparison, find_carrier
from stickslip_fit.estimation.profile import follows_position
from stickslip_fit.logs.history import (
    CHANGES,
    JOINT_NET_USE,
    JOINT_USE,
    LATE_TEMPERATURE,
    MOVES,
    NET_USE,
    OTHER_USE,
    TIME_OF_DAY,
    USE,
    unit_of,
)
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX, has_times, position_columns
from stickslip_fit.machine import Machine, mean_load
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    GREY,
    INK,
    direction_entries,
    direction_styles,
    make_figure,
    make_legend_entry,
    report_style,
    robust_limit,
    set_angle_ticks,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture, name_traverses
from stickslip_fit.plotting.sides import (
    LIMIT_QUANTILE,
    ColouredRows,
    caption_overview,
    choose_sides,
    draw_overview,
    draw_sides,
    envelope_entry,
    picture_sides,
)
from stickslip_fit.units import from_si

FIT_MAX_POINTS = 900  # of a joint
FIT_LIMIT_ZOOM = 1.6  # of a scale, see `robust_limit`


def fit_residuals_picture(rows: pd.DataFrame, machine: Machine) -> Picture:
    """All traverses of a joint, by how far they are from the least-squares law."""
    joint = int(rows["joint"].iloc[0])
    key, title = f"departures-{joint}", f"Residuals of the law, {joint_name(joint, machine)}"
    if not _fit_covariates(rows, machine):
        return make_missing_picture(key, title, "It would need a second traverse.")
    sample, sizes = thin_rows(rows, FIT_MAX_POINTS), rows["departure"].abs()
    of_all = "" if len(sample) == len(rows) else f" of {len(rows):,}, chosen at random"
    limit = max(robust_limit(sizes.dropna().to_numpy(), LIMIT_QUANTILE, FIT_LIMIT_ZOOM), 1e-4)
    n_beyond = int((sample["departure"].abs() > limit).sum())
    caption = (
        f"{pluralize(len(sample), 'traverse')}{of_all}, residuals (measured less model): a law that lacks "
        "nothing leaves a level band in every panel. Half of them are within "
        f"{format_percent(float(sizes.median()))} of the law."
        + (f" {pluralize(n_beyond, 'point')} beyond the scale, drawn at its edge." if n_beyond else "")
    )
    return make_picture(key, title, caption, draw_fit_residuals(sample, limit, machine))


def draw_fit_residuals(rows: pd.DataFrame, limit: float, machine: Machine) -> Figure:
    """One panel for each quantity that varied."""
    joint = int(rows["joint"].iloc[0])
    quantities = _fit_covariates(rows, machine)
    styles = direction_styles(joint, machine).values()
    with report_style():
        legend = [make_legend_entry(style.label, style.colour, marker="o") for style in styles]
        figure, axes = make_figure([1.55], len(quantities), legend, top=0.12)
        axes[0, 0].set_ylim(-100 * limit, 100 * limit)
        axes[0, 0].set_ylabel("residual (%)")
        for axis, (label, x) in zip(axes[0], quantities.items(), strict=True):
            axis.axhline(0.0, color=INK, lw=0.7)
            for direction, colour in DIRECTION_COLOURS.items():
                subset = (rows["direction"] == direction).to_numpy()
                y = 100 * np.clip(rows["departure"].to_numpy()[subset], -limit, limit)
                (points,) = axis.plot(x[subset], y, ls="", marker="o", ms=2.0, mew=0, alpha=0.6, color=colour)
                name_traverses(points, rows.index[subset])
            axis.set_xlabel(label)
            if "°" in label:
                set_angle_ticks(axis, np.nanmin(x), np.nanmax(x), 3 if len(quantities) > 5 else 4)
    return figure


def _fit_covariates(rows: pd.DataFrame, machine: Machine) -> dict[str, np.ndarray]:
    """The quantities that varied, by axis label, in its unit; of the moving joint the traverse's middle."""
    joint = int(rows["joint"].iloc[0])
    quantities = {}
    for name in position_columns(rows):
        unit = coordinate_unit(name, machine)
        moving = name == f"q{joint}"
        label = f"{'middle of ' if moving else ''}{name} ({'°' if unit == 'deg' else unit})"
        quantities[label] = from_si(rows["centre" if moving else name].to_numpy(float), unit)
    quantities[SESSION_HOURS] = from_si(rows["session_seconds"].to_numpy(float), "h")
    return {label: x for label, x in quantities.items() if len(x) and np.ptp(x) > 1e-6}


# Not in proportion to the load, nor in the own travel of a joint.
PERIOD_PATTERN = re.compile(r"period of ([0-9.]+) (min|traverses)(?:, joint .*)?")


def fold_phase(carrier: str, rows: pd.DataFrame, shape: Array) -> tuple[str, Array] | None:
    """The phase of each row, if a finding's carrier is a period.

    Parameters
    ----------
    carrier : str
        As `Finding.carrier`, e.g. "period of 50.0 min".
    rows : DataFrame
        A log's, n of them.
    shape : array, shape (n,)
        The finding's effect on each row. The phase is 0 where it is largest, in each session by itself: the
        period does not start anew with a session.

    Returns
    -------
    tuple of str and array, shape (n,), or None
        A label, and minutes or traverses since phase 0.
    """
    match = PERIOD_PATTERN.fullmatch(carrier)
    if match is None:
        return None
    period, unit = float(match[1]), match[2]
    session = pd.factorize(rows["session"].astype(object))[0]
    minutes = from_si(rows["session_seconds"].to_numpy(float), "min")
    clock = minutes if unit == "min" else rows.groupby(session).cumcount().to_numpy(float)
    angle = 2 * np.pi * clock / period
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offset = np.zeros(len(rows))
    for code in np.unique(session):
        subset = session == code
        cosine, sine = np.linalg.lstsq(waves[subset], shape[subset], rcond=None)[0]
        offset[subset] = np.arctan2(sine, cosine)
    phase = np.mod(angle - offset, 2 * np.pi) / (2 * np.pi)
    return f"{'minutes' if unit == 'min' else unit} into a period of {period:g}", phase * period


SESSION_GAP = 0.04  # of all hours, between two sessions drawn one after the other
CONCATENATED_HOURS = "hours, all sessions"
SESSION_HOURS = "hours in session"
MAX_PLAIN_STEPS = 1e4
OWN_STEPS = "own steps so far (millions)"
LOAD_BEFORE = "previous traverse's load"
REVERSED = "0: same way, 1: reversed"
HISTORY_LABELS = {
    "session_seconds": SESSION_HOURS,
    "steps_before": OWN_STEPS,
    "before_load": LOAD_BEFORE,
    "before_direction": REVERSED,
}


def find_label(column: str) -> str:
    """The axis that shows a column of the log best, if it is one that a cause follows by itself."""
    if column in CONDITIONS:
        return CONDITIONS[column].axis
    return HISTORY_LABELS.get(column) or column.removeprefix(COVARIATE_PREFIX)


def collect_covariates(rows: pd.DataFrame, machine: Machine) -> dict[str, Array]:
    """The quantities that varied over n traverses, by axis label, in its unit; NaN where not known."""
    return {label: values for label, values in _compute_covariates(rows, machine) if _varies(values)}


def _compute_covariates(rows: pd.DataFrame, machine: Machine) -> Iterator[tuple[str, Array]]:
    joint = rows["joint"].to_numpy()
    middle = ((rows["start"] + rows["stop"]) / 2).to_numpy(float)
    yield SESSION_HOURS, from_si(rows["session_seconds"].to_numpy(float), "h")
    for name, condition in CONDITIONS.items():
        yield condition.axis, from_si(rows[name].to_numpy(float), condition.unit)
    if machine.has_published_geometry:
        yield "load along the axis", _compute_load(rows)
        zeta = rows["psi"].to_numpy(float) - np.where(joint == 2, middle, rows["q2"].to_numpy(float))
        yield "zeta = psi − q2 (°)", from_si(zeta, "deg")
    # The published laws depend most on joints 2 and 3.
    first = [name for name in ("q2", "q3") if machine.has_published_geometry]
    for name in dict.fromkeys([*first, *position_columns(rows)]):
        unit, values = coordinate_unit(name, machine), rows[name].to_numpy(float)
        values = np.where(joint == int(name[1:]), middle, values) if name.startswith("q") else values
        yield f"{name} ({'°' if unit == 'deg' else unit})", from_si(values, unit)
    steps = rows["steps"].to_numpy(float)
    yield ("steps", steps) if steps.max(initial=0.0) < MAX_PLAIN_STEPS else ("steps (thousands)", steps / 1e3)
    yield LOAD_BEFORE, rows["before_load"].to_numpy(float)
    if has_times(rows):
        yield REVERSED, is_reversed(rows["before_direction"], rows["direction"]).astype(float)
    for column in rows.columns:
        if column.startswith(COVARIATE_PREFIX):
            yield column.removeprefix(COVARIATE_PREFIX), rows[column].to_numpy(float)
    if rows["session"].nunique() > 1 and has_times(rows):
        yield CONCATENATED_HOURS, concatenate_sessions(rows)
    yield OWN_STEPS, rows["steps_before"].to_numpy(float) / 1e6


def concatenate_sessions(rows: pd.DataFrame) -> Array:
    """Hours, with the nights between sessions cut out."""
    hours = from_si(rows["session_seconds"].to_numpy(float), "h")
    lasts = pd.Series(hours).groupby(rows["session"].astype(object).to_numpy(), sort=False).max()
    begins = np.r_[0.0, np.cumsum(lasts.to_numpy() + SESSION_GAP * lasts.sum())[:-1]]
    begin = rows["session"].astype(object).map(dict(zip(lasts.index, begins, strict=True)))
    return hours + begin.to_numpy(float)


def _compute_load(rows: pd.DataFrame) -> Array:
    load = np.zeros(len(rows))
    for joint in rows["joint"].unique():
        subset = (rows["joint"] == joint).to_numpy()
        at = [rows[name].to_numpy(float)[subset] for name in ("start", "stop", "q1", "q2", "theta", "psi")]
        load[subset] = mean_load(int(joint), *at)
    return load


def _varies(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and bool(np.ptp(known) > 1e-6 * max(1.0, float(np.abs(known).max())))


TRAVERSE_LABEL = "traverse"
BEFORE_LABEL = "the traverse before (%)"
PROPOSAL_LABEL = "what is proposed, as fitted"
EFFECT_LABEL = "effect of the proposal (%)"
CARRIER_LABELS = {"load": "load along the axis", "transverse_load": "transverse load", "zeta": "zeta = psi"}
# Of history that no cause follows: its axis, and the unit of that where it is not SI.
FURTHER_LABELS = {
    "before_length": ("length of the joint's traverse before (share of its travel)", ""),
    "before_gap": ("distance from the joint's last stop (share of its travel)", ""),
    "before_joint": ("joint that moved before", ""),
    "other_load": ("load of another joint's last traverse", ""),
    "pause": ("since the traverse before (min)", "min"),
    "joint_pause": ("since the joint's traverse before (min)", "min"),
    "other_pause": ("since another joint moved (min)", "min"),
    "tilt_age": ("since the arm was tilted (min)", "min"),
    TIME_OF_DAY: ("time of day (h)", "h"),
    **{
        name: (f"temperature {seconds / 60.0:.0f} min late (°C)", "°C")
        for name, seconds in LATE_TEMPERATURE.items()
    },
    **{
        name: (
            f"change of the {CONDITIONS[condition].label} in {seconds / 60.0:.0f} min ({unit_of(name)})",
            unit_of(name),
        )
        for name, (condition, seconds) in CHANGES.items()
    },
    **{
        name: (
            f"change of {coordinate} in {seconds / 60.0:.0f} min ({unit_of(name).replace('deg', '°')})",
            unit_of(name),
        )
        for name, (coordinate, seconds) in MOVES.items()
    },
    **{name: (f"full travels in {seconds / 60.0:.0f} min", "") for name, seconds in USE.items()},
    **{name: (f"own full travels in {seconds / 60.0:.0f} min", "") for name, seconds in JOINT_USE.items()},
    **{
        name: (f"others' full travels in {seconds / 60.0:.0f} min", "") for name, seconds in OTHER_USE.items()
    },
    "joint_travel": ("own full travels in the session", ""),
    **{name: (f"net full travels in {seconds / 60.0:.0f} min", "") for name, seconds in NET_USE.items()},
    **{
        name: (f"own net full travels in {seconds / 60.0:.0f} min", "")
        for name, seconds in JOINT_NET_USE.items()
    },
}


def finding_picture(
    finding: Finding, selected: SelectedCause, shape: Array, comparison: ResidualComparison, machine: Machine
) -> Picture:
    """Residuals before and after one finding, over the quantity that carries it.

    Parameters
    ----------
    selected : SelectedCause
        The same in the selection; not of outliers, which have no shape.
    shape : array, shape (n,)
        Its effect on each row, in any unit.
    """
    label, figure = draw_finding(finding, selected, shape, comparison, machine)
    over = f"the {label}" if label == EFFECT_LABEL else label
    over += ", one session after the other (dotted: where one begins)" * (label == CONCATENATED_HOURS)
    title, above = f"{finding.cause}: residuals", ""
    if _is_proposal(selected):
        proposed = finding.term or f"a smooth function of {name_carriers(finding)}".rstrip(",")
        title = f"What is proposed: {proposed}"
        above = (
            f"what the law leaves without it; dashed: the {'term' if finding.term else 'function'} as "
            "fitted, beyond what recalibration absorbs; both should agree within the bars"
        )
    elif selected.version is not None:
        title += " before and after"
        above = f"under the law as it was ({format_percent(rms(comparison.before))} rms)"
    return picture_sides(finding, title, over, above, rms(comparison.after), LogInfo(), figure)


def draw_finding(
    finding: Finding, selected: SelectedCause, shape: Array, comparison: ResidualComparison, machine: Machine
) -> tuple[str, Figure]:
    """Joints side by side, before above after: the label of the finding's carrier, and the figure."""
    rows = comparison.rows
    joints = [joint for joint in finding.joints if (rows["joint"] == joint).any()]
    subset = rows["joint"].isin(joints).to_numpy()
    if getattr(selected.version, "n_slow", 0):  # a wave without one phase for the whole session
        label, values = EFFECT_LABEL, 100 * shape
    else:
        label, values = fold_phase(finding.carrier, rows, shape) or _find_carrier_values(
            selected, shape, comparison, subset, machine
        )
    panels = {
        joint_name(joint, machine): _by_direction(rows, (rows["joint"] == joint).to_numpy())
        for joint in joints
    }
    partial, legend = shape if _is_proposal(selected) else None, _residual_entries()
    if partial is not None:
        legend.append(make_legend_entry(PROPOSAL_LABEL, INK, line="--"))
    sides = choose_sides(comparison, without=partial, extended=selected.version is not None)
    figure = draw_sides(sides, label, values, panels, legend, LogInfo(), effect=partial, numbers=rows.index)
    if label == CONCATENATED_HOURS:
        begins = values - from_si(rows["session_seconds"].to_numpy(float), "h")
        for axis, begin in product(figure.axes, np.unique(begins.round(6))[1:]):
            axis.axvline(begin, color=GREY, lw=0.8, ls=":", zorder=0.8)
    return label, figure


def _find_carrier_values(
    selected: SelectedCause, shape: Array, comparison: ResidualComparison, subset: BoolArray, machine: Machine
) -> tuple[str, Array]:
    """The quantity that carries a finding: its label and values."""
    assert selected.misfit is not None
    best = selected.misfit.best_hypothesis(selected.cause)
    if isinstance(best, AR1):
        return BEFORE_LABEL, np.where(best.before >= 0, 100 * comparison.after[best.before], np.nan)
    rows = comparison.rows
    columns, carriers = _select_covariates(rows, subset, machine), getattr(selected.version, "carriers", ())
    if len(carriers) > 1:
        return EFFECT_LABEL, 100 * shape
    label, values = _own_position(rows, subset, machine)
    if POSITION in carriers or (selected.version is not None and follows_position(selected.version)):
        return label, values
    if LENGTH in carriers:
        return _own_length(rows, subset, machine)
    if carriers and carriers[0] in FURTHER_LABELS:
        label, unit = FURTHER_LABELS[carriers[0]]
        values = rows[carriers[0]].to_numpy(float)
        return label, from_si(values, unit) if unit else values
    if any(_varies(values[subset & (rows["joint"] == joint).to_numpy()]) for joint in rows["joint"].unique()):
        columns = {label: values} | columns  # first: a coordinate of one joint is a setting of the others
    own = [find_label(column) for column in getattr(selected.version, "columns", ())]
    begins = tuple(CARRIER_LABELS.get(name, f"{name} (") for name in carriers)
    own += [label for label in columns if begins and label.startswith(begins)]
    columns = {label: columns[label] for label in own if label in columns} | columns
    groups = 2 * rows["joint"].to_numpy() + (rows["direction"] == "-").to_numpy()
    label = find_carrier(
        shape[subset], {name: values[subset] for name, values in columns.items()}, groups[subset]
    )
    return label, columns[label]


def _own_position(rows: pd.DataFrame, subset: BoolArray, machine: Machine) -> tuple[str, Array]:
    """The middle of each traverse along its own joint's travel, in that joint's unit."""
    middle = ((rows["start"] + rows["stop"]) / 2).to_numpy(float)
    names = [f"q{one}" for one in np.unique(rows["joint"].to_numpy()[subset])]
    return _in_own_unit(names[0] if len(names) == 1 else "own position", middle, rows, subset, machine)


def _own_length(rows: pd.DataFrame, subset: BoolArray, machine: Machine) -> tuple[str, Array]:
    length = (rows["stop"] - rows["start"]).abs().to_numpy(float)
    return _in_own_unit("length of the traverse", length, rows, subset, machine)


def _in_own_unit(
    name: str, values: Array, rows: pd.DataFrame, subset: BoolArray, machine: Machine
) -> tuple[str, Array]:
    """Positions or lengths, SI, in the unit of each traverse's joint; the label has those of a subset."""
    joint, shown = rows["joint"].to_numpy(), np.empty(len(rows))
    unit_of = {int(one): coordinate_unit(f"q{one}", machine) for one in np.unique(joint)}
    for one, unit in unit_of.items():
        shown[joint == one] = from_si(values[joint == one], unit)
    units = dict.fromkeys(unit_of[int(one)].replace("deg", "°") for one in np.unique(joint[subset]))
    return f"{name} ({' or '.join(units)})", shown


def _is_proposal(selected: SelectedCause) -> bool:
    """Whether it is what extends the law for structure without a name."""
    return selected.cause == UNKNOWN and selected.version is not None


def residuals_overview_picture(joint: int, comparison: ResidualComparison, machine: Machine) -> Picture:
    """A joint's residuals against each quantity that varied."""
    subset = (comparison.rows["joint"] == joint).to_numpy()
    key, title = f"everything-{joint}", f"Residuals against each quantity, {joint_name(joint, machine)}"
    if not _select_covariates(comparison.rows, subset, machine):
        return make_missing_picture(key, title, "It would need a second traverse.")
    caption = caption_overview(comparison, subset, LogInfo())
    if CONCATENATED_HOURS in _select_covariates(comparison.rows, subset, machine):
        caption += f" {CONCATENATED_HOURS.capitalize()}: one after the other, without the nights between."
    return make_picture(key, title, caption, draw_residuals_overview(joint, comparison, machine))


def draw_residuals_overview(joint: int, comparison: ResidualComparison, machine: Machine) -> Figure:
    """A panel for each quantity."""
    subset = (comparison.rows["joint"] == joint).to_numpy()
    columns = _select_covariates(comparison.rows, subset, machine)
    entries = [entry for entry in _residual_entries() if entry.get_label() != TRAVERSE_LABEL]
    return draw_overview(columns, comparison, _by_direction(comparison.rows, subset), entries, LogInfo())


def _residual_entries() -> list[Line2D]:
    return [
        make_legend_entry(TRAVERSE_LABEL, GREY, marker="."),
        *direction_entries(marker="o", line="-", label="mean, direction {}"),
        envelope_entry("log"),
    ]


def _by_direction(rows: pd.DataFrame, subset: BoolArray) -> ColouredRows:
    directions = rows["direction"].to_numpy(object)
    return {colour: subset & (directions == sign) for sign, colour in DIRECTION_COLOURS.items()}


def _select_covariates(rows: pd.DataFrame, subset: BoolArray, machine: Machine) -> dict[str, Array]:
    """The quantities that varied in a subset of the rows, for all rows."""
    varied = collect_covariates(rows[subset], machine)
    return {label: values for label, values in collect_covariates(rows, machine).items() if label in varied}
