"""The traverses worth making next, as text."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import pandas as pd

from stickslip_fit._format import format_configuration, format_direction, join_words, pluralize
from stickslip_fit._summary import text_table
from stickslip_fit.diagnose import Diagnosis, NextTraverse
from stickslip_fit.diagnose.experiments.unseen import Unseen
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.machine import Machine

WIDTH = 110


def next_traverses_text(
    diagnosis: Diagnosis,
    traverses: Sequence[NextTraverse],
    beyond: Sequence[tuple[str, str]],
    unseen: Sequence[Unseen],
    machine: Machine,
) -> str:
    """What is left to tell apart and what tells it; what could not be seen and what would show it.

    Parameters
    ----------
    diagnosis : Diagnosis
    traverses : sequence of NextTraverse
    beyond : sequence of (str, str)
        Pairs that no traverse within reach tells apart.
    unseen : sequence of Unseen
    machine : Machine
    """
    if UNKNOWN in diagnosis.untestable:
        told = f"This log can show nothing: {diagnosis.untestable[UNKNOWN]}."
        return fill(told, WIDTH, break_on_hyphens=False)
    parts = [fill(_answer(diagnosis, traverses, beyond), WIDTH, break_on_hyphens=False)]
    if traverses:
        parts.append(f"to tell apart, in a new session\n{_table(traverses, machine)}")
    shown = [each.traverse for each in unseen if each.traverse is not None]
    if shown:
        head = "to make testable what this log could not show, in a new session, least time first"
        parts.append(f"{head}\n{_table(shown, machine)}")
    further = [each for each in unseen if each.traverse is None]
    if further:
        parts.append("not to be shown by a single traverse\n" + "\n".join(map(_in_words, further)))
    return "\n\n".join(parts)


def _answer(
    diagnosis: Diagnosis, traverses: Sequence[NextTraverse], beyond: Sequence[tuple[str, str]]
) -> str:
    told = [_state(diagnosis)]
    if traverses:
        number = sum(each.repeats for each in traverses)
        told.append(
            f"{pluralize(number, 'traverse')}, and the calibration that goes with them, would tell apart "
            "what this log cannot."
        )
    for one, other in beyond:
        told.append(f"No traverse within reach separates {one} from {other}.")
    if diagnosis.findings and not traverses and not beyond:
        told.append("Nothing is left to tell apart.")
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        told.append(
            "What has no name predicts nothing, so that no traverse can be worked out for it; replicates of "
            "the configurations that are furthest off, hours apart, show whether it stays or comes and goes."
        )
    return " ".join(told)


def _state(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings:
        return "Nothing is wrong that this log could show."
    each = [
        join_words([finding.cause, *finding.equivalent], "or") if finding.equivalent else finding.cause
        for finding in diagnosis.findings
    ]
    return f"Found: {'; '.join(each)}."


def _table(traverses: Sequence[NextTraverse], machine: Machine) -> str:
    header = ["causes", "joint", "configuration", "times", "when"]
    rows = [
        [
            ", ".join(each.tells_apart),
            f"{each.joint} {format_direction(each.direction)}",
            _where(each, machine),
            str(each.repeats), each.note,
        ]
        for each in traverses
    ]  # fmt: skip
    return text_table(header, rows, left=5)


def _where(traverse: NextTraverse, machine: Machine) -> str:
    low, high = machine.ranges[traverse.joint]
    ends = {"start": traverse.start, "stop": traverse.stop}
    if pd.isna(traverse.start):
        ends = {"start": low, "stop": high}
    places = {name: getattr(traverse, name) for name in ("joint", "q1", "q2", "q3", "theta", "psi")}
    return format_configuration(pd.Series(places | ends), machine.span(traverse.joint))


def _in_words(unseen: Unseen) -> str:
    told = f"{unseen.cause}: {unseen.reason}; best seen with {unseen.shows_best}"
    return fill(told, WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
