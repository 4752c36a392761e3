"""Figures of sweeps: step size, law and residuals against one coordinate, the others being fixed.

Prismatic joint after Figs. 4.4 to 4.13 of the thesis, rotary joints after Figs. 5.5 to 5.7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import radians
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stickslip_fit._format import format_angle as angle
from stickslip_fit._format import format_configuration as configuration
from stickslip_fit._format import format_coordinate as place
from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent, joint_name, step_unit
from stickslip_fit._format import pluralize as count
from stickslip_fit._typing import Array
from stickslip_fit.errors import shorten
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.identifiability import is_full
from stickslip_fit.laws import traverse_length
from stickslip_fit.plotting._style import (
    DIRECTION_COLOURS,
    GREEN,
    GREY,
    INK,
    LEGEND_LINE,
    MARKERS,
    MAX_SESSIONS,
    PURPLE,
    TITLE_LINE,
    add_legend,
    count_legend_rows,
    make_figure,
    make_legend_entry,
    report_style,
    select_recent,
    set_angle_ticks,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture, name_traverses
from stickslip_fit.units import from_si

MAX_PANEL_POINTS = 400
MAX_TICKS = {1: 7, 2: 7, 3: 7, 4: 4}  # at most, by how many panels stand side by side
ZOOM = 3.0  # the departures' scale leaves out points that are this much further off than 95 % of them


@dataclass(frozen=True)
class PointStyle:
    """Points of one colour: label in the legend and the colour."""

    label: str
    colour: str


@dataclass(frozen=True)
class SweepPanel:
    """One column of the figure.

    Attributes
    ----------
    title : str
        What is held fixed in it.
    points : DataFrame
        x (people's unit), step_size, error, model, departure (SI), kind, session; half_width of the
        traverse in x where that means something.
    curves : DataFrame
        x, step_size, kind, session: the law, one curve for each kind and session.
    left_out : int
        Traverses that are not among the points because there are too many to tell apart.
    """

    title: str
    points: pd.DataFrame
    curves: pd.DataFrame
    left_out: int = 0


def overlay_panels(one: SweepPanel, other: SweepPanel) -> SweepPanel:
    """Two panels in one, under the first one's title."""
    points, curves = pd.concat([one.points, other.points]), pd.concat([one.curves, other.curves])
    return SweepPanel(one.title, points, curves, one.left_out + other.left_out)


def draw_panels(
    panels: Sequence[SweepPanel], kinds: dict[str, PointStyle], *, x_label: str, unit: str, angle: bool
) -> Figure:
    """Draw panels side by side on common scales.

    Parameters
    ----------
    panels : sequence of Panel
    kinds : dict
        By the name that the points' column kind holds.
    x_label : str
    unit : {"nm", "µrad"}
        Of the step size.
    angle : bool
        Whether x is an angle in degrees.
    """
    sessions = list(dict.fromkeys(session for panel in panels for session in panel.points["session"]))
    lines = max(panel.title.count("\n") + 1 for panel in panels)
    with report_style():
        entries = _legend_entries(kinds, sessions)
        top = LEGEND_LINE * count_legend_rows(entries) + TITLE_LINE * lines + 0.14
        figure, axes = make_figure([1.75, 1.0], len(panels), top=top)
        limit = _residual_limit(pd.concat([panel.points for panel in panels]))
        for column, panel in enumerate(panels):
            above, below = axes[:, column]
            above.set_title(panel.title)
            _draw_curves(above, panel, kinds, unit)
            _draw_step_sizes(above, panel, kinds, sessions, unit)
            _draw_residuals(below, panel, kinds, sessions, limit)
            if angle:
                x = panel.points["x"]
                set_angle_ticks(below, x.min(), x.max(), MAX_TICKS.get(len(panels), 3))
        axes[0, 0].set_ylabel(f"mean step size ({unit})")
        axes[1, 0].set_ylabel("seen less law (%)")
        figure.align_ylabels(axes[:, 0])
        figure.supxlabel(x_label, y=0.02, va="bottom", size=8, color=INK)
        add_legend(figure, entries)
    return figure


def _draw_curves(axes: Axes, panel: SweepPanel, kinds: dict[str, PointStyle], unit: str) -> None:
    for (kind, _), curve in panel.curves.groupby(["kind", "session"], sort=False, observed=True):
        axes.plot(curve["x"], from_si(curve["step_size"].to_numpy(), unit), color=kinds[kind].colour, lw=0.9)


def _draw_step_sizes(
    axes: Axes, panel: SweepPanel, kinds: dict[str, PointStyle], sessions: list[str], unit: str
) -> None:
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        drawn = axes.errorbar(
            points["x"],
            from_si(points["step_size"].to_numpy(), unit),
            yerr=from_si(points["error"].to_numpy(), unit),
            xerr=points["half_width"] if points["half_width"].any() else None,
            **_choose_style(kinds[kind], sessions.index(session)),
        )
        name_traverses(drawn[0], points.index)


def _draw_residuals(
    axes: Axes, panel: SweepPanel, kinds: dict[str, PointStyle], sessions: list[str], limit: float
) -> None:
    axes.axhline(0.0, color=INK, lw=0.8, zorder=1)
    axes.set_ylim(-limit, limit)
    spread = _point_spacing(panel.points["x"])
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        order = list(kinds).index(kind) * len(sessions) + sessions.index(session)
        aside = spread * (order - (len(kinds) * len(sessions) - 1) / 2) / (len(kinds) * len(sessions))
        departure = 100 * points["departure"].to_numpy()
        shown = np.clip(departure, -limit, limit)
        style = _choose_style(kinds[kind], sessions.index(session))
        error = 100 * (points["error"] / points["step_size"]).to_numpy()
        bars = np.where(shown == departure, error, 0.0)
        drawn = axes.errorbar(points["x"] + aside, shown, yerr=bars, **style)
        name_traverses(drawn[0], points.index)
        beyond = shown != departure
        axes.plot(
            (points["x"] + aside)[beyond], shown[beyond], ls="", marker="x", ms=6, color=INK, clip_on=False
        )


def _choose_style(kind: PointStyle, session: int) -> dict[str, Any]:
    return {
        "linestyle": "",
        "marker": MARKERS[session % len(MARKERS)],
        "color": kind.colour,
        "markerfacecolor": "white",
        "markeredgewidth": 0.8,
        "elinewidth": 0.7,
    }


def _residual_limit(points: pd.DataFrame) -> float:
    """Half the departures' scale, %: wide enough for all points but a few that are far out."""
    reach = 100 * (points["departure"].abs() + points["error"] / points["step_size"]).dropna().to_numpy()
    if not len(reach):
        return 1.0
    return float(1.1 * min(reach.max(), ZOOM * np.quantile(reach, 0.95)))


def count_beyond_scale(panels: Sequence[SweepPanel]) -> int:
    """How many points the departures' scale leaves out; a caption should say so."""
    points = pd.concat([panel.points for panel in panels])
    return int((100 * points["departure"].abs() > _residual_limit(points)).sum())


def _point_spacing(x: pd.Series[float]) -> float:
    """Room beside a point before its neighbour's begins."""
    values = np.unique(x.round(6))
    return 0.5 * float(np.min(np.diff(values))) if len(values) > 1 else 1.0


def _legend_entries(kinds: dict[str, PointStyle], sessions: list[str]) -> list[Line2D]:
    entries = [make_legend_entry(kind.label, kind.colour, marker="o", line="-") for kind in kinds.values()]
    if len(sessions) > 1:
        entries += [
            make_legend_entry(shorten(session, 18), GREY, marker=MARKERS[index % len(MARKERS)])
            for index, session in enumerate(sessions)
        ]
    return [*entries, make_legend_entry("law (least squares)", INK, line="-")]


POSITION_TOL = 1e-6  # rad or m
MIN_VALUES = 3  # different places that make a sweep
MAX_PANELS = 7
CURVE_POINTS = 61


@dataclass(frozen=True)
class Sweep:
    """What runs along x.

    Attributes
    ----------
    name, unit : str
        As the axis has them.
    read : callable
        Its value in each row, SI.
    move : callable
        The same rows with it set to other values, SI.
    along : bool
        Whether it runs along the traverse, which then has a width on the axis.
    """

    name: str
    unit: str
    read: Callable[[pd.DataFrame], Array]
    move: Callable[[pd.DataFrame, Array], pd.DataFrame]
    along: bool = False

    @property
    def label(self) -> str:
        """Axis label."""
        return f"{self.name} ({'°' if self.unit == 'deg' else self.unit})"


def _make_column_sweep(name: str, unit: str) -> Sweep:
    return Sweep(
        name, unit, lambda rows: rows[name].to_numpy(float), lambda rows, x: rows.assign(**{name: x})
    )


def _move_centre(rows: pd.DataFrame, centre: pd.Series[float] | Array) -> pd.DataFrame:
    half = (rows["stop"] - rows["start"]) / 2
    return rows.assign(start=centre - half, stop=centre + half)


THETA, PSI, Q2, Q3 = (
    _make_column_sweep("theta", "deg"),
    _make_column_sweep("psi", "deg"),
    _make_column_sweep("q2", "deg"),
    _make_column_sweep("q3", "mm"),
)
ZETA_BY_BASE = Sweep(
    "zeta = psi − q2",
    "deg",
    lambda rows: (rows["psi"] - rows["q2"]).to_numpy(float),
    lambda rows, x: rows.assign(psi=rows["q2"] + x),
)
ZETA_BY_ARM = Sweep(
    "zeta = psi − q2", "deg", ZETA_BY_BASE.read, lambda rows, x: rows.assign(q2=rows["psi"] - x)
)
ZETA_ALONG = Sweep(
    "zeta = psi − q2 at the middle of the interval",
    "deg",
    lambda rows: (rows["psi"] - rows["centre"]).to_numpy(float),
    lambda rows, x: _move_centre(rows, rows["psi"] - x),
    along=True,
)
Q1_ALONG = Sweep(
    "q1 at the middle of the interval",
    "deg",
    lambda rows: rows["centre"].to_numpy(float),
    _move_centre,
    along=True,
)


def select_fixed(rows: pd.DataFrame, fixed: dict[str, float]) -> pd.DataFrame:
    """The rows whose columns have the fixed values."""
    mask = np.ones(len(rows), dtype=bool)
    for name, value in fixed.items():
        mask &= np.abs(rows[name].to_numpy(float) - value) < POSITION_TOL
    return rows[mask]


def make_panels(rows: pd.DataFrame, sweep: Sweep, by: list[str], fit: Result) -> tuple[list[SweepPanel], int]:
    """One panel for each value of the columns `by` at which the rows sweep far enough.

    Returns
    -------
    panels, left_out
        At most `MOST_PANELS`, spread evenly, and how many more there would have been.
    """
    rows = find_sweep_sessions(rows, sweep, by)
    groups = dict(list(rows.groupby(by)))
    found = sorted(
        rows.loc[_is_swept(rows, sweep, by), by].drop_duplicates().itertuples(index=False), key=_compute_size
    )
    chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), MAX_PANELS)).round().astype(int))
    panels = [
        make_panel("\n".join(map(place, by, found[k])), groups[tuple(found[k])], sweep, fit) for k in chosen
    ]
    return panels, len(found) - len(panels)


