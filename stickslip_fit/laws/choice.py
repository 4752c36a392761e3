"""choose_laws: the law of each joint: one that is given, else the published one, else a constant step.

This is the one place that decides. Everything else asks the law through `StepLaw`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

import numpy as np
import pandas as pd

from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.laws.base import Rows, StepLaw
from stickslip_fit.laws.checks import call_own, check_law
from stickslip_fit.laws.published import ConstantStep, published_law
from stickslip_fit.machine import Machine


@runtime_checkable
class LawSource(Protocol):
    """What gives a joint's law when it meets the rows of that joint's traverses, such as a formula."""

    def step_law(self, joint: int, rows: Rows, machine: Machine) -> StepLaw:
        """The law of `joint` for these rows."""
        ...


LawFunction = Callable[[int, Rows, Machine], StepLaw]
Laws = Mapping[int, StepLaw | LawSource | LawFunction]
"""Laws of one's own by joint: each a law, a formula, or a function of joint, rows and machine."""


def choose_laws(rows: pd.DataFrame, machine: Machine, laws: Laws | None = None) -> dict[int, StepLaw]:
    """The law of every joint that has rows.

    Parameters
    ----------
    rows : DataFrame
        Traverses of a log, with a column joint.
    machine : Machine
    laws : mapping of int to StepLaw, LawSource or function, optional
        Laws of one's own for some joints or all.

    Returns
    -------
    dict of int to StepLaw
        In order of the joints: the law in `laws`, else the published law; on a machine without the published
        geometry, a constant step of each session and direction.

    Raises
    ------
    InputError
        For a joint that the machine does not have, what is no law of its joint, and a law that cannot be
        fitted to these rows; see `check_law`.

    Examples
    --------
    >>> import pandas as pd
    >>> from stickslip_fit.laws import ConstantStep
    >>> from stickslip_fit.machine import load_machine
    >>> rows = pd.DataFrame({"joint": [3, 2], "start": 0.0, "stop": [0.012, 3.0], "steps": 12_300})
    >>> chosen = choose_laws(rows.assign(check_every=1), load_machine(), {3: ConstantStep(3)})
    >>> {joint: law.name for joint, law in chosen.items()}
    {2: 'rotary-elbow', 3: 'constant'}
    """
    given = {} if laws is None else laws
    unknown = [joint for joint in given if joint not in machine.ranges]
    if unknown:
        known = ", ".join(map(str, machine.ranges))
        message = f"the machine {machine.name!r} has no such joint; laws are given by joint, one of {known}"
        raise InputError([InputIssue(message, column="joint in laws", value=str(joint)) for joint in unknown])
    chosen: dict[int, StepLaw] = {}
    for joint in map(int, np.unique(rows["joint"])):
        own = rows[rows["joint"] == joint]
        if joint in given:
            chosen[joint] = make_law(given[joint], joint, own, machine)
            check_law(chosen[joint], own)
        else:
            chosen[joint] = _default_law(joint, own, machine)
    return chosen


def _default_law(joint: int, rows: pd.DataFrame, machine: Machine) -> StepLaw:
    if machine.has_published_geometry:
        return published_law(joint, rows, machine)
    return ConstantStep(joint, prismatic=machine.is_prismatic(joint))


def make_law(given: object, joint: int, rows: pd.DataFrame, machine: Machine) -> StepLaw:
    """The law of a joint from a law, a formula or a function.

    Raises
    ------
    InputError
        For what is no law of this joint.
    """
    law, what = given, f"the law of joint {joint}"
    if isinstance(given, LawSource):
        law = call_own(what, lambda: given.step_law(joint, rows, machine))
    elif not isinstance(given, StepLaw) and callable(given):
        law = call_own(what, lambda: given(joint, rows, machine))
    if not isinstance(law, StepLaw):
        raise InputError(
            f"{what} is no StepLaw but {type(law).__name__}; give a StepLaw, a formula, or "
            "a function (joint, rows, machine) that returns a StepLaw"
        )
    if law.joint != joint:
        raise InputError(f"the law {law.name!r} is of joint {law.joint}, but is given for joint {joint}")
    return law
