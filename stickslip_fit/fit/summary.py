"""A result as text for the terminal."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_uncertain, format_value
from stickslip_fit._summary import text_table
from stickslip_fit.fit.repeatability import Repeatability
from stickslip_fit.fit.result import EVERYWHERE, JointFit, Result
from stickslip_fit.units import from_si

# A season of sessions does not fit a screen; the JSON and the report hold them all.
MOST_SESSIONS = 12


def summary(result: Result) -> str:
    """The parameters of every joint by session and direction, then what is wrong with them."""
    table = result.parameters
    parts = [f"{result.method} fit of {', '.join(result.provenance.log_files)}"]
    for joint, fit in result.joints.items():
        parts.append(_joint(fit, table[table["joint"] == joint]))
    if (table["joint"] == EVERYWHERE).any():
        parts.append(_causes(table[table["joint"] == EVERYWHERE]))
    if result.remarks:
        parts.append("\n".join(f"! {message}" for message in unique_messages(result)))
    return "\n\n".join(parts)


def unique_messages(result: Result) -> list[str]:
    """Each remark's message once, in order."""
    return list(dict.fromkeys(remark.message for remark in result.remarks))


def _joint(fit: JointFit, table: pd.DataFrame) -> str:
    sessions = list(dict.fromkeys(fit.groups["session"]))
    shown = table[table["session"].isin(sessions[-MOST_SESSIONS:])]
    apart = (*fit.shared, *fit.common)
    names = [parameter.name for parameter in fit.law.parameters if parameter.name not in apart]
    rows = []
    for (session, direction), group in shown.groupby(["session", "direction"], sort=False):
        cells = [format_uncertain(row.estimate, row.standard_error, row.unit) for row in group.itertuples()]
        rows.append([str(session), str(direction), *cells])
    noise = ", ".join(
        f"{way} {format_value(found.value, '%', 2)} ({_source(found)})"
        for way, found in fit.repeatability.items()
        if found.freedom > 0
    )
    title = f"joint {fit.law.joint}, {fit.law.name} law; repeatability {noise or 'not known'}"
    omitted = len(sessions) - MOST_SESSIONS
    if omitted > 0:
        title += f"\n(the last {MOST_SESSIONS} sessions; {omitted} earlier ones are left out here)"
    parts = [title]
    if names:
        parts.append(text_table(["session", "", *names], rows, left=2))
    if fit.shared:
        common = table[table["session"].isna()]
        cells = [
            f"{row.name} {row.direction} {format_uncertain(row.estimate, row.standard_error, row.unit)}"
            for row in common.itertuples()
        ]
        parts.append(f"the same in all sessions: {', '.join(cells)}")
    return "\n".join(parts)


def _causes(table: pd.DataFrame) -> str:
    """What departs from the published laws, the same in the whole campaign."""
    rows = [
        [row.name, format_uncertain(row.estimate, row.standard_error, row.unit)] for row in table.itertuples()
    ]
    return (
        f"departures from the published laws, one number for the whole campaign\n{text_table(['', ''], rows)}"
    )


def _source(found: Repeatability) -> str:
    return "given" if found.source == "given" else f"{found.source}, {found.freedom} degrees of freedom"


def profile_summary(table: pd.DataFrame) -> str:
    """Both intervals of each parameter, as `profile_intervals` gives them; `*` where they differ."""
    known = table[table["estimate"].notna() & table["profile_low"].notna()]
    rows = [
        [
            f"{row.joint} {row.direction}",
            str(row.session),
            row.name,
            format_value(row.estimate, row.unit, _decimals(row.unit)),
            _interval(row.low, row.high, row.unit),
            _interval(row.profile_low, row.profile_high, row.unit) + (" *" if row.differs else "  "),
        ]
        for row in known.itertuples(index=False)
    ]
    header = ["joint", "session", "", "estimate", "95 % quadratic", "95 % profile  "]
    note = "* the likelihood is lopsided here: trust the profile" if known["differs"].any() else "they agree"
    return text_table(header, rows, left=3) + "\n" + note


def _interval(low: float, high: float, unit: str) -> str:
    decimals = _decimals(unit)
    return f"{from_si(low, unit):.{decimals}f} to {from_si(high, unit):.{decimals}f}"


def _decimals(unit: str) -> int:
    return {"1": 5, "nm": 2, "µrad": 3}.get(unit, 4)
