"""Figure of a stage: one step in time, and the step size against one quantity at a time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
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
from stickslip_fit.step import StageAnalysis, StepSweep, quantity_of
from stickslip_fit.units import from_si

LABELS = {
    "load": ("load against the motion (m/s²)", "m/s²"),
    "mass": ("slider mass (g)", "g"),
    "voltage": ("voltage (V)", "V"),
    "preload": ("preload (N)", "N"),
    "ramp time": ("ramp time (ms)", "ms"),
}
COLUMNS = 2
FEW = 5  # points of a sweep


def draw_step(analysis: StageAnalysis) -> Figure:
    """Foot and slider, and friction, against time; below, a panel for each sweep."""
    panels = 2 + len(analysis.sweeps)
    rows = -(-panels // COLUMNS)
    legend = [
        make_legend_entry("foot", GREY, line="--"),
        make_legend_entry("slider, and the friction on it", BLUE, line="-"),
        make_legend_entry("step size", VERMILLION, line="-"),
        make_legend_entry("the stage as given", INK, marker="o"),
    ]
    with report_style():
        figure, axes = make_figure(
            [1.5] * rows, COLUMNS, legend, down=0.55, across=0.75, share_x="none", share_y="none"
        )
        flat = list(axes.flat)
        _draw_trace(flat[0], flat[1], analysis)
        for axis, sweep in zip(flat[2:], analysis.sweeps, strict=False):
            _draw_sweep(axis, sweep, analysis)
        for axis in flat[panels:]:
            axis.set_visible(False)
    return figure


def _draw_trace(motion: Axes, force: Axes, analysis: StageAnalysis) -> None:
    trace = analysis.trace
    time = from_si(trace.time, "ms")
    motion.plot(time, from_si(trace.foot, "nm"), color=GREY, linestyle="--")
    motion.plot(time, from_si(trace.slider, "nm"), color=BLUE)
    motion.set_ylabel("position (nm)")
    force.plot(time, from_si(trace.friction, "mN"), color=BLUE)
    force.set_ylabel("friction (mN)")
    for axis in (motion, force):
        axis.set_xlabel("time (ms)")


def _draw_sweep(axis: Axes, sweep: StepSweep, analysis: StageAnalysis) -> None:
    label, unit = LABELS[sweep.quantity]
    steps = from_si(sweep.steps, "nm")
    # With bristles a step takes time to compute: few points, which are marked.
    marker = "." if len(steps) <= FEW else ""
    axis.plot(from_si(sweep.values, unit), steps, color=VERMILLION, marker=marker)
    own = from_si(quantity_of(analysis.stage, sweep.quantity), unit)
    axis.plot(own, from_si(analysis.step, "nm"), color=INK, marker="o", linestyle="")
    low, high = min(0.0, float(np.nanmin(steps))), float(np.nanmax(steps))
    axis.set_ylim(1.08 * low, 1.08 * max(high, 1e-3))
    axis.set_xlabel(label)
    axis.set_ylabel("step size (nm)")
