"""The accuracy that the thesis states: its claims, what its own numbers imply, what a log shows.

The claims are those of its abstract, Secs. 4.7, 6.1 and 6.2 and Chs. 7 and 8; A. Damani, "An Empirical
Model of Piezoelectric Stick-Slip Actuation of the Kleindiek MM3A Micromanipulator", M.S. thesis, University
of Utah, 2013.
"""

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
from stickslip_fit.machine import Machine
from stickslip_fit.strategies.designs import ClosedForm, ConstantStepStrategy
from stickslip_fit.units import PRISMATIC, to_si

if TYPE_CHECKING:
    from stickslip_fit.strategies.compare import Comparison


@dataclass(frozen=True)
class Claim:
    """A limit of the error, in its unit, that the thesis states for the law or for the constant step.

    Attributes
    ----------
    model : {"law", "constant step"}
    unit : {"%", "nm", "µrad"}
    """

    model: str
    limit: float
    unit: str

    @property
    def label(self) -> str:
        """The limit with its unit."""
        return f"±{format_plain(self.limit)} {self.unit}"

    @property
    def kind(self) -> str:
        """The column of errors that it limits, see `EvaluationTables`."""
        return "relative" if self.unit == "%" else "absolute"

    def format_kept(self, errors: pd.Series) -> str:
        """Share of traverses within the limit, %; errors are relative for a claim in %, else rad or m.

        100 only of all, and 0 only of none.

        Examples
        --------
        >>> [Claim("law", 20.0, "%").format_kept(pd.Series([0.1] * n + [0.3])) for n in (1, 99, 999)]
        ['50', '99', '>99']
        """
        share = 100 * float(np.mean(errors.abs() <= to_si(self.limit, self.unit)))
        return "<1" if 0 < share < 1 else ">99" if 99 < share < 100 else f"{share:.0f}"


PRISMATIC_CLAIMS = (
    Claim("law", 20.0, "%"),
    Claim("law", 15.0, "%"),
    Claim("law", 100.0, "nm"),
    Claim("constant step", 10.0, "%"),
)
ROTARY_CLAIMS = (
    Claim("law", 1.0, "µrad"),
    Claim("law", 2.0, "µrad"),
    Claim("law", 2.0, "%"),
    Claim("constant step", 1.3, "%"),
)
# Printed in the thesis or computed from what it prints; data/published gives the source of each.
STEP = {"nm": 972.0, "µrad": 95.0}
CONSTANT_STEP_ERROR = {"nm": 158.9, "µrad": 25.7}  # %
QUADRATIC_ERROR = 1.4  # µrad
REPEATABILITY, DAY_TO_DAY = 0.27, (2.6, 1.9)  # %
NOTE = (
    "The thesis makes these statements in different places; they do not agree with each other. Its own "
    f"parameters put the constant step's error at up to {CONSTANT_STEP_ERROR['nm']} % (prismatic) and "
    f"{CONSTANT_STEP_ERROR['µrad']} % (rotary)."
)
NOTES = {
    "nm": (
        f"Its p-values imply that a traverse repeats to {REPEATABILITY} % and that days differ by "
        f"{DAY_TO_DAY[0]} % (+) and {DAY_TO_DAY[1]} % (−): a law kept from another day is off by that much. "
        f"The {CONSTANT_STEP_ERROR['nm']} % follows from its a, b and c (Fig. 4.13), in − with the arm "
        "hanging, theta = psi = 0."
    ),
    "µrad": (
        "Its quadratic for d (Eq. 6.6), used for every gamma0 from 75 to 115 µrad, is by itself off by up "
        f"to {QUADRATIC_ERROR} µrad. The {CONSTANT_STEP_ERROR['µrad']} % follows from joint 2's d (Fig. "
        "5.6), in + with the arm out and level, theta = psi = 0, gamma0 = 95 µrad, the middle of that span."
    ),
}


def claims_of(joint: int) -> tuple[Claim, ...]:
    """The claims of the thesis on a joint."""
    return PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS


