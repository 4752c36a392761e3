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

from stickslip_fit._format import (
    format_angle,
    format_configuration,
    format_coordinate,
    format_direction,
    format_percent,
    joint_name,
    pluralize,
    step_unit,
)
from stickslip_fit._typing import Array
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.identifiability import is_full
from stickslip_fit.laws import traverse_length
from stickslip_fit.plotting._style import (
    GREEN,
    INK,
    MARKERS,
    MAX_RECENT_SESSIONS,
    PURPLE,
    TITLE_LINE,
    PointStyle,
    direction_styles,
    make_figure,
    make_legend_entry,
    report_style,
    robust_limit,
    select_recent,
    set_angle_ticks,
    sweep_entries,
    thin_rows,
)
from stickslip_fit.plotting._svg import Picture, make_missing_picture, make_picture, name_traverses
from stickslip_fit.units import from_si

MAX_PANEL_POINTS = 400
MAX_TICKS = {1: 7, 2: 7, 3: 7, 4: 4}  # by the number of panels side by side
LIMIT_QUANTILE, LIMIT_ZOOM = 0.95, 3.0  # of the residuals' scale, see `robust_limit`
POSITION_TOL = 1e-6  # rad or m
MIN_VALUES = 3  # different places that make a sweep
MAX_PANELS = 7
CURVE_POINTS = 61


@dataclass(frozen=True)
class SweepPanel:
    """One column of the figure; the title says what is held fixed in it.

    Attributes
    ----------
    points : DataFrame
        x (the axis's unit), step_size, error, model, departure (SI), kind, session; half_width of the
        traverse in x, 0 where x does not run along it.
    curves : DataFrame
        x, step_size, kind, session: the law, one curve for each kind and session.
    left_out : int
        Traverses that are not among the points, since more would overlap.
    """

    title: str
    points: pd.DataFrame
    curves: pd.DataFrame
    left_out: int = 0


def draw_panels(
    panels: Sequence[SweepPanel], kinds: dict[str, PointStyle], *, x_label: str, unit: str, angle: bool
) -> Figure:
    """Panels side by side on common scales, step sizes in `unit`; with `angle`, x is in degrees."""
    sessions = list(dict.fromkeys(session for panel in panels for session in panel.points["session"]))
    lines = max(panel.title.count("\n") + 1 for panel in panels)
    with report_style():
        legend = [*sweep_entries(kinds, sessions), make_legend_entry("law (least squares)", INK, line="-")]
        figure, axes = make_figure([1.75, 1.0], len(panels), legend, top=TITLE_LINE * lines + 0.14)
        limit = _residual_limit(pd.concat([panel.points for panel in panels]))
        for column, panel in enumerate(panels):
            above, below = axes[:, column]
            above.set_title(panel.title)
            _draw_step_sizes(above, panel, kinds, sessions, unit)
            _draw_residuals(below, panel, kinds, sessions, limit)
            if angle:
                x = panel.points["x"]
                set_angle_ticks(below, x.min(), x.max(), MAX_TICKS.get(len(panels), 3))
        axes[0, 0].set_ylabel(f"mean step size ({unit})")
        axes[1, 0].set_ylabel("residual (%)")
        figure.align_ylabels(axes[:, 0])
        figure.supxlabel(x_label, y=0.02, va="bottom", size=8, color=INK)
    return figure


def _draw_step_sizes(
    axes: Axes, panel: SweepPanel, kinds: dict[str, PointStyle], sessions: list[str], unit: str
) -> None:
    for (kind, _), curve in panel.curves.groupby(["kind", "session"], sort=False, observed=True):
        axes.plot(curve["x"], from_si(curve["step_size"].to_numpy(), unit), color=kinds[kind].colour, lw=0.9)
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        markers, *_ = axes.errorbar(
            points["x"],
            from_si(points["step_size"].to_numpy(), unit),
            yerr=from_si(points["error"].to_numpy(), unit),
            xerr=points["half_width"] if points["half_width"].any() else None,
            **_choose_style(kinds[kind], sessions.index(session)),
        )
        name_traverses(markers, points.index)


