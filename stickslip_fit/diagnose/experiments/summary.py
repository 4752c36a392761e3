"""What the next traverses would tell after a log, and what a plan could tell before any."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit._format import MISSING, format_percent, join_words, pluralize
from stickslip_fit._summary import Column, Section, Summary, Table, words
from stickslip_fit.diagnose.diagnosis import Diagnosis, NextTraverse
from stickslip_fit.diagnose.experiments.matrix import CONFUSED, Matrix, Showing
from stickslip_fit.diagnose.experiments.unseen import Unseen
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.telling.summary import traverses_table
from stickslip_fit.units import from_si

SHOWN_AT = 8.0  # strength at which rates of confusion are shown
MAX_PAIRS = 20


def summarize_next(
    diagnosis: Diagnosis,
    traverses: Sequence[NextTraverse],
    beyond: Sequence[tuple[str, str]],
    unseen: Sequence[Unseen],
) -> Summary:
    """What is left to tell apart and what tells it; what could not be seen and what would show it.

    Parameters
    ----------
    diagnosis : Diagnosis
    traverses : sequence of NextTraverse
    beyond : sequence of (str, str)
        Pairs that no traverse within reach tells apart.
    unseen : sequence of Unseen
    """
    title = "The next traverses"
    if UNKNOWN in diagnosis.untestable:
        return Summary(title, (f"This log can show nothing: {diagnosis.untestable[UNKNOWN]}.",))
    caption = "To make testable what this log could not show, in a new session, least time first"
    tables = [
        *traverses_table("To tell apart, in a new session", traverses),
        *traverses_table(caption, [each.traverse for each in unseen if each.traverse is not None]),
    ]
    further = tuple(
        f"{each.cause}: {each.reason}; best seen with {each.shows_best}"
        for each in unseen
        if each.traverse is None
    )
    sections = [Section(tables=tuple(tables))] if tables else []
    sections += [Section("Not to be shown by a single traverse", further)] if further else []
    return Summary(title, (_next_answer(diagnosis, traverses, beyond),), tuple(sections))


def _next_answer(
    diagnosis: Diagnosis, traverses: Sequence[NextTraverse], beyond: Sequence[tuple[str, str]]
) -> str:
    causes = [join_words([each.cause, *each.equivalent], "or") for each in diagnosis.findings]
    said = [f"Found: {'; '.join(causes)}." if causes else "Nothing is wrong that this log could show."]
    if traverses:
        number = sum(each.repeats for each in traverses)
        said.append(
            f"{pluralize(number, 'traverse')}, and the calibration that goes with them, would tell apart "
            "what this log cannot."
        )
    said += [f"No traverse within reach separates {one} from {other}." for one, other in beyond]
    if causes and not traverses and not beyond:
        said.append("Nothing is left to tell apart.")
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        said.append(
            "What has no name predicts nothing, so that no traverse can be worked out for it; replicates of "
            "the configurations that are furthest off, hours apart, show whether it stays or comes and goes."
        )
    return " ".join(said)


def summarize_plan(found: Matrix, plan: str, traverses: int, sessions: int) -> Summary:
    """What a plan could tell: the causes with their sizes, the pairs that are hard.

    Parameters
    ----------
    found : Matrix
    plan : str
        Its name.
    traverses, sessions : int
        How many it has.
    """
    hard = [
        (one, other, needed)
        for one, other, needed in found.pairs()
        if needed > min(found.of(one).found, found.of(other).found)
    ]
    shown = len(found.showing) + len(found.by_scatter)
    said = (
        f"{plan}: {pluralize(traverses, 'traverse')} in {pluralize(sessions, 'session')} could show "
        f"{shown} of {shown + len(found.untestable)} causes."
    )
    never = [f"{one} from {other}" for one, other, _ in hard if not found.apart(one, other)]
    if never:
        said += f" At no plausible size could they tell {join_words(never, 'or')}."
    elif hard:
        said += f" {pluralize(len(hard), 'pair')} of them could be found before they could be told apart."
    else:
        said += " Whatever of these is large enough to be found is told from all others."
    unseen = tuple(f"{cause}: {reason}" for cause, reason in found.untestable.items())
    sections = [Section(tables=(_sizes(found), *([_pairs(found, hard)] if hard else [])))]
    sections += [Section("Could not be seen in its log", unseen)] if unseen else []
    return Summary("What this plan could tell", (said,), tuple(sections))


def _sizes(found: Matrix) -> Table:
    rows = tuple(
        (each.cause, _size(each, each.smallest), _size(each, each.largest), _hardest(found, each.cause))
        for each in found.showing
    )
    columns = (*words("cause"), *map(Column, ("found from", "largest plausible", "hardest rival")))
    return Table("Could be found", columns, rows, note=_how(found))


def _hardest(found: Matrix, cause: str) -> str:
    """The rival that is hardest to tell from a cause, and how often it is taken for it."""
    others = [other for other in found.causes if other != cause]
    rates = [found.rate(cause, other, SHOWN_AT) for other in others]
    if not rates or max(rates) < CONFUSED:
        return MISSING
    return f"{others[int(np.argmax(rates))]} {format_percent(max(rates))}"


def _how(found: Matrix) -> str:
    strengths = [each.found for each in found.showing]
    if not strengths:
        return ""
    said = (
        f"Found from: the size that raises the alarm in nine of ten logs, at a false-alarm rate of "
        f"{format_percent(found.alpha)}; for that, strength (rms effect left after recalibration, over the "
        f"repeatability, times the square root of the traverses) must be {min(strengths):.1f} to "
        f"{max(strengths):.1f}, by logs of this plan in which nothing is wrong. Hardest rival: taken for "
        f"each other in so many logs at strength {SHOWN_AT:.0f}, where that is {format_percent(CONFUSED)} or "
        "more."
    )
    if found.by_scatter:
        said += f" Not listed: {join_words(found.by_scatter)}, which single counts show."
    return said


def _pairs(found: Matrix, hard: Sequence[tuple[str, str, float]]) -> Table:
    rows = tuple(
        (
            one,
            other,
            format_percent(found.rate(one, other, SHOWN_AT)),
            f"{needed:.1f}" if np.isfinite(needed) else "never",
            _from(found.of(one), needed),
            _from(found.of(other), needed),
        )
        for one, other, needed in hard[:MAX_PAIRS]
    )
    heads = (f"confused at {SHOWN_AT:.0f}", "told apart from", "cause of", "rival of")
    note = f"The hardest {MAX_PAIRS} of {len(hard)} pairs." if len(hard) > MAX_PAIRS else ""
    return Table(
        "Hard to tell apart", (*words("cause", "rival"), *map(Column, heads)), rows, stubs=2, note=note
    )


def _from(showing: Showing, strength: float) -> str:
    """Size at a strength; in brackets beyond what is plausible."""
    if not np.isfinite(strength):
        return MISSING
    text = _size(showing, showing.size(strength))
    return text if showing.size(strength) <= showing.largest else f"({text})"


def _size(showing: Showing, value: float) -> str:
    unit = "" if showing.unit == "1" else f" {showing.unit}"
    return f"{float(f'{from_si(value, showing.unit):.2g}'):,g}{unit}"