def claims_table(errors: pd.DataFrame, machine: Machine) -> Table:
    """Each claim with the share of this log's traverses within it.

    Parameters
    ----------
    errors : DataFrame
        joint; measured, and predicted by law and by constant: mean step size, rad or m.
    """
    columns = (
        *words("joint", "model"),
        Column("claimed"),
        Column("traverses within", "%", "this log"),
        Column("worst", group="this log"),
    )
    body = []
    for joint, subset in errors.groupby("joint"):
        for claim in claims_of(joint):
            predicted = subset[claim.model.removesuffix(" step")]
            relative = claim.unit == "%"
            error = predicted / subset["measured"] - 1.0 if relative else predicted - subset["measured"]
            worst = error.iloc[np.argmax(error.abs())]
            worst_text = format_percent(worst, signed=True) if relative else format_value(worst, claim.unit)
            row = (
                joint_name(int(joint), machine),
                claim.model,
                claim.label,
                claim.format_kept(error),
                worst_text,
            )
            body.append(row)
    return Table("The thesis's claims and this log", columns, tuple(body), stubs=2, note=NOTE)


def implied(claim: Claim, unit: str) -> str:
    """What the thesis's own numbers make of one of its claims.

    Parameters
    ----------
    unit : {"nm", "µrad"}
        Of the joint's step size.

    Examples
    --------
    >>> implied(Claim("law", 20.0, "%"), "nm")
    '194 nm of its 972 nm step'
    >>> implied(Claim("constant step", 1.3, "%"), "µrad")
    'off by up to 25.7 % (joint 2)'
    """
    step = f"{STEP[unit]:.0f} {unit}"
    if claim.model == "constant step":
        joint = " (joint 2)" if unit == "µrad" else ""
        return f"off by up to {format_plain(CONSTANT_STEP_ERROR[unit])} %{joint}"
    if claim.unit == "%":
        return f"{STEP[unit] * claim.limit / 100:.3g} {unit} of its {step} step"
    return f"{100 * claim.limit / STEP[unit]:.2g} % of its {step} step"


def implied_table(comparison: Comparison, joint: int) -> Table:
    """Each claim, what the printed numbers make of it, and the accuracy of the strategy that it is about."""
    unit = step_unit(joint, comparison.machine)
    shared = comparison.shared[comparison.shared["joint"] == joint]
    accuracy = comparison.accuracy().set_index(["joint", "strategy"])
    columns = (
        *words("claim", "its own numbers say"),
        Column("calibrated by", group="this log", text=True),
        *numbers("rms", "worst", group="this log"),
        Column("traverses within", "%", "this log"),
    )
    body = []
    for claim in claims_of(joint):
        name = ClosedForm.name if claim.model == "law" else ConstantStepStrategy.name
        errors = shared[shared["strategy"] == name]
        cells = (MISSING,) * 3
        if len(errors):
            own = accuracy.loc[joint, name]
            if claim.unit == "%":
                rms, worst = own["rms_relative"], own["worst_relative"]
                texts = format_percent(rms), format_percent(worst, signed=True)
            else:
                texts = format_value(own["rms"], unit), format_value(own["worst"], unit)
            cells = (*texts, claim.format_kept(errors[claim.kind]))
        body.append((f"{claim.model} {claim.label}", implied(claim, unit), name, *cells))
    name = joint_name(joint, comparison.machine).capitalize()
    caption = f"{name}: what the thesis claims, implies, and what is reached"
    return Table(caption, columns, tuple(body), note=typeset_text(NOTES[unit]))


def claimed_table(comparison: Comparison, joint: int) -> Table:
    """For each strategy, the share of traverses within each of the thesis's claims."""
    subset, claims = comparison.shared[comparison.shared["joint"] == joint], claims_of(joint)
    columns = [Column(claim.label, "%", claim.model) for claim in claims]
    body = []
    for strategy in comparison.compared(joint):
        own = subset[subset["strategy"] == strategy]
        body.append((strategy, *(claim.format_kept(own[claim.kind]) for claim in claims)))
    caption = f"{joint_name(joint, comparison.machine).capitalize()}: traverses within what the thesis claims"
    return Table(caption, (Column("strategy", text=True), *columns), tuple(body), note=typeset_text(NOTE))
