"""The thesis's accuracy (Ch. 7) beside what each strategy reaches on a log."""

from __future__ import annotations

from stickslip_fit._format import format_plain, joint_name, step_unit, typeset
from stickslip_fit._summary import Column, Table, paragraph, text_table
from stickslip_fit.machine import PRISMATIC
from stickslip_fit.report.claims import NOTE, PRISMATIC_CLAIMS, ROTARY_CLAIMS, Claim, share
from stickslip_fit.report.implied import NOTES, implied_table, within
from stickslip_fit.strategies import Comparison


def claimed_table(found: Comparison, joint: int) -> Table:
    """For each strategy, the share of traverses that keep to each of the thesis's claims."""
    claims = PRISMATIC_CLAIMS if joint == PRISMATIC else ROTARY_CLAIMS
    shared = found.shared
    mine = shared[shared["joint"] == joint]
    columns = [Column(_head(claim), "%", _of_whom(claim)) for claim in claims]
    body = []
    for strategy in found.compared(joint):
        own = mine[mine["strategy"] == strategy]
        body.append((strategy, *(share(within(own, claim)) for claim in claims)))
    caption = f"{joint_name(joint).capitalize()}: traverses within what the thesis claims"
    return Table(caption, (Column("strategy", text=True), *columns), tuple(body), note=typeset(NOTE))


def claimed_text(found: Comparison) -> str:
    """All joints' tables for the terminal, then what to mind; empty where nothing is compared."""
    parts = []
    for joint in found.joints:
        beside, each = implied_table(found, joint), claimed_table(found, joint)
        heads = ["claim", "its own numbers say", "calibrated by", "rms", "worst", "% within"]
        parts.append(f"{beside.caption}\n{text_table(heads, beside.rows, left=3)}")
        heads = ["strategy", *(f"{column.group} {column.head}" for column in each.columns[1:])]
        parts.append(f"{each.caption} (%)\n{text_table(heads, each.rows)}")
    notes = [NOTE, *dict.fromkeys(NOTES[step_unit(joint)] for joint in reversed(found.joints))]
    return "\n\n".join([*parts, paragraph(" ".join(notes))]) if parts else ""


def _head(claim: Claim) -> str:
    return f"±{format_plain(claim.limit)} {claim.unit}"


def _of_whom(claim: Claim) -> str:
    return "law" if claim.model == "law" else "constant step"
