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

__all__ = [
    "StepDerivatives",
    "back_slip",
    "drive_ratio",
    "is_friction_limited",
    "settling_time",
    "step_derivatives",
    "step_size",
]