def _draw_residuals(
    axes: Axes, panel: SweepPanel, kinds: dict[str, PointStyle], sessions: list[str], limit: float
) -> None:
    axes.axhline(0.0, color=INK, lw=0.8, zorder=1)
    axes.set_ylim(-limit, limit)
    places = np.unique(panel.points["x"].round(6))
    spacing = 0.5 * float(np.min(np.diff(places))) if len(places) > 1 else 1.0
    n_offsets = len(kinds) * len(sessions)
    for (kind, session), points in panel.points.groupby(["kind", "session"], sort=False, observed=True):
        order = list(kinds).index(kind) * len(sessions) + sessions.index(session)
        x = points["x"] + spacing * (order - (n_offsets - 1) / 2) / n_offsets
        residual = 100 * points["departure"].to_numpy()
        y = np.clip(residual, -limit, limit)
        beyond = y != residual
        error = np.where(beyond, 0.0, 100 * (points["error"] / points["step_size"]).to_numpy())
        markers, *_ = axes.errorbar(x, y, yerr=error, **_choose_style(kinds[kind], sessions.index(session)))
        name_traverses(markers, points.index)
        axes.plot(x[beyond], y[beyond], ls="", marker="x", ms=6, color=INK, clip_on=False)


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
    """Half the residuals' scale, %: wide enough for all points but a few that are far out."""
    sizes = 100 * (points["departure"].abs() + points["error"] / points["step_size"]).dropna().to_numpy()
    return robust_limit(sizes, LIMIT_QUANTILE, LIMIT_ZOOM, margin=1.1) if len(sizes) else 1.0


def count_beyond_scale(panels: Sequence[SweepPanel]) -> int:
    """How many points the residuals' scale leaves out; a caption should say so."""
    points = pd.concat([panel.points for panel in panels])
    return int((100 * points["departure"].abs() > _residual_limit(points)).sum())


@dataclass(frozen=True)
class Sweep:
    """The coordinate along x.

    Attributes
    ----------
    read : callable
        Its value in each row, SI.
    move : callable
        The same rows with it set to other values, SI.
    along : bool
        Whether it runs along the traverse, which then has a width on the axis.
    """

    name: str
    read: Callable[[pd.DataFrame], Array]
    move: Callable[[pd.DataFrame, Array], pd.DataFrame]
    unit: str = "deg"
    along: bool = False

    @property
    def label(self) -> str:
        """Axis label."""
        return f"{self.name} ({'°' if self.unit == 'deg' else self.unit})"


def _make_column_sweep(name: str, unit: str = "deg") -> Sweep:
    return Sweep(
        name, lambda rows: rows[name].to_numpy(float), lambda rows, x: rows.assign(**{name: x}), unit
    )


def _move_centre(rows: pd.DataFrame, centre: pd.Series[float] | Array) -> pd.DataFrame:
    half = (rows["stop"] - rows["start"]) / 2
    return rows.assign(start=centre - half, stop=centre + half)


THETA, PSI, Q2 = map(_make_column_sweep, ("theta", "psi", "q2"))
Q3 = _make_column_sweep("q3", "mm")
ZETA_BY_BASE = Sweep(
    "zeta = psi − q2",
    lambda rows: (rows["psi"] - rows["q2"]).to_numpy(float),
    lambda rows, x: rows.assign(psi=rows["q2"] + x),
)
ZETA_BY_ARM = replace(ZETA_BY_BASE, move=lambda rows, x: rows.assign(q2=rows["psi"] - x))
ZETA_ALONG = Sweep(
    "zeta = psi − q2 at the middle of the interval",
    lambda rows: (rows["psi"] - rows["centre"]).to_numpy(float),
    lambda rows, x: _move_centre(rows, rows["psi"] - x),
    along=True,
)
Q1_ALONG = Sweep(
    "q1 at the middle of the interval", lambda rows: rows["centre"].to_numpy(float), _move_centre, along=True
)


def select_fixed(rows: pd.DataFrame, fixed: dict[str, float]) -> pd.DataFrame:
    """The rows whose columns have the fixed values."""
    for name, value in fixed.items():
        rows = rows[np.abs(rows[name].to_numpy(float) - value) < POSITION_TOL]
    return rows


