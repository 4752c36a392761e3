"""The physics of one step of a stick-slip actuator: a slider on a foot that creeps forward and flies back."""

from stickslip_fit.step import _summary as _summary  # registers how a stage is summarized
from stickslip_fit.step.analysis import StageAnalysis, analyse_stage
from stickslip_fit.step.closed_form import (
    RelativeStep,
    back_slip,
    drive_ratio,
    is_friction_limited,
    relative_size,
    relative_step,
    settling_time,
    step_size,
)
from stickslip_fit.step.coulomb import CoulombMotion, coulomb_motion, coulomb_step
from stickslip_fit.step.drift import StageDrift
from stickslip_fit.step.friction import (
    BristleModel,
    Dahl,
    Elastoplastic,
    LuGre,
    MaxwellSlip,
    spread_maxwell_slip,
)
from stickslip_fit.step.hysteresis import Hysteresis, MaxwellCapacitor, PrandtlIshlinskii
from stickslip_fit.step.motion import FootMotion, make_motion, motion_from_table
from stickslip_fit.step.ode import BristleMotion, Foot, RecoilBase, StepLimitError, solve_motion
from stickslip_fit.step.recoil import recoil_share
from stickslip_fit.step.stage import (
    Contact,
    Drive,
    Stage,
    StepSweep,
    StepTrace,
    apply_drift,
    quantity_of,
    sweep_step,
)

__all__ = [
    "BristleModel",
    "BristleMotion",
    "Contact",
    "CoulombMotion",
    "Dahl",
    "Drive",
    "Elastoplastic",
    "Foot",
    "FootMotion",
    "Hysteresis",
    "LuGre",
    "MaxwellCapacitor",
    "MaxwellSlip",
    "PrandtlIshlinskii",
    "RecoilBase",
    "RelativeStep",
    "Stage",
    "StageAnalysis",
    "StageDrift",
    "StepLimitError",
    "StepSweep",
    "StepTrace",
    "analyse_stage",
    "apply_drift",
    "back_slip",
    "coulomb_motion",
    "coulomb_step",
    "drive_ratio",
    "is_friction_limited",
    "make_motion",
    "motion_from_table",
    "quantity_of",
    "recoil_share",
    "relative_size",
    "relative_step",
    "settling_time",
    "solve_motion",
    "spread_maxwell_slip",
    "step_size",
    "sweep_step",
]
