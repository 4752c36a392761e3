"""Figure of a drive: how surely the tip is known, and how far it truly is from there."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from stickslip_fit.plotting._style import (
    BLUE,
    GREY,
    INK,
    VERMILLION,
    make_figure,
    make_legend_entry,
    report_style,
)


def draw_drive(table: pd.DataFrame, tolerance: float) -> Figure:
    """The 95 % radius and the true error over time, with the moment of the first advice.

    Parameters
    ----------
    table : DataFrame
        Of `DriveTrace`.
    tolerance : float
        µm.
    """
    advised = table["time_s"][table["advice"] != ""]
    legend = [
        make_legend_entry("95 % radius, as shown", BLUE, line="-"),
        make_legend_entry("true error of the tip", VERMILLION, line="-"),
        make_legend_entry("tolerance", INK, line="--"),
        *([make_legend_entry("first advice to go back to a stop", GREY, line=":")] if len(advised) else []),
    ]
    with report_style():
        figure, axes = make_figure([2.0], 1, legend, top=0.1, bottom=0.5)
        axis = axes[0, 0]
        axis.plot(table["time_s"], table["radius_um"], color=BLUE)
        axis.plot(table["time_s"], table["error_um"], color=VERMILLION)
        axis.axhline(tolerance, color=INK, ls="--", lw=0.9)
        if len(advised):
            axis.axvline(advised.iloc[0], color=GREY, ls=":", lw=1.2)
        axis.set_ylim(0.0, 1.15 * max(tolerance, table["radius_um"].max(), table["error_um"].max()))
        axis.set_xlabel("time (s)")
        axis.set_ylabel("distance (µm)")
    return figure
