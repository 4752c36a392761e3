"""Figures of the analysis of variance: step sizes by day, direction and rotation (Figs. 4.4, 5.1, 4.6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_direction, join_words, joint_name, pluralize, typeset_text
from stickslip_fit.anova import FactorTest
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    INK,
    MAX_HORIZONTAL_LABELS,
    MAX_SESSIONS,
    TITLE_LINE,
    direction_entries,
    label_sessions,
    make_figure,
    make_legend_entry,
    report_style,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture
from stickslip_fit.units import PRISMATIC, from_si

MAX_POINTS = 900
FAN_HALF_WIDTH = 0.16  # how far beside its level's place an observation may be drawn


def factor_pictures(joint: int, factor_tests: Sequence[FactorTest]) -> list[Picture]:
    """The figures of a joint's factor tests."""
    pictures = []
    for factor, (title, describe) in _CAPTIONS.items():
        subset = _select_tests(joint, factor, factor_tests)
        if subset:
            machine = subset[0].design.machine
            title = f"Step size by {title}, {joint_name(joint, machine)}"
            if machine.has_published_geometry:
                figure = "4.6" if factor == "normal-force" else "4.4" if joint == PRISMATIC else "5.1"
                title += f" (as Fig. {figure} of the thesis)"
            pictures.append(
                make_picture(f"{factor}-{joint}", title, describe(subset), plot_factor(joint, factor, subset))
            )
    return pictures


def plot_factor(joint: int, factor: str, factor_tests: Sequence[FactorTest]) -> Figure:
    """The observations of one joint by one factor.

    Raises
    ------
    InputError
        If that was not tested.
    """
    subset = _select_tests(joint, factor, factor_tests)
    if not subset:
        known = sorted({(test.design.joint, test.design.analysis) for test in factor_tests})
        tested = join_words([f"joint {number}'s {name}" for number, name in known]) or "nothing"
        raise InputError(f"{factor} was not tested for joint {joint}; what was: {tested}")
    if factor == "normal-force":
        return draw_rotations(_prefer_over_sessions(subset))
    draw = draw_days if factor == "day" else draw_directions
    return draw(subset, _list_sessions(subset)[-MAX_SESSIONS:])


def _select_tests(joint: int, factor: str, factor_tests: Sequence[FactorTest]) -> list[FactorTest]:
    return [test for test in factor_tests if test.design.analysis == factor and test.design.joint == joint]


def _prefer_over_sessions(factor_tests: Sequence[FactorTest]) -> list[FactorTest]:
    """Those over all sessions, where there are any."""
    return [test for test in factor_tests if test.design.session is None] or list(factor_tests)


def _describe_days(factor_tests: Sequence[FactorTest]) -> str:
    return (
        f"{_describe_points(factor_tests)}; bars: the session's mean with its 95 % interval, for the scatter "
        "of traverses alone. Means further apart than their bars are days that differ."
    )


def _describe_directions(factor_tests: Sequence[FactorTest]) -> str:
    return (
        f"{_describe_points(factor_tests)}; lines join the means of the two directions in a session. Lines "
        "of one slope are a difference that holds in every session."
    )


def _describe_rotations(factor_tests: Sequence[FactorTest]) -> str:
    over = _prefer_over_sessions(factor_tests)
    n_rows = sum(len(test.design.observations) for test in over)
    return (
        f"{pluralize(n_rows, 'traverse')} at {typeset_text(over[0].design.configuration)}, each minus the "
        "mean of its session; bars: the mean of each orientation with its 95 % interval. The load along the "
        "axis is the same in all of them, so that a level row says that the force across it does not matter."
    )


_CAPTIONS = {
    "day": ("day", _describe_days),
    "direction": ("direction", _describe_directions),
    "normal-force": ("rotation about the axis", _describe_rotations),
}


def draw_days(factor_tests: Sequence[FactorTest], sessions: Sequence[str]) -> Figure:
    """One panel for each direction."""
    with report_style():
        figure, axes = make_figure(
            [1.5] * len(factor_tests),
            1,
            _legend_entries(factor_tests),
            top=0.11,
            bottom=_label_height(sessions),
            share_y=False,
        )
        for axis, test in zip(axes[:, 0], factor_tests, strict=True):
            sign = str(test.design.direction)
            rows = test.design.observations
            places = _number_places(rows["session"], sessions)
            _draw_observations(axis, rows, places, DIRECTION_COLOURS[sign], 0.0, test.design.unit)
            _draw_means(
                axis, test, [sessions.index(name) if name in sessions else -1 for name in test.levels]
            )
            axis.set_ylabel(f"direction {format_direction(sign)} ({test.design.unit})")
        label_sessions(axes[-1, 0], sessions, vertical=_is_crowded(sessions))
    return figure


