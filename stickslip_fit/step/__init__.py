"""The physics of one step of a stick-slip actuator: a slider on a foot that creeps forward and flies back."""

from stickslip_fit.step.closed_form import (
    StepDerivatives,
    back_slip,
    drive_ratio,
    is_friction_limited,
    settling_time,
    step_derivatives,
    step_size,
)
from stickslip_fit.step.coulomb import CoulombMotion, coulomb_motion, coulomb_step
from stickslip_fit.step.friction import (
    BristleModel,
    Dahl,
    Elastoplastic,
    LuGre,
    MaxwellSlip,
    spread_maxwell_slip,
)
from stickslip_fit.step.motion import FootMotion, make_motion, motion_from_table
from stickslip_fit.step.ode import Base, BristleMotion, Foot, StepLimitError, solve_motion

__all__ = [
    "Base",
    "BristleModel",
    "BristleMotion",
    "CoulombMotion",
    "Dahl",
    "Elastoplastic",
    "Foot",
    "FootMotion",
    "LuGre",
    "MaxwellSlip",
    "StepDerivatives",
    "StepLimitError",
    "back_slip",
    "coulomb_motion",
    "coulomb_step",
    "drive_ratio",
    "is_friction_limited",
    "make_motion",
    "motion_from_table",
    "settling_time",
    "solve_motion",
    "spread_maxwell_slip",
    "step_derivatives",
    "step_size",
]
