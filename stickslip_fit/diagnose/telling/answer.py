"""What a diagnosis says in two sentences that a lab can act on, and what else has to be said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stickslip_fit._format import capitalize_first, format_p_value, format_percent, join_words
from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding, Gain
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.searching.search import MISFIRE
from stickslip_fit.diagnose.telling.told import what_happens, what_to_do

MOST_UNSEEN = 4
FOLLOWS = {
    "time": "changes slowly with time, in each session in its own way",
    "time, the same in each session": "changes slowly with time, in all sessions alike",
    "configuration": "depends on the configuration, in both directions alike",
    "configuration and direction": "depends on configuration and direction",
}


def answer(diagnosis: Diagnosis) -> list[str]:
    """The verdict, and what it means for who uses the law.

    Returns
    -------
    list of str
        Sentences: what is wrong, what to do about it, then what else is wrong.
    """
    if not diagnosis.findings:
        return [_nothing(diagnosis), _unseen(diagnosis)]
    first, *others = diagnosis.findings
    return [f"{_told(first, diagnosis)}.", _worth(first, diagnosis), *(_besides(each) for each in others)]


def phrase(cause: str, diagnosis: Diagnosis) -> str:
    """A cause in words, with its name."""
    words = {each.name: getattr(each, "phrase", "") for each in diagnosis.search.bench.causes}
    return f"{words[cause]} ({cause})" if words.get(cause) else cause


def follows(carrier: str) -> str:
    """What structure without a name does, as the end of a sentence.

    Examples
    --------
    >>> follows("period of 41.2 min"), follows("time, joint 3")
    ('comes and goes with a period of 41.2 min', 'changes slowly with time, in joint 3')
    """
    if carrier.startswith("period"):
        return f"comes and goes with a {carrier}"
    if carrier.startswith("memory"):
        whose = carrier.removeprefix("memory").strip() or "of any joint"
        return f"carries over from one traverse {whose} to the next"
    if carrier.startswith("time, joint"):
        return f"changes slowly with time, in {carrier.removeprefix('time, ')}"
    return FOLLOWS.get(carrier, f"follows {carrier}")


def _nothing(diagnosis: Diagnosis) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return f"Nothing can be said of this log: {diagnosis.untestable[UNKNOWN]}."
    return (
        "Nothing is wrong that this log can show: the published law leaves "
        f"{format_percent(diagnosis.misfit)} rms, and a traverse repeats to "
        f"{format_percent(diagnosis.repeatability)} "
        f"(p {format_p_value(diagnosis.p_value, relation=True)})."
    )


def _unseen(diagnosis: Diagnosis) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return "Until then no cause is confirmed, and none ruled out."
    unseen = list(diagnosis.untestable)
    if not unseen:
        return "It could have shown every cause that is known, at its largest plausible size."
    shown = unseen[:MOST_UNSEEN]
    if len(unseen) > len(shown):
        shown = [*unseen[: MOST_UNSEEN - 1], f"{len(unseen) - MOST_UNSEEN + 1} others"]
    return f"It could not have shown {join_words(shown)}; the reasons are below."


def _told(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return _shape(finding)
    told = what_happens(finding)
    if not finding.equivalent:
        return told
    either = join_words([phrase(each, diagnosis) for each in (finding.cause, *finding.equivalent)], "or")
    return f"This log cannot tell what is wrong: {either}. If it is the first: {_begun_small(told)}"


def _shape(finding: Finding) -> str:
    told = (
        f"What is left of the counts, {format_percent(finding.effect.estimate)} rms, "
        f"{follows(finding.carrier)}, and has the shape of no known cause"
    )
    if not finding.closest:
        return told
    share = f"{100 * finding.share:.0f} %"
    return f"{told}; the closest, {finding.closest}, explains {share} of it"


def _worth(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return (
            "The figures show it: compare them with whatever changed meanwhile, and log that as a column of "
            "its own; until it has a name, count on errors of "
            f"{format_percent(diagnosis.misfit)}, where a traverse repeats to "
            f"{format_percent(diagnosis.repeatability)}."
        )
    cure = what_to_do(finding) if not finding.equivalent else ""
    law = "" if finding.cause == MISFIRE else "the extended law"
    what = capitalize_first(f"{cure}, or {law}," if cure and law else cure or law)
    rest = _cut(diagnosis.gain, finding, diagnosis.repeatability)
    return f"{what} {rest}{_tell(diagnosis)}"


def _cut(gain: Gain | None, finding: Finding, repeatability: float) -> str:
    repeats = f"the repeatability is {format_percent(repeatability)}."
    if gain is None:
        return f"takes away errors of {format_percent(finding.effect.estimate)} rms; {repeats}"
    return (
        f"cuts the prediction error on held-out traverses from {format_percent(gain.baseline)} to "
        f"{format_percent(gain.extended)}; {repeats}"
    )


def _tell(diagnosis: Diagnosis) -> str:
    if not diagnosis.findings[0].equivalent:
        return ""
    if diagnosis.next_experiment:
        return " The traverses that would tell which it is are below."
    return " No traverse that was looked at would tell which it is."


def _besides(finding: Finding) -> str:
    if finding.cause == UNKNOWN:
        return f"Besides that: {_begun_small(_shape(finding))}."
    rivals: Sequence[str] = finding.equivalent
    told = f"Besides that: {_begun_small(what_happens(finding))} ({finding.cause}"
    return f"{told}{', or ' + join_words(rivals, 'or') if rivals else ''})."


def _begun_small(text: str) -> str:
    """A sentence after a colon; names that begin with a capital have more than one."""
    return text[:1].lower() + text[1:]
