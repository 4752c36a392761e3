"""Step sizes by day, direction and rotation about the axis, every reading visible (thesis 4.4, 4.6, 5.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import join_words as listed
from stickslip_fit._format import joint_name, step_unit, typeset
from stickslip_fit._format import pluralize as count
from stickslip_fit.anova import Answer
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.report.figures.picture import Picture, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    INK,
    TITLE_LINE,
    canvas,
    key_line,
    legend,
    look,
)
from stickslip_fit.report.figures.traverses import thinned
from stickslip_fit.units import from_si

MOST_SESSIONS = 30
LABELS = 12  # session names that an axis has room for
POINTS = 900
ACROSS = 6  # as many that it has room for side by side
SPREAD = 0.16  # how far beside its level's place a reading may be drawn


def factor_pictures(joint: int, answers: Sequence[Answer]) -> list[Picture]:
    """The figures that a joint's answers can fill."""
    pictures = {"day": _day, "direction": _direction, "normal-force": _normal_force}
    by_name = {name: _of(joint, name, answers) for name in pictures}
    return [pictures[name](joint, mine) for name, mine in by_name.items() if mine]


def plot_factor(joint: int, factor: str, answers: Sequence[Answer]) -> Figure:
    """The readings of one joint by one factor.

    Raises
    ------
    InputError
        If that was not answered.
    """
    mine = _of(joint, factor, answers)
    if not mine:
        known = sorted({(each.question.joint, each.question.analysis) for each in answers})
        said = listed([f"joint {number}'s {name}" for number, name in known]) or "nothing"
        raise InputError(f"{factor} was not answered for joint {joint}; what was: {said}")
    return _drawn(factor, mine)


def _of(joint: int, factor: str, answers: Sequence[Answer]) -> list[Answer]:
    return [each for each in answers if each.question.analysis == factor and each.question.joint == joint]


def _drawn(factor: str, answers: Sequence[Answer]) -> Figure:
    if factor == "normal-force":
        return draw_rotations(_over(answers))
    draw = draw_days if factor == "day" else draw_directions
    return draw(answers, _sessions(answers)[-MOST_SESSIONS:])


def _over(answers: Sequence[Answer]) -> list[Answer]:
    """Those over all sessions, where there are any."""
    return [each for each in answers if each.question.session is None] or list(answers)


def _day(joint: int, answers: Sequence[Answer]) -> Picture:
    sessions = _sessions(answers)
    caption = (
        f"{_latest(sessions)}Points: single readings at {_where(answers[0])}; bars: the session's mean with "
        "its 95 % interval, for the scatter of readings alone. Means further apart than their bars are days "
        "that differ."
    )
    title = f"Step size by day, {joint_name(joint)} (as Fig. 4.4 of the thesis)"
    return picture(f"day-{joint}", title, caption, _drawn("day", answers))


def _direction(joint: int, answers: Sequence[Answer]) -> Picture:
    sessions = _sessions(answers)
    caption = (
        f"{_latest(sessions)}Points: single readings at {_where(answers[0])}; lines join the means of the "
        "two directions in a session. Lines of one slope are a difference that holds in every session."
    )
    title = f"Step size by direction, {joint_name(joint)} (as Fig. 4.6 of the thesis)"
    return picture(f"direction-{joint}", title, caption, _drawn("direction", answers))


def _normal_force(joint: int, answers: Sequence[Answer]) -> Picture:
    over = _over(answers)
    rows = sum(len(each.question.readings) for each in over)
    caption = (
        f"{count(rows, 'reading')} at {_where(over[0])}, each less the mean of its session; bars: the mean "
        "of each orientation with its 95 % interval. The load along the axis is the same in all of them, so "
        "that a level row says that the force across it does not matter."
    )
    title = f"Step size by rotation about the axis, {joint_name(joint)} (as Fig. 5.1 of the thesis)"
    return picture(f"normal-force-{joint}", title, caption, _drawn("normal-force", answers))


def draw_days(answers: Sequence[Answer], sessions: Sequence[str]) -> Figure:
    """One panel for each direction."""
    with look():
        figure, axes = canvas([1.5] * len(answers), 1, top=0.30, bottom=_room(sessions), share_y=False)
        for axis, answer in zip(axes[:, 0], answers, strict=True):
            sign = str(answer.question.direction)
            rows = answer.question.readings
            _readings(axis, rows, _places(rows["session"], sessions), DIRECTION_COLOURS[sign], 0.0)
            _bars(axis, answer, [sessions.index(name) if name in sessions else -1 for name in answer.levels])
            unit = step_unit(answer.question.joint)
            axis.set_ylabel(f"direction {way(sign)} ({unit})")
        _name_sessions(axes[-1, 0], sessions)
        legend(figure, _entries(answers))
    return figure


def draw_directions(answers: Sequence[Answer], sessions: Sequence[str]) -> Figure:
    """Both directions of each session side by side."""
    rows = pd.concat([each.question.readings for each in answers]).drop_duplicates("time")
    unit = step_unit(answers[0].question.joint)
    with look():
        figure, axes = canvas([1.9], 1, top=0.30, bottom=_room(sessions))
        axis = axes[0, 0]
        for sign, aside in (("+", -SPREAD), ("-", SPREAD)):
            mine = rows[rows["direction"] == sign]
            _readings(axis, mine, _places(mine["session"], sessions), DIRECTION_COLOURS[sign], aside)
        means = rows.groupby(["session", "direction"])["step_size"].mean().unstack()
        for place, name in enumerate(sessions):
            pair = from_si(means.loc[name, ["+", "-"]].to_numpy(float), unit)
            axis.plot([place - SPREAD, place + SPREAD], pair, color=INK, marker="_", ms=9.0, lw=0.8)
        axis.set_ylabel(f"step size ({unit})")
        _name_sessions(axis, sessions)
        entries = [key_line(f"direction {way(sign)}", DIRECTION_COLOURS[sign], marker="o") for sign in "+-"]
        legend(figure, [*entries, key_line("mean", INK, marker="_", line="-")])
    return figure


