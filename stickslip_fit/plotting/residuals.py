"""Figures of residuals: against every covariate, and before and after each finding.

Periodic findings are drawn folded by their period. `plot_readings` shows step sizes in time order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import joint_name, step_unit
from stickslip_fit._format import pluralize as count
from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.position import is_reversed
from stickslip_fit.diagnosis import Finding
from stickslip_fit.diagnosis.hypotheses import AR1
from stickslip_fit.diagnosis.residuals import ResidualComparison, bin_residuals, bin_values, find_carrier
from stickslip_fit.diagnosis.selection import SelectedCause
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.laws import expected_steps, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import CONDITIONS, COVARIATE_PREFIX
from stickslip_fit.machine import mean_load
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    GREY,
    INK,
    LEGEND_LINE,
    TITLE_LINE,
    add_legend,
    make_figure,
    make_legend_entry,
    report_style,
    set_angle_ticks,
    set_white_background,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture, name_traverses
from stickslip_fit.plotting.sweeps import direction_styles
from stickslip_fit.units import from_si

FIT_MAX_POINTS = 900
FIT_LIMIT_QUANTILE, FIT_ZOOM = 0.98, 1.6


def fit_residuals_picture(rows: pd.DataFrame) -> Picture:
    """All traverses of a joint, by how far they are from the least-squares law."""
    joint = int(rows["joint"].iloc[0])
    key, title = f"departures-{joint}", f"What the law leaves over, {joint_name(joint)}"
    if not _fit_covariates(rows):
        return make_missing_picture(key, title, "It would need a second traverse.")
    shown = thin_rows(rows, FIT_MAX_POINTS)
    of_all = "" if len(shown) == len(rows) else f" of {len(rows):,}, chosen at random"
    limit = _fit_limit(rows)
    beyond = int((shown["departure"].abs() > limit).sum())
    caption = (
        f"{count(len(shown), 'traverse')}{of_all}, seen less law: a law that lacks nothing leaves a level "
        f"band in every panel. Half of them are within {percent(float(rows['departure'].abs().median()))} of "
        "the law." + (f" {count(beyond, 'point')} beyond the scale, drawn at its edge." if beyond else "")
    )
    return make_picture(key, title, caption, draw_fit_residuals(shown, limit))


def draw_fit_residuals(rows: pd.DataFrame, limit: float) -> Figure:
    """One panel for each quantity that varied."""
    joint = int(rows["joint"].iloc[0])
    quantities = _fit_covariates(rows)
    with report_style():
        entries = [
            make_legend_entry(kind.label, kind.colour, marker="o")
            for kind in direction_styles(joint).values()
        ]
        figure, axes = make_figure([1.55], len(quantities), top=LEGEND_LINE + 0.12)
        axes[0, 0].set_ylim(-100 * limit, 100 * limit)
        axes[0, 0].set_ylabel("seen less law (%)")
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
        add_legend(figure, entries)
    return figure


def _fit_covariates(rows: pd.DataFrame) -> dict[str, np.ndarray]:
    """What varied, by axis label, in people's units; of the moving joint where the traverse's middle was."""
    joint = int(rows["joint"].iloc[0])
    units = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
    found = {}
    for name, unit in units.items():
        moving = name == f"q{joint}"
        label = f"{'middle of ' if moving else ''}{name} ({'°' if unit == 'deg' else unit})"
        found[label] = from_si(rows["centre" if moving else name].to_numpy(float), unit)
    found["hours in session"] = from_si(rows["session_seconds"].to_numpy(float), "h")
    return {label: x for label, x in found.items() if np.ptp(x) > 1e-6}


def _fit_limit(rows: pd.DataFrame) -> float:
    sizes = rows["departure"].abs().dropna()
    return max(1.05 * min(float(sizes.max()), FIT_ZOOM * float(sizes.quantile(FIT_LIMIT_QUANTILE))), 1e-4)


PERIOD_PATTERN = re.compile(r"period of ([0-9.]+) (min|traverses)")


def fold_phase(carrier: str, rows: pd.DataFrame, shape: Array) -> tuple[str, Array] | None:
    """Where in its period each row stands, if a finding's carrier is a period.

    Parameters
    ----------
    carrier : str
        As `Finding.carrier`, e.g. "period of 50.0 min".
    rows : DataFrame
        A log's, n of them.
    shape : array, shape (n,)
        What the finding does to each row. A session begins its periods where that is largest: what comes and
        goes in a room takes no notice of when a session begins.

    Returns
    -------
    tuple of str and array, shape (n,), or None
        A label, and minutes or traverses since the last time it was largest.
    """
    found = PERIOD_PATTERN.fullmatch(carrier)
    if found is None:
        return None
    period, unit = float(found[1]), found[2]
    session = pd.factorize(rows["session"].astype(object))[0]
    minutes = from_si(rows["session_seconds"].to_numpy(float), "min")
    clock = minutes if unit == "min" else rows.groupby(session).cumcount().to_numpy(float)
    angle = 2 * np.pi * clock / period
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    largest = np.zeros(len(rows))
    for each in np.unique(session):
        subset = session == each
        size = np.linalg.lstsq(waves[subset], shape[subset], rcond=None)[0]
        largest[subset] = np.arctan2(size[1], size[0])
    share = np.mod(angle - largest, 2 * np.pi) / (2 * np.pi)
    counted = "minutes" if unit == "min" else unit
    return f"{counted} into a period of {period:g} {unit}", share * period


DIRECTION_MARKERS = {"+": "o", "-": "s"}
MAX_LABELS = 10  # session names that there is room for, side by side


def plot_readings(log: Log) -> Figure:
    """A panel for each joint, sessions one after the other; what may not be fitted is left out.

    Raises
    ------
    InputError
        If no traverse is usable.
    """
    rows = log.usable
    if rows.empty:
        raise InputError("there is nothing to draw: the log has no usable traverse")
    joints = sorted(int(joint) for joint in rows["joint"].unique())
    step = traverse_length(rows) / expected_steps(rows["steps"], rows["check_every"])
    with report_style():
        figure, axes = make_figure(
            [1.15] * len(joints), 1, top=LEGEND_LINE + 0.14, bottom=0.3, down=0.14, share_x="col"
        )
        for axis, joint in zip(axes[:, 0], joints, strict=True):
            for sign, colour in DIRECTION_COLOURS.items():
                subset = np.flatnonzero((rows["joint"] == joint) & (rows["direction"] == sign))
                axis.plot(
                    subset,
                    from_si(step[subset], step_unit(joint)),
                    DIRECTION_MARKERS[sign],
                    color=colour,
                    ms=2.2,
                    mew=0,
                )
            axis.set_ylabel(f"joint {joint} ({step_unit(joint)})")
            axis.grid(visible=False, axis="x")
        _draw_sessions(axes[:, 0], log)
        figure.align_ylabels(axes[:, 0])
        add_legend(
            figure,
            [
                make_legend_entry(f"mean step, direction {way(sign)}", colour, marker=DIRECTION_MARKERS[sign])
                for sign, colour in DIRECTION_COLOURS.items()
            ],
        )
    return set_white_background(figure)


def _draw_sessions(axes: np.ndarray, log: Log) -> None:
    """Lines between sessions, and their names below, as many as there is room for."""
    names = log.usable["session"].to_numpy(object)
    begins = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    ends = np.r_[begins[1:], len(names)]
    for axis in axes:
        for begin in begins[1:]:
            axis.axvline(begin - 0.5, color=GREY, lw=0.7)
        axis.tick_params(axis="x", length=0)
    kept = slice(None, None, -(-len(begins) // MAX_LABELS))
    last: Axes = axes[-1]
    labels = [shorten(str(names[begin]), 12) for begin in begins[kept]]
    last.set_xticks((begins[kept] + ends[kept] - 1) / 2, labels)
    last.set_xlim(-1, len(names))


SESSION_GAP = 0.04  # of all hours, between two sessions drawn one after the other
CONCATENATED_HOURS = "hours, sessions in a row"
SESSION_HOURS = "hours in session"
OWN_STEPS = "own steps so far (millions)"
LOAD_BEFORE = "load of the traverse before"
REVERSED = "after a reversal (1) or not (0)"
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


def collect_covariates(rows: pd.DataFrame) -> dict[str, Array]:
    """What varied, by axis label, in people's units; NaN where it is not known.

    Parameters
    ----------
    rows : DataFrame
        Traverses of one or more joints.

    Returns
    -------
    dict of str to array, shape (n,)
        What people set first, then what came of itself.
    """
    return {label: values for label, values in _compute_covariates(rows) if _varies(values)}


def _compute_covariates(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    joint = rows["joint"].to_numpy()
    middle = ((rows["start"] + rows["stop"]) / 2).to_numpy(float)
    yield SESSION_HOURS, from_si(rows["session_seconds"].to_numpy(float), "h")
    for name, condition in CONDITIONS.items():
        yield condition.axis, from_si(rows[name].to_numpy(float), condition.unit)
    yield "load along the axis", _compute_load(rows)
    yield "q2 (°)", from_si(np.where(joint == 2, middle, rows["q2"].to_numpy(float)), "deg")
    yield "q3 (mm)", from_si(np.where(joint == 3, middle, rows["q3"].to_numpy(float)), "mm")
    yield "q1 (°)", from_si(np.where(joint == 1, middle, rows["q1"].to_numpy(float)), "deg")
    yield "theta (°)", from_si(rows["theta"].to_numpy(float), "deg")
    yield "psi (°)", from_si(rows["psi"].to_numpy(float), "deg")
    yield "steps (thousands)", rows["steps"].to_numpy(float) / 1e3
    yield LOAD_BEFORE, rows["before_load"].to_numpy(float)
    turned = is_reversed(rows["before_direction"], rows["direction"])
    yield REVERSED, turned.astype(float)
    for column in rows.columns:
        if column.startswith(COVARIATE_PREFIX):
            yield column.removeprefix(COVARIATE_PREFIX), rows[column].to_numpy(float)
    if rows["session"].nunique() > 1:
        yield CONCATENATED_HOURS, concatenate_sessions(rows)
    yield OWN_STEPS, rows["steps_before"].to_numpy(float) / 1e6


def concatenate_sessions(rows: pd.DataFrame) -> Array:
    """Hours, with the nights between sessions cut out."""
    hours = from_si(rows["session_seconds"].to_numpy(float), "h")
    lasts = pd.Series(hours).groupby(rows["session"].astype(object).to_numpy(), sort=False).max()
    begins = np.r_[0.0, np.cumsum(lasts.to_numpy() + SESSION_GAP * lasts.sum())[:-1]]
    begun = rows["session"].astype(object).map(dict(zip(lasts.index, begins, strict=True)))
    return hours + begun.to_numpy(float)


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


MAX_POINTS = 500  # a panel
LIMIT_QUANTILE, LIMIT_ZOOM = 0.98, 1.35
ENVELOPE_COLOUR = "#dcdcd8"
Z_95 = 1.96
N_COLUMNS = 4  # panels side by side
MIN_LIMIT = 0.01  # %: a law with as many parameters as traverses leaves nothing
MAX_LIMIT_RATIO = 3.0  # times what is left: the scale cuts what was there before
TRAVERSE_LABEL = "traverse"
BEFORE_LABEL = "the traverse before (%)"


def finding_picture(
    finding: Finding, found: SelectedCause, shape: Array, shown: ResidualComparison
) -> Picture:
    """What one finding explains, before and after, over the quantity that carries it.

    Parameters
    ----------
    finding : Finding
    found : Found
        The same in the search; not of misfires, which have no shape.
    shape : array, shape (n,)
        What it does to each row, in any unit.
    shown : Shown
    """
    is_named = found.version is not None
    title = f"{finding.cause}: what is left over{' before and after' if is_named else ''}"
    key = "finding-" + "".join(letter if letter.isalnum() else "-" for letter in finding.cause)
    where, figure = draw_finding(finding, found, shape, shown)
    return make_picture(key, title, _write_caption(where, is_named, shown), figure)


def draw_finding(
    finding: Finding, found: SelectedCause, shape: Array, shown: ResidualComparison
) -> tuple[str, Figure]:
    """Joints side by side, before above after; what carries the finding, and the figure."""
    joints = [joint for joint in finding.joints if (shown.rows["joint"] == joint).any()]
    subset = shown.rows["joint"].isin(joints).to_numpy()
    label, values = fold_phase(finding.carrier, shown.rows, shape) or _find_carrier_values(
        found, shape, shown, subset
    )
    sides = [("after", shown.after, shown.null_after)]
    if found.version is not None:
        sides.insert(0, ("before", shown.before, shown.null_before))
    with report_style():
        figure, axes = make_figure([1.5] * len(sides), len(joints), top=LEGEND_LINE + TITLE_LINE + 0.14)
        limit = _compute_limit(np.concatenate([side for _, side, _ in sides]))
        masks = [(shown.rows["joint"] == joint).to_numpy() & np.isfinite(values) for joint in joints]
        for column, (joint, subset) in enumerate(zip(joints, masks, strict=True)):
            axes[0, column].set_title(joint_name(joint))
            axes[-1, column].set_xlabel(label)
            _set_ticks(axes[-1, column], label, values[subset], 7 if len(joints) < 3 else 4)
            for axis, (_, residual, chance) in zip(axes[:, column], sides, strict=True):
                limit = max(limit, 1.1 * _draw_bin_means(axis, values, residual, chance, subset, shown))
        for axes_of_joint, subset in zip(axes.T, masks, strict=True):
            for axis, (_, residual, _) in zip(axes_of_joint, sides, strict=True):
                _draw_points(axis, values, residual, subset, limit, shown)
        for axis, (name, _, _) in zip(axes[:, 0], sides, strict=True):
            axis.set_ylim(-limit, limit)
            axis.set_ylabel(f"{name + ': ' if len(sides) > 1 else ''}count less law (%)")
        add_legend(figure, _legend_entries())
    return label, figure


def _find_carrier_values(
    found: SelectedCause, shape: Array, shown: ResidualComparison, subset: BoolArray
) -> tuple[str, Array]:
    """The quantity that carries a finding: its label and values."""
    assert found.misfit is not None
    best = found.misfit.best_hypothesis(found.cause)
    if isinstance(best, AR1):
        return BEFORE_LABEL, np.where(best.before >= 0, 100 * shown.after[best.before], np.nan)
    columns = _select_covariates(shown, subset)
    own = [find_label(column) for column in getattr(found.version, "columns", ())]
    columns = {label: columns[label] for label in own if label in columns} | columns
    groups = 2 * shown.rows["joint"].to_numpy() + (shown.rows["direction"] == "-").to_numpy()
    label = find_carrier(
        shape[subset], {name: values[subset] for name, values in columns.items()}, groups[subset]
    )
    return label, columns[label]


def residuals_overview_picture(joint: int, shown: ResidualComparison) -> Picture:
    """What is left of a joint's counts against all that varied."""
    found = bool(np.any(shown.before != shown.after))
    key, title = f"everything-{joint}", f"What is left against everything, {joint_name(joint)}"
    if not _select_covariates(shown, (shown.rows["joint"] == joint).to_numpy()):
        return make_missing_picture(key, title, "It would need a second traverse.")
    rms = percent(float(np.sqrt(np.mean(shown.after[(shown.rows["joint"] == joint).to_numpy()] ** 2))))
    before = " Dotted: the means under the published law." if found else ""
    caption = (
        f"Means of the counts less the law{' with all that was found in it' if found else ''}, by classes "
        f"of each quantity; {rms} rms. Grey: where all means of a panel lie in 95 of 100 logs in which "
        f"nothing is wrong.{before}"
    )
    return make_picture(key, title, caption, draw_residuals_overview(joint, shown))


