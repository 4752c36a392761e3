"""What was true in each traverse of a simulated log: the step size, and what the stage was like."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._toml import SUFFIX_OF
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.laws.base import traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulation.campaign import expected_counts
from stickslip_fit.simulation.schedule import UNITS_OF
from stickslip_fit.simulation.stage_law import StageLaw
from stickslip_fit.simulation.truth import LawValues
from stickslip_fit.units import from_si

IDENTITY = ["session", "time", "joint", "direction"]


def true_steps(log: Log, truth: LawValues, plan: Plan) -> pd.DataFrame:
    """Each traverse's true step size, without the day's factor and noise, and its stage's quantities.

    Parameters
    ----------
    log : Log
        Simulated from `plan` under `truth`.

    Returns
    -------
    DataFrame
        session, time, joint, direction; ``step``, the mean over the traverse (rad or m); preload, friction,
        voltage, ramp time and payload, SI, NaN for a joint that has a law in place of a stage.
    """
    rows = log.rows.assign(traverse=np.arange(1, len(log.rows) + 1))
    truth = truth.in_campaign([each.label for each in plan.sessions], plan.traverses_per_session)
    table = rows[IDENTITY].assign(step=np.nan, **dict.fromkeys(UNITS_OF, np.nan))
    for joint in rows["joint"].unique():
        own = rows[rows["joint"] == joint]
        law = truth.laws[joint]
        counts = expected_counts(law, own, truth.of_rows(own, joint)[0])
        table.loc[own.index, "step"] = traverse_length(own) / counts
        stage_law = law.law if isinstance(law, ExtendedLaw) else law
        if isinstance(stage_law, StageLaw):
            for direction, stage in stage_law.stages.items():
                part = own[own["direction"] == direction]
                for name, values in stage.conditions(part).items():
                    table.loc[part.index, name] = np.broadcast_to(values, len(part))
    return table


def format_true_steps(table: pd.DataFrame, machine: Machine) -> str:
    """A table of `true_steps` as CSV, in the units of logs and stage files."""
    slides = np.array([machine.is_prismatic(joint) for joint in table["joint"]])
    columns = {name: table[name] for name in IDENTITY}
    columns |= {"step_nm": from_si(table["step"], "nm").where(slides)}
    columns |= {"step_urad": from_si(table["step"], "µrad").where(~slides)}
    for name, (unit, *_) in UNITS_OF.items():
        suffix = "" if unit == "1" else f"_{SUFFIX_OF[unit]}"
        columns[f"{name.replace(' ', '_')}{suffix}"] = from_si(table[name], unit)
    shown = pd.DataFrame(columns).dropna(axis=1, how="all")
    return shown.to_csv(
        index=False, float_format="%.10g", date_format="%Y-%m-%dT%H:%M:%S", lineterminator="\n"
    )