def draw_rotations(answers: Sequence[Answer]) -> Figure:
    """One panel for each direction: readings less their session's mean over the orientations' means."""
    with look():
        figure, axes = canvas([1.7], len(answers), top=0.34 + TITLE_LINE, bottom=_lines(answers))
        for axis, answer in zip(axes[0], answers, strict=True):
            asked, unit = answer.question, step_unit(answer.question.joint)
            order = _by_angle(answer)
            rows = asked.readings
            cells = rows.groupby(["session", "level"])["step_size"].mean()
            middle = rows["session"].map(cells.groupby("session").mean())
            shown = rows.assign(step_size=rows["step_size"] - middle)
            colour = DIRECTION_COLOURS[str(asked.direction)]
            _readings(axis, shown, _places(rows["level"], order), colour, 0.0)
            _bars(axis, answer, [order.index(name) for name in answer.levels], centred=True)
            axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
            axis.set_xticks(range(len(order)), [typeset(name).replace(", ", "\n") for name in order])
            session = f", {shorten(asked.session, 18)}" if asked.session else ""
            axis.set_title(f"direction {way(str(asked.direction))}{session}")
        axes[0, 0].set_ylabel(f"less the session's mean ({unit})")
        legend(figure, _entries(answers))
    return figure


def _readings(axis: Axes, rows: pd.DataFrame, places: np.ndarray, colour: str, aside: float) -> None:
    """Readings of one level fan out in the order in which they were read."""
    shown = rows.assign(place=places)[places >= 0]
    if shown.empty:
        return
    turn = shown.groupby("place").cumcount()
    share = (turn + 0.5) / shown.groupby("place")["place"].transform("size") - 0.5
    shown = thinned(shown.assign(x=shown["place"] + aside + SPREAD * share), POINTS)
    unit = step_unit(int(rows["joint"].iloc[0]))
    y = from_si(shown["step_size"].to_numpy(), unit)
    axis.plot(shown["x"], y, ls="", marker="o", ms=2.8, mew=0, alpha=0.65, color=colour)


def _bars(axis: Axes, answer: Answer, places: Sequence[int], *, centred: bool = False) -> None:
    """Means of the levels with their intervals, beside the readings."""
    unit, at = step_unit(answer.question.joint), np.array(places)
    means = answer.effect.means - (answer.effect.means.mean() if centred else 0.0)
    y, error = from_si(means, unit)[at >= 0], from_si(answer.effect.half_width, unit)[at >= 0]
    beside = at[at >= 0] + 1.4 * SPREAD
    axis.errorbar(beside, y, yerr=error, ls="", marker="_", ms=6.0, color=INK, elinewidth=0.9, capsize=2.0)


def _entries(answers: Sequence[Answer]) -> list[Line2D]:
    signs = dict.fromkeys(str(each.question.direction) for each in answers)
    entries = [
        key_line(f"reading, direction {way(sign)}", DIRECTION_COLOURS[sign], marker="o") for sign in signs
    ]
    return [*entries, key_line("mean with 95 % interval", INK, marker="_", line="-")]


def _sessions(answers: Sequence[Answer]) -> list[str]:
    rows = pd.concat([each.question.readings[["session", "time"]] for each in answers])
    return list(rows.sort_values("time", kind="stable")["session"].unique())


def _latest(sessions: Sequence[str]) -> str:
    if len(sessions) <= MOST_SESSIONS:
        return ""
    return f"The latest {MOST_SESSIONS} of {count(len(sessions), 'session')}. "


def _where(answer: Answer) -> str:
    return typeset(answer.question.configuration)


def _places(names: pd.Series[str], order: Sequence[str]) -> np.ndarray:
    """The place of each name on the axis; -1 for what is not shown."""
    return names.map({name: place for place, name in enumerate(order)}).fillna(-1).to_numpy(int)


def _by_angle(answer: Answer) -> list[str]:
    rows = answer.question.readings.drop_duplicates("level")
    return list(rows.sort_values(["theta", "psi"])["level"])


def _is_crowded(sessions: Sequence[str]) -> bool:
    return len(sessions) > ACROSS


def _room(sessions: Sequence[str]) -> float:
    """Inches below the axes: names of many sessions stand upright."""
    return 0.85 if _is_crowded(sessions) else 0.28


def _lines(answers: Sequence[Answer]) -> float:
    """Inches below the axes for as many lines as an orientation's name has."""
    return 0.14 + TITLE_LINE * max(name.count(", ") + 1 for each in answers for name in each.levels)


def _name_sessions(axis: Axes, sessions: Sequence[str]) -> None:
    every = -(-len(sessions) // LABELS)
    places = list(range(0, len(sessions), every))
    axis.set_xlim(-0.5, len(sessions) - 0.5)
    names = [shorten(sessions[place], 12) for place in places]
    axis.set_xticks(places, names, rotation=90 if _is_crowded(sessions) else 0)
    axis.ticklabel_format(axis="y", useOffset=False)
    axis.grid(visible=False, axis="x")
