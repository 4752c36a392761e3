"""What the step size should be, and the steps over a traverse that follow from it."""

from stickslip_fit.laws.constant import ConstantStep
from stickslip_fit.laws.count import expected_steps, rounding_variance, seen_count
from stickslip_fit.laws.law import Rows, StepLaw, column, travel
from stickslip_fit.laws.parameter import Configuration, Parameter
from stickslip_fit.laws.prismatic import Prismatic
from stickslip_fit.laws.published import constant_law, describe_law, published_law, restore_law
from stickslip_fit.laws.rotary import Base, BaseAtOneReach, Elbow, Rotary
from stickslip_fit.laws.state import State, state_at

__all__ = [
    "Base",
    "BaseAtOneReach",
    "Configuration",
    "ConstantStep",
    "Elbow",
    "Parameter",
    "Prismatic",
    "Rotary",
    "Rows",
    "State",
    "StepLaw",
    "column",
    "constant_law",
    "describe_law",
    "expected_steps",
    "published_law",
    "restore_law",
    "rounding_variance",
    "seen_count",
    "state_at",
    "travel",
]
