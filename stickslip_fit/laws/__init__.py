"""The published and the physical step-size laws, and the steps over a traverse that follow from them."""

from stickslip_fit.laws.base import (
    Configuration,
    Parameter,
    Rows,
    StepLaw,
    expected_steps,
    float_column,
    observed_count,
    rounding_variance,
    traverse_length,
)
from stickslip_fit.laws.choice import Laws, LawSource, choose_laws
from stickslip_fit.laws.formula import Law, restore_formula_law
from stickslip_fit.laws.integration import State, state_at
from stickslip_fit.laws.physical import (
    FRICTION_LIMITED,
    Physical,
    PhysicalBase,
    PhysicalBaseAtOneReach,
    PhysicalElbow,
    PhysicalPrismatic,
    PhysicalRotary,
)
from stickslip_fit.laws.published import (
    Base,
    BaseAtOneReach,
    ConstantStep,
    Elbow,
    Prismatic,
    Rotary,
    constant_law,
    is_published,
    published_law,
)
from stickslip_fit.laws.registry import UnknownLawError, describe_law, installed_laws, restore_law
from stickslip_fit.laws.table import TableLaw

__all__ = [
    "FRICTION_LIMITED",
    "Base",
    "BaseAtOneReach",
    "Configuration",
    "ConstantStep",
    "Elbow",
    "Law",
    "LawSource",
    "Laws",
    "Parameter",
    "Physical",
    "PhysicalBase",
    "PhysicalBaseAtOneReach",
    "PhysicalElbow",
    "PhysicalPrismatic",
    "PhysicalRotary",
    "Prismatic",
    "Rotary",
    "Rows",
    "State",
    "StepLaw",
    "TableLaw",
    "UnknownLawError",
    "choose_laws",
    "constant_law",
    "describe_law",
    "expected_steps",
    "float_column",
    "installed_laws",
    "is_published",
    "observed_count",
    "published_law",
    "restore_formula_law",
    "restore_law",
    "rounding_variance",
    "state_at",
    "traverse_length",
]
