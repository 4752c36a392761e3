"""What the thesis says of its accuracy (Ch. 7), beside what this log shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._format import format_percent, format_plain, format_value, joint_name
from stickslip_fit._summary import Column, Table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.units import to_si


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


def claims_table(errors: pd.DataFrame) -> Table:
    """Each claim with the share of this log's traverses that keep to it."""
    columns = (
        Column("joint", text=True),
        Column("model", text=True),
        Column("claimed"),
        Column("traverses within", "%", "this log"),
        Column("worst", group="this log"),
    )
    body = []
    for joint, mine in errors.groupby("joint"):
        for claim in PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS:
            error = _error(mine, claim)
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
