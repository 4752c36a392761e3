"""The thesis's accuracy (Ch. 7): what it claims, what its own numbers imply, and what a log shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    format_percent,
    format_plain,
    format_value,
    joint_name,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.strategies.designs import ClosedForm, ConstantStepStrategy
from stickslip_fit.units import PRISMATIC, to_si

if TYPE_CHECKING:
    from stickslip_fit.strategies.compare import Comparison


@dataclass(frozen=True)
class Claim:
    """An error that the thesis says is not exceeded.

    Attributes
    ----------
    model : {"law", "constant"}
    limit : float
        In people's unit.
    unit : {"%", "nm", "µrad"}
    """

    model: str
    limit: float
    unit: str


PRISMATIC_CLAIMS = (
    Claim("law", 20.0, "%"),
    Claim("law", 15.0, "%"),
    Claim("law", 100.0, "nm"),
    Claim("constant", 10.0, "%"),
)
ROTARY_CLAIMS = (
    Claim("law", 1.0, "µrad"),
    Claim("law", 2.0, "µrad"),
    Claim("law", 2.0, "%"),
    Claim("constant", 1.3, "%"),
)
NOTE = (
    "The thesis makes these statements side by side; they do not agree with each other. Its own parameters "
    "put the constant step's error at up to 159 % (prismatic) and 25.7 % (rotary)."
)
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


def claims_of(joint: int) -> tuple[Claim, ...]:
    """What the thesis says of a joint."""
    return PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS


def claims_table(errors: pd.DataFrame) -> Table:
    """Each claim with the share of this log's traverses that keep to it."""
    columns = (
        *words("joint", "model"),
        Column("claimed"),
        Column("traverses within", "%", "this log"),
        Column("worst", group="this log"),
    )
    body = []
    for joint, subset in errors.groupby("joint"):
        for claim in claims_of(joint):
            error = _error(subset, claim)
            within = float(np.mean(np.abs(error) <= to_si(claim.limit, claim.unit)))
            name = "law" if claim.model == "law" else "constant step"
            worst = error[np.argmax(np.abs(error))]
            shown = (
                format_percent(worst, signed=True) if claim.unit == "%" else format_value(worst, claim.unit)
            )
            cells = (name, f"±{format_plain(claim.limit)} {claim.unit}", share(within), shown)
            body.append((joint_name(int(joint)), *cells))
    return Table("The thesis's claims and this log", columns, tuple(body), stubs=2, note=NOTE)


def _error(errors: pd.DataFrame, claim: Claim) -> np.ndarray:
    predicted, measured = errors[claim.model].to_numpy(), errors["measured"].to_numpy()
    return predicted / measured - 1.0 if claim.unit == "%" else predicted - measured


def share(part: float) -> str:
    """A share in per cent that says 100 only of all, and 0 only of none.

    Examples
    --------
    >>> share(1.0), share(0.9999), share(0.5), share(0.001)
    ('100', '>99', '50', '<1')
    """
    shown = 100 * part
    if 0 < shown < 1:
        return "<1"
    if 99 < shown < 100:
        return ">99"
    return f"{shown:.0f}"


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
        *words("claim", "its own numbers say"),
        Column("calibrated by", group="this log", text=True),
        *numbers("rms", "worst", group="this log"),
        Column("traverses within", "%", "this log"),
    )
    body = []
    for claim in claims_of(joint):
        name, model = (
            (ClosedForm.name, "law") if claim.model == "law" else (ConstantStepStrategy.name, "constant step")
        )
        own = shared[shared["strategy"] == name]
        reached = _reached(accuracy.loc[joint, name], own, claim) if len(own) else (MISSING,) * 3
        body.append(
            (f"{model} ±{format_plain(claim.limit)} {claim.unit}", implied(claim, unit), name, *reached)
        )
    caption = f"{joint_name(joint).capitalize()}: what the thesis claims, implies, and what is reached"
    return Table(caption, columns, tuple(body), note=typeset_text(NOTES[unit]))


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


def claimed_table(found: Comparison, joint: int) -> Table:
    """For each strategy, the share of traverses that keep to each of the thesis's claims."""
    shared = found.shared
    subset = shared[shared["joint"] == joint]
    columns = [Column(_head(claim), "%", _of_whom(claim)) for claim in claims_of(joint)]
    body = []
    for strategy in found.compared(joint):
        own = subset[subset["strategy"] == strategy]
        body.append((strategy, *(share(within(own, claim)) for claim in claims_of(joint))))
    caption = f"{joint_name(joint).capitalize()}: traverses within what the thesis claims"
    return Table(caption, (Column("strategy", text=True), *columns), tuple(body), note=typeset_text(NOTE))


def _head(claim: Claim) -> str:
    return f"±{format_plain(claim.limit)} {claim.unit}"


def _of_whom(claim: Claim) -> str:
    return "law" if claim.model == "law" else "constant step"
