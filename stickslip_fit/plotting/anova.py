"""Figures of the analysis of variance: readings by day, direction and rotation (Figs. 4.4, 4.6, 5.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import join_words as listed
from stickslip_fit._format import joint_name, step_unit, typeset_text
from stickslip_fit._format import pluralize as count
from stickslip_fit.anova import FactorTest
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    INK,
    TITLE_LINE,
    add_legend,
    make_figure,
    make_legend_entry,
    report_style,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_picture
from stickslip_fit.units import from_si

MAX_SESSIONS = 30
MAX_SESSION_LABELS = 12  # session names that an axis has room for
MAX_POINTS = 900
MAX_ACROSS = 6  # as many that it has room for side by side
FAN_HALF_WIDTH = 0.16  # how far beside its level's place a reading may be drawn


def factor_pictures(joint: int, answers: Sequence[FactorTest]) -> list[Picture]:
    """The figures that a joint's answers can fill."""
    pictures = {
        "day": _make_day_picture,
        "direction": _make_direction_picture,
        "normal-force": _make_normal_force_picture,
    }
    by_name = {name: _select_tests(joint, name, answers) for name in pictures}
    return [pictures[name](joint, subset) for name, subset in by_name.items() if subset]


def plot_factor(joint: int, factor: str, answers: Sequence[FactorTest]) -> Figure:
    """The readings of one joint by one factor.

    Raises
    ------
    InputError
        If that was not answered.
    """
    subset = _select_tests(joint, factor, answers)
    if not subset:
        known = sorted({(each.design.joint, each.design.analysis) for each in answers})
        said = listed([f"joint {number}'s {name}" for number, name in known]) or "nothing"
        raise InputError(f"{factor} was not answered for joint {joint}; what was: {said}")
    return _draw_factor(factor, subset)


def _select_tests(joint: int, factor: str, answers: Sequence[FactorTest]) -> list[FactorTest]:
    return [each for each in answers if each.design.analysis == factor and each.design.joint == joint]


def _draw_factor(factor: str, answers: Sequence[FactorTest]) -> Figure:
    if factor == "normal-force":
        return draw_rotations(_prefer_over_sessions(answers))
    draw = draw_days if factor == "day" else draw_directions
    return draw(answers, _list_sessions(answers)[-MAX_SESSIONS:])


def _prefer_over_sessions(answers: Sequence[FactorTest]) -> list[FactorTest]:
    """Those over all sessions, where there are any."""
    return [each for each in answers if each.design.session is None] or list(answers)


def _make_day_picture(joint: int, answers: Sequence[FactorTest]) -> Picture:
    sessions = _list_sessions(answers)
    caption = (
        f"{_describe_latest(sessions)}Points: single readings at {_describe_configuration(answers[0])}; bars: the session's mean with "
        "its 95 % interval, for the scatter of readings alone. Means further apart than their bars are days "
        "that differ."
    )
    title = f"Step size by day, {joint_name(joint)} (as Fig. 4.4 of the thesis)"
    return make_picture(f"day-{joint}", title, caption, _draw_factor("day", answers))


def _make_direction_picture(joint: int, answers: Sequence[FactorTest]) -> Picture:
    sessions = _list_sessions(answers)
    caption = (
        f"{_describe_latest(sessions)}Points: single readings at {_describe_configuration(answers[0])}; lines join the means of the "
        "two directions in a session. Lines of one slope are a difference that holds in every session."
    )
    title = f"Step size by direction, {joint_name(joint)} (as Fig. 4.6 of the thesis)"
    return make_picture(f"direction-{joint}", title, caption, _draw_factor("direction", answers))


def _make_normal_force_picture(joint: int, answers: Sequence[FactorTest]) -> Picture:
    over = _prefer_over_sessions(answers)
    rows = sum(len(each.design.readings) for each in over)
    caption = (
        f"{count(rows, 'reading')} at {_describe_configuration(over[0])}, each less the mean of its session; bars: the mean "
        "of each orientation with its 95 % interval. The load along the axis is the same in all of them, so "
        "that a level row says that the force across it does not matter."
    )
    title = f"Step size by rotation about the axis, {joint_name(joint)} (as Fig. 5.1 of the thesis)"
    return make_picture(f"normal-force-{joint}", title, caption, _draw_factor("normal-force", answers))


