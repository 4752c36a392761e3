"""Figures of accuracy: held-out errors, worst configurations, load coefficients of joint 2, the tip's error.

Load coefficients after Figs. 6.2, 6.6 and 6.7 of the thesis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stickslip_fit._format import (
    format_configuration,
    format_direction,
    format_percent,
    joint_name,
    pluralize,
)
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.result import choose_repeatability
from stickslip_fit.laws import Elbow
from stickslip_fit.machine import Machine
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    INK,
    LETTER_WIDTH,
    MARKERS,
    TITLE_LINE,
    LineStyle,
    direction_entries,
    direction_styles,
    make_figure,
    make_legend_entry,
    report_style,
    robust_limit,
    select_recent,
    set_log_axis,
    sweep_entries,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture, name_traverses
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.moves import AccuracyMap

MAX_CURVE_POINTS = 300
MIN_ERROR = 0.02  # %


def errors_picture(errors: pd.DataFrame, calibration: Result, fit: Result) -> Picture:
    """Share of traverses that each model predicts to better than x."""
    key, title = "errors", "Error of a traverse not calibrated on: the law against a constant step"
    if errors.empty:
        return make_missing_picture(
            key, title, "It would need traverses beside those that the calibration uses."
        )
    joints = sorted(errors["joint"].unique())
    quantiles = [
        f"{joint_name(joint, fit.machine)}: {_format_quantile(errors, joint, 'law')} by the law, "
        f"{_format_quantile(errors, joint, 'constant')} by the constant step"
        for joint in joints
    ]
    caption = (
        f"{pluralize(len(errors), 'traverse')}. The further left, the better. Nine traverses in ten are "
        f"predicted to within: {'; '.join(quantiles)}. Dotted: replicate scatter; residual scatter for want "
        "of replicates."
    )
    noise = {
        (joint, sign): choose_repeatability(joint, sign, calibration, fit).value
        for joint in joints
        for sign in ("+", "-")
    }
    return make_picture(key, title, caption, draw_errors(errors, noise, fit.machine))


def draw_errors(errors: pd.DataFrame, noise: dict[tuple[int, str], float], machine: Machine) -> Figure:
    """One panel for each joint; `noise`, the replicate scatter, dotted where it is known."""
    joints = sorted(errors["joint"].unique())
    with report_style():
        legend = [
            *direction_entries(line="-"),
            make_legend_entry("law", INK, line="-"),
            make_legend_entry("constant step", INK, line="--"),
            *([make_legend_entry("replicate scatter", INK, line=":")] if noise else []),
        ]
        figure, axes = make_figure([1.8], len(joints), legend, top=TITLE_LINE + 0.14, bottom=0.5)
        for axis, joint in zip(axes[0], joints, strict=True):
            axis.set_title(joint_name(joint, machine))
            _draw_shares(axis, errors[errors["joint"] == joint], noise)
        axes[0, 0].set_ylabel("traverses predicted better (%)")
        figure.supxlabel("error of the mean step size (%)", y=0.02, va="bottom", size=8, color=INK)
    return figure


def _draw_shares(axis: Axes, errors: pd.DataFrame, noise: dict[tuple[int, str], float]) -> None:
    """One joint's share of traverses that each model predicts to better than x, and its repeatability."""
    for direction, colour in DIRECTION_COLOURS.items():
        subset = errors[errors["direction"] == direction]
        for model, line in (("law", "-"), ("constant", "--")):
            axis.step(*_cumulative_shares(subset, model), where="post", color=colour, ls=line)
        floor = noise.get((int(errors["joint"].iloc[0]), direction), np.nan)
        if np.isfinite(floor):
            axis.axvline(100 * floor, color=colour, ls=":", lw=1.0)
    set_log_axis(axis.xaxis, ticks=(0.1, 1, 10, 100))
    axis.set_xlim(MIN_ERROR, 250)
    axis.set_ylim(0, 101)


MAX_RESIDUALS = 600  # points of a joint and direction
RESIDUAL_QUANTILE, RESIDUAL_ZOOM = 0.98, 1.6  # of the scale, see `robust_limit`


