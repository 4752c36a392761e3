"""Residuals against what matters to each finding, before and after; and against everything."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import joint_name
from stickslip_fit.diagnose.diagnosis import Finding
from stickslip_fit.diagnose.searching.search import Found
from stickslip_fit.diagnose.shapes.memory import Memory
from stickslip_fit.diagnose.telling.show import Shown, by_class, carrier, classes_of
from stickslip_fit.report.figures.folded import folded
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    GREY,
    INK,
    LEGEND_LINE,
    TITLE_LINE,
    angle_ticks,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.report.figures.svg import name_traverses
from stickslip_fit.report.quantities import label_of, quantities

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

POINTS = 500  # a panel
QUANTILE, ZOOM = 0.98, 1.35
BAND = "#dcdcd8"
TWO_SIDED = 1.96
ACROSS = 4  # panels side by side
SMALLEST = 0.01  # %: a law with as many parameters as traverses leaves nothing
FURTHEST = 3.0  # times what is left: the scale cuts what was there before
POINT = "traverse"
BEFORE = "the traverse before (%)"


def finding_picture(finding: Finding, found: Found, shape: Array, shown: Shown) -> Picture:
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
    return picture(key, title, _caption(where, is_named, shown), figure)


def draw_finding(finding: Finding, found: Found, shape: Array, shown: Shown) -> tuple[str, Figure]:
    """Joints side by side, before above after; what carries the finding, and the figure."""
    joints = [joint for joint in finding.joints if (shown.rows["joint"] == joint).any()]
    mine = shown.rows["joint"].isin(joints).to_numpy()
    label, values = folded(finding.carrier, shown.rows, shape) or _along(found, shape, shown, mine)
    sides = [("after", shown.after, shown.chance_after)]
    if found.version is not None:
        sides.insert(0, ("before", shown.before, shown.chance_before))
    with look():
        figure, axes = canvas([1.5] * len(sides), len(joints), top=LEGEND_LINE + TITLE_LINE + 0.14)
        limit = _limit(np.concatenate([side for _, side, _ in sides]))
        masks = [(shown.rows["joint"] == joint).to_numpy() & np.isfinite(values) for joint in joints]
        for column, (joint, mine) in enumerate(zip(joints, masks, strict=True)):
            axes[0, column].set_title(joint_name(joint))
            axes[-1, column].set_xlabel(label)
            _ticks(axes[-1, column], label, values[mine], 7 if len(joints) < 3 else 4)
            for axis, (_, residual, chance) in zip(axes[:, column], sides, strict=True):
                limit = max(limit, 1.1 * _means(axis, values, residual, chance, mine, shown))
        for axes_of_joint, mine in zip(axes.T, masks, strict=True):
            for axis, (_, residual, _) in zip(axes_of_joint, sides, strict=True):
                _points(axis, values, residual, mine, limit, shown)
        for axis, (name, _, _) in zip(axes[:, 0], sides, strict=True):
            axis.set_ylim(-limit, limit)
            axis.set_ylabel(f"{name + ': ' if len(sides) > 1 else ''}count less law (%)")
        legend(figure, _entries())
    return label, figure


def _along(found: Found, shape: Array, shown: Shown, mine: Mask) -> tuple[str, Array]:
    """The quantity that carries a finding: its label and values."""
    assert found.misfit is not None
    best = found.misfit.best_of(found.cause)
    if isinstance(best, Memory):
        return BEFORE, np.where(best.before >= 0, 100 * shown.after[best.before], np.nan)
    columns = _columns(shown, mine)
    own = [label_of(column) for column in getattr(found.version, "columns", ())]
    columns = {label: columns[label] for label in own if label in columns} | columns
    groups = 2 * shown.rows["joint"].to_numpy() + (shown.rows["direction"] == "-").to_numpy()
    label = carrier(shape[mine], {name: values[mine] for name, values in columns.items()}, groups[mine])
    return label, columns[label]


def everything_picture(joint: int, shown: Shown) -> Picture:
    """What is left of a joint's counts against all that varied."""
    found = bool(np.any(shown.before != shown.after))
    key, title = f"everything-{joint}", f"What is left against everything, {joint_name(joint)}"
    if not _columns(shown, (shown.rows["joint"] == joint).to_numpy()):
        return not_drawn(key, title, "It would need a second traverse.")
    rms = percent(float(np.sqrt(np.mean(shown.after[(shown.rows["joint"] == joint).to_numpy()] ** 2))))
    before = " Dotted: the means under the published law." if found else ""
    caption = (
        f"Means of the counts less the law{' with all that was found in it' if found else ''}, by classes "
        f"of each quantity; {rms} rms. Grey: where all means of a panel lie in 95 of 100 logs in which "
        f"nothing is wrong.{before}"
    )
    return picture(key, title, caption, draw_everything(joint, shown))


