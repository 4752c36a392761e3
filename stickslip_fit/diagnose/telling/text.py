"""A diagnosis as text for the terminal: the answer first, then the tables."""

from __future__ import annotations

import re
from textwrap import fill
from typing import Any

import numpy as np

from stickslip_fit._format import (
    format_direction,
    format_estimate,
    format_interval,
    format_p_value,
    format_percent,
    format_value,
    join_words,
)
from stickslip_fit._summary import text_table
from stickslip_fit.diagnose.diagnosis import Diagnosis, Gain, NextTraverse, SizedParameter
from stickslip_fit.diagnose.experiments.next_experiment import out_of_reach
from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnose.telling.answer import answer

WIDTH = 110
INDENTED: dict[str, Any] = {
    "width": WIDTH, "initial_indent": "  ", "subsequent_indent": "    ", "break_on_hyphens": False
}  # fmt: skip
LIKELY_ENOUGH, MOST_RANKED = 0.015, 8
POWER_OF_TEN = np.log(10.0)
NO_BREAK = "\N{NO-BREAK SPACE}"
_SPACED = re.compile(r"(?<=\d) (?=[%a-zµ])")  # between a number and its unit


def text(diagnosis: Diagnosis) -> str:
    """The answer, findings with sizes, the ranking of causes, the gain, and what cannot be told."""
    said = _SPACED.sub(NO_BREAK, " ".join(answer(diagnosis)))
    said = fill(said, WIDTH, break_on_hyphens=False).replace(NO_BREAK, " ")
    parts = [
        said,
        findings_text(diagnosis),
        parameters_text(diagnosis),
        ranking_text(diagnosis),
        gain_text(diagnosis),
        next_text(diagnosis),
        alike_text(diagnosis),
        untestable_text(diagnosis),
    ]
    return "\n\n".join(part for part in parts if part)


def findings_text(diagnosis: Diagnosis) -> str:
    """What is wrong, how large it is, how sure, and what it might be instead."""
    header = ["found", "effect rms", "95 %", "joints", "p", "cannot be told from"]
    rows = [
        [
            finding.cause,
            format_percent(finding.effect.estimate),
            format_interval(finding.effect, "%", 1),
            ", ".join(map(str, finding.joints)),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or "–",
        ]
        for finding in diagnosis.findings
    ]
    return text_table(header, rows) if rows else ""


def parameters_text(diagnosis: Diagnosis) -> str:
    """The parameters of all that was named."""
    rows = [
        [
            finding.cause,
            each.name,
            format_estimate(each.size, each.unit, signed=True),
            format_interval(each.size, each.unit, 1),
            where(each),
        ]
        for finding in diagnosis.findings
        for each in finding.parameters
    ]
    return text_table(["parameter", "", "", "95 %", ""], rows, left=2) if rows else ""


def where(parameter: SizedParameter) -> str:
    """What a parameter belongs to, where that is not the whole campaign."""
    joint = (
        f"joint {parameter.joint} {format_direction(parameter.direction)}".strip() if parameter.joint else ""
    )
    session = f"session {parameter.session}" if parameter.session else ""
    return ", ".join(filter(None, [joint, session]))