def overview_picture(
    traverses: pd.DataFrame, errors: pd.DataFrame, calibration: Result, fit: Result
) -> Picture:
    """Residuals of the law, above how well its calibration predicts.

    Parameters
    ----------
    traverses : DataFrame
        All joints' rows as of `collect_traverses`, indexed by the log's usable traverses.
    errors : DataFrame
        As of `held_out_errors`; may be empty.
    """
    rms = float(np.sqrt(np.nanmean(traverses["departure"].to_numpy() ** 2)))
    caption = (
        f"Above: {pluralize(len(traverses), 'traverse')} by how far they are from the law fitted to all "
        f"of them ({format_percent(rms)} rms); a level band is a law that lacks nothing."
    )
    if len(errors):
        caption += (
            f" Below: {pluralize(len(errors), 'traverse')} that the calibration did not use, by how well it "
            "predicts them; the further left, the better. Dotted: replicate scatter; residual scatter for "
            "want of replicates."
        )
    title = (
        "Residuals of the law, and how well its calibration predicts"
        if len(errors)
        else "Residuals of the law"
    )
    return make_picture("overview", title, caption, draw_overview(traverses, errors, calibration, fit))


def draw_overview(traverses: pd.DataFrame, errors: pd.DataFrame, calibration: Result, fit: Result) -> Figure:
    """A column for each joint: residuals in order of the log, and below the errors of the calibration."""
    joints = sorted(int(joint) for joint in traverses["joint"].unique())
    sizes = traverses["departure"].abs().dropna().to_numpy()
    limit = max(robust_limit(sizes, RESIDUAL_QUANTILE, RESIDUAL_ZOOM), 1e-4) if len(sizes) else 1e-4
    heights = [1.5, 1.5] if len(errors) else [1.5]
    with report_style():
        legend = direction_entries(marker="o")
        if len(errors):
            legend += [make_legend_entry(label, INK, line=line) for label, line in _MODEL_LINES]
        figure, axes = make_figure(
            heights, len(joints), legend, top=TITLE_LINE + 0.14, down=0.5, share_x="none", share_y="row"
        )
        for column, joint in zip(axes.T, joints, strict=True):
            column[0].set_title(joint_name(joint, fit.machine))
            _draw_residuals(column[0], traverses[traverses["joint"] == joint], limit)
            subset = errors[errors["joint"] == joint]
            if len(subset):
                noise = {
                    (joint, sign): choose_repeatability(joint, sign, calibration, fit).value for sign in "+-"
                }
                _draw_shares(column[1], subset, noise)
                column[1].set_xlabel("error of the mean step size (%)")
            elif len(errors):
                column[1].set_axis_off()
        axes[0, 0].set_ylabel("residual (%)")
        if len(errors):
            axes[1, 0].set_ylabel("predicted better (%)")
    return figure


_MODEL_LINES: tuple[tuple[str, LineStyle], ...] = (
    ("law", "-"),
    ("constant step", "--"),
    ("replicate scatter", ":"),
)


def _draw_residuals(axis: Axes, rows: pd.DataFrame, limit: float) -> None:
    """One joint's residuals in order of the log; what is beyond the scale lies at its edge."""
    axis.axhline(0.0, color=INK, lw=0.7)
    for sign, colour in DIRECTION_COLOURS.items():
        own = thin_rows(rows[(rows["direction"] == sign) & rows["departure"].notna()], MAX_RESIDUALS)
        y = 100 * np.clip(own["departure"].to_numpy(), -limit, limit)
        (points,) = axis.plot(own.index + 1, y, ls="", marker="o", ms=2.0, mew=0, alpha=0.6, color=colour)
        name_traverses(points, own.index)
    axis.set_ylim(-100 * limit, 100 * limit)
    axis.set_xlabel("traverse, in order of the log")


def _sort_relative_errors(errors: pd.DataFrame, model: str) -> np.ndarray:
    return np.sort(np.abs(errors[model] / errors["measured"] - 1.0).to_numpy())


def _format_quantile(errors: pd.DataFrame, joint: int, model: str) -> str:
    return format_percent(
        float(np.quantile(_sort_relative_errors(errors[errors["joint"] == joint], model), 0.9))
    )