def find_sweep_sessions(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.DataFrame:
    """The latest sessions that make the sweep; where it only comes about over several, the latest of all."""
    sweeping = rows.loc[_is_swept(rows, sweep, ["session", *by]), "session"].unique()
    return select_recent(rows[rows["session"].isin(sweeping)] if len(sweeping) else rows)


def _is_swept(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.Series[bool]:
    """Whether x takes enough different values among the rows of the same direction and the same `by`."""
    x = pd.Series(sweep.read(rows).round(6), index=rows.index)
    keys = [rows[name] for name in [*by, "direction"]]
    return x.groupby(keys, observed=True).transform("nunique") >= MIN_VALUES


def _compute_size(values: tuple[float, ...]) -> list[float]:
    return [abs(value) for value in values]


def make_panel(
    title: str, rows: pd.DataFrame, sweep: Sweep, fit: Result, kind: str = "direction"
) -> SweepPanel:
    """Rows as a panel, coloured by the column `kind`."""
    shown = thin_rows(rows, MAX_PANEL_POINTS)
    to_people = partial(from_si, symbol=sweep.unit)
    half = np.abs(to_people((shown["stop"] - shown["start"]).to_numpy(float))) / 2
    points = shown[["step_size", "error", "model", "departure", "session"]].assign(
        x=to_people(sweep.read(shown)), kind=shown[kind], half_width=half if sweep.along else 0.0
    )
    curves = compute_curves(rows, sweep, fit, kind)
    curves["x"] = to_people(curves["x"].to_numpy(float))
    return SweepPanel(title, points, curves, left_out=len(rows) - len(shown))


def compute_curves(rows: pd.DataFrame, sweep: Sweep, fit: Result, kind: str = "direction") -> pd.DataFrame:
    """The law along a sweep: x (SI), step_size, kind and session for each session and kind of the rows."""
    x = sweep.read(rows)
    grid = np.linspace(x.min(), x.max(), CURVE_POINTS)
    first = rows.drop_duplicates(["session", "direction", kind])
    repeated = first.loc[first.index.repeat(len(grid))].reset_index(drop=True)
    moved = sweep.move(repeated, np.tile(grid, len(first)))
    return pd.DataFrame(
        {
            "x": np.tile(grid, len(first)),
            "step_size": fit.predict(moved)["step_size"].to_numpy(),
            "kind": moved[kind],
            "session": moved["session"],
        }
    )


@dataclass(frozen=True)
class SweepFigure:
    """What one sweep figure shows.

    Attributes
    ----------
    key, title : str
    sweep : Sweep
    fixed : dict of str to float
        Columns held at one value in the whole figure, SI.
    by : tuple of str
        Columns held in each panel.
    needed : str
        The traverses to make where the log has no such sweep.
    note : str
        What to look for.
    """

    key: str
    title: str
    sweep: Sweep
    fixed: dict[str, float]
    by: tuple[str, ...]
    needed: str
    note: str = ""


def sweep_picture(spec: SweepFigure, rows: pd.DataFrame, fit: Result) -> Picture:
    """Draw a sweep from the rows of one joint, or say which traverses it would need."""
    panels, left_out = make_panels(select_fixed(rows, spec.fixed), spec.sweep, list(spec.by), fit)
    if not panels:
        return make_missing_picture(spec.key, spec.title, f"It would need {spec.needed}.")
    joint = int(rows["joint"].iloc[0])
    figure = draw_panels(
        panels,
        direction_styles(joint),
        x_label=spec.sweep.label,
        unit=step_unit(joint),
        angle=spec.sweep.unit == "deg",
    )
    more = f" {count(left_out, 'further panel')} left out." if left_out else ""
    return make_picture(
        spec.key, spec.title, f"{spec.note} {write_caption(panels, rows, fit)}{more}".strip(), figure
    )


def direction_styles(joint: int) -> dict[str, PointStyle]:
    """The two directions as colours."""
    words = {"+": "outward", "-": "inward"} if joint == 3 else {"+": "increasing", "-": "decreasing"}
    return {sign: PointStyle(f"{way(sign)} ({words[sign]})", DIRECTION_COLOURS[sign]) for sign in ("+", "-")}


def write_caption(panels: Sequence[SweepPanel], rows: pd.DataFrame, fit: Result) -> str:
    """What the panels show, in numbers."""
    points = pd.concat([panel.points for panel in panels])
    joint = int(rows["joint"].iloc[0])
    unit = step_unit(joint)
    low, high = (from_si(value, unit) for value in (points["step_size"].min(), points["step_size"].max()))
    shown, left_out = points.index.nunique(), sum(panel.left_out for panel in panels)
    sessions = _describe_sessions(points["session"].nunique(), rows["session"].nunique())
    told = [f"{count(shown, 'traverse')} of {joint_name(joint)}{sessions}: {low:,.0f} to {high:,.0f} {unit}."]
    if left_out:
        told.append(f"{left_out:,} more are left out, by lot.")
    if points["departure"].notna().any():
        worst = rows.loc[points["departure"].abs().idxmax()]
        told.append(
            f"Furthest from the law: {format_percent(worst['departure'], signed=True)} in direction "
            f"{way(worst['direction'])}, {configuration(worst, fit.machine.span(joint))}."
        )
    if hidden := count_beyond_scale(panels):
        told.append(f"{count(hidden, 'point')} beyond the lower scale (×).")
    return " ".join(told)


def _describe_sessions(shown: int, all_of_them: int) -> str:
    if all_of_them == 1:
        return ""
    if all_of_them <= MAX_SESSIONS:
        return f" in {count(shown, 'session')}"
    return f" in the latest {shown} of {all_of_them} sessions"


LEVEL_Q2 = radians(-90.0)
ZETA_STYLES = {
    "base": PointStyle("base turned (psi), q2 = −90°", GREEN),
    "arm": PointStyle("arm turned (q2), psi = 0", PURPLE),
}

PRISMATIC_SWEEPS = (
    SweepFigure(
        key="prismatic-theta",
        title="Step size against theta at each q2, psi = 0",
        sweep=THETA,
        fixed={"psi": 0.0},
        by=("q2",),
        needed="joint 3 driven at psi = 0 for three or more theta, at one or more q2",
        note="As the base is turned on its side (theta = −90°) the load goes and recoil alone is left.",
    ),
    SweepFigure(
        key="prismatic-psi",
        title="Step size against psi, arm level (q2 = −90°, theta = 0)",
        sweep=PSI,
        fixed={"q2": LEVEL_Q2, "theta": 0.0},
        by=("q2",),
        needed="joint 3 driven at q2 = −90°, theta = 0 for three or more psi",
        note="Load without recoil.",
    ),
    SweepFigure(
        key="prismatic-q2",
        title="Step size against q2 at each theta, psi = 0",
        sweep=Q2,
        fixed={"psi": 0.0},
        by=("theta",),
        needed="joint 3 driven at psi = 0 for three or more q2, at theta = −90° and 0",
        note=(
            "At theta = −90° no load acts: what the step size loses as |cos q2| grows is recoil. At "
            "theta = 0 the load adds."
        ),
    ),
)


def prismatic_pictures(rows: pd.DataFrame, fit: Result) -> list[Picture]:
    """All sweep figures of joint 3."""
    theta, psi, q2 = (sweep_picture(spec, rows, fit) for spec in PRISMATIC_SWEEPS)
    return [theta, psi, zeta_picture(rows, fit), q2]


def zeta_picture(rows: pd.DataFrame, fit: Result) -> Picture:
    """Step size against zeta, turned to by the base or by the arm: the gap between the two is recoil."""
    key, title = "prismatic-zeta", "Step size against zeta = psi − q2 (theta = 0)"
    flat = select_fixed(rows, {"theta": 0.0})
    base = find_sweep_sessions(select_fixed(flat, {"q2": LEVEL_Q2}), ZETA_BY_BASE, ["q2"])
    arm = select_fixed(flat[flat["session"].isin(base["session"])], {"psi": 0.0})
    panels = []
    for direction, kind in direction_styles(3).items():
        by_base, by_arm = (part[part["direction"] == direction] for part in (base, arm))
        if min(by_base["psi"].nunique(), by_arm["q2"].nunique()) >= MIN_VALUES:
            turned_base = make_panel(kind.label, by_base.assign(kind="base"), ZETA_BY_BASE, fit, "kind")
            turned_arm = make_panel(kind.label, by_arm.assign(kind="arm"), ZETA_BY_ARM, fit, "kind")
            panels.append(overlay_panels(turned_base, turned_arm))
    if not panels:
        lacking = "joint 3 driven for three or more psi at q2 = −90° and for three or more q2 at psi = 0"
        return make_missing_picture(key, title, f"It would need {lacking}, all at theta = 0.")
    figure = draw_panels(panels, ZETA_STYLES, x_label=ZETA_BY_BASE.label, unit="nm", angle=True)
    note = (
        "Equal zeta is equal load: what lies between the two curves is recoil, which only turning the arm "
        "brings."
    )
    return make_picture(key, title, f"{note} {write_caption(panels, rows, fit)}", figure)


FULL_SWEEPS = {
    2: (
        SweepFigure(
            key="elbow-theta",
            title="Joint 2: mean step size of full traverses against theta at each q3, psi = 0",
            sweep=THETA,
            fixed={"psi": 0.0},
            by=("q3",),
            needed="full traverses of joint 2 at psi = 0 for three or more theta",
            note="The load goes with cos theta.",
        ),
        SweepFigure(
            key="elbow-psi",
            title="Joint 2: mean step size of full traverses against psi at each q3, theta = 0",
            sweep=PSI,
            fixed={"theta": 0.0},
            by=("q3",),
            needed="full traverses of joint 2 at theta = 0 for three or more psi",
            note="The base's tilt decides over which part of the traverse gravity helps.",
        ),
        SweepFigure(
            key="elbow-q3",
            title="Joint 2: mean step size of full traverses against q3 at each theta, psi = 0",
            sweep=Q3,
            fixed={"psi": 0.0},
            by=("theta",),
            needed="full traverses of joint 2 at psi = 0 for three or more q3, at theta = −90° and 0",
            note="The further the arm is out, the more inertia and gravity change the step.",
        ),
    ),
    1: (
        SweepFigure(
            key="base-theta",
            title="Joint 1: mean step size of full traverses against theta at each q2 and q3, psi = 0",
            sweep=THETA,
            fixed={"psi": 0.0},
            by=("q2", "q3"),
            needed="full traverses of joint 1 at psi = 0 for three or more theta",
            note="No load with the base level, most with the base on its side.",
        ),
        SweepFigure(
            key="base-psi",
            title="Joint 1: mean step size of full traverses against psi at each q2 and q3, theta = 0",
            sweep=PSI,
            fixed={"theta": 0.0},
            by=("q2", "q3"),
            needed="full traverses of joint 1 at theta = 0 for three or more psi",
            note="The load's swing grows with sin psi.",
        ),
    ),
}
PARTIAL_SWEEPS = {
    2: SweepFigure(
        key="elbow-zeta",
        title="Joint 2: step size along the traverse, psi = 0",
        sweep=ZETA_ALONG,
        fixed={"psi": 0.0},
        by=("theta", "q3"),
        needed="joint 2 driven in intervals of 30° at psi = 0, theta = 0",
        note="Under gravity the step size swings with sin zeta; with theta = −90° it should not.",
    ),
    1: SweepFigure(
        key="base-q1",
        title="Joint 1: step size along the traverse, psi = 0",
        sweep=Q1_ALONG,
        fixed={"psi": 0.0},
        by=("theta", "q2", "q3"),
        needed="joint 1 driven in intervals of 30° at psi = 0, theta = −90°",
        note="With theta = −90° the step size swings with cos q1; with the base level it should not.",
    ),
}


def rotary_pictures(rows: pd.DataFrame, fit: Result) -> list[Picture]:
    """All sweep figures of joint 1 or 2."""
    joint = int(rows["joint"].iloc[0])
    full = is_full(rows, fit.machine.span(joint))
    whole = [sweep_picture(spec, rows[full], fit) for spec in FULL_SWEEPS[joint]] if full.any() else []
    return [*whole, _make_partial_picture(PARTIAL_SWEEPS[joint], rows[~full], fit)]


def _make_partial_picture(spec: SweepFigure, rows: pd.DataFrame, fit: Result) -> Picture:
    """Partial traverses, those of the commonest length: the law's mean over an interval depends on it."""
    if rows.empty:
        return sweep_picture(spec, rows, fit)
    lengths = pd.Series(traverse_length(rows), index=rows.index).round(6)
    common = lengths.mode().iloc[0]
    title = f"{spec.title}, in intervals of {angle(common)}"
    return sweep_picture(replace(spec, title=title), rows[lengths == common], fit)
