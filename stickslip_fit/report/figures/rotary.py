"""The rotary joints' sweeps, after the thesis's Figs. 5.5 to 5.7."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from stickslip_fit._format import format_angle as angle
from stickslip_fit.fit import Result
from stickslip_fit.laws import travel
from stickslip_fit.report.figures.picture import Picture
from stickslip_fit.report.figures.sweep_picture import SweepFigure, sweep_picture
from stickslip_fit.report.figures.sweeps import PSI, Q1_ALONG, Q3, THETA, ZETA_ALONG
from stickslip_fit.report.figures.traverses import is_full

FULL = {
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
PARTS = {
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
    whole = [sweep_picture(spec, rows[full], fit) for spec in FULL[joint]] if full.any() else []
    return [*whole, _along(PARTS[joint], rows[~full], fit)]


def _along(spec: SweepFigure, rows: pd.DataFrame, fit: Result) -> Picture:
    """Partial traverses, those of the commonest length: the law's mean over an interval depends on it."""
    if rows.empty:
        return sweep_picture(spec, rows, fit)
    lengths = pd.Series(travel(rows), index=rows.index).round(6)
    common = lengths.mode().iloc[0]
    title = f"{spec.title}, in intervals of {angle(common)}"
    return sweep_picture(replace(spec, title=title), rows[lengths == common], fit)
