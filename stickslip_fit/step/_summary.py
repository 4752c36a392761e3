"""A stage's step in a few lines, and its tables."""

from __future__ import annotations

from math import isfinite, isnan

import numpy as np

from stickslip_fit._format import MINUS, MISSING, format_number, format_plain, format_significant
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit._typing import Array
from stickslip_fit.step.analysis import FACTORS, LOADS, StageAnalysis
from stickslip_fit.step.stage import GRAVITY, StepSweep, quantity_of
from stickslip_fit.units import from_si

UNIT_OF = {"load": "m/s²", "mass": "g", "voltage": "V", "preload": "N", "ramp time": "ms"}
ROWS = 40  # of the step in time
NAMES = {
    "coulomb": "Coulomb friction",
    "lugre": "LuGre friction",
    "dahl": "Dahl friction",
    "elastoplastic": "elastoplastic friction",
    "maxwell-slip": "Maxwell-slip friction",
}


@summarize.register
def summarize_stage(analysis: StageAnalysis) -> Summary:
    """The step and its regime first; then what it depends on."""
    use = (_in_use(analysis),) if analysis.in_use else ()
    tables = (_dependence(analysis), *use, _loads(analysis), *map(_sweep, analysis.sweeps), _trace(analysis))
    return Summary(
        title=f"The step of {analysis.stage.name}",
        headline=tuple(_headline(analysis)),
        sections=(Section(tables=tables),),
        flags=tuple(_flags(analysis)),
    )


def _headline(analysis: StageAnalysis) -> list[str]:
    stage = analysis.stage
    lines = [f"{stage.name}: a step of {_nm(analysis.step)} nm with {NAMES[stage.contact.model]}."]
    if stage.has_ramp and stage.is_rigid:
        ratio = stage.load / stage.friction_acceleration
        drive, limit = format_significant(stage.drive_ratio), format_significant(1 - ratio)
        sides = f"lambda = {drive}, 1 - r = {limit}"
        if stage.is_friction_limited:
            lines.append(
                f"Friction-limited ({sides}): the slider never reaches the foot's speed. The step grows with "
                "friction over mass and with the square of the ramp time; the voltage does not matter."
            )
        else:
            lines.append(
                f"The slider catches up with the foot ({sides}): without load the step is the foot's travel, "
                "whatever the mass; voltage sets it."
            )
    lines += _hysteresis(analysis)
    if not isnan(analysis.load_slope):
        weight = f"One g against the motion costs {_nm(-analysis.load_slope)} nm"
        share = 100 * analysis.load_curvature
        lines.append(f"{weight}; the response bends by {format_number(share, '1', 1)} % of that over 1 g.")
    if not stage.is_rigid:
        regime = ", friction-limited" if stage.is_friction_limited else ""
        lines.append(
            "With Coulomb friction on a foot that follows its waveform the step would be "
            f"{_nm(analysis.coulomb_step)} nm{regime}."
        )
    return lines


def _hysteresis(analysis: StageAnalysis) -> list[str]:
    drive = analysis.stage.drive
    if drive.hysteresis is None:
        return []
    opening = drive.gain * drive.hysteresis.opening(drive.voltage)
    if opening == 0:
        return ["The voltage is too small to open the loop of the piezo's hysteresis: nothing slides in it."]
    share = format_number(100 * opening / drive.amplitude, "1", 1)
    return [
        f"The piezo's hysteresis opens a loop of {_nm(opening)} nm, {share} % of its travel of "
        f"{_nm(drive.amplitude)} nm. A linear piezo of the same travel would step "
        f"{_nm(analysis.linear_step)} nm."
    ]


def _flags(analysis: StageAnalysis) -> list[str]:
    flags = []
    if not analysis.rests:
        flags.append("The slider still moves when the next step begins; give the drive a longer rest time.")
    if analysis.step <= 0:
        flags.append("The step goes backwards; shorten the flyback, or lower the load.")
    return flags


def _dependence(analysis: StageAnalysis) -> Table:
    heads = [f"× {factor:.3g}" for factor in FACTORS]
    rows = []
    for sweep in analysis.sweeps[1:]:
        unit = UNIT_OF[sweep.quantity]
        own = quantity_of(analysis.stage, sweep.quantity)
        slope = analysis.elasticities[sweep.quantity]
        cells = map(_nm, _at_points(sweep, len(FACTORS)))
        rows.append((sweep.quantity, _value(own, unit), *cells, format_number(slope, "1", 2)))
    columns = (
        *words("quantity", "as given"),
        *numbers(*heads, unit="nm", group="step size with the quantity"),
    )
    return Table(
        "Step size against one quantity at a time",
        (*columns, Column("slope", "% per %")),
        tuple(rows),
        stubs=2,
    )


def _loads(analysis: StageAnalysis) -> Table:
    steps = _at_points(analysis.sweeps[0], len(LOADS))
    heads = [f"{load:+.1f} g".replace("-", MINUS) if load else "as given" for load in LOADS]
    columns = (*words("load"), *numbers(*heads, unit="nm", group="step size"))
    row = ("against the motion", *map(_nm, steps))
    given = analysis.stage.load / GRAVITY
    note = f"Added to the given load of {_value(given, '1')} g." if given else ""
    return Table("Step size under a further load", columns, (row,), note=note)


def _at_points(sweep: StepSweep, points: int) -> Array:
    """Steps at the points of the tables, of those of the figure."""
    return sweep.steps[:: (len(sweep.steps) - 1) // (points - 1)]


def _in_use(analysis: StageAnalysis) -> Table:
    """Step size after steps without a pause, by heat and wear."""
    heads = [f"{count:,}" for count, _ in analysis.in_use]
    columns = (*words("quantity"), *numbers(*heads, group="after so many steps without a pause"))
    steps = [step for _, step in analysis.in_use]
    changes = [f"{100 * (step / steps[0] - 1):+.2f}" if isfinite(step) else MISSING for step in steps]
    rows = (("step size in nm", *map(_nm, steps)), ("change in %", *changes))
    return Table("Step size in use", columns, rows)


def _sweep(sweep: StepSweep) -> Table:
    unit = UNIT_OF[sweep.quantity]
    rows = [
        (_value(value, unit, False), _nm(step)) for value, step in zip(sweep.values, sweep.steps, strict=True)
    ]
    columns = (Column(sweep.quantity, unit), Column("step size", "nm"))
    return Table(f"Step size against {sweep.quantity}", columns, tuple(rows), folded=True)


def _trace(analysis: StageAnalysis) -> Table:
    trace = analysis.trace
    chosen = np.unique(np.linspace(0, len(trace.time) - 1, ROWS + 1).round().astype(int))
    rows = [
        (
            format_plain(round(from_si(float(trace.time[i]), "ms"), 5)),
            *(f"{from_si(float(values[i]), 'nm'):.1f}" for values in (trace.foot, trace.slider)),
            f"{from_si(float(trace.friction[i]), 'mN'):.2f}",
        )
        for i in chosen
    ]
    columns = (Column("time", "ms"), *numbers("foot", "slider", unit="nm"), Column("friction", "mN"))
    return Table("One step in time", columns, tuple(rows), folded=True)


def _nm(value: float) -> str:
    return f"{from_si(value, 'nm'):.1f}" if isfinite(value) else MISSING


def _value(value: float, unit: str, with_unit: bool = True) -> str:
    shown = format_significant(from_si(float(value), unit), 4)
    return f"{shown} {unit}" if with_unit and unit != "1" else shown