def draw_directions(factor_tests: Sequence[FactorTest], sessions: Sequence[str]) -> Figure:
    """Both directions of each session side by side."""
    with report_style():
        figure, axes = make_figure([1.9], 1, _pair_entries(), top=0.11, bottom=_label_height(sessions))
        _draw_pairs(axes[0, 0], factor_tests, sessions)
        axes[0, 0].set_ylabel(f"step size ({factor_tests[0].design.unit})")
    return figure


def sessions_picture(factor_tests: Sequence[FactorTest]) -> Picture:
    """Both directions of each session, a panel for each joint: what day and direction change."""
    key, title = "sessions", "Step size by session and direction"
    tested = {
        joint: [*_select_tests(joint, "day", factor_tests), *_select_tests(joint, "direction", factor_tests)]
        for joint in dict.fromkeys(test.design.joint for test in factor_tests)
    }
    tested = {joint: tests for joint, tests in tested.items() if tests}
    if not tested:
        return make_missing_picture(key, title, "It would need a second session or direction.")
    places = "; ".join(
        f"{joint_name(joint, tests[0].design.machine)} at {typeset_text(tests[0].design.configuration)}"
        for joint, tests in tested.items()
    )
    many = max(len(_list_sessions(tests)) for tests in tested.values()) > MAX_SESSIONS
    caption = (
        f"Points: single traverses, {places}. Lines join the means of the two directions in a session: lines "
        "at one height say that days do not differ, level lines that directions do not."
        + f" The latest {MAX_SESSIONS} sessions."
        * many
    )
    return make_picture(key, title, caption, draw_sessions(tested))


def draw_sessions(tested: Mapping[int, Sequence[FactorTest]]) -> Figure:
    """A panel for each joint: both directions of each session side by side."""
    sessions = {joint: _list_sessions(tests)[-MAX_SESSIONS:] for joint, tests in tested.items()}
    bottom = max(map(_label_height, sessions.values()))
    with report_style():
        figure, axes = make_figure(
            [1.9],
            len(tested),
            _pair_entries(),
            top=TITLE_LINE + 0.14,
            bottom=max(bottom, 0.85 if len(tested) > 1 else 0.0),
            across=0.42,
            share_y="none",
        )
        for axis, (joint, tests) in zip(axes[0], tested.items(), strict=True):
            _draw_pairs(axis, tests, sessions[joint], vertical=len(tested) > 1)
            axis.set_title(f"{joint_name(joint, tests[0].design.machine)} ({tests[0].design.unit})")
        axes[0, 0].set_ylabel("step size")
    return figure


def _pair_entries() -> list[Line2D]:
    return [*direction_entries(marker="o"), make_legend_entry("mean", INK, marker="_", line="-")]


def _draw_pairs(
    axis: Axes, factor_tests: Sequence[FactorTest], sessions: Sequence[str], *, vertical: bool = False
) -> None:
    """Observations of both directions by session, and their means joined by a line."""
    rows = pd.concat([test.design.observations for test in factor_tests])
    rows = rows[~rows.index.duplicated()]
    unit = factor_tests[0].design.unit
    for sign, aside in (("+", -FAN_HALF_WIDTH), ("-", FAN_HALF_WIDTH)):
        subset = rows[rows["direction"] == sign]
        places = _number_places(subset["session"], sessions)
        _draw_observations(axis, subset, places, DIRECTION_COLOURS[sign], aside, unit)
    means = rows.groupby(["session", "direction"])["step_size"].mean().unstack().reindex(columns=["+", "-"])
    pairs = from_si(means.loc[list(sessions)].to_numpy(float), unit)
    ends = np.arange(len(sessions))[:, None] + [-FAN_HALF_WIDTH, FAN_HALF_WIDTH, np.nan]
    heights = np.column_stack([pairs, np.full(len(sessions), np.nan)])  # NaN ends a line
    axis.plot(ends.ravel(), heights.ravel(), color=INK, marker="_", ms=9.0, lw=0.8)
    label_sessions(axis, sessions, vertical=vertical or _is_crowded(sessions))