def _cumulative_shares(errors: pd.DataFrame, model: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors (%) and the share of traverses (%) within each, at as many points as a curve needs."""
    sizes = np.maximum(100 * _sort_relative_errors(errors, model), MIN_ERROR)
    share = 100 * np.arange(1, len(sizes) + 1) / len(sizes) if len(sizes) else sizes
    keep = np.unique(np.linspace(0, len(sizes) - 1, min(len(sizes), MAX_CURVE_POINTS)).round().astype(int))
    return sizes[keep], share[keep]


MAX_CONFIGURATIONS = 12


def configurations_picture(summary: pd.DataFrame, machine: Machine) -> Picture:
    """The configurations in which the law is worst.

    Parameters
    ----------
    summary : DataFrame
        As `estimation.summarize_errors` returns it for one joint, by direction and configuration.
    """
    joint = int(summary["joint"].iloc[0])
    worst = summary.sort_values("law_rms_relative", ascending=False).head(MAX_CONFIGURATIONS)
    labels = [
        f"{format_configuration(row, machine)} ({format_direction(row['direction'])})"
        for row in worst.to_dict("records")
    ]
    first = worst.iloc[0]
    title = f"Error by configuration, worst first, {joint_name(joint, machine)}"
    caption = (
        f"The {len(worst)} of {len(summary):,} configurations and directions in which the law is furthest "
        f"off (rms over sessions and replicates). Worst: {format_percent(first['law_rms_relative'])} at "
        f"{labels[0]}; a constant step is off by {format_percent(first['constant_rms_relative'])} there."
    )
    return make_picture(f"configurations-{joint}", title, caption, draw_configurations(worst, labels))


def draw_configurations(summary: pd.DataFrame, labels: list[str]) -> Figure:
    """One line of dots for each row of the summary."""
    y = np.arange(len(summary))[::-1]
    law, constant = (
        np.maximum(100 * summary[f"{model}_rms_relative"].to_numpy(), MIN_ERROR)
        for model in ("law", "constant")
    )
    left = 0.2 + LETTER_WIDTH * max(map(len, labels))
    colours = [DIRECTION_COLOURS[sign] for sign in summary["direction"]]
    with report_style():
        legend = [
            *direction_entries(marker="o"),
            make_legend_entry("law", INK, marker="o"),
            make_legend_entry("constant step", INK, marker="o"),
        ]
        legend[-1].set_markerfacecolor("white")
        height = 0.19 * len(summary) + 0.1
        figure, axes = make_figure([height], 1, legend, left=left, top=0.1, bottom=0.42, right=0.15)
        axis = axes[0, 0]
        axis.hlines(y, law, constant, color="#cccccc", lw=1.0, zorder=1)
        axis.scatter(law, y, c=colours, s=18, zorder=2)
        axis.scatter(constant, y, facecolors="white", edgecolors=colours, s=18, linewidths=0.9, zorder=2)
        axis.set_yticks(y, labels)
        axis.set_ylim(-0.6, len(summary) - 0.4)
        set_log_axis(axis.xaxis, subs=(1.0, 2.0, 5.0))
        axis.set_xlabel("rms error of the mean step size (%)")
        axis.spines["left"].set_visible(False)
        axis.tick_params(axis="y", length=0)
        axis.grid(visible=False, axis="y")
    return figure


PICTURE_KEY, PICTURE_TITLE = "elbow-d", "Joint 2: gamma0 and d against q3, d in three ways"
METHOD_OFFSET = 0.25  # mm between sessions at the same q3


def load_coefficient_picture(table: pd.DataFrame, fit: Result) -> Picture:
    """Draw the table of `tabulate_load_coefficients`, or say what it lacks."""
    if table.empty:
        needed = "full traverses of joint 2 at psi = 0 with theta = −90° and with theta = 0, at the same q3"
        return make_missing_picture(PICTURE_KEY, PICTURE_TITLE, f"It would need {needed}.")
    recent = select_recent(table)
    worst_quadratic = from_si(float((table["quadratic"] - table["d"]).abs().max()), "µrad")
    worst_iteration = from_si(float((table["iteration_1"] - table["d"]).abs().max()), "µrad")
    caption = (
        f"{pluralize(len(recent), 'pair')} of full traverses with and without load, replicates averaged; "
        "bars: one standard error. Lines: the least-squares law, which has both linear in q3. Right: what "
        f"the thesis's shortcuts add to d; Eq. 6.6 is off by up to {worst_quadratic:.2g} µrad, the thesis's "
        f"iteration after one pass by up to {worst_iteration:.2g} µrad, solving the integral by nothing "
        "(grey bars: its error from the counts)."
    )
    return make_picture(PICTURE_KEY, PICTURE_TITLE, caption, draw_load_coefficients(recent, fit))


def draw_load_coefficients(table: pd.DataFrame, fit: Result) -> Figure:
    """gamma0, d, and the errors of the thesis's shortcuts side by side."""
    sessions = list(table["session"].unique())
    with report_style():
        legend = [
            *sweep_entries(direction_styles(2, fit.machine), sessions),
            make_legend_entry("Eq. 6.6", INK, marker="x"),
            make_legend_entry("iteration, one pass", INK, marker="+"),
        ]
        figure, axes = make_figure([2.1], 3, legend, top=0.3, across=0.55, share_y=False, left=0.5)
        for direction, colour in DIRECTION_COLOURS.items():
            for index, session in enumerate(sessions):
                subset = table[(table["session"] == session) & (table["direction"] == direction)]
                x = from_si(subset["q3"].to_numpy(), "mm") + METHOD_OFFSET * (index - (len(sessions) - 1) / 2)
                style: dict[str, Any] = {
                    "marker": MARKERS[index],
                    "color": colour,
                    "markerfacecolor": "white",
                    "ls": "",
                }
                _draw_error_bars(axes[0, 0], x, subset["gamma0"], subset["gamma0_error"], style)
                _draw_error_bars(axes[0, 1], x, subset["d"], subset["d_error"], style)
                _draw_shortcuts(axes[0, 2], x + (0.06 if direction == "+" else -0.06), subset, colour)
        _draw_law(axes[0, 0], axes[0, 1], sessions, fit)
        for axis, title in zip(
            axes[0], ("gamma0 (µrad)", "d (µrad)", "shortcut less exact d (µrad)"), strict=True
        ):
            axis.set_title(title)
            axis.set_xlabel("q3 (mm)")
        axes[0, 1].axhline(0.0, color=INK, lw=0.6)
        axes[0, 2].axhline(0.0, color=INK, lw=0.6)
    return figure


def _draw_error_bars(
    axes: Axes, x: np.ndarray, value: pd.Series, error: pd.Series, style: dict[str, Any]
) -> None:
    axes.errorbar(
        x,
        from_si(value.to_numpy(), "µrad"),
        yerr=from_si(np.nan_to_num(error.to_numpy()), "µrad"),
        elinewidth=0.7,
        markeredgewidth=0.8,
        **style,
    )


def _draw_shortcuts(axes: Axes, x: np.ndarray, table: pd.DataFrame, colour: str) -> None:
    error = from_si(np.nan_to_num(table["d_error"].to_numpy()), "µrad")
    axes.errorbar(x, np.zeros(len(x)), yerr=error, ls="", color="#d9d9d9", elinewidth=2.0, zorder=1)
    for column, marker in (("quadratic", "x"), ("iteration_1", "+")):
        off = from_si((table[column] - table["d"]).to_numpy(), "µrad")
        axes.plot(x, off, ls="", marker=marker, color=colour, ms=4.5, mew=1.0)


def _draw_law(left: Axes, right: Axes, sessions: list[str], fit: Result) -> None:
    elbow = fit.joints[Elbow.joint]
    law = Elbow(fit.machine)
    ends = np.array(fit.machine.ranges[3])
    for group in elbow.groups.itertuples():
        if group.session in sessions:
            gamma0, d = law.coefficients({"q3": ends}, elbow.values[group.Index, : len(law.parameters)])
            colour = DIRECTION_COLOURS[group.direction]
            left.plot(from_si(ends, "mm"), from_si(gamma0, "µrad"), color=colour, lw=0.8, zorder=1)
            right.plot(from_si(ends, "mm"), from_si(d, "µrad"), color=colour, lw=0.8, zorder=1)


def draw_accuracy_map(accuracy: AccuracyMap) -> Figure:
    """A panel with joint 1 at its stop, and one with it halfway between its stops."""
    panels = [("joint 1 at its stop", accuracy.error)]
    if np.isfinite(accuracy.error_far).any():
        panels.append(("joint 1 halfway", accuracy.error_far))
    radius, height = (from_si(values, "mm") for values in (accuracy.radius, accuracy.height))
    with report_style():
        figure, axes = make_figure([2.9], 2, top=TITLE_LINE + 0.14, right=0.6, across=1.05, share_y="none")
        for axis, (title, error) in zip(axes[0], panels, strict=False):
            size = from_si(error, "µm")
            mesh = axis.pcolormesh(
                radius, height, size, vmin=0.0, shading="gouraud", cmap="viridis_r", rasterized=True
            )
            axis.set_title(title)
            axis.set_xlabel("distance from joint 1's axis (mm)")
            axis.set_aspect("equal")
            axis.grid(visible=False)
            bar = figure.colorbar(mesh, ax=axis, fraction=0.05, pad=0.03)
            bar.set_label("95 % error of the tip (µm)")
        axes[0, 0].set_ylabel("height above joint 1 (mm)")
        for axis in axes[0, len(panels) :]:
            axis.set_axis_off()
    return figure
