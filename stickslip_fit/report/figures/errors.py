"""How far both models are from traverses that took no part in their calibration (thesis Ch. 7)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import joint_name
from stickslip_fit._format import pluralize as count
from stickslip_fit.fit import Result
from stickslip_fit.report.figures.picture import Picture, not_drawn, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    INK,
    LEGEND_LINE,
    TITLE_LINE,
    canvas,
    key_line,
    legend,
    look,
    plain_log,
)
from stickslip_fit.report.figures.traverses import repeatability_of

STEPS_A_CURVE = 300
SMALLEST = 0.02  # %


def errors_picture(errors: pd.DataFrame, calibration: Result, fit: Result) -> Picture:
    """Share of traverses that each model predicts to better than x."""
    key, title = "errors", "Error of a traverse not calibrated on: the law against a constant step"
    if errors.empty:
        return not_drawn(key, title, "It would need traverses beside those that the calibration uses.")
    joints = sorted(errors["joint"].unique())
    told = [
        f"{joint_name(joint)}: {percent(_within(errors, joint, 'law'))} by the law, "
        f"{percent(_within(errors, joint, 'constant'))} by the constant step"
        for joint in joints
    ]
    caption = (
        f"{count(len(errors), 'traverse')}. The further left, the better. Nine traverses in ten are "
        f"predicted to within: {'; '.join(told)}. Dotted: repeatability, which no law can beat."
    )
    noise = {
        (joint, sign): repeatability_of(joint, sign, calibration, fit).value
        for joint in joints
        for sign in ("+", "-")
    }
    return picture(key, title, caption, draw_errors(errors, noise))


def draw_errors(errors: pd.DataFrame, noise: dict[tuple[int, str], float]) -> Figure:
    """One panel for each joint."""
    joints = sorted(errors["joint"].unique())
    with look():
        entries = [
            *(
                key_line(f"direction {way(sign)}", colour, line="-")
                for sign, colour in DIRECTION_COLOURS.items()
            ),
            key_line("law", INK, line="-"),
            key_line("constant step", INK, line="--"),
            key_line("repeatability", INK, line=":"),
        ]
        figure, axes = canvas([2.2], len(joints), top=LEGEND_LINE + TITLE_LINE + 0.14, bottom=0.5)
        for axis, joint in zip(axes[0], joints, strict=True):
            axis.set_title(joint_name(joint))
            for direction, colour in DIRECTION_COLOURS.items():
                mine = errors[(errors["joint"] == joint) & (errors["direction"] == direction)]
                for model, line in (("law", "-"), ("constant", "--")):
                    axis.step(*_shares(mine, model), where="post", color=colour, ls=line)
                if np.isfinite(noise[joint, direction]):
                    axis.axvline(100 * noise[joint, direction], color=colour, ls=":", lw=1.0)
            plain_log(axis, (0.1, 1, 10, 100))
            axis.set_xlim(SMALLEST, 250)
            axis.set_ylim(0, 101)
        axes[0, 0].set_ylabel("traverses predicted better (%)")
        figure.supxlabel("error of the mean step size (%)", y=0.02, va="bottom", size=8, color=INK)
        legend(figure, entries)
    return figure


def _relative(errors: pd.DataFrame, model: str) -> np.ndarray:
    return np.sort(np.abs(errors[model] / errors["measured"] - 1.0).to_numpy())


def _within(errors: pd.DataFrame, joint: int, model: str) -> float:
    return float(np.quantile(_relative(errors[errors["joint"] == joint], model), 0.9))


def _shares(errors: pd.DataFrame, model: str) -> tuple[np.ndarray, np.ndarray]:
    """Error (%) and the share of traverses (%) that is no further off, at so many places as a curve needs."""
    sizes = np.maximum(100 * _relative(errors, model), SMALLEST)
    share = 100 * np.arange(1, len(sizes) + 1) / len(sizes) if len(sizes) else sizes
    keep = np.unique(np.linspace(0, len(sizes) - 1, min(len(sizes), STEPS_A_CURVE)).round().astype(int))
    return sizes[keep], share[keep]
