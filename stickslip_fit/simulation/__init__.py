"""A plan and laws or stages that are known make a log."""

from stickslip_fit.simulation.campaign import (
    draw_noise,
    expected_counts,
    simulate,
    step_through,
)
from stickslip_fit.simulation.schedule import ByColumn, Schedule, Since, WithUse
from stickslip_fit.simulation.stage_law import MountedStage, StageLaw
from stickslip_fit.simulation.stage_tables import SimulatedColumn
from stickslip_fit.simulation.truth import LawValues, read_law_values
from stickslip_fit.simulation.truth_table import true_steps

__all__ = [
    "ByColumn",
    "LawValues",
    "MountedStage",
    "Schedule",
    "SimulatedColumn",
    "Since",
    "StageLaw",
    "WithUse",
    "draw_noise",
    "expected_counts",
    "read_law_values",
    "simulate",
    "step_through",
    "true_steps",
]
