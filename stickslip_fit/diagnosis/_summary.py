"""A log's diagnosis as a summary: the conclusion and what to do about it, then the tables.

`write_headline` makes the sentences, `summarize_diagnosis` the whole, `describe_effect` and `remedy_for`
what each cause does and what cures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
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
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, words
from stickslip_fit.causes import EndStopMisfire, SizedParameter
from stickslip_fit.causes.parameters import plain_description
from stickslip_fit.diagnosis._noise_summary import describe_noise
from stickslip_fit.diagnosis._stage_summary import describe_reading, stage_sections
from stickslip_fit.diagnosis._unknown_summary import (
    caption_parameters,
    describe_company,
    describe_proposals,
    describe_scatter,
    describe_shape,
    describe_unknown_gain,
    explains_tables,
    find_extending,
    name_findings,
)
from stickslip_fit.diagnosis.experiments import find_inseparable_pairs
from stickslip_fit.diagnosis.finding import Finding, Gain, NextTraverse
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.problem import MISFIRE
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.laws.published import name_of_laws
from stickslip_fit.units import PRISMATIC

MAX_UNTESTABLE_NAMED = 4
MIN_PROBABILITY, MAX_RANKED, MAX_TRAVERSES = 0.015, 10, 20
LN_10 = np.log(10.0)
MAX_POWER = 6  # of ten, of a Bayes factor that is written out


def describe_effect(finding: Finding) -> str:
    """What a named cause does, without a full stop; without parameters, with the size of its effect.

    A cause without `describe` is described by its phrase.
    """
    cause = _cause(finding)
    if hasattr(cause, "describe"):
        text = cause.describe(finding.parameters)
    else:
        text = plain_description(getattr(cause, "phrase", finding.cause), finding.parameters)
    return text if finding.parameters else f"{text}, by {format_percent(finding.effect.estimate)} rms"


def remedy_for(finding: Finding) -> str:
    """What cures it, as the beginning of a sentence; empty where only the extended law does."""
    return getattr(_cause(finding), "remedy", "")


def _cause(finding: Finding) -> Any:
    return EndStopMisfire() if finding.cause == MISFIRE else finding.version


def write_headline(diagnosis: Diagnosis) -> list[str]:
    """Sentences: what is wrong, what to do about it, then what else is wrong."""
    if not diagnosis.findings:
        noise = describe_noise(diagnosis)
        return [_describe_no_misfit(diagnosis), *noise, describe_untestable(diagnosis), *diagnosis.notes]
    first, *others = diagnosis.findings
    return [
        f"{_describe_finding(first, diagnosis)}.",
        _describe_gain(first, diagnosis),
        *(_describe_side_effects(finding) for finding in others),
        *(describe_reading(one, intervals=False) for one in diagnosis.stage if one.suffices),
        *describe_noise(diagnosis),
        *diagnosis.notes,
    ]


def name_cause(cause: str, diagnosis: Diagnosis) -> str:
    """A cause in words, with its name."""
    phrases = {one.name: getattr(one, "phrase", "") for one in diagnosis.selection.problem.causes}
    return f"{phrases[cause]} ({cause})" if phrases.get(cause) else cause


def baseline_name(diagnosis: Diagnosis) -> str:
    """What the laws are called that are put to the test."""
    return name_of_laws(part.law for part in diagnosis.selection.problem.parts)


def _describe_no_misfit(diagnosis: Diagnosis) -> str:
    if not np.isfinite(diagnosis.repeatability):
        return f"Nothing can be said of this log: {diagnosis.untestable[UNKNOWN]}."
    return (
        f"Nothing is wrong that this log can show: the {baseline_name(diagnosis)} leaves "
        f"{format_percent(diagnosis.misfit)} rms, and {describe_scatter(diagnosis)} "
        f"(p {format_p_value(diagnosis.p_value, relation=True)})."
    )


def describe_untestable(diagnosis: Diagnosis) -> str:
    """Which causes the data could not have shown, as a sentence."""
    if not np.isfinite(diagnosis.repeatability):
        return "Until then no cause is confirmed, and none ruled out."
    names = list(diagnosis.untestable)
    if not names:
        return "It could have shown every cause that was searched, at its largest plausible size."
    if len(names) > MAX_UNTESTABLE_NAMED:
        first = names[: MAX_UNTESTABLE_NAMED - 1]
        names = [*first, f"{len(names) - len(first)} others"]
    return f"It could not have shown {join_words(names)}."


def _describe_finding(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return describe_shape(finding)
    effect = f"{describe_effect(finding)}{describe_company(finding)}"
    if not finding.equivalent:
        return effect
    either = join_words([name_cause(cause, diagnosis) for cause in finding.cause_set], "or")
    return f"This log cannot tell what is wrong: {either}. If it is the first: {lower_first(effect)}"


def _describe_gain(finding: Finding, diagnosis: Diagnosis) -> str:
    if finding.cause == UNKNOWN:
        return describe_unknown_gain(finding, diagnosis)
    cure = remedy_for(finding) if not finding.equivalent else ""
    law = "" if finding.cause == MISFIRE else "the extended law"
    gain = diagnosis.gain
    if gain is None or gain.extended >= gain.baseline:
        cut = f"takes away errors of {format_percent(finding.effect.estimate)} rms"
    else:
        cut = (
            "cuts the prediction error on held-out traverses from "
            f"{format_percent(gain.baseline)} to {format_percent(gain.extended)}"
        )
    choices = " or ".join(filter(None, [f"{cure}," if cure and law else cure, law]))
    what = f"Remedy: {choices}, which" if cure else capitalize_first(law)
    following = ""
    if finding.equivalent and diagnosis.next_experiment:
        following = " The traverses that would separate them are below."
    elif finding.equivalent:
        following = " No candidate traverse would separate them."
    return f"{what} {cut}; {describe_scatter(diagnosis)}.{following}"


def _describe_side_effects(finding: Finding) -> str:
    if finding.cause == UNKNOWN:
        return f"Besides that: {lower_first(describe_shape(finding))}."
    rivals = f", or {join_words(finding.equivalent, 'or')}" if finding.equivalent else ""
    company = describe_company(finding)
    return f"Besides that: {lower_first(describe_effect(finding))} ({finding.cause}{rivals}){company}."


def lower_first(text: str) -> str:
    """The text with a small first letter, for the middle of a sentence."""
    return text[:1].lower() + text[1:]


def summarize_log_diagnosis(diagnosis: Diagnosis) -> Summary:
    """A log's: the headline; findings with sizes and gain; the alternatives; the untestable causes."""
    name = Path(diagnosis.log_file).name or "a log that was never in a file"
    next_traverses = traverses_table("Discriminating traverses", diagnosis.next_experiment)
    return Summary(
        f"Diagnosis of {name}",
        tuple(map(typeset_text, write_headline(diagnosis))),
        (
            Section(tables=(*_findings_tables(diagnosis), *_gain_tables(diagnosis))),
            *stage_sections(diagnosis.stage),
            Section(
                "What else it could be",
                tuple(_alternatives(diagnosis)),
                (*explains_tables(diagnosis), *ranking_tables(diagnosis), *next_traverses),
                key="alternatives",
            ),
            Section("What this log could not have shown", tuple(list_untestable(diagnosis)), key="unseen"),
        ),
        provenance=(
            (name, f"sha256 {diagnosis.log_sha256}"),
            ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
        ),
    )


