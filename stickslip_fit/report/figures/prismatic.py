"""The prismatic joint's sweeps, after the thesis's Figs. 4.4 to 4.13."""

from __future__ import annotations

from math import radians

import pandas as pd

from stickslip_fit.fit import Result
from stickslip_fit.report.figures.panels import Kind, draw_panels, overlaid
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import GREEN, PURPLE
from stickslip_fit.report.figures.sweep_picture import SweepFigure, caption, direction_kinds, sweep_picture
from stickslip_fit.report.figures.sweeps import (
    FEWEST,
    PSI,
    Q2,
    THETA,
    ZETA_BY_ARM,
    ZETA_BY_BASE,
    held,
    panel_of,
    sweeping_sessions,
)

LEVEL = radians(-90.0)
TURNED = {
    "base": Kind("base turned (psi), q2 = −90°", GREEN),
    "arm": Kind("arm turned (q2), psi = 0", PURPLE),
}

SWEEPS = (
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
        fixed={"q2": LEVEL, "theta": 0.0},
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
    theta, psi, q2 = (sweep_picture(spec, rows, fit) for spec in SWEEPS)
    return [theta, psi, zeta_picture(rows, fit), q2]


def zeta_picture(rows: pd.DataFrame, fit: Result) -> Picture:
    """Step size against zeta, turned to by the base or by the arm: the gap between the two is recoil."""
    key, title = "prismatic-zeta", "Step size against zeta = psi − q2 (theta = 0)"
    flat = held(rows, {"theta": 0.0})
    base = sweeping_sessions(held(flat, {"q2": LEVEL}), ZETA_BY_BASE, ["q2"])
    arm = held(flat[flat["session"].isin(base["session"])], {"psi": 0.0})
    panels = []
    for direction, kind in direction_kinds(3).items():
        by_base, by_arm = (part[part["direction"] == direction] for part in (base, arm))
        if min(by_base["psi"].nunique(), by_arm["q2"].nunique()) >= FEWEST:
            turned_base = panel_of(kind.label, by_base.assign(kind="base"), ZETA_BY_BASE, fit, "kind")
            turned_arm = panel_of(kind.label, by_arm.assign(kind="arm"), ZETA_BY_ARM, fit, "kind")
            panels.append(overlaid(turned_base, turned_arm))
    if not panels:
        lacking = "joint 3 driven for three or more psi at q2 = −90° and for three or more q2 at psi = 0"
        return not_drawn(key, title, f"It would need {lacking}, all at theta = 0.")
    figure = draw_panels(panels, TURNED, x_label=ZETA_BY_BASE.label, unit="nm", angle=True)
    note = (
        "Equal zeta is equal load: what lies between the two curves is recoil, which only turning the arm "
        "brings."
    )
    return picture(key, title, f"{note} {caption(panels, rows, fit)}", figure)
