"""Withdrawal: a cause that does not predict better is no longer named.

What a cause is worth shows on traverses that took no part in choosing or fitting it. A finding whose law
predicts them worse than without it, or whose gain is so uncertain that it says nothing, becomes ``unknown``:
the structure is there, the name is not supported. A term or smooth function for unknown structure that does
not predict better leaves the law: its finding stays, without a term. `Diagnosis.measure_gain` decides this,
nothing else does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stickslip_fit.diagnosis.cause_set import form_cause_set
from stickslip_fit.diagnosis.finding import GIVEN_BEFORE, DataInfo, Finding, Gain
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.selection import Selection, refit_selection
from stickslip_fit.diagnosis.unknown_size import compare_causes


def is_supported(gain: Gain) -> bool:
    """Whether held-out traverses are predicted no worse, and the interval could not mean twice the error."""
    before, after = gain.judged
    return bool(after <= before and np.isfinite(gain.high) and gain.low > -gain.baseline)


def find_unsupported(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Findings that extend the law without predicting better."""
    return tuple(
        one for one in findings if one.version is not None and one.gain and not is_supported(one.gain)
    )


def withdraw_causes(
    selection: Selection, findings: Sequence[Finding], unsupported: Sequence[Finding], info: DataInfo
) -> tuple[Selection, tuple[Finding, ...]]:
    """The selection and its findings with `unknown` for the unsupported ones.

    What is said of it is what was found, with the size that it has as the cause: what unstructured
    alternatives see of it may be less, or another thing.
    """
    withdrawn = [one for one in unsupported if one.cause != UNKNOWN]
    if not withdrawn:
        return _withdraw_terms(selection, findings, unsupported)
    names = [one.cause for one in withdrawn]
    first = next(one for one in selection.selected if one.cause in names)
    withdrawn.sort(key=lambda one: one.cause != first.cause)
    unknown = replace(
        first, cause=UNKNOWN, version=None, start=np.zeros(0), cause_set=form_cause_set(first.test, UNKNOWN)
    )
    before = [one for one in findings if one.withdrawn]
    withdrawn += [one for finding in before for one in finding.withdrawn]
    # What has no name but was found first, or beside it, does not rest on what is withdrawn.
    beside = selection.selected[: selection.selected.index(first)]
    if UNKNOWN in first.together_with:
        beside = selection.selected
    others = [
        one
        for one in selection.selected
        if one.cause not in (*names, UNKNOWN)
        or (one.cause == UNKNOWN and one in beside and one.version is not None)
    ]
    smaller = refit_selection(selection, (*others, unknown))
    kept = [one for one in findings if selection.behind(one) in others]
    finding = Finding(
        UNKNOWN,
        None,
        (),
        withdrawn[0].p_value,
        withdrawn[0].joints,
        withdrawn[0].effect,
        (),
        carrier=_name_carrier(withdrawn[0]),
        note="; ".join(_explain(one, info) for one in withdrawn),
        withdrawn=tuple(withdrawn),
        **compare_causes(first.test, first.cause),
    )
    return smaller, (*kept, finding)


def _name_carrier(finding: Finding) -> str:
    """The columns that a cause follows; its name where it follows none."""
    columns = [name for name in getattr(finding.version, "columns", ()) if name != "session"]
    return " and ".join("time" if name == "session_seconds" else name for name in columns) or finding.cause


def _withdraw_terms(
    selection: Selection, findings: Sequence[Finding], unsupported: Sequence[Finding]
) -> tuple[Selection, tuple[Finding, ...]]:
    """The selection and its findings without the laws for some unknown structure."""
    terms = [selection.behind(one) for one in unsupported]
    smaller = refit_selection(
        selection,
        tuple(
            replace(one, version=None, start=np.zeros(0)) if one in terms else one
            for one in selection.selected
        ),
    )
    return smaller, tuple(
        replace(one, version=None, term="", parameters=(), gain=None)
        if any(one is other for other in unsupported)
        else one
        for one in findings
    )


def _explain(finding: Finding, info: DataInfo) -> str:
    assert finding.gain is not None
    return f"{finding.cause} is not named, since {explain_unsupported(finding.gain, info)}"


def explain_unsupported(gain: Gain, info: DataInfo) -> str:
    """Why a gain does not speak for a cause, as a clause."""
    before, after = map(info.format_size, gain.judged)
    given, rows = f", {GIVEN_BEFORE}," if gain.given_before else "", f"held-out {info.row}s"
    if gain.judged[1] > gain.judged[0] or not np.isfinite(gain.high):
        return f"{rows}{given} are not predicted better with it ({after}, without it {before})"
    return (
        f"{rows}{given} are predicted better with it ({after}, without it {before}), but in a replicate "
        "of these data the error with it could be twice that without it"
    )
