"""The thesis's claims beside what its own printed numbers imply, and beside what a log shows."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    format_percent,
    format_plain,
    format_value,
    joint_name,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.report.claims import PRISMATIC_CLAIMS, ROTARY_CLAIMS, Claim, share
from stickslip_fit.strategies import ClosedForm, Comparison, ConstantStep
from stickslip_fit.units import to_si

# Of the thesis, or worked out from what it prints; data/published says which, and where from.
STEP = {"nm": 12e6 / 12300, "µrad": 95.0}
CONSTANT_STEP_ERROR = {"nm": 159.0, "µrad": 25.7}  # %
QUADRATIC_ERROR = 1.6  # µrad
REPEATABILITY, DAY_TO_DAY = 0.27, (2.6, 1.9)  # %
NOTES = {
    "nm": (
        f"Its p-values imply that a traverse repeats to {REPEATABILITY} % and that days differ by "
        f"{DAY_TO_DAY[0]} % (+) and {DAY_TO_DAY[1]} % (−): a law kept from another day is off by that much. "
        f"The {CONSTANT_STEP_ERROR['nm']:.0f} % was worked out from its a, b and c; its b and c are not "
        "among the numbers at hand here, so that it cannot be worked out again."
    ),
    "µrad": (
        "Its quadratic for d (Eq. 6.6), used for every gamma0 from 75 to 115 µrad, is by itself off by up "
        f"to {QUADRATIC_ERROR} µrad. The {CONSTANT_STEP_ERROR['µrad']} % is joint 2's at gamma0 = 95 µrad, "
        "psi = 0."
    ),
}


def implied(claim: Claim, unit: str) -> str:
    """What the thesis's own numbers make of one of its claims.

    Parameters
    ----------
    claim : Claim
    unit : {"nm", "µrad"}
        Of the joint's step size.

    Examples
    --------
    >>> implied(Claim("law", 20.0, "%"), "nm")
    '195 nm of its 976 nm step'
    >>> implied(Claim("constant", 1.3, "%"), "µrad")
    'off by up to 25.7 % (joint 2)'
    """
    step = f"{STEP[unit]:.0f} {unit}"
    if claim.model == "constant":
        whose = " (joint 2)" if unit == "µrad" else ""
        return f"off by up to {format_plain(CONSTANT_STEP_ERROR[unit])} %{whose}"
    if claim.unit == "%":
        return f"{STEP[unit] * claim.limit / 100:.3g} {unit} of its {step} step"
    return f"{100 * claim.limit / STEP[unit]:.2g} % of its {step} step"


def implied_table(found: Comparison, joint: int) -> Table:
    """Each claim, what the printed numbers make of it, and what the strategy it speaks of reaches."""
    unit = step_unit(joint)
    shared = found.shared[found.shared["joint"] == joint]
    accuracy = found.accuracy().set_index(["joint", "strategy"])
    columns = (
        Column("claim", text=True),
        Column("its own numbers say", text=True),
        Column("calibrated by", group="this log", text=True),
        Column("rms", group="this log"),
        Column("worst", group="this log"),
        Column("traverses within", "%", "this log"),
    )
    body = []
    for claim in PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS:
        name, model = (
            (ClosedForm.name, "law") if claim.model == "law" else (ConstantStep.name, "constant step")
        )
        own = shared[shared["strategy"] == name]
        reached = _reached(accuracy.loc[joint, name], own, claim) if len(own) else (MISSING,) * 3
        body.append(
            (f"{model} ±{format_plain(claim.limit)} {claim.unit}", implied(claim, unit), name, *reached)
        )
    caption = f"{joint_name(joint).capitalize()}: what the thesis claims, implies, and what is reached"
    return Table(caption, columns, tuple(body), note=typeset(NOTES[unit]))


def within(errors: pd.DataFrame, claim: Claim) -> float:
    """Share of traverses that keep to a claim."""
    kind = "relative" if claim.unit == "%" else "absolute"
    return float(np.mean(errors[kind].abs() <= to_si(claim.limit, claim.unit)))


def _reached(summed: pd.Series, errors: pd.DataFrame, claim: Claim) -> tuple[str, str, str]:
    kept = share(within(errors, claim))
    if claim.unit == "%":
        return (
            format_percent(summed["rms_relative"]),
            format_percent(summed["worst_relative"], signed=True),
            kept,
        )
    return format_value(summed["rms"], claim.unit), format_value(summed["worst"], claim.unit), kept