def ranking(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """Causes that may be at work, likeliest first: name, probability, log10 of the odds against chance.

    The odds are those of the look at the residuals that found it, or else of the last one.
    """
    odds = dict(diagnosis.search.last.by_cause)
    for found in diagnosis.search.found:
        looked: Misfit | None = found.misfit
        if looked is not None:
            odds |= {cause: looked.by_cause[cause] for cause in (found.cause, *found.naming.rivals)}
    likely = {cause: value for cause, value in diagnosis.inclusion.items() if value is not None}
    order = sorted(likely, key=lambda cause: (-likely[cause], cause))
    return [(cause, likely[cause], odds.get(cause, np.nan) / POWER_OF_TEN) for cause in order]


def ranking_text(diagnosis: Diagnosis) -> str:
    """The likeliest causes."""
    shown = [each for each in ranking(diagnosis) if each[1] >= LIKELY_ENOUGH][:MOST_RANKED]
    rows = [
        [cause, f"{100 * likely:.0f} %" if likely < 0.995 else "> 99 %", _power(odds)]
        for cause, likely, odds in shown
    ]
    if not rows:
        return ""
    return text_table(["may be at work", "probability", "odds against chance"], rows)


def gain_text(diagnosis: Diagnosis) -> str:
    """Errors on traverses that took no part, before and after."""
    named = [(each.cause, each.gain) for each in diagnosis.findings if each.cause != UNKNOWN]
    steps = [(f"  with {cause}", gain) for cause, gain in named] if len(named) > 1 else []
    lines: list[tuple[str, Gain | None]] = [
        ("held-out traverses", diagnosis.gain if diagnosis.findings else None),
        *steps,
        ("a new session, by its calibration", diagnosis.gain_new_session if diagnosis.findings else None),
    ]
    rows = [
        [
            name,
            format_percent(gain.baseline),
            format_percent(gain.extended),
            f"{format_percent(gain.baseline - gain.extended)}",
            f"{format_percent(gain.low).removesuffix(' %')} to {format_percent(gain.high)}",
            format_percent(gain.noise_floor),
        ]
        for name, gain in lines
        if gain is not None
    ]
    header = ["rms error on", "published law", "extended", "gain", "95 %", "noise floor"]
    return text_table(header, rows) if rows else ""


def next_text(diagnosis: Diagnosis) -> str:
    """The traverses that would tell, and pairs that none within reach does."""
    parts = []
    if diagnosis.next_experiment:
        header = ["drive", "times", "at", "from", "to", "tells apart"]
        rows = [[*drive(each), ", ".join(each.tells_apart)] for each in diagnosis.next_experiment]
        notes = dict.fromkeys(each.note for each in diagnosis.next_experiment if each.note)
        lines = [fill(note, **INDENTED) for note in notes]
        parts.append("\n".join(["traverses that would tell", text_table(header, rows, left=3), *lines]))
    for pair in out_of_reach(diagnosis.findings, diagnosis.next_experiment):
        parts.append(f"no traverse within reach tells {join_words(pair)} apart")
    return "\n".join(parts)


def drive(traverse: NextTraverse) -> list[str]:
    """A traverse as a line of a table: what to drive, how often, where everything stands, from, to."""
    unit = "mm" if traverse.joint == 3 else "deg"
    stands = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
    at = [
        f"{name} {format_value(getattr(traverse, name), symbol, 0)}"
        for name, symbol in stands.items()
        if np.isfinite(getattr(traverse, name)) and name != f"q{traverse.joint}"
    ]
    whole = not np.isfinite(traverse.start)
    ends = (
        ["all of", "its range"] if whole else [format_value(x, unit) for x in (traverse.start, traverse.stop)]
    )
    return [
        f"{traverse.joint} {format_direction(traverse.direction)}",
        str(traverse.repeats),
        ", ".join(at),
        *ends,
    ]


def alike_text(diagnosis: Diagnosis) -> str:
    """Causes that leave the same trace, whatever is at work."""
    lines = [
        fill(f"{first}: whatever it would do, {second} could have done too", **INDENTED)
        for first, second in diagnosis.alike
    ]
    return "\n".join(["the same in this log, whatever the size", *lines]) if lines else ""


def untestable_text(diagnosis: Diagnosis) -> str:
    """What the log could not have shown, reason by reason."""
    lines = [
        fill(f"{join_words(causes)}: {reason}", **INDENTED) for reason, causes in unseen(diagnosis).items()
    ]
    return "\n".join(["this log could not have shown", *lines]) if lines else ""


def unseen(diagnosis: Diagnosis) -> dict[str, list[str]]:
    """Causes that could not have been seen, by reason."""
    reasons: dict[str, list[str]] = {}
    for cause, reason in diagnosis.untestable.items():
        reasons.setdefault(reason, []).append(cause)
    return reasons


def _power(odds: float) -> str:
    if not np.isfinite(odds):
        return "–"
    return f"10^{odds:.0f}".replace("-", "−") if abs(odds) >= 2 else f"{10**odds:.2g}"
