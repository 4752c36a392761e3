"""Summaries of the next experiment, and of the causes that a plan can detect and separate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit._format import MISSING, format_percent, join_words, pluralize
from stickslip_fit._summary import Column, Section, Summary, Table, words
from stickslip_fit.diagnosis._summary import traverses_table
from stickslip_fit.diagnosis.experiments import UntestableCause
from stickslip_fit.diagnosis.finding import NextTraverse
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.separability import MAX_CONFUSION_DESIGN, Detectability, SeparabilityMatrix
from stickslip_fit.units import from_si

SHOWN_AT = 8.0  # strength for the rates of confusion
MAX_PAIRS = 20
ON_SCREEN = slice(0, 10)  # rows of a long table


def summarize_next(
    diagnosis: Diagnosis,
    traverses: Sequence[NextTraverse],
    inseparable: Sequence[tuple[str, str]],
    untestable: Sequence[UntestableCause],
) -> Summary:
    """Traverses that separate causes, the pairs that none separates, and traverses for untestable causes."""
    title = "The next traverses"
    if UNKNOWN in diagnosis.untestable:
        return Summary(title, (f"This log can show nothing: {diagnosis.untestable[UNKNOWN]}.",))
    caption = "To make testable what this log could not show, in a new session, least time first"
    tables = [
        *traverses_table("To separate causes, in a new session", traverses),
        *traverses_table(caption, [one.traverse for one in untestable if one.traverse is not None]),
    ]
    further = tuple(
        f"{one.cause}: {one.reason}; best seen with {one.shows_best}"
        for one in untestable
        if one.traverse is None
    )
    sections = [Section(tables=tuple(tables))] if tables else []
    sections += [Section("Not to be shown by a single traverse", further)] if further else []
    return Summary(title, (_next_headline(diagnosis, traverses, inseparable),), tuple(sections))


def _next_headline(
    diagnosis: Diagnosis, traverses: Sequence[NextTraverse], inseparable: Sequence[tuple[str, str]]
) -> str:
    causes = [join_words(finding.cause_set, "or") for finding in diagnosis.findings]
    text = [f"Found: {'; '.join(causes)}." if causes else "Nothing is wrong that this log could show."]
    if traverses:
        number = sum(traverse.repeats for traverse in traverses)
        text.append(
            f"{pluralize(number, 'traverse')}, and the calibration that goes with them, would separate "
            "what this log cannot."
        )
    text += [f"No traverse within reach separates {one} from {other}." for one, other in inseparable]
    if causes and not traverses and not inseparable:
        text.append("Nothing is left to separate.")
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        text.append(
            "What has no name may be due to anything, so that no traverse can be worked out that would tell; "
            "replicates of the configurations that are furthest off, hours apart, show whether it stays or "
            "comes and goes."
        )
    return " ".join(text)


def summarize_plan(matrix: SeparabilityMatrix, plan: str, traverses: int, sessions: int) -> Summary:
    """The detectable causes of a plan with their sizes, and the pairs that are hard to separate."""
    hard = [
        (one, other, needed)
        for one, other, needed in matrix.pairs()
        if needed
        > min(matrix.detectability(one).detection_strength, matrix.detectability(other).detection_strength)
    ]
    number = len(matrix.detectable) + len(matrix.scatter_only)
    text = (
        f"{plan}: {pluralize(traverses, 'traverse')} in {pluralize(sessions, 'session')} could show "
        f"{number} of {number + len(matrix.untestable)} causes."
    )
    never = [f"{one} from {other}" for one, other, _ in hard if not matrix.are_separable(one, other)]
    if never:
        text += f" At no plausible size could they separate {join_words(never, 'or')}."
    elif hard:
        text += f" {pluralize(len(hard), 'pair')} of them could be detected before they could be separated."
    else:
        text += " Each of these that is large enough to be detected is separated from all others."
    untestable = tuple(f"{cause}: {reason}" for cause, reason in matrix.untestable.items())
    sections = [Section(tables=(_sizes_table(matrix), *([_pairs_table(matrix, hard)] if hard else [])))]
    sections += [Section("Could not be seen in its log", untestable)] if untestable else []
    return Summary("What this plan could show", (text,), tuple(sections))


def _sizes_table(matrix: SeparabilityMatrix) -> Table:
    rows = tuple(
        (
            one.cause,
            _format_size(one, one.smallest_size),
            _format_size(one, one.largest_size),
            _hardest_rival(matrix, one.cause),
        )
        for one in matrix.detectable
    )
    columns = (*words("cause"), *map(Column, ("found from", "largest plausible", "hardest rival")))
    return Table("Detectable causes", columns, rows, note=_explain_sizes(matrix), short=ON_SCREEN)


def _hardest_rival(matrix: SeparabilityMatrix, cause: str) -> str:
    """The rival with the largest rate of confusion, and that rate."""
    others = [other for other in matrix.causes if other != cause]
    rates = [matrix.pair_confusion(cause, other, SHOWN_AT) for other in others]
    if not rates or max(rates) < MAX_CONFUSION_DESIGN:
        return MISSING
    return f"{others[int(np.argmax(rates))]} {format_percent(max(rates))}"


def _explain_sizes(matrix: SeparabilityMatrix) -> str:
    strengths = [one.detection_strength for one in matrix.detectable]
    if not strengths:
        return ""
    text = (
        f"Found from: the size that raises the alarm in nine of ten logs, at a false-alarm rate of "
        f"{format_percent(matrix.alpha)}; for that, strength (rms effect left after recalibration, over the "
        f"repeatability, times the square root of the traverses) must be {min(strengths):.1f} to "
        f"{max(strengths):.1f}, by logs of this plan in which nothing is wrong. Hardest rival: taken for "
        f"each other in so many logs at strength {SHOWN_AT:.0f}, where that is "
        f"{format_percent(MAX_CONFUSION_DESIGN)} or more."
    )
    if matrix.scatter_only:
        text += f" Not listed: {join_words(matrix.scatter_only)}, which single counts show."
    return text


def _pairs_table(matrix: SeparabilityMatrix, hard: Sequence[tuple[str, str, float]]) -> Table:
    rows = tuple(
        (
            one,
            other,
            format_percent(matrix.pair_confusion(one, other, SHOWN_AT)),
            f"{needed:.1f}" if np.isfinite(needed) else "never",
            _size_at(matrix.detectability(one), needed),
            _size_at(matrix.detectability(other), needed),
        )
        for one, other, needed in hard[:MAX_PAIRS]
    )
    heads = (f"confused at {SHOWN_AT:.0f}", "separated from", "cause of", "rival of")
    note = f"The hardest {MAX_PAIRS} of {len(hard)} pairs." if len(hard) > MAX_PAIRS else ""
    return Table(
        "Hard to separate", (*words("cause", "rival"), *map(Column, heads)), rows, stubs=2, note=note
    )


def _size_at(cause: Detectability, strength: float) -> str:
    """Size at a strength; in brackets where it is not plausible."""
    if not np.isfinite(strength):
        return MISSING
    size = cause.size(strength)
    return _format_size(cause, size) if size <= cause.largest_size else f"({_format_size(cause, size)})"


def _format_size(cause: Detectability, value: float) -> str:
    unit = "" if cause.unit == "1" else f" {cause.unit}"
    return f"{float(f'{from_si(value, cause.unit):.2g}'):,g}{unit}"