def draw_residuals_overview(joint: int, shown: ResidualComparison) -> Figure:
    """A panel for each quantity."""
    subset = (shown.rows["joint"] == joint).to_numpy()
    columns = _select_covariates(shown, subset)
    rows = -(-len(columns) // N_COLUMNS)
    with report_style():
        figure, axes = make_figure(
            [1.15] * rows, N_COLUMNS, top=LEGEND_LINE + 0.12, down=0.55, share_x="none", share_y="all"
        )
        reach, before = 0.0, 0.0
        for axis, (label, values) in zip(axes.ravel(), columns.items(), strict=False):
            kept = subset & np.isfinite(values)
            reach = max(reach, _draw_bin_means(axis, values, shown.after, shown.null_after, kept, shown))
            if np.any(shown.before != shown.after):
                before = max(before, _draw_baseline_means(axis, values, kept, shown))
            axis.set_xlabel(label)
            _set_ticks(axis, label, values[kept], 4)
        for axis in axes.ravel()[len(columns) :]:
            axis.set_axis_off()
        limit = 1.1 * max(reach, min(before, MAX_LIMIT_RATIO * reach), MIN_LIMIT)
        axes[0, 0].set_ylim(-limit, limit)
        for axis in axes[:, 0]:
            axis.set_ylabel("count less law (%)")
        add_legend(figure, [each for each in _legend_entries() if each.get_label() != TRAVERSE_LABEL])
    return figure


def _legend_entries() -> list[Line2D]:
    means = [
        make_legend_entry(f"mean, direction {way(sign)}", colour, marker="o", line="-")
        for sign, colour in DIRECTION_COLOURS.items()
    ]
    band = make_legend_entry("95 % of logs with nothing wrong", ENVELOPE_COLOUR, line="-")
    band.set_linewidth(6)
    return [make_legend_entry(TRAVERSE_LABEL, GREY, marker="."), *means, band]


def _draw_points(
    axis: Axes, values: Array, residual: Array, subset: BoolArray, limit: float, shown: ResidualComparison
) -> None:
    for sign, colour in DIRECTION_COLOURS.items():
        rows = np.flatnonzero(subset & (shown.rows["direction"] == sign).to_numpy())
        if len(rows) > MAX_POINTS:
            rows = np.sort(np.random.default_rng(0).choice(rows, MAX_POINTS, replace=False))
        y = np.clip(100 * residual[rows], -limit, limit)
        (points,) = axis.plot(values[rows], y, ls="", marker="o", ms=1.8, mew=0, alpha=0.35, color=colour)
        name_traverses(points, shown.rows.index[rows])


def _draw_bin_means(
    axis: Axes, values: Array, residual: Array, chance: Array, subset: BoolArray, shown: ResidualComparison
) -> float:
    """Means by class with their errors over the envelope; how far up any of it reaches, %."""
    place = bin_values(np.where(subset, values, np.nan))
    axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
    reach, bands = 0.0, []
    for sign, colour in DIRECTION_COLOURS.items():
        rows = subset & (shown.rows["direction"] == sign).to_numpy()
        if not rows.any():
            continue
        found = bin_residuals(residual, chance, values, place, rows)
        axis.errorbar(
            found.place, 100 * found.mean, yerr=100 * Z_95 * found.error, color=colour, marker="o",
            ms=3.0, lw=0.9, elinewidth=0.8,
        )  # fmt: skip
        bands.append((found.place, 100 * found.envelope))
        reach = max(reach, float(np.max(100 * np.maximum(np.abs(found.mean), found.envelope))))
    for x, band in bands:
        axis.fill_between(x, -band, band, color=ENVELOPE_COLOUR, lw=0, zorder=0.5)
    return reach


def _draw_baseline_means(axis: Axes, values: Array, subset: BoolArray, shown: ResidualComparison) -> float:
    """Means by class under the published law; how far up they reach, %."""
    place, reach = bin_values(np.where(subset, values, np.nan)), 0.0
    for sign, colour in DIRECTION_COLOURS.items():
        rows = subset & (shown.rows["direction"] == sign).to_numpy()
        if rows.any():
            found = bin_residuals(shown.before, shown.null_before, values, place, rows)
            axis.plot(found.place, 100 * found.mean, color=colour, ls=":", lw=0.9)
            reach = max(reach, float(np.max(100 * np.abs(found.mean))))
    return reach


def _write_caption(where: str, is_named: bool, shown: ResidualComparison) -> str:
    before, after = (percent(float(np.sqrt(np.mean(side**2)))) for side in (shown.before, shown.after))
    seen = f"Over {where}, which carries it. Points: traverses; lines: means by class with 95 % bars. "
    if is_named:
        return (
            f"{seen}Above under the published law ({before} rms), below with all that was found in it "
            f"({after} rms): the lines should lie within the grey band, where noise alone would keep them."
        )
    return f"{seen}{after} rms; noise alone would keep the lines within the grey band."


def _compute_limit(residual: Array) -> float:
    sizes = 100 * np.abs(residual)
    return max(min(1.05 * float(sizes.max()), LIMIT_ZOOM * float(np.quantile(sizes, LIMIT_QUANTILE))), 0.05)


def _select_covariates(shown: ResidualComparison, subset: BoolArray) -> dict[str, Array]:
    """What varied among some of the rows."""
    there = collect_covariates(shown.rows[subset])
    return {label: values for label, values in collect_covariates(shown.rows).items() if label in there}


def _set_ticks(axis: Axes, label: str, values: Array, most: int) -> None:
    if "°)" in label:
        set_angle_ticks(axis, float(values.min()), float(values.max()), most)
    else:
        axis.locator_params(axis="x", nbins=most)