def draw_days(answers: Sequence[FactorTest], sessions: Sequence[str]) -> Figure:
    """One panel for each direction."""
    with report_style():
        figure, axes = make_figure(
            [1.5] * len(answers), 1, top=0.30, bottom=_label_height(sessions), share_y=False
        )
        for axis, answer in zip(axes[:, 0], answers, strict=True):
            sign = str(answer.design.direction)
            rows = answer.design.readings
            _draw_readings(
                axis, rows, _number_places(rows["session"], sessions), DIRECTION_COLOURS[sign], 0.0
            )
            _draw_means(
                axis, answer, [sessions.index(name) if name in sessions else -1 for name in answer.levels]
            )
            unit = step_unit(answer.design.joint)
            axis.set_ylabel(f"direction {way(sign)} ({unit})")
        _label_sessions(axes[-1, 0], sessions)
        add_legend(figure, _legend_entries(answers))
    return figure


def draw_directions(answers: Sequence[FactorTest], sessions: Sequence[str]) -> Figure:
    """Both directions of each session side by side."""
    rows = pd.concat([each.design.readings for each in answers]).drop_duplicates("time")
    unit = step_unit(answers[0].design.joint)
    with report_style():
        figure, axes = make_figure([1.9], 1, top=0.30, bottom=_label_height(sessions))
        axis = axes[0, 0]
        for sign, aside in (("+", -FAN_HALF_WIDTH), ("-", FAN_HALF_WIDTH)):
            subset = rows[rows["direction"] == sign]
            _draw_readings(
                axis, subset, _number_places(subset["session"], sessions), DIRECTION_COLOURS[sign], aside
            )
        means = rows.groupby(["session", "direction"])["step_size"].mean().unstack()
        for place, name in enumerate(sessions):
            pair = from_si(means.loc[name, ["+", "-"]].to_numpy(float), unit)
            axis.plot(
                [place - FAN_HALF_WIDTH, place + FAN_HALF_WIDTH], pair, color=INK, marker="_", ms=9.0, lw=0.8
            )
        axis.set_ylabel(f"step size ({unit})")
        _label_sessions(axis, sessions)
        entries = [
            make_legend_entry(f"direction {way(sign)}", DIRECTION_COLOURS[sign], marker="o") for sign in "+-"
        ]
        add_legend(figure, [*entries, make_legend_entry("mean", INK, marker="_", line="-")])
    return figure


def draw_rotations(answers: Sequence[FactorTest]) -> Figure:
    """One panel for each direction: readings less their session's mean over the orientations' means."""
    with report_style():
        figure, axes = make_figure([1.7], len(answers), top=0.34 + TITLE_LINE, bottom=_name_height(answers))
        for axis, answer in zip(axes[0], answers, strict=True):
            asked, unit = answer.design, step_unit(answer.design.joint)
            order = _angle_order(answer)
            rows = asked.readings
            cells = rows.groupby(["session", "level"])["step_size"].mean()
            middle = rows["session"].map(cells.groupby("session").mean())
            shown = rows.assign(step_size=rows["step_size"] - middle)
            colour = DIRECTION_COLOURS[str(asked.direction)]
            _draw_readings(axis, shown, _number_places(rows["level"], order), colour, 0.0)
            _draw_means(axis, answer, [order.index(name) for name in answer.levels], centred=True)
            axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
            axis.set_xticks(range(len(order)), [typeset_text(name).replace(", ", "\n") for name in order])
            session = f", {shorten(asked.session, 18)}" if asked.session else ""
            axis.set_title(f"direction {way(str(asked.direction))}{session}")
        axes[0, 0].set_ylabel(f"less the session's mean ({unit})")
        add_legend(figure, _legend_entries(answers))
    return figure


