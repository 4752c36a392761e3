"""Sweeps of one quantity with the others held: which traverses belong to one, and the law along it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_coordinate as place
from stickslip_fit.fit import Result
from stickslip_fit.report.figures.panels import POINTS_A_PANEL, Panel
from stickslip_fit.report.figures.traverses import recent, thinned
from stickslip_fit.units import from_si

Array = npt.NDArray[np.float64]

SAME_PLACE = 1e-6  # rad or m
FEWEST = 3  # different places that make a sweep
MOST_PANELS = 7
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


def _column(name: str, unit: str) -> Sweep:
    return Sweep(
        name, unit, lambda rows: rows[name].to_numpy(float), lambda rows, x: rows.assign(**{name: x})
    )


def _centred(rows: pd.DataFrame, centre: pd.Series[float] | Array) -> pd.DataFrame:
    half = (rows["stop"] - rows["start"]) / 2
    return rows.assign(start=centre - half, stop=centre + half)


THETA, PSI, Q2, Q3 = _column("theta", "deg"), _column("psi", "deg"), _column("q2", "deg"), _column("q3", "mm")
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
    lambda rows, x: _centred(rows, rows["psi"] - x),
    along=True,
)
Q1_ALONG = Sweep(
    "q1 at the middle of the interval",
    "deg",
    lambda rows: rows["centre"].to_numpy(float),
    _centred,
    along=True,
)


def held(rows: pd.DataFrame, fixed: dict[str, float]) -> pd.DataFrame:
    """The rows whose columns have the fixed values."""
    mask = np.ones(len(rows), dtype=bool)
    for name, value in fixed.items():
        mask &= np.abs(rows[name].to_numpy(float) - value) < SAME_PLACE
    return rows[mask]


def panels_of(rows: pd.DataFrame, sweep: Sweep, by: list[str], fit: Result) -> tuple[list[Panel], int]:
    """One panel for each value of the columns `by` at which the rows sweep far enough.

    Returns
    -------
    panels, left_out
        At most `MOST_PANELS`, spread evenly, and how many more there would have been.
    """
    rows = sweeping_sessions(rows, sweep, by)
    groups = dict(list(rows.groupby(by)))
    found = sorted(
        rows.loc[_sweeps(rows, sweep, by), by].drop_duplicates().itertuples(index=False), key=_size
    )
    chosen = np.unique(np.linspace(0, len(found) - 1, min(len(found), MOST_PANELS)).round().astype(int))
    panels = [
        panel_of("\n".join(map(place, by, found[k])), groups[tuple(found[k])], sweep, fit) for k in chosen
    ]
    return panels, len(found) - len(panels)


def sweeping_sessions(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.DataFrame:
    """The latest sessions that make the sweep; where it only comes about over several, the latest of all."""
    sweeping = rows.loc[_sweeps(rows, sweep, ["session", *by]), "session"].unique()
    return recent(rows[rows["session"].isin(sweeping)] if len(sweeping) else rows)


def _sweeps(rows: pd.DataFrame, sweep: Sweep, by: list[str]) -> pd.Series[bool]:
    """Whether x takes enough different values among the rows of the same direction and the same `by`."""
    x = pd.Series(sweep.read(rows).round(6), index=rows.index)
    keys = [rows[name] for name in [*by, "direction"]]
    return x.groupby(keys, observed=True).transform("nunique") >= FEWEST


def _size(values: tuple[float, ...]) -> list[float]:
    return [abs(value) for value in values]


def panel_of(title: str, rows: pd.DataFrame, sweep: Sweep, fit: Result, kind: str = "direction") -> Panel:
    """Rows as a panel, coloured by the column `kind`."""
    shown = thinned(rows, POINTS_A_PANEL)
    to_people = partial(from_si, symbol=sweep.unit)
    half = np.abs(to_people((shown["stop"] - shown["start"]).to_numpy(float))) / 2
    points = shown[["step_size", "error", "model", "departure", "session"]].assign(
        x=to_people(sweep.read(shown)), kind=shown[kind], half_width=half if sweep.along else 0.0
    )
    curves = curves_of(rows, sweep, fit, kind)
    curves["x"] = to_people(curves["x"].to_numpy(float))
    return Panel(title, points, curves, left_out=len(rows) - len(shown))


def curves_of(rows: pd.DataFrame, sweep: Sweep, fit: Result, kind: str = "direction") -> pd.DataFrame:
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
