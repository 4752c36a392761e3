"""The thesis's accuracy (Ch. 7) beside what each strategy reaches on a log."""

from __future__ import annotations

from textwrap import fill

import numpy as np
import pandas as pd

from stickslip_fit.machine import PRISMATIC
from stickslip_fit.report.claims import NOTE, PRISMATIC_CLAIMS, ROTARY_CLAIMS, Claim, share
from stickslip_fit.report.table import Column, Table
from stickslip_fit.report.wording import joint_name, plain
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import WIDTH
from stickslip_fit.units import text_table, to_si


def claimed_table(found: Comparison, joint: int) -> Table:
    """For each strategy, the share of traverses that keep to each of the thesis's claims."""
    claims = PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS
    shared = found.shared
    mine = shared[shared["joint"] == joint]
    columns = [Column(_head(claim), "%", _of_whom(claim)) for claim in claims]
    body = []
    for strategy in found.compared(joint):
        own = mine[mine["strategy"] == strategy]
        body.append((strategy, *(share(_within(own, claim)) for claim in claims)))
    caption = f"{joint_name(joint).capitalize()}: traverses within what the thesis claims"
    return Table(caption, (Column("strategy", text=True), *columns), tuple(body), note=NOTE)


def claimed_text(found: Comparison) -> str:
    """All joints' tables for the terminal; empty where nothing is compared."""
    parts = []
    for joint in found.joints:
        table = claimed_table(found, joint)
        header = ["strategy", *(f"{each.group} {each.head}" for each in table.columns[1:])]
        parts.append(f"{table.caption} (%)\n{text_table(header, table.rows)}")
    return "\n\n".join([*parts, fill(NOTE, WIDTH)]) if parts else ""


def _head(claim: Claim) -> str:
    return f"±{plain(claim.limit)} {claim.unit}"


def _of_whom(claim: Claim) -> str:
    return "law" if claim.model == "law" else "constant step"


def _within(errors: pd.DataFrame, claim: Claim) -> float:
    kind = "relative" if claim.unit == "%" else "absolute"
    return float(np.mean(errors[kind].abs() <= to_si(claim.limit, claim.unit)))