def draw_rotations(factor_tests: Sequence[FactorTest]) -> Figure:
    """One panel for each direction: observations less their session's mean, by orientation."""
    with report_style():
        n_lines = max(name.count(", ") + 1 for test in factor_tests for name in test.levels)
        figure, axes = make_figure(
            [1.7],
            len(factor_tests),
            _legend_entries(factor_tests),
            top=0.15 + TITLE_LINE,
            bottom=0.14 + TITLE_LINE * n_lines,
        )
        for axis, test in zip(axes[0], factor_tests, strict=True):
            design, unit = test.design, test.design.unit
            rows = design.observations
            order = list(rows.drop_duplicates("level").sort_values(["theta", "psi"])["level"])
            cells = rows.groupby(["session", "level"])["step_size"].mean()
            centred = rows["step_size"] - rows["session"].map(cells.groupby("session").mean())
            colour = DIRECTION_COLOURS[str(design.direction)]
            places = _number_places(rows["level"], order)
            _draw_observations(axis, rows.assign(step_size=centred), places, colour, 0.0, unit)
            _draw_means(axis, test, [order.index(name) for name in test.levels], centred=True)
            axis.axhline(0.0, color=INK, lw=0.7, zorder=1)
            axis.set_xticks(range(len(order)), [typeset_text(name).replace(", ", "\n") for name in order])
            session = f", {shorten(design.session, 18)}" if design.session else ""
            axis.set_title(f"direction {format_direction(str(design.direction))}{session}")
        axes[0, 0].set_ylabel(f"less the session's mean ({unit})")
    return figure


def _draw_observations(
    axis: Axes, rows: pd.DataFrame, places: np.ndarray, colour: str, offset: float, unit: str
) -> None:
    """Observations of one level fan out in the order in which they were made."""
    points = rows.assign(place=places)[places >= 0]
    if points.empty:
        return
    by_place = points.groupby("place")["place"]
    share = (by_place.cumcount() + 0.5) / by_place.transform("size") - 0.5
    points = thin_rows(points.assign(x=points["place"] + offset + FAN_HALF_WIDTH * share), MAX_POINTS)
    y = from_si(points["step_size"].to_numpy(), unit)
    axis.plot(points["x"], y, ls="", marker="o", ms=2.8, mew=0, alpha=0.65, color=colour)


def _draw_means(axis: Axes, test: FactorTest, places: Sequence[int], *, centred: bool = False) -> None:
    """Means of the levels with their intervals, beside the observations."""
    unit, place = test.design.unit, np.array(places)
    shown = place >= 0
    means = test.effect.means - (test.effect.means.mean() if centred else 0.0)
    y, error = from_si(means, unit)[shown], from_si(test.effect.half_width, unit)[shown]
    x = place[shown] + 1.4 * FAN_HALF_WIDTH
    axis.errorbar(x, y, yerr=error, ls="", marker="_", ms=6.0, color=INK, elinewidth=0.9, capsize=2.0)


def _legend_entries(factor_tests: Sequence[FactorTest]) -> list[Line2D]:
    signs = dict.fromkeys(str(test.design.direction) for test in factor_tests)
    entries = direction_entries(marker="o", label="traverse, direction {}", signs=signs)
    return [*entries, make_legend_entry("mean with 95 % interval", INK, marker="_", line="-")]


def _list_sessions(factor_tests: Sequence[FactorTest]) -> list[str]:
    rows = pd.concat([test.design.observations[["session", "time"]] for test in factor_tests])
    return list(rows.sort_values("time", kind="stable")["session"].unique())


def _describe_points(factor_tests: Sequence[FactorTest]) -> str:
    n_sessions, where = len(_list_sessions(factor_tests)), factor_tests[0].design.configuration
    latest = f"The latest {MAX_SESSIONS} of {pluralize(n_sessions, 'session')}. "
    return f"{latest if n_sessions > MAX_SESSIONS else ''}Points: single traverses at {typeset_text(where)}"


def _number_places(names: pd.Series[str], order: Sequence[str]) -> np.ndarray:
    """The place of each name on the axis; -1 for what is not shown."""
    return names.map({name: place for place, name in enumerate(order)}).fillna(-1).to_numpy(int)


def _is_crowded(sessions: Sequence[str]) -> bool:
    return len(sessions) > MAX_HORIZONTAL_LABELS


def _label_height(sessions: Sequence[str]) -> float:
    """Inches below the axes: names of many sessions stand upright."""
    return 0.85 if _is_crowded(sessions) else 0.28