def draw_everything(joint: int, shown: Shown) -> Figure:
    """A panel for each quantity."""
    mine = (shown.rows["joint"] == joint).to_numpy()
    columns = _columns(shown, mine)
    rows = -(-len(columns) // ACROSS)
    with look():
        figure, axes = canvas(
            [1.15] * rows, ACROSS, top=LEGEND_LINE + 0.12, down=0.55, share_x="none", share_y="all"
        )
        reach, before = 0.0, 0.0
        for axis, (label, values) in zip(axes.ravel(), columns.items(), strict=False):
            kept = mine & np.isfinite(values)
            reach = max(reach, _means(axis, values, shown.after, shown.chance_after, kept, shown))
            if np.any(shown.before != shown.after):
                before = max(before, _dotted(axis, values, kept, shown))
            axis.set_xlabel(label)
            _ticks(axis, label, values[kept], 4)
        for axis in axes.ravel()[len(columns) :]:
            axis.set_axis_off()
        limit = 1.1 * max(reach, min(before, FURTHEST * reach), SMALLEST)
        axes[0, 0].set_ylim(-limit, limit)
        for axis in axes[:, 0]:
            axis.set_ylabel("count less law (%)")
        legend(figure, [each for each in _entries() if each.get_label() != POINT])
    return figure


def _entries() -> list[Line2D]:
    means = [
        key_line(f"mean, direction {way(sign)}", colour, marker="o", line="-")
        for sign, colour in DIRECTION_COLOURS.items()
    ]
    band = key_line("95 % of logs with nothing wrong", BAND, line="-")
    band.set_linewidth(6)
    return [key_line(POINT, GREY, marker="."), *means, band]


def _points(axis: Axes, values: Array, residual: Array, mine: Mask, limit: float, shown: Shown) -> None:
    for sign, colour in DIRECTION_COLOURS.items():
        rows = np.flatnonzero(mine & (shown.rows["direction"] == sign).to_numpy())
        if len(rows) > POINTS:
            rows = np.sort(np.random.default_rng(0).choice(rows, POINTS, replace=False))
        y = np.clip(100 * residual[rows], -limit, limit)
        (points,) = axis.plot(values[rows], y, ls="", marker="o", ms=1.8, mew=0, alpha=0.35, color=colour)
        name_traverses(points, shown.rows.index[rows])


def _means(axis: Axes, values: Array, residual: Array, chance: Array, mine: Mask, shown: Shown) -> float:
    """Means by class with their errors over the envelope; how far up any of it reaches, %."""
    place = classes_of(np.where(mine, values, np.nan))
    axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
    reach, bands = 0.0, []
    for sign, colour in DIRECTION_COLOURS.items():
        rows = mine & (shown.rows["direction"] == sign).to_numpy()
        if not rows.any():
            continue
        found = by_class(residual, chance, values, place, rows)
        axis.errorbar(
            found.place, 100 * found.mean, yerr=100 * TWO_SIDED * found.error, color=colour, marker="o",
            ms=3.0, lw=0.9, elinewidth=0.8,
        )  # fmt: skip
        bands.append((found.place, 100 * found.envelope))
        reach = max(reach, float(np.max(100 * np.maximum(np.abs(found.mean), found.envelope))))
    for x, band in bands:
        axis.fill_between(x, -band, band, color=BAND, lw=0, zorder=0.5)
    return reach


def _dotted(axis: Axes, values: Array, mine: Mask, shown: Shown) -> float:
    """Means by class under the published law; how far up they reach, %."""
    place, reach = classes_of(np.where(mine, values, np.nan)), 0.0
    for sign, colour in DIRECTION_COLOURS.items():
        rows = mine & (shown.rows["direction"] == sign).to_numpy()
        if rows.any():
            found = by_class(shown.before, shown.chance_before, values, place, rows)
            axis.plot(found.place, 100 * found.mean, color=colour, ls=":", lw=0.9)
            reach = max(reach, float(np.max(100 * np.abs(found.mean))))
    return reach


def _caption(where: str, is_named: bool, shown: Shown) -> str:
    before, after = (percent(float(np.sqrt(np.mean(side**2)))) for side in (shown.before, shown.after))
    seen = f"Over {where}, which carries it. Points: traverses; lines: means by class with 95 % bars. "
    if is_named:
        return (
            f"{seen}Above under the published law ({before} rms), below with all that was found in it "
            f"({after} rms): the lines should lie within the grey band, where noise alone would keep them."
        )
    return f"{seen}{after} rms; noise alone would keep the lines within the grey band."


def _limit(residual: Array) -> float:
    sizes = 100 * np.abs(residual)
    return max(min(1.05 * float(sizes.max()), ZOOM * float(np.quantile(sizes, QUANTILE))), 0.05)


def _columns(shown: Shown, mine: Mask) -> dict[str, Array]:
    """What varied among some of the rows."""
    there = quantities(shown.rows[mine])
    return {label: values for label, values in quantities(shown.rows).items() if label in there}


def _ticks(axis: Axes, label: str, values: Array, most: int) -> None:
    if "°)" in label:
        angle_ticks(axis, float(values.min()), float(values.max()), most)
    else:
        axis.locator_params(axis="x", nbins=most)
