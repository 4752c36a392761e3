"""Which causes a plan would confuse: one cell for each pair."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from stickslip_fit.diagnose.experiments.matrix import CONFUSED, Matrix
from stickslip_fit.report.figures.drawing import on_white
from stickslip_fit.report.figures.style import INK, LETTER_WIDTH, VERMILLION, WIDTH, canvas, look

WORST = 0.5  # a coin
DARK = 0.3  # beyond, numbers are white
TITLE = 0.3  # inches


def plot_separability(found: Matrix, strength: float) -> Figure:
    """Rate of confusion of each pair of causes, at one strength.

    Parameters
    ----------
    found : Matrix
        Of two causes or more.
    strength : float
    """
    causes = found.causes
    margin = 0.15 + LETTER_WIDTH * max(map(len, causes))
    cell = (WIDTH - margin - 0.1) / (len(causes) - 1)
    rates = np.full((len(causes) - 1, len(causes) - 1), np.nan)
    for row, one in enumerate(causes[1:]):
        for column, other in enumerate(causes[: row + 1]):
            rates[row, column] = found.rate(one, other, strength)
    with look():
        figure, axes = canvas(
            [min(cell, 0.3) * len(rates)], 1, left=margin, right=0.1, top=TITLE, bottom=margin
        )
        axis = axes[0, 0]
        colours = LinearSegmentedColormap.from_list("confused", ["#f7f7f4", VERMILLION])
        axis.imshow(rates, cmap=colours, vmin=0.0, vmax=WORST, aspect="auto")
        for row, column in zip(*np.nonzero(rates >= CONFUSED), strict=True):
            rate = rates[row, column]
            colour = "white" if rate > DARK else INK
            axis.text(column, row, f"{100 * rate:.0f}", ha="center", va="center", fontsize=6.5, color=colour)
        axis.set_xticks(range(len(rates)), causes[:-1], rotation=90)
        axis.set_yticks(range(len(rates)), causes[1:])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        for side in ("left", "bottom"):
            axis.spines[side].set_visible(False)
        figure.suptitle(
            f"Logs in which the two are confused (%), effects of strength {strength:.0f}; "
            f"numbers from {100 * CONFUSED:.0f} %",
            x=0.01, y=0.995, ha="left", va="top",
        )  # fmt: skip
    return on_white(figure)
