"""Errors on held-out traverses by session, before and after the law is extended."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import pluralize as count
from stickslip_fit.diagnose.diagnosis import Diagnosis, Gain
from stickslip_fit.diagnose.telling.show import shape_of, shown
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.evidence import draw_finding
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    BLUE,
    GREY,
    INK,
    LEGEND_LINE,
    VERMILLION,
    canvas,
    key_line,
    legend,
    look,
)

MOST_SESSIONS = 30
CROWDED, LABELS = 6, 12  # session names: side by side; and that there is room for
FLOOR = "repeatability and rounding"


def gain_picture(diagnosis: Diagnosis) -> Picture:
    """What the extended law gains in each session."""
    key, title, gain = "gain", "Errors on held-out traverses, by session", diagnosis.gain
    if gain is None or gain.by_session.empty or not diagnosis.findings:
        return not_drawn(key, title, "It would need a named cause, and traverses beside those that fit it.")
    sessions = len(gain.by_session)
    caption = f"The latest {MOST_SESSIONS} of {count(sessions, 'session')}. " * (sessions > MOST_SESSIONS)
    caption += (
        "Each traverse predicted by laws to which it contributed nothing, the search for causes "
        f"included: {percent(gain.baseline)} rms by the published law, {percent(gain.extended)} by the "
        f"extended one, over all sessions. No law can be better than the line, {percent(gain.noise_floor)}."
    )
    return picture(key, title, caption, draw_gain(gain))


def plot_gain(diagnosis: Diagnosis) -> Figure:
    """The chart by itself.

    Raises
    ------
    InputError
        If nothing was named, so that nothing was gained.
    """
    if diagnosis.gain is None or diagnosis.gain.by_session.empty:
        raise InputError("there is no gain to draw: no cause was named, or no traverse could be held out")
    return on_white(draw_gain(diagnosis.gain))


def draw_gain(gain: Gain) -> Figure:
    """A pair of points for each session."""
    shown = gain.by_session.tail(MOST_SESSIONS)
    place, crowded = np.arange(len(shown)), len(shown) > CROWDED
    before, after = (100 * shown[name].to_numpy(float) for name in ("baseline", "extended"))
    with look():
        figure, axes = canvas([1.6], 1, top=LEGEND_LINE + 0.12, bottom=0.9 if crowded else 0.3)
        axis = axes[0, 0]
        axis.vlines(place, after, before, color=GREY, lw=0.9)
        axis.plot(place, before, ls="", marker="s", ms=4.5, color=VERMILLION)
        axis.plot(place, after, ls="", marker="o", ms=4.5, color=BLUE)
        axis.axhline(100 * gain.noise_floor, color=INK, lw=0.8, ls="--")
        every = -(-len(shown) // LABELS)
        names = [shorten(str(name), 14) for name in shown["session"]]
        axis.set_xticks(place[::every], names[::every], rotation=90 if crowded else 0)
        axis.set_xlim(-0.5, len(shown) - 0.5)
        axis.set_ylim(0.0, 1.1 * max(float(before.max()), float(after.max())))
        axis.set_ylabel("rms error (%)")
        axis.grid(visible=False, axis="x")
        entries = [
            key_line("published law", VERMILLION, marker="s"),
            key_line("extended law", BLUE, marker="o"),
            key_line(FLOOR, INK, line="--"),
        ]
        legend(figure, entries)
    return figure


def plot_residuals(diagnosis: Diagnosis, finding: int) -> Figure:
    """One finding's residuals before and after.

    Raises
    ------
    InputError
        If there is no such finding, or it has no shape.
    """
    found = {each.cause: each for each in diagnosis.search.found}
    if not 0 <= finding < len(diagnosis.findings):
        raise InputError(f"there is no finding {finding}: this diagnosis has {len(diagnosis.findings)}")
    chosen = diagnosis.findings[finding]
    if found[chosen.cause].misfit is None:
        raise InputError("misfires have no shape to draw; the finding's `traverses` are those counts")
    shape = shape_of(found[chosen.cause], diagnosis.search.bench.study())
    left = shown(diagnosis.search, diagnosis.seed)
    return on_white(draw_finding(chosen, found[chosen.cause], shape, left)[1])