def _findings_tables(diagnosis: Diagnosis) -> list[Table]:
    """The findings with their effects, their parameters, and the outlying counts."""
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        *numbers("effect, rms", "95 % interval", unit="%"),
        Column("joints", text=True),
        Column("p"),
        Column("not separable from", text=True),
    )
    rows = tuple(
        (
            name,
            format_percent(finding.effect.estimate, with_unit=False),
            format_interval(finding.effect, "%", 1),
            ", ".join(map(str, finding.joints)),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or MISSING,
        )
        for name, finding in zip(name_findings(diagnosis.findings), diagnosis.findings, strict=True)
    )
    note = "Effect on the counts, beyond what recalibration absorbs. p: of any alarm, if nothing were wrong."
    outliers = [
        _outliers_table(finding.traverses) for finding in diagnosis.findings if finding.traverses is not None
    ]
    return [Table("What is wrong", columns, rows, note=note), *_parameter_tables(diagnosis), *outliers]


def _parameter_tables(diagnosis: Diagnosis) -> list[Table]:
    proposed = any(finding.cause == UNKNOWN and finding.term for finding in diagnosis.findings)
    columns: tuple[Column, ...] = (
        *words("found" if proposed else "cause", "parameter"),
        *numbers("estimate", "95 % interval"),
        Column("of", text=True),
    )
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            name,
            parameter.name,
            typeset_text(format_estimate(parameter.size, parameter.unit, signed=True)),
            format_interval(parameter.size, parameter.unit, 1),
            _scope(parameter),
        )
        for name, finding in zip(name_findings(diagnosis.findings), diagnosis.findings, strict=True)
        if finding.cause != UNKNOWN or finding.term
        for parameter in finding.parameters
    )
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], tuple(row[:-1] for row in rows)
    return [Table(caption_parameters(diagnosis.findings), columns, rows, stubs=2)] if rows else []