def make_panels(rows: pd.DataFrame, sweep: Sweep, by: list[str], fit: Result) -> tuple[list[SweepPanel], int]:
    """One panel for each value of the columns `by` at which the rows sweep far enough.

    Returns
    -------
    panels, left_out
        At most `MAX_PANELS`, spread evenly, and how many more there would have been.
    """
    rows = find_sweep_sessions(rows, sweep, by)
    groups = dict(list(rows.groupby(by)))
    swept = rows.loc[_is_swept(rows, sweep, by), by].drop_duplicates().itertuples(index=False)
    values = sorted(swept, key=lambda row: list(map(abs, row)))
    chosen = np.unique(np.linspace(0, len(values) - 1, min(len(values), MAX_PANELS)).round().astype(int))
    panels = []
    for k in chosen:
        titles = [format_coordinate(*one, fit.machine) for one in zip(by, values[k], strict=True)]
        panels.append(make_panel("\n".join(titles), groups[tuple(values[k])], sweep, fit))
    return panels, len(values) - len(panels)


def find_sweep_sessions(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.DataFrame:
    """The latest sessions that make the sweep by themselves; where none does, the latest of all."""
    sessions = rows.loc[_is_swept(rows, sweep, ["session", *by]), "session"].unique()
    return select_recent(rows[rows["session"].isin(sessions)] if len(sessions) else rows)


def _is_swept(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.Series[bool]:
    """Whether x takes enough different values among the rows of the same direction and the same `by`."""
    x = pd.Series(sweep.read(rows).round(6), index=rows.index)
    keys = [rows[name] for name in [*by, "direction"]]
    return x.groupby(keys, observed=True).transform("nunique") >= MIN_VALUES


def make_panel(
    title: str, rows: pd.DataFrame, sweep: Sweep, fit: Result, kind: str = "direction"
) -> SweepPanel:
    """Rows as a panel, coloured by the column `kind`."""
    sample, to_unit = thin_rows(rows, MAX_PANEL_POINTS), partial(from_si, symbol=sweep.unit)
    half = np.abs(to_unit((sample["stop"] - sample["start"]).to_numpy(float))) / 2
    points = sample[["step_size", "error", "model", "departure", "session"]].assign(
        x=to_unit(sweep.read(sample)), kind=sample[kind], half_width=half if sweep.along else 0.0
    )
    curves = compute_curves(rows, sweep, fit, kind)
    curves["x"] = to_unit(curves["x"].to_numpy(float))
    return SweepPanel(title, points, curves, left_out=len(rows) - len(sample))


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
            "step_size": fit.si.predict(moved)["step_size"].to_numpy(),
            "kind": moved[kind],
            "session": moved["session"],
        }
    )


@dataclass(frozen=True)
class SweepFigure:
    """One sweep figure: columns fixed in all of it (SI) and by panel, the traverses needed, what to see."""

    key: str
    title: str
    sweep: Sweep
    fixed: dict[str, float]
    by: tuple[str, ...]
    needed: str
    note: str


def sweep_picture(spec: SweepFigure, rows: pd.DataFrame, fit: Result) -> Picture:
    """Draw a sweep from the rows of one joint, or say which traverses it would need."""
    panels, left_out = make_panels(select_fixed(rows, spec.fixed), spec.sweep, list(spec.by), fit)
    if not panels:
        return make_missing_picture(spec.key, spec.title, f"It would need {spec.needed}.")
    joint = int(rows["joint"].iloc[0])
    figure = draw_panels(
        panels,
        direction_styles(joint, fit.machine),
        x_label=spec.sweep.label,
        unit=step_unit(joint, fit.machine),
        angle=spec.sweep.unit == "deg",
    )
    more = f" {pluralize(left_out, 'further panel')} left out." if left_out else ""
    return make_picture(spec.key, spec.title, f"{spec.note} {write_caption(panels, rows, fit)}{more}", figure)


