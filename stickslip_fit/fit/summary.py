"""A result as text for the terminal."""

from __future__ import annotations

import pandas as pd

from stickslip_fit.fit.result import JointFit, Result
from stickslip_fit.units import format_uncertain, format_value, text_table

# A season of sessions does not fit a screen; the JSON and the report hold them all.
MOST_SESSIONS = 12


def summary(result: Result) -> str:
    """The parameters of every joint by session and direction, then what is wrong with them."""
    table = result.parameters
    parts = [f"{result.method} fit of {', '.join(result.provenance.log_files)}"]
    for joint, fit in result.joints.items():
        parts.append(_joint(fit, table[table["joint"] == joint]))
    if result.remarks:
        parts.append("\n".join(f"! {message}" for message in unique_messages(result)))
    return "\n\n".join(parts)


def unique_messages(result: Result) -> list[str]:
    """Each remark's message once, in order."""
    return list(dict.fromkeys(remark.message for remark in result.remarks))


def _joint(fit: JointFit, table: pd.DataFrame) -> str:
    sessions = list(dict.fromkeys(fit.groups["session"]))
    shown = table[table["session"].isin(sessions[-MOST_SESSIONS:])]
    names = [parameter.name for parameter in fit.law.parameters]
    rows = []
    for (session, direction), group in shown.groupby(["session", "direction"], sort=False):
        cells = [format_uncertain(row.estimate, row.standard_error, row.unit) for row in group.itertuples()]
        rows.append([str(session), str(direction), *cells])
    noise = ", ".join(
        f"{way} {format_value(found.value, '%', 2)} ({found.source}, {found.freedom} degrees of freedom)"
        for way, found in fit.repeatability.items()
        if found.freedom > 0
    )
    title = f"joint {fit.law.joint}, {fit.law.name} law; repeatability {noise or 'not known'}"
    omitted = len(sessions) - MOST_SESSIONS
    if omitted > 0:
        title += f"\n(the last {MOST_SESSIONS} sessions; {omitted} earlier ones are left out here)"
    return title + "\n" + text_table(["session", "", *names], rows, left=2)