def _scope(parameter: SizedParameter) -> str:
    """The joint, direction and session of a parameter; empty for the whole campaign."""
    direction = format_direction(parameter.direction)
    joint = f"joint {parameter.joint} {direction}".strip() if parameter.joint else ""
    session = f"session {parameter.session}" if parameter.session else ""
    return ", ".join(filter(None, [joint, session]))


def _outliers_table(traverses: pd.DataFrame) -> Table:
    columns = (*words("session", "time", "joint"), Column("steps"), Column("residual", "%"))
    order = traverses["departure"].abs().sort_values(ascending=False).index
    largest = traverses.loc[order].head(MAX_TRAVERSES)
    rows = tuple(
        (
            str(row["session"]),
            row["time"].strftime("%Y-%m-%d %H:%M:%S"),
            f"{row['joint']} {format_direction(str(row['direction']))}",
            f"{row['steps']:,}",
            format_percent(float(row["departure"]), with_unit=False, signed=True),
        )
        for _, row in largest.iterrows()
    )
    left_out = len(largest) < len(traverses)
    note = f"The {MAX_TRAVERSES} largest of {pluralize(len(traverses), 'count')}." if left_out else ""
    return Table("Outlying counts", columns, rows, note=note)


def _gain_tables(diagnosis: Diagnosis) -> list[Table]:
    """Errors on held-out traverses, before and after."""
    named = find_extending(diagnosis.findings)
    names = name_findings(named)
    steps = [(f"with {name}", one.gain) for name, one in zip(names, named, strict=True)] if names[1:] else []
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
    heads = (baseline_name(diagnosis), "extended law", "gain", "95 % interval", "noise floor")
    columns = (Column("predicted", text=True), *(Column(head, "%") for head in heads))
    note = (
        "Rms error of the step size on held-out traverses. Interval: for a fresh replicate of this campaign."
    )
    return [Table("What the extended law gains", columns, rows, note=note)]


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    sentences = [
        f"Whatever {first} would do in this log, {second} could have done too."
        for first, second in diagnosis.aliased_causes
    ]
    inseparable = find_inseparable_pairs(diagnosis.findings, diagnosis.next_experiment)
    sentences += [f"No traverse within reach separates {one} from {other}." for one, other in inseparable]
    return [*sentences, *describe_proposals(diagnosis.findings, "log")]