def write_caption(panels: Sequence[SweepPanel], rows: pd.DataFrame, fit: Result) -> str:
    """What the panels show, in numbers."""
    points = pd.concat([panel.points for panel in panels])
    joint = int(rows["joint"].iloc[0])
    unit, size = step_unit(joint, fit.machine), points["step_size"]
    low, high = from_si(size.min(), unit), from_si(size.max(), unit)
    n_traverses, left_out = points.index.nunique(), sum(panel.left_out for panel in panels)
    n_shown, n_sessions = points["session"].nunique(), rows["session"].nunique()
    sessions = f" in {pluralize(n_shown, 'session')}" if n_sessions > 1 else ""
    if n_sessions > MAX_RECENT_SESSIONS:
        sessions = f" in the latest {n_shown} of {n_sessions} sessions"
    traverses = f"{pluralize(n_traverses, 'traverse')} of {joint_name(joint, fit.machine)}{sessions}"
    sentences = [f"{traverses}: {low:,.0f} to {high:,.0f} {unit}."]
    if left_out:
        sentences.append(f"{left_out:,} more are left out at random.")
    if points["departure"].notna().any():
        worst = rows.loc[points["departure"].abs().idxmax()]
        sentences.append(
            f"Furthest from the law: {format_percent(worst['departure'], signed=True)} in direction "
            f"{format_direction(worst['direction'])}, {format_configuration(worst, fit.machine)}."
        )
    if n_beyond := count_beyond_scale(panels):
        sentences.append(f"{pluralize(n_beyond, 'point')} beyond the lower scale (×).")
    return " ".join(sentences)


LEVEL_Q2 = radians(-90.0)
ZETA_STYLES = {
    "base": PointStyle("base turned (psi), q2 = −90°", GREEN),
    "arm": PointStyle("arm turned (q2), psi = 0", PURPLE),
}

PRISMATIC_SWEEPS = (
    SweepFigure(
        "prismatic-theta",
        "Step size against theta at each q2, psi = 0",
        THETA,
        {"psi": 0.0},
        ("q2",),
        "joint 3 driven at psi = 0 for three or more theta, at one or more q2",
        "As the base is turned on its side (theta = −90°) the load goes and recoil alone is left.",
    ),
    SweepFigure(
        "prismatic-psi",
        "Step size against psi, arm level (q2 = −90°, theta = 0)",
        PSI,
        {"q2": LEVEL_Q2, "theta": 0.0},
        ("q2",),
        "joint 3 driven at q2 = −90°, theta = 0 for three or more psi",
        "Load without recoil.",
    ),
    SweepFigure(
        "prismatic-q2",
        "Step size against q2 at each theta, psi = 0",
        Q2,
        {"psi": 0.0},
        ("theta",),
        "joint 3 driven at psi = 0 for three or more q2, at theta = −90° and 0",
        "At theta = −90° no load acts: what the step size loses as |cos q2| grows is recoil. At theta = 0 "
        "the load adds.",
    ),
)


def prismatic_pictures(rows: pd.DataFrame, fit: Result) -> list[Picture]:
    """All sweep figures of joint 3."""
    theta, psi, q2 = (sweep_picture(spec, rows, fit) for spec in PRISMATIC_SWEEPS)
    return [theta, psi, zeta_picture(rows, fit), q2]


