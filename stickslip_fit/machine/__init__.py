"""The manipulator: geometry, kinematics, dynamics, and the load on each joint."""

from stickslip_fit.machine.dynamics import (
    coriolis_matrix,
    gravity_forces,
    gravity_scale,
    inertia_matrix,
)
from stickslip_fit.machine.kinematics import (
    forward,
    full_load,
    inverse,
    jacobian,
    mean_load,
    nearest_solution,
    published_load,
    reach,
)
from stickslip_fit.machine.machine import Link, Machine, load_machine

__all__ = [
    "Link",
    "Machine",
    "coriolis_matrix",
    "forward",
    "full_load",
    "gravity_forces",
    "gravity_scale",
    "inertia_matrix",
    "inverse",
    "jacobian",
    "load_machine",
    "mean_load",
    "nearest_solution",
    "published_load",
    "reach",
]
