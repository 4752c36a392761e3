"""Figure of the accuracy map: the tip's error over the plane of the arm."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stickslip_fit.moves.accuracy_map import AccuracyMap
from stickslip_fit.plotting._style import TITLE_LINE, make_figure, report_style
from stickslip_fit.units import from_si


def draw_accuracy_map(accuracy: AccuracyMap) -> Figure:
    """A panel with joint 1 at its stop, and one with it halfway between its stops."""
    panels = [("joint 1 at its stop", accuracy.error)]
    if np.isfinite(accuracy.error_far).any():
        panels.append(("joint 1 halfway", accuracy.error_far))
    radius, height = (from_si(values, "mm") for values in (accuracy.radius, accuracy.height))
    with report_style():
        figure, axes = make_figure([2.9], 2, top=TITLE_LINE + 0.14, right=0.6, across=1.05, share_y="none")
        for axis, (title, error) in zip(axes[0], panels, strict=False):
            size = from_si(error, "µm")
            mesh = axis.pcolormesh(
                radius, height, size, vmin=0.0, shading="gouraud", cmap="viridis_r", rasterized=True
            )
            axis.set_title(title)
            axis.set_xlabel("distance from joint 1's axis (mm)")
            axis.set_aspect("equal")
            axis.grid(visible=False)
            bar = figure.colorbar(mesh, ax=axis, fraction=0.05, pad=0.03)
            bar.set_label("95 % error of the tip (µm)")
        axes[0, 0].set_ylabel("height above joint 1 (mm)")
        for axis in axes[0, len(panels) :]:
            axis.set_axis_off()
    return figure