def zeta_picture(rows: pd.DataFrame, fit: Result) -> Picture:
    """Step size against zeta, by turning the base or the arm: the gap between the two curves is recoil."""
    key, title = "prismatic-zeta", "Step size against zeta = psi − q2 (theta = 0)"
    flat = select_fixed(rows, {"theta": 0.0})
    base = find_sweep_sessions(select_fixed(flat, {"q2": LEVEL_Q2}), ZETA_BY_BASE, ["q2"])
    arm = select_fixed(flat[flat["session"].isin(base["session"])], {"psi": 0.0})
    panels = []
    for direction, kind in direction_styles(3, fit.machine).items():
        by_base, by_arm = (part[part["direction"] == direction] for part in (base, arm))
        if min(by_base["psi"].nunique(), by_arm["q2"].nunique()) >= MIN_VALUES:
            turned_base = make_panel(kind.label, by_base.assign(kind="base"), ZETA_BY_BASE, fit, "kind")
            turned_arm = make_panel(kind.label, by_arm.assign(kind="arm"), ZETA_BY_ARM, fit, "kind")
            panels.append(
                SweepPanel(
                    kind.label,
                    pd.concat([turned_base.points, turned_arm.points]),
                    pd.concat([turned_base.curves, turned_arm.curves]),
                    turned_base.left_out + turned_arm.left_out,
                )
            )
    if not panels:
        lacking = "joint 3 driven for three or more psi at q2 = −90° and for three or more q2 at psi = 0"
        return make_missing_picture(key, title, f"It would need {lacking}, all at theta = 0.")
    figure = draw_panels(panels, ZETA_STYLES, x_label=ZETA_BY_BASE.label, unit="nm", angle=True)
    note = (
        "Equal zeta is equal load: what lies between the two curves is recoil, which only turning the arm "
        "brings."
    )
    return make_picture(key, title, f"{note} {write_caption(panels, rows, fit)}", figure)


def _full_sweep(joint: int, coordinate: str, fixed: str, by: tuple[str, ...], note: str) -> SweepFigure:
    sweep = {"theta": THETA, "psi": PSI, "q3": Q3}[coordinate]
    extra = ", at theta = −90° and 0" if by == ("theta",) else ""
    return SweepFigure(
        f"{'elbow' if joint == 2 else 'base'}-{coordinate}",
        f"Joint {joint}: mean step size of full traverses against {coordinate} at each {' and '.join(by)}, "
        f"{fixed} = 0",
        sweep,
        {fixed: 0.0},
        by,
        f"full traverses of joint {joint} at {fixed} = 0 for three or more {coordinate}{extra}",
        note,
    )


FULL_SWEEPS = {
    2: (
        _full_sweep(2, "theta", "psi", ("q3",), "The load goes with cos theta."),
        _full_sweep(
            2,
            "psi",
            "theta",
            ("q3",),
            "The base's tilt decides over which part of the traverse gravity helps.",
        ),
        _full_sweep(
            2,
            "q3",
            "psi",
            ("theta",),
            "The further the arm is out, the more inertia and gravity change the step.",
        ),
    ),
    1: (
        _full_sweep(
            1, "theta", "psi", ("q2", "q3"), "No load with the base level, most with the base on its side."
        ),
        _full_sweep(1, "psi", "theta", ("q2", "q3"), "The load's swing grows with sin psi."),
    ),
}
PARTIAL_SWEEPS = {
    2: SweepFigure(
        "elbow-zeta",
        "Joint 2: step size along the traverse, psi = 0",
        ZETA_ALONG,
        {"psi": 0.0},
        ("theta", "q3"),
        "joint 2 driven in intervals of 30° at psi = 0, theta = 0",
        "Under gravity the step size swings with sin zeta; with theta = −90° it should not.",
    ),
    1: SweepFigure(
        "base-q1",
        "Joint 1: step size along the traverse, psi = 0",
        Q1_ALONG,
        {"psi": 0.0},
        ("theta", "q2", "q3"),
        "joint 1 driven in intervals of 30° at psi = 0, theta = −90°",
        "With theta = −90° the step size swings with cos q1; with the base level it should not.",
    ),
}


def rotary_pictures(rows: pd.DataFrame, fit: Result) -> list[Picture]:
    """All sweep figures of joint 1 or 2."""
    joint = int(rows["joint"].iloc[0])
    full = is_full(rows, fit.machine.span(joint))
    pictures = [sweep_picture(spec, rows[full], fit) for spec in FULL_SWEEPS[joint]] if full.any() else []
    spec, partial_rows = PARTIAL_SWEEPS[joint], rows[~full]
    if len(partial_rows):
        # The law's mean over an interval depends on its length: those of the commonest length alone.
        lengths = pd.Series(traverse_length(partial_rows), index=partial_rows.index).round(6)
        common = lengths.mode().iloc[0]
        spec = replace(spec, title=f"{spec.title}, in intervals of {format_angle(common)}")
        partial_rows = partial_rows[lengths == common]
    return [*pictures, sweep_picture(spec, partial_rows, fit)]
