"""The configurations in which the law is worst, beside the constant step there."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from stickslip_fit._format import format_configuration as configuration
from stickslip_fit._format import format_direction as way
from stickslip_fit._format import format_percent as percent
from stickslip_fit._format import joint_name
from stickslip_fit.report.figures.picture import Picture, picture
from stickslip_fit.report.figures.style import (
    DIRECTION_COLOURS,
    INK,
    LEGEND_LINE,
    LETTER_WIDTH,
    canvas,
    key_line,
    legend,
    look,
    plain_log,
)

WORST_SHOWN = 12
SMALLEST = 0.02  # %


def configurations_picture(summary: pd.DataFrame, machine_span: float) -> Picture:
    """The configurations in which the law is worst.

    Parameters
    ----------
    summary : DataFrame
        As `fit.summarise` returns it for one joint, by direction and configuration.
    machine_span : float
        Full travel of the joint, rad or m.
    """
    joint = int(summary["joint"].iloc[0])
    shown = summary.sort_values("law_rms_relative", ascending=False).head(WORST_SHOWN)
    labels = [f"{configuration(row, machine_span)} ({way(row['direction'])})" for _, row in shown.iterrows()]
    first = shown.iloc[0]
    title = f"Error by configuration, worst first, {joint_name(joint)}"
    caption = (
        f"The {len(shown)} of {len(summary):,} configurations and directions in which the law is furthest "
        f"off (rms over sessions and replicates). Worst: {percent(first['law_rms_relative'])} at "
        f"{labels[0]}; a constant step is off by {percent(first['constant_rms_relative'])} there."
    )
    return picture(f"configurations-{joint}", title, caption, draw_configurations(shown, labels))


def draw_configurations(summary: pd.DataFrame, labels: list[str]) -> Figure:
    """One line of dots for each row of the summary."""
    y = np.arange(len(summary))[::-1]
    law, constant = (
        np.maximum(100 * summary[f"{model}_rms_relative"].to_numpy(), SMALLEST)
        for model in ("law", "constant")
    )
    left = 0.2 + LETTER_WIDTH * max(map(len, labels))
    colours = [DIRECTION_COLOURS[sign] for sign in summary["direction"]]
    with look():
        entries = [
            *(
                key_line(f"direction {way(sign)}", colour, marker="o")
                for sign, colour in DIRECTION_COLOURS.items()
            ),
            key_line("law", INK, marker="o"),
            key_line("constant step", INK, marker="o"),
        ]
        entries[-1].set_markerfacecolor("white")
        figure, axes = canvas(
            [0.19 * len(summary) + 0.1], 1, left=left, top=LEGEND_LINE + 0.1, bottom=0.42, right=0.15
        )
        axis = axes[0, 0]
        axis.hlines(y, law, constant, color="#cccccc", lw=1.0, zorder=1)
        axis.scatter(law, y, c=colours, s=18, zorder=2)
        axis.scatter(constant, y, facecolors="white", edgecolors=colours, s=18, linewidths=0.9, zorder=2)
        axis.set_yticks(y, labels)
        axis.set_ylim(-0.6, len(summary) - 0.4)
        plain_log(axis, (0.1, 1, 10, 100))
        axis.set_xlabel("rms error of the mean step size (%)")
        axis.spines["left"].set_visible(False)
        axis.tick_params(axis="y", length=0)
        axis.grid(visible=False, axis="y")
        legend(figure, entries)
    return figure