def rank_causes(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """Testable causes, likeliest first: name, probability, log10 of the Bayes factor against noise alone.

    The Bayes factor is that of the test in which the cause was selected, or else of the last one; unknown
    structure has that of the cause that it is most like, if that is not named.
    """
    evidence = dict(diagnosis.selection.last_misfit.log_evidence_by_cause)
    withdrawn = [one.cause for finding in diagnosis.findings for one in finding.withdrawn]
    for selected in diagnosis.selection.selected:
        if selected.misfit is not None:
            own = selected.misfit.log_evidence_by_cause
            names = (selected.cause, *selected.cause_set.rivals)
            if selected.cause == UNKNOWN and selected.version is None:
                own = own | {UNKNOWN: max(own.values())}
                names = (UNKNOWN, *withdrawn)
            evidence |= {cause: own[cause] for cause in names if cause in own}
    probability = {cause: value for cause, value in diagnosis.inclusion.items() if value is not None}
    order = sorted(probability, key=lambda cause: (-probability[cause], cause))
    return [(cause, probability[cause], evidence.get(cause, np.nan) / LN_10) for cause in order]


def ranking_tables(diagnosis: Diagnosis) -> list[Table]:
    """The likeliest causes, or no table."""
    ranked = [row for row in rank_causes(diagnosis) if row[1] >= MIN_PROBABILITY][:MAX_RANKED]
    columns = (Column("cause", text=True), Column("probability", "%"), Column("Bayes factor"))
    rows = tuple(
        (cause, f"{100 * probability:.0f}" if probability < 0.995 else "> 99", format_bayes_factor(power))
        for cause, probability, power in ranked
    )
    note = "Bayes factor: how much likelier the data are with the cause than with noise alone."
    unlikely = not diagnosis.findings
    return [Table("Candidate causes", columns, rows, note=note, folded=unlikely)] if rows else []


def format_bayes_factor(power: float) -> str:
    """A Bayes factor of which the decimal logarithm is given; none is believed beyond a million.

    Examples
    --------
    >>> [format_bayes_factor(power) for power in (240.7, 1.26, -0.4, -9.0)]
    ['> 10^6', '18', '0.4', '< 0.01']
    """
    if not np.isfinite(power):
        return MISSING
    if power > MAX_POWER:
        return f"> 10^{MAX_POWER}"
    if power < -2:
        return "< 0.01"
    value = 10.0**power
    return f"{value:.2g}" if value < 10 else f"{float(f'{value:.2g}'):,.0f}"


def traverses_table(caption: str, traverses: Sequence[NextTraverse]) -> list[Table]:
    """Traverses to make next, with the causes that they separate or show; no table where there are none."""
    positions = ("q1", "q2", "q3", "theta", "psi")
    columns = (*words("causes", "joint"), *map(Column, ("times", *positions, "from", "to")), *words("when"))
    rows = []
    for traverse in traverses:
        values = [
            (format_length if name == "q3" else format_angle)(getattr(traverse, name))
            if np.isfinite(getattr(traverse, name)) and name != f"q{traverse.joint}"
            else MISSING
            for name in positions
        ]
        show = format_length if traverse.joint == PRISMATIC else format_angle
        ends = [show(end) if np.isfinite(end) else "stop" for end in (traverse.start, traverse.stop)]
        joint = f"{traverse.joint} {format_direction(traverse.direction)}"
        causes = ", ".join(traverse.tells_apart)
        rows.append((causes, joint, str(traverse.repeats), *values, *ends, traverse.note))
    return [Table(caption, columns, tuple(rows))] if rows else []


def list_untestable(diagnosis: Diagnosis) -> list[str]:
    """Untestable causes by reason."""
    causes: dict[str, list[str]] = {}
    for cause, reason in diagnosis.untestable.items():
        causes.setdefault(reason, []).append(cause)
    if not causes:
        return ["Nothing: every cause that is known would have shown at its largest plausible size."]
    return [f"{join_words(names)}: {typeset_text(reason)}" for reason, names in causes.items()]