def _draw_readings(axis: Axes, rows: pd.DataFrame, places: np.ndarray, colour: str, aside: float) -> None:
    """Readings of one level fan out in the order in which they were read."""
    shown = rows.assign(place=places)[places >= 0]
    if shown.empty:
        return
    turn = shown.groupby("place").cumcount()
    share = (turn + 0.5) / shown.groupby("place")["place"].transform("size") - 0.5
    shown = thin_rows(shown.assign(x=shown["place"] + aside + FAN_HALF_WIDTH * share), MAX_POINTS)
    unit = step_unit(int(rows["joint"].iloc[0]))
    y = from_si(shown["step_size"].to_numpy(), unit)
    axis.plot(shown["x"], y, ls="", marker="o", ms=2.8, mew=0, alpha=0.65, color=colour)


def _draw_means(axis: Axes, answer: FactorTest, places: Sequence[int], *, centred: bool = False) -> None:
    """Means of the levels with their intervals, beside the readings."""
    unit, at = step_unit(answer.design.joint), np.array(places)
    means = answer.effect.means - (answer.effect.means.mean() if centred else 0.0)
    y, error = from_si(means, unit)[at >= 0], from_si(answer.effect.half_width, unit)[at >= 0]
    beside = at[at >= 0] + 1.4 * FAN_HALF_WIDTH
    axis.errorbar(beside, y, yerr=error, ls="", marker="_", ms=6.0, color=INK, elinewidth=0.9, capsize=2.0)


def _legend_entries(answers: Sequence[FactorTest]) -> list[Line2D]:
    signs = dict.fromkeys(str(each.design.direction) for each in answers)
    entries = [
        make_legend_entry(f"reading, direction {way(sign)}", DIRECTION_COLOURS[sign], marker="o")
        for sign in signs
    ]
    return [*entries, make_legend_entry("mean with 95 % interval", INK, marker="_", line="-")]


def _list_sessions(answers: Sequence[FactorTest]) -> list[str]:
    rows = pd.concat([each.design.readings[["session", "time"]] for each in answers])
    return list(rows.sort_values("time", kind="stable")["session"].unique())


def _describe_latest(sessions: Sequence[str]) -> str:
    if len(sessions) <= MAX_SESSIONS:
        return ""
    return f"The latest {MAX_SESSIONS} of {count(len(sessions), 'session')}. "


def _describe_configuration(answer: FactorTest) -> str:
    return typeset_text(answer.design.configuration)


def _number_places(names: pd.Series[str], order: Sequence[str]) -> np.ndarray:
    """The place of each name on the axis; -1 for what is not shown."""
    return names.map({name: place for place, name in enumerate(order)}).fillna(-1).to_numpy(int)


def _angle_order(answer: FactorTest) -> list[str]:
    rows = answer.design.readings.drop_duplicates("level")
    return list(rows.sort_values(["theta", "psi"])["level"])


def _is_crowded(sessions: Sequence[str]) -> bool:
    return len(sessions) > MAX_ACROSS


def _label_height(sessions: Sequence[str]) -> float:
    """Inches below the axes: names of many sessions stand upright."""
    return 0.85 if _is_crowded(sessions) else 0.28


def _name_height(answers: Sequence[FactorTest]) -> float:
    """Inches below the axes for as many lines as an orientation's name has."""
    return 0.14 + TITLE_LINE * max(name.count(", ") + 1 for each in answers for name in each.levels)


def _label_sessions(axis: Axes, sessions: Sequence[str]) -> None:
    every = -(-len(sessions) // MAX_SESSION_LABELS)
    places = list(range(0, len(sessions), every))
    axis.set_xlim(-0.5, len(sessions) - 0.5)
    names = [shorten(sessions[place], 12) for place in places]
    axis.set_xticks(places, names, rotation=90 if _is_crowded(sessions) else 0)
    axis.ticklabel_format(axis="y", useOffset=False)
    axis.grid(visible=False, axis="x")
