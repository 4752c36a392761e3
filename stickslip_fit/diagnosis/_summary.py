"""A diagnosis as text: the conclusion and what to do about it, then the tables.

Order of reading: `write_headline` for the sentences, `format_diagnosis` for the whole text,
`describe_effect` for what each cause does and `remedy_for` for what cures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MINUS,
    MISSING,
    capitalize_first,
    format_angle,
    format_direction,
    format_estimate,
    format_interval,
    format_length,
    format_p_value,
    format_percent,
    format_percent_range,
    join_words,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.causes import EndStopMisfire, SizedParameter
from stickslip_fit.causes.parameters import plain_description
from stickslip_fit.diagnosis.experiments import UntestableCause, find_inseparable_pairs
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnosis.result import Diagnosis, Finding, Gain, NextTraverse
from stickslip_fit.diagnosis.selection import MISFIRE
from stickslip_fit.diagnosis.separability import MAX_CONFUSION_DESIGN, Detectability, SeparabilityMatrix
from stickslip_fit.units import PRISMATIC, from_si


def describe_effect(finding: Finding) -> str:
    """What a named cause does, without a full stop.

    Parameters
    ----------
    finding : Finding
        Of any cause; one that doesn't describe itself, not being a `Cause`, is told by its phrase. Without
        parameters, the size of the effect stands for theirs.
    """
    cause = _cause(finding)
    if hasattr(cause, "describe"):
        text = cause.describe(finding.parameters)
    else:
        text = plain_description(getattr(cause, "phrase", finding.cause), finding.parameters)
    return text if finding.parameters else f"{text}, by {format_percent(finding.effect.estimate)} rms"


def remedy_for(finding: Finding) -> str:
    """What cures it, as the beginning of a sentence; empty where nothing but the extended law does."""
    return getattr(_cause(finding), "remedy", "")


def _cause(finding: Finding) -> Any:
    """The cause as it acts in the log; counts that misfired are left out of it, and need no version."""
    return EndStopMisfire() if finding.cause == EndStopMisfire.name else finding.version


MAX_UNTESTABLE_NAMED = 4
CARRIER_PHRASES = {
    "time": "changes slowly with time, in each session in its own way",
    "time, the same in each session": "changes slowly with time, in all sessions alike",
    "configuration": "depends on the configuration, in both directions alike",
    "configuration and direction": "depends on configuration and direction",
}


def write_headline(diagnosis: Diagnosis) -> list[str]:
    """The verdict, and what it means for who uses the law.

    Returns
    -------
    list of str
        Sentences: what is wrong, what to do about it, then what else is wrong.
    """
    if not diagnosis.findings:
        return [_describe_no_misfit(diagnosis), _describe_untestable(diagnosis)]
    first, *others = diagnosis.findings
    return [
        f"{_describe_finding(first, diagnosis)}.",
        _describe_gain(first, diagnosis),
        *(_describe_side_effects(each) for each in others),
    ]


def name_cause(cause: str, diagnosis: Diagnosis) -> str:
    """A cause in words, with its name."""
    words = {each.name: getattr(each, "phrase", "") for each in diagnosis.search.problem.causes}
    return f"{words[cause]} ({cause})" if words.get(cause) else cause


def describe_carrier(carrier: str) -> str:
    """What structure without a name does, as the end of a sentence.

    Examples
    --------
    >>> describe_carrier("period of 41.2 min"), describe_carrier("time, joint 3")
    ('comes and goes with a period of 41.2 min', 'changes slowly with time, in joint 3')
    """
    if carrier.startswith("period"):
        return f"comes and goes with a {carrier}"
    if carrier.startswith("memory"):
        whose = carrier.removeprefix("memory").strip() or "of any joint"
        return f"carries over from one traverse {whose} to the next"
    if carrier.startswith("time, joint"):
        return f"changes slowly with time, in {carrier.removeprefix('time, ')}"
    return CARRIER_PHRASES.get(carrier, f"follows {carrier}")


def _describe_no_misfit(diagnosis: Diagnosis) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return f"Nothing can be said of this log: {diagnosis.untestable[UNKNOWN]}."
    return (
        "Nothing is wrong that this log can show: the published law leaves "
        f"{format_percent(diagnosis.misfit)} rms, and a traverse repeats to "
        f"{format_percent(diagnosis.repeatability)} "
        f"(p {format_p_value(diagnosis.p_value, relation=True)})."
    )


def _describe_untestable(diagnosis: Diagnosis) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return "Until then no cause is confirmed, and none ruled out."
    unseen = list(diagnosis.untestable)
    if not unseen:
        return "It could have shown every cause that is known, at its largest plausible size."
    shown = unseen[:MAX_UNTESTABLE_NAMED]
    if len(unseen) > len(shown):
        shown = [*unseen[: MAX_UNTESTABLE_NAMED - 1], f"{len(unseen) - MAX_UNTESTABLE_NAMED + 1} others"]
    return f"It could not have shown {join_words(shown)}; the reasons are below."


def _describe_finding(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return _describe_shape(finding)
    told = describe_effect(finding)
    if not finding.equivalent:
        return told
    either = join_words([name_cause(each, diagnosis) for each in (finding.cause, *finding.equivalent)], "or")
    return f"This log cannot tell what is wrong: {either}. If it is the first: {_lower_first(told)}"


def _describe_shape(finding: Finding) -> str:
    told = (
        f"What is left of the counts, {format_percent(finding.effect.estimate)} rms, "
        f"{describe_carrier(finding.carrier)}, and has the shape of no known cause"
    )
    if not finding.closest:
        return told
    share = f"{100 * finding.share:.0f} %"
    return f"{told}; the closest, {finding.closest}, explains {share} of it"


def _describe_gain(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return (
            "The figures show it: compare them with whatever changed meanwhile, and log that as a column of "
            "its own; until it has a name, count on errors of "
            f"{format_percent(diagnosis.misfit)}, where a traverse repeats to "
            f"{format_percent(diagnosis.repeatability)}."
        )
    cure = remedy_for(finding) if not finding.equivalent else ""
    law = "" if finding.cause == MISFIRE else "the extended law"
    what = capitalize_first(f"{cure}, or {law}," if cure and law else cure or law)
    rest = _describe_error_cut(diagnosis.gain, finding, diagnosis.repeatability)
    return f"{what} {rest}{_describe_next_experiment(diagnosis)}"


def _describe_error_cut(gain: Gain | None, finding: Finding, repeatability: float) -> str:
    repeats = f"the repeatability is {format_percent(repeatability)}."
    if gain is None:
        return f"takes away errors of {format_percent(finding.effect.estimate)} rms; {repeats}"
    return (
        f"cuts the prediction error on held-out traverses from {format_percent(gain.baseline)} to "
        f"{format_percent(gain.extended)}; {repeats}"
    )


def _describe_next_experiment(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings[0].equivalent:
        return ""
    if diagnosis.next_experiment:
        return " The traverses that would tell which it is are below."
    return " No traverse that was looked at would tell which it is."


def _describe_side_effects(finding: Finding) -> str:
    if finding.cause == UNKNOWN:
        return f"Besides that: {_lower_first(_describe_shape(finding))}."
    rivals: Sequence[str] = finding.equivalent
    told = f"Besides that: {_lower_first(describe_effect(finding))} ({finding.cause}"
    return f"{told}{', or ' + join_words(rivals, 'or') if rivals else ''})."


def _lower_first(text: str) -> str:
    """A sentence after a colon; names that begin with a capital have more than one."""
    return text[:1].lower() + text[1:]


MIN_PROBABILITY, MAX_RANKED, MAX_TRAVERSES = 0.015, 10, 20
LN_10 = np.log(10.0)


@summarize.register
def summarize_diagnosis(diagnosis: Diagnosis) -> Summary:
    """The answer; findings with sizes and gain; what else it could be; what could not be seen."""
    name = Path(diagnosis.log_file).name or "a log that was never in a file"
    further = traverses_table("Traverses that would tell", diagnosis.next_experiment)
    return Summary(
        f"Diagnosis of {name}",
        tuple(map(typeset_text, write_headline(diagnosis))),
        (
            Section(tables=(*_findings_tables(diagnosis), *_gain_tables(diagnosis))),
            Section(
                "What else it could be",
                tuple(_alternatives(diagnosis)),
                (*_ranking_tables(diagnosis), *further),
                key="alternatives",
            ),
            Section("What this log could not have shown", tuple(_not_seen(diagnosis)), key="unseen"),
        ),
        provenance=(
            (name, f"sha256 {diagnosis.log_sha256}"),
            ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
        ),
    )


def _findings_tables(diagnosis: Diagnosis) -> list[Table]:
    """What is wrong with its size, its parameters, and counts that are wildly off."""
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        *numbers("effect, rms", "95 % interval", unit="%"),
        Column("joints", text=True),
        Column("p"),
        Column("cannot be told from", text=True),
    )
    rows = tuple(
        (
            finding.cause,
            format_percent(finding.effect.estimate, with_unit=False),
            format_interval(finding.effect, "%", 1),
            ", ".join(map(str, finding.joints)),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or MISSING,
        )
        for finding in diagnosis.findings
    )
    note = (
        "Effect: rms over all rows of what the cause does to the count, beyond what recalibration absorbs. "
        "p: the chance of anything as far off, anywhere that was searched, if nothing were wrong."
    )
    outliers = [_outliers(each.traverses) for each in diagnosis.findings if each.traverses is not None]
    return [Table("What is wrong", columns, rows, note=note), *_parameters(diagnosis), *outliers]


def _parameters(diagnosis: Diagnosis) -> list[Table]:
    columns: tuple[Column, ...] = (
        *words("cause", "parameter"),
        *numbers("estimate", "95 % interval"),
        Column("of", text=True),
    )
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            finding.cause,
            each.name,
            typeset_text(format_estimate(each.size, each.unit, signed=True)),
            format_interval(each.size, each.unit, 1),
            _scope(each),
        )
        for finding in diagnosis.findings
        for each in finding.parameters
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    return [Table("Parameters of what was named", columns, rows, stubs=2)] if rows else []


def _scope(parameter: SizedParameter) -> str:
    """What a parameter belongs to, where that is not the whole campaign."""
    direction = format_direction(parameter.direction)
    joint = f"joint {parameter.joint} {direction}".strip() if parameter.joint else ""
    session = f"session {parameter.session}" if parameter.session else ""
    return ", ".join(filter(None, [joint, session]))


def _outliers(traverses: pd.DataFrame) -> Table:
    columns = (*words("session", "time", "joint"), Column("steps"), Column("count less law", "%"))
    order = traverses["departure"].abs().sort_values(ascending=False).index
    shown = traverses.loc[order].head(MAX_TRAVERSES)
    rows = tuple(
        (
            str(row["session"]),
            row["time"].strftime("%Y-%m-%d %H:%M:%S"),
            f"{row['joint']} {format_direction(str(row['direction']))}",
            f"{row['steps']:,}",
            format_percent(float(row["departure"]), with_unit=False, signed=True),
        )
        for _, row in shown.iterrows()
    )
    left_out = len(shown) < len(traverses)
    note = f"The {MAX_TRAVERSES} furthest off of {pluralize(len(traverses), 'count')}." if left_out else ""
    return Table("Counts that are wildly off", columns, rows, note=note)


def _gain_tables(diagnosis: Diagnosis) -> list[Table]:
    """Errors on traverses that took no part, before and after."""
    named = [(each.cause, each.gain) for each in diagnosis.findings if each.cause != UNKNOWN]
    steps = [(f"with {cause}", gain) for cause, gain in named] if len(named) > 1 else []
    lines: list[tuple[str, Gain | None]] = [
        ("held-out traverses", diagnosis.gain),
        *steps,
        ("a new session, by its calibration", diagnosis.gain_new_session),
    ]
    rows = tuple(
        (
            name,
            format_percent(gain.baseline, with_unit=False),
            format_percent(gain.extended, with_unit=False),
            format_percent(gain.baseline - gain.extended, with_unit=False),
            format_percent_range(gain.low, gain.high),
            format_percent(gain.noise_floor, with_unit=False),
        )
        for name, gain in lines
        if gain is not None
    )
    if not rows or not named:
        return []
    heads = ("published law", "extended law", "gain", "95 % interval", "noise floor")
    columns = (Column("predicted", text=True), *(Column(head, "%") for head in heads))
    note = (
        "Rms error of the step size on traverses that took no part in choosing or fitting anything. The "
        "interval is for a fresh replicate of this campaign; the noise floor includes the rounding of counts."
    )
    return [Table("What the extended law gains", columns, rows, note=note)]


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    said = [
        f"Whatever {first} would do in this log, {second} could have done too."
        for first, second in diagnosis.aliased_causes
    ]
    beyond = find_inseparable_pairs(diagnosis.findings, diagnosis.next_experiment)
    said += [f"No traverse within reach tells {one} from {other}." for one, other in beyond]
    if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
        said.append("Structure without a name is not put into the law, so that it gains nothing.")
    return said


def rank_causes(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """Causes that may be at work, likeliest first: name, probability, log10 of the odds against chance.

    The odds are those of the look at the residuals that found it, or else of the last one.
    """
    odds = dict(diagnosis.search.last.log_evidence_by_cause)
    for found in diagnosis.search.found:
        misfit: Misfit | None = found.misfit
        if misfit is not None:
            odds |= {
                cause: misfit.log_evidence_by_cause[cause] for cause in (found.cause, *found.cause_set.rivals)
            }
    likely = {cause: value for cause, value in diagnosis.inclusion.items() if value is not None}
    order = sorted(likely, key=lambda cause: (-likely[cause], cause))
    return [(cause, likely[cause], odds.get(cause, np.nan) / LN_10) for cause in order]


def _ranking_tables(diagnosis: Diagnosis) -> list[Table]:
    ranked = [each for each in rank_causes(diagnosis) if each[1] >= MIN_PROBABILITY][:MAX_RANKED]
    columns = (
        Column("cause", text=True),
        Column("probability", "%"),
        Column("odds against chance", "powers of ten"),
    )
    rows = tuple(
        (
            cause,
            f"{100 * likely:.0f}" if likely < 0.995 else "> 99",
            f"{odds:.1f}".replace("-", MINUS) if np.isfinite(odds) else MISSING,
        )
        for cause, likely, odds in ranked
    )
    return [Table("What may be at work", columns, rows)] if rows else []


def traverses_table(caption: str, traverses: Sequence[NextTraverse]) -> list[Table]:
    """Traverses to make next, with the causes that they tell apart or show; nothing where there are none."""
    places = ("q1", "q2", "q3", "theta", "psi", "from", "to")
    columns = (*words("causes", "joint"), *map(Column, ("times", *places)), *words("when"))
    rows = tuple(map(_traverse, traverses))
    return [Table(caption, columns, rows)] if rows else []


def _traverse(each: NextTraverse) -> tuple[str, ...]:
    ends = format_length if each.joint == PRISMATIC else format_angle
    stands = [(name, getattr(each, name)) for name in ("q1", "q2", "q3", "theta", "psi")]
    places = [
        (format_length if name == "q3" else format_angle)(value)
        if np.isfinite(value) and name != f"q{each.joint}"
        else MISSING
        for name, value in stands
    ]
    limits = [ends(value) if np.isfinite(value) else "stop" for value in (each.start, each.stop)]
    return (
        ", ".join(each.tells_apart),
        f"{each.joint} {format_direction(each.direction)}",
        str(each.repeats),
        *places,
        *limits,
        each.note,
    )


def _not_seen(diagnosis: Diagnosis) -> list[str]:
    """Causes that could not have been seen, by reason."""
    causes: dict[str, list[str]] = {}
    for cause, reason in diagnosis.untestable.items():
        causes.setdefault(reason, []).append(cause)
    if not causes:
        return ["Nothing: every cause that is known would have shown at its largest plausible size."]
    return [f"{join_words(names)}: {typeset_text(reason)}" for reason, names in causes.items()]


SHOWN_AT = 8.0  # strength at which rates of confusion are shown
MAX_PAIRS = 20


def summarize_next(
    diagnosis: Diagnosis,
    traverses: Sequence[NextTraverse],
    beyond: Sequence[tuple[str, str]],
    unseen: Sequence[UntestableCause],
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


def summarize_plan(found: SeparabilityMatrix, plan: str, traverses: int, sessions: int) -> Summary:
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
    shown = len(found.detectable) + len(found.scatter_only)
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


def _sizes(found: SeparabilityMatrix) -> Table:
    rows = tuple(
        (each.cause, _size(each, each.smallest), _size(each, each.largest), _hardest(found, each.cause))
        for each in found.detectable
    )
    columns = (*words("cause"), *map(Column, ("found from", "largest plausible", "hardest rival")))
    return Table("Could be found", columns, rows, note=_how(found))


def _hardest(found: SeparabilityMatrix, cause: str) -> str:
    """The rival that is hardest to tell from a cause, and how often it is taken for it."""
    others = [other for other in found.causes if other != cause]
    rates = [found.rate(cause, other, SHOWN_AT) for other in others]
    if not rates or max(rates) < MAX_CONFUSION_DESIGN:
        return MISSING
    return f"{others[int(np.argmax(rates))]} {format_percent(max(rates))}"


def _how(found: SeparabilityMatrix) -> str:
    strengths = [each.found for each in found.detectable]
    if not strengths:
        return ""
    said = (
        f"Found from: the size that raises the alarm in nine of ten logs, at a false-alarm rate of "
        f"{format_percent(found.alpha)}; for that, strength (rms effect left after recalibration, over the "
        f"repeatability, times the square root of the traverses) must be {min(strengths):.1f} to "
        f"{max(strengths):.1f}, by logs of this plan in which nothing is wrong. Hardest rival: taken for "
        f"each other in so many logs at strength {SHOWN_AT:.0f}, where that is {format_percent(MAX_CONFUSION_DESIGN)} or "
        "more."
    )
    if found.scatter_only:
        said += f" Not listed: {join_words(found.scatter_only)}, which single counts show."
    return said


def _pairs(found: SeparabilityMatrix, hard: Sequence[tuple[str, str, float]]) -> Table:
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


def _from(showing: Detectability, strength: float) -> str:
    """Size at a strength; in brackets beyond what is plausible."""
    if not np.isfinite(strength):
        return MISSING
    text = _size(showing, showing.size(strength))
    return text if showing.size(strength) <= showing.largest else f"({text})"


def _size(showing: Detectability, value: float) -> str:
    unit = "" if showing.unit == "1" else f" {showing.unit}"
    return f"{float(f'{from_si(value, showing.unit):.2g}'):,g}{unit}"
