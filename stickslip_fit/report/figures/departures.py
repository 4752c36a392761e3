"""What the fitted law leaves over, against everything that varied: structure here is what the law lacks."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import joint_name
from stickslip_fit._format import pluralize as count
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    INK,
    LEGEND_LINE,
    angle_ticks,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.report.figures.svg import name_traverses
from stickslip_fit.report.figures.sweep_picture import direction_kinds
from stickslip_fit.report.figures.traverses import thinned
from stickslip_fit.units import from_si

POINTS = 900
QUANTILE, ZOOM = 0.98, 1.6


def departures_picture(rows: pd.DataFrame) -> Picture:
    """All traverses of a joint, by how far they are from the least-squares law."""
    joint = int(rows["joint"].iloc[0])
    key, title = f"departures-{joint}", f"What the law leaves over, {joint_name(joint)}"
    if not _quantities(rows):
        return not_drawn(key, title, "It would need a second traverse.")
    shown = thinned(rows, POINTS)
    of_all = "" if len(shown) == len(rows) else f" of {len(rows):,}, chosen at random"
    limit = _limit(rows)
    beyond = int((shown["departure"].abs() > limit).sum())
    caption = (
        f"{count(len(shown), 'traverse')}{of_all}, seen less law: a law that lacks nothing leaves a level "
        f"band in every panel. Half of them are within {percent(float(rows['departure'].abs().median()))} of "
        "the law." + (f" {count(beyond, 'point')} beyond the scale, drawn at its edge." if beyond else "")
    )
    return picture(key, title, caption, draw_departures(shown, limit))


def draw_departures(rows: pd.DataFrame, limit: float) -> Figure:
    """One panel for each quantity that varied."""
    joint = int(rows["joint"].iloc[0])
    quantities = _quantities(rows)
    with look():
        entries = [key_line(kind.label, kind.colour, marker="o") for kind in direction_kinds(joint).values()]
        figure, axes = canvas([1.55], len(quantities), top=LEGEND_LINE + 0.12)
        axes[0, 0].set_ylim(-100 * limit, 100 * limit)
        axes[0, 0].set_ylabel("seen less law (%)")
        for axis, (label, x) in zip(axes[0], quantities.items(), strict=True):
            axis.axhline(0.0, color=INK, lw=0.7)
            for direction, colour in DIRECTION_COLOURS.items():
                mine = (rows["direction"] == direction).to_numpy()
                y = 100 * np.clip(rows["departure"].to_numpy()[mine], -limit, limit)
                (points,) = axis.plot(x[mine], y, ls="", marker="o", ms=2.0, mew=0, alpha=0.6, color=colour)
                name_traverses(points, rows.index[mine])
            axis.set_xlabel(label)
            if "°" in label:
                angle_ticks(axis, np.nanmin(x), np.nanmax(x), 3 if len(quantities) > 5 else 4)
        legend(figure, entries)
    return figure


def _quantities(rows: pd.DataFrame) -> dict[str, np.ndarray]:
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


def _limit(rows: pd.DataFrame) -> float:
    sizes = rows["departure"].abs().dropna()
    return max(1.05 * min(float(sizes.max()), ZOOM * float(sizes.quantile(QUANTILE))), 1e-4)
