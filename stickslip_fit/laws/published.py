"""The published laws for the joints of a log, by joint or by name."""

from __future__ import annotations

import numpy as np

from stickslip_fit.errors import InputError
from stickslip_fit.laws.base import Rows, StepLaw, float_column
from stickslip_fit.laws.prismatic import ConstantStep, Prismatic
from stickslip_fit.laws.rotary import Base, BaseAtOneReach, Elbow
from stickslip_fit.machine import Machine, reach

REACH_TOL = 1e-6  # m; closer than a lab can set an arm


def published_law(joint: int, rows: Rows, machine: Machine) -> StepLaw:
    """The law of `joint` as the rows of its traverses can support it.

    Joint 1's gamma0 and d are linear in the reach, and constants where the rows have one reach.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> published_law(3, {}, load_machine()).name
    'prismatic'
    """
    if joint == Prismatic.joint:
        return Prismatic()
    if joint == Elbow.joint:
        return Elbow(machine)
    q2, q3 = float_column(rows, "q2"), float_column(rows, "q3")
    if len(q2) and np.ptp(reach(machine, q2, q3)) < REACH_TOL:
        return BaseAtOneReach(machine, float(q2[0]), float(q3[0]))
    return Base(machine)


def describe_law(law: StepLaw) -> dict[str, str | int | float]:
    """What `restore_law` needs to build the law again; plain JSON types."""
    description: dict[str, str | int | float] = {"name": law.name, "joint": law.joint}
    if isinstance(law, BaseAtOneReach):
        description |= {"q2_rad": law.q2, "q3_m": law.q3}
    return description


def restore_law(description: dict[str, str | int | float], machine: Machine) -> StepLaw:
    """The law that `describe_law` described.

    Raises
    ------
    InputError
        For a law that this version does not know.
    """
    name = description.get("name")
    if name == Prismatic.name:
        return Prismatic()
    if name == Elbow.name:
        return Elbow(machine)
    if name == Base.name:
        return Base(machine)
    if name == BaseAtOneReach.name:
        return BaseAtOneReach(machine, float(description["q2_rad"]), float(description["q3_m"]))
    raise InputError(f"the saved law {name!r} is unknown to this version; fit the log again")


def constant_law(law: StepLaw) -> ConstantStep:
    """The constant step of thesis Ch. 7 beside `law`: measured in its first calibration configuration."""
    return ConstantStep(law.joint, law.calibration()[0])
