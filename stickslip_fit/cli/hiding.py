"""Causes hidden in an emulated rig."""

from __future__ import annotations

import numpy as np

from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.logs.columns import CONDITIONS
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import LawValues
from stickslip_fit.simulate.driven import HISTORY


def hidden(laws: LawValues, names: tuple[str, ...], plan: Plan, machine: Machine) -> LawValues:
    """Laws with causes in them, each of the size that matters; a law file says any other size.

    Raises
    ------
    InputError
        For a cause that is not known, that looks at what the emulator doesn't have, or if the laws have
        causes in them already.
    """
    if not names:
        return laws
    if any(isinstance(law, ExtendedLaw) for law in laws.laws.values()):
        raise InputError("the law file has causes in it already; leave --hide out, or take them out")
    rows = plan.rows().assign(**HISTORY)
    known = {cause.name: cause for cause in library()}
    causes = []
    for name in names:
        if name not in known or not set(CONDITIONS).isdisjoint(known[name].columns):
            possible = [each for each, cause in known.items() if set(CONDITIONS).isdisjoint(cause.columns)]
            raise InputError(Problem(f"give one of {', '.join(possible)}", column="--hide", value=name))
        trials = known[name].trials(rows)
        if not trials:
            message = "has no usual size; write it into a law file, and give that with --truth"
            raise InputError(Problem(message, column="--hide", value=name))
        version, _ = trials[0]
        causes.append(version.bound(rows, machine))
    sizes = np.array([size for cause in causes for size in cause.scale])
    return LawValues(
        {joint: ExtendedLaw(law, tuple(causes)) for joint, law in laws.laws.items()},
        {key: np.append(values, sizes) for key, values in laws.values.items()},
        laws.day_to_day,
    )
