"""A diagnosis as a summary: the conclusion and what to do about it, then the tables.

What is said of a log and of a table in their own words is in `_words`; sizes are shown per cent of a step in
a log, in the unit of the response in a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit._format import (
    MISSING,
    format_angle,
    format_direction,
    format_length,
    format_measured,
    format_measured_range,
    format_p_value,
    format_significant,
    join_words,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis._log_words import LogWords, knows_calibration
from stickslip_fit.diagnosis._stage_summary import stage_sections
from stickslip_fit.diagnosis._table_words import TableWords
from stickslip_fit.diagnosis._unknown_summary import explains_tables, name_findings
from stickslip_fit.diagnosis._words import Words, baseline_name, describe_proposals, largest_departures
from stickslip_fit.diagnosis.cross_validation import MIN_SESSIONS
from stickslip_fit.diagnosis.experiments import find_inseparable_pairs
from stickslip_fit.diagnosis.finding import GIVEN_BEFORE, Finding, Gain, NextTraverse, TableInfo, shown_size
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.units import PRISMATIC, Interval

MIN_PROBABILITY, MAX_RANKED = 0.015, 10
# Of an error: within which a rms of some hundred rows is known, and what of a gain nobody would notice.
ERROR_SHARE, GAIN_SHARE = 0.05, 0.01
MAX_PARAMETERS, MAX_OUTLIERS = 40, 20
LN_10 = np.log(10.0)
MAX_POWER = 6  # of ten, of a Bayes factor that is written out


def find_words(diagnosis: Diagnosis) -> Words:
    """The words for what was diagnosed."""
    return LogWords(diagnosis) if diagnosis.table is None else TableWords(diagnosis)


def write_headline(diagnosis: Diagnosis) -> list[str]:
    """Sentences: what is wrong, what to do about it, what else is wrong, and how much the data tell."""
    words = find_words(diagnosis)
    if diagnosis.findings:
        told = [*words.tell_findings(), *words.tell_cancelling(), *words.tell_rest()]
    else:
        told = [*words.tell_no_finding(), words.describe_untestable()]
    return [*words.flags(), *told, *words.notes()]


@summarize.register
def summarize_diagnosis(diagnosis: Diagnosis) -> Summary:
    """The headline; findings with sizes and gain; the alternatives; the untestable causes."""
    words, info = find_words(diagnosis), diagnosis.info
    name = Path(diagnosis.log_file).name or info.nameless
    next_traverses = traverses_table("Discriminating traverses", diagnosis.next_experiment)
    return Summary(
        f"Diagnosis of {name}",
        tuple(map(typeset_text, write_headline(diagnosis))),
        (
            Section(tables=(*_findings_tables(diagnosis, words), *_gain_tables(diagnosis, words))),
            *stage_sections(diagnosis.stage),
            Section(
                "What else it could be",
                tuple(_alternatives(diagnosis)),
                (*explains_tables(diagnosis), *ranking_tables(diagnosis), *next_traverses),
                key="alternatives",
            ),
            Section(
                f"What this {info.data} could not have shown", tuple(list_untestable(diagnosis)), key="unseen"
            ),
        ),
        provenance=(
            (name, f"sha256 {diagnosis.log_sha256}" if diagnosis.log_sha256 else "no hash"),
            *(
                [("columns", "; ".join(_list_columns(diagnosis.table)))]
                if diagnosis.table is not None
                else []
            ),
            ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
        ),
    )


def _list_columns(table: TableInfo) -> list[str]:
    unit = f" in {table.unit}" if table.unit else ""
    roles = [f"{role}: {column}" for role, column in table.roles.items() if column]
    return [f"response: {table.response}{unit}", *roles]


def _findings_tables(diagnosis: Diagnosis, words: Words) -> list[Table]:
    """The findings with their effects, their parameters, and the outlying values."""
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        *numbers("effect, rms", "95 % interval", unit=words.info.unit),
        Column("joints", text=True),
        Column("p"),
        Column("not separable from", text=True),
    )
    effects = [finding.effect.times(words.info.factor) for finding in diagnosis.findings]
    rows = [
        (
            name,
            format_measured(size) if size.estimate > 0 else f"< {format_significant(size.high, 2)}",
            format_measured_range(size),
            ", ".join(map(str, finding.joints)),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or MISSING,
        )
        for name, finding, size in zip(
            name_findings(diagnosis.findings), diagnosis.findings, effects, strict=True
        )
    ]
    beside = " in the law with all others" * (len(diagnosis.findings) > 1)
    unnamed = [one for one in diagnosis.findings if one.cause == UNKNOWN and one.version is not None]
    lacking = ""
    if unnamed and diagnosis.table is None:
        lacking = "Of what has no name, the interval's upper end has what its form may lack, too. "
    note = (
        f"Effect: rms over all {words.info.row}s of what the cause does to {words.info.response}{beside}, "
        "beyond what the law's own parameters absorb; its interval allows for selection: what is barely "
        f"found, noise has often made larger. {lacking}p: the chance of anything as far off, "
        "anywhere that was searched, if nothing were wrong."
    )
    found = _without_empty("What is wrong", columns, rows, "joints", note=note)
    outliers = [_outliers_table(one, words) for one in diagnosis.findings if one.traverses is not None]
    return [found, *_parameter_tables(diagnosis), *outliers]


def _without_empty(
    caption: str, columns: Sequence[Column], rows: Sequence[tuple[str, ...]], head: str, **options: Any
) -> Table:
    """A table without the column of this head, if it is empty in all rows."""
    place = [column.head for column in columns].index(head)
    kept = [k for k in range(len(columns)) if k != place or any(row[place] for row in rows)]
    shown = tuple(tuple(row[k] for k in kept) for row in rows)
    return Table(caption, tuple(columns[k] for k in kept), shown, **options)


def _parameter_tables(diagnosis: Diagnosis) -> list[Table]:
    findings = diagnosis.findings
    proposed = any(finding.cause == UNKNOWN and finding.term for finding in findings)
    columns = (
        *words("found" if proposed else "cause", "parameter"),
        *numbers("estimate", "95 % interval"),
        Column("of", text=True),
    )
    rows = [
        (
            name,
            parameter.name,
            format_measured(shown_size(parameter), parameter.unit),
            format_measured_range(shown_size(parameter)),
            _scope(parameter),
        )
        for name, finding in zip(name_findings(findings), findings, strict=True)
        if finding.cause != UNKNOWN or finding.term
        for parameter in finding.shown_parameters
    ]
    notes = [f"The first {MAX_PARAMETERS} of {len(rows)}."] if len(rows) > MAX_PARAMETERS else []
    notes += [
        f"Of {finding.cause}: differences from {finding.version.beside}."
        for finding in findings
        if hasattr(finding.version, "beside")
    ]
    notes += [
        f"{join_words(ends)} of {finding.cause}: at the end of the range searched, and maybe beyond it."
        for finding in findings
        if (ends := finding.at_bounds)
    ]
    note = " ".join(notes)
    caption = f"Parameters of what was named{' or proposed' if proposed else ''}"
    return [_without_empty(caption, columns, rows[:MAX_PARAMETERS], "of", stubs=2, note=note)] if rows else []


def _scope(parameter: SizedParameter) -> str:
    """The joint, direction and session of a parameter; empty for the whole campaign."""
    direction = format_direction(parameter.direction)
    joint = f"joint {parameter.joint} {direction}".strip() if parameter.joint else ""
    joint = joint or (f"direction {direction}" if direction else "")
    session = f"session {parameter.session}" if parameter.session else ""
    return ", ".join(filter(None, [joint, session]))


def _outliers_table(finding: Finding, words: Words) -> Table:
    outliers = finding.traverses
    assert outliers is not None
    largest = largest_departures(outliers, MAX_OUTLIERS)
    cells = [
        words.outlier_cells(row) | {"residual": words.info.format_signed(float(row["departure"]))}
        for _, row in largest.iterrows()
    ]
    *heads, last = cells[0]
    columns = (*(Column(head, text=head != "steps") for head in heads), Column(last, words.info.unit))
    left_out = len(largest) < len(outliers)
    note = f"The {MAX_OUTLIERS} largest of {pluralize(len(outliers), 'value')}." * left_out
    return Table("Outlying values", columns, tuple(tuple(one.values()) for one in cells), note=note)


def _gain_tables(diagnosis: Diagnosis, words: Words) -> list[Table]:
    """Errors on held-out rows, before and after."""
    named, gain = [one for one in diagnosis.findings if one.version is not None], diagnosis.gain
    lines: list[tuple[str, Gain | None]] = [(f"held-out {words.info.row}s", gain)]
    if len(named) > 1:
        names = name_findings(named)
        lines += [(f"with {name}", one.gain) for name, one in zip(names, named, strict=True)]
    lines.append((words.info.new_session, diagnosis.gain_new_session))
    rows = [(name, *_gain_cells(one, words)) for name, one in lines if one is not None]
    if not rows or not named:
        return []
    heads = (baseline_name(diagnosis), "extended law", "gain", "95 % interval", "noise floor")
    columns = (Column("predicted", text=True), *(Column(head, words.info.unit) for head in heads))
    info = words.info
    note = (
        f"Rms error of {info.response} on {info.row}s that took no part in choosing or fitting anything: "
        f"{(gain and gain.held_out) or info.held_out} were held out. The interval is for a fresh replicate "
        f"of this {info.data}."
    )
    if gain is not None and gain.stalled:
        note += f" {pluralize(gain.stalled, info.row)}, where the law alone would stall, do not count."
    if gain is not None and gain.given_before:
        before, after = gain.given_before
        cells = map(words.info.format_number, (before, after, before - after))
        rows.insert(1, (GIVEN_BEFORE, *cells, MISSING, MISSING))
        note += (
            " Noise that persists hides in such an error what is smaller than its slow part: a finding is "
            "judged by the error of each row given those of the rows before it that were held out with it."
        )
    note += _tell_joints_of_new_session(diagnosis)
    return [Table("What the extended law gains", columns, tuple(rows), note=note)]


def _tell_joints_of_new_session(diagnosis: Diagnosis) -> str:
    """Which joints no session can be calibrated for, as a sentence with a space before it; else empty."""
    gain, rows = diagnosis.gain_new_session, diagnosis.selection.problem.rows
    if diagnosis.log is None or rows["session"].nunique() < MIN_SESSIONS:
        return ""
    known = set() if gain is None else set(gain.by_joint.get("joint", rows["joint"]))
    missing = [str(joint) for joint in sorted(set(rows["joint"]) - known)]
    if not missing:
        return ""
    joints = f"{'joint' if len(missing) == 1 else 'joints'} {join_words(missing)}"
    return (
        f" A new session is not predicted for {joints}: no session has the traverses there by which its law "
        "is calibrated."
    )


def _gain_cells(gain: Gain, words: Words) -> tuple[str, ...]:
    cut = gain.cut.times(words.info.factor)
    errors = [words.info.factor * error for error in (gain.baseline, gain.extended, gain.noise_floor)]
    # As many decimals as the gain, which is the difference of the first two, and two digits of each.
    half = min([(cut.high - cut.low) / 2, *(error for error in errors if error > 0)])
    half = max(half, ERROR_SHARE * errors[0])
    before, after, floor = (format_measured(Interval(one, one - half, one + half)) for one in errors)
    least = GAIN_SHARE * errors[0]
    return before, after, format_measured(cut, least=least), format_measured_range(cut, least), floor


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    sentences = [
        f"Whatever {first} would do in this {diagnosis.info.data}, {second} could have done too."
        for first, second in diagnosis.aliased_causes
    ]
    # Of a table the headline says what would separate them.
    if diagnosis.table is None and knows_calibration(diagnosis):
        inseparable = find_inseparable_pairs(diagnosis.findings, diagnosis.next_experiment)
        sentences += [f"No traverse within reach separates {one} from {other}." for one, other in inseparable]
    return [*sentences, *describe_proposals(diagnosis.findings, diagnosis.info.data)]


def rank_causes(diagnosis: Diagnosis) -> list[tuple[str, float, float]]:
    """Testable causes, likeliest first: name, probability, log10 of the Bayes factor against none besides.

    The Bayes factor is that of the test in which the cause was selected, or else of the last one; unknown
    structure has that of the cause that it is most like, if that is not named.
    """
    evidence = dict(diagnosis.selection.last_misfit.log_evidence_by_cause)
    for selected in diagnosis.selection.selected:
        if selected.misfit is not None:
            own = selected.misfit.log_evidence_by_cause
            names = (selected.cause, *selected.cause_set.rivals)
            if selected.cause == UNKNOWN and selected.version is None:
                own = own | {UNKNOWN: max(own.values())}
                names = (UNKNOWN, *diagnosis.withdrawn)
            evidence |= {cause: own[cause] for cause in names if cause in own}
    probability = {cause: value for cause, value in diagnosis.inclusion.items() if value is not None}
    order = sorted(probability, key=lambda cause: (-probability[cause], cause))
    return [(cause, probability[cause], evidence.get(cause, np.nan) / LN_10) for cause in order]


def ranking_tables(diagnosis: Diagnosis) -> list[Table]:
    """The likeliest causes and those that are withdrawn, or no table."""
    withdrawn, every = diagnosis.withdrawn, rank_causes(diagnosis)
    ranked = [one for one in every if one[1] >= MIN_PROBABILITY and one[0] not in withdrawn][:MAX_RANKED]
    ranked += [(cause, np.nan, power) for cause, _, power in every if cause in withdrawn]
    columns = (Column("cause", text=True), Column("probability", "%"), Column("Bayes factor"))
    rows = tuple(
        (cause, _format_probability(probability), format_bayes_factor(power))
        for cause, probability, power in ranked
    )
    beside = "with noise alone"
    if diagnosis.findings:
        beside = "without it, beside what was found before it; of what was not found, beside all that was"
    note = (
        "Probability: that the cause is at work; several may be at once. Bayes factor: how much likelier the "
        f"data are with the cause than {beside}."
    )
    note += "".join(f" Withdrawn: {cause}, since {why}." for cause, why in withdrawn.items())
    unlikely = not diagnosis.findings
    return [Table("Candidate causes", columns, rows, note=note, folded=unlikely)] if rows else []


def _format_probability(probability: float) -> str:
    """In per cent; of a cause that is withdrawn NaN."""
    if np.isnan(probability):
        return "withdrawn"
    return f"{100 * probability:.0f}" if probability < 0.995 else "> 99"


def format_bayes_factor(power: float) -> str:
    """A Bayes factor of which the decimal logarithm is given; none is believed beyond a million.

    Examples
    --------
    >>> [format_bayes_factor(power) for power in (240.7, 1.26, -0.4, -9.0)]
    ['> 1,000,000', '18', '0.4', '< 0.01']
    """
    if not np.isfinite(power):
        return MISSING
    if power > MAX_POWER:
        return f"> {10**MAX_POWER:,}"
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
