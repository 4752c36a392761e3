"""A table's diagnosis as a summary: as a log's (`_summary`), with sizes in the unit of the response.

`write_table_headline` makes the sentences, `summarize_table_diagnosis` the whole. Nothing here converts a
unit: a table is in whatever units its columns have.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit._format import (
    MISSING,
    capitalize_first,
    format_measured,
    format_measured_range,
    format_p_value,
    format_significant,
    join_words,
    pluralize,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.causes.roles import ROW_NUMBER
from stickslip_fit.diagnosis._summary import (
    describe_untestable,
    list_untestable,
    lower_first,
    ranking_tables,
    summarize_log_diagnosis,
)
from stickslip_fit.diagnosis._table_words import (
    describe_independence,
    describe_nearest,
    describe_no_misfit,
    describe_suspects,
    describe_table_carrier,
    flag_law,
    format_signed,
    format_size,
    name_table_cause,
)
from stickslip_fit.diagnosis._unknown_summary import describe_company, describe_proposals, name_findings
from stickslip_fit.diagnosis.finding import TO_SOME_EXTENT, Finding, Gain, TableInfo, shown_size
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.units import Interval

MAX_PARAMETERS_NAMED = 4
MAX_PARAMETERS, MAX_OUTLIERS = 40, 20
MIN_SHARE = 0.05  # of a structure that its closest cause explains, to be told
GIVEN_BEFORE = "each given those before it"


@summarize.register
def summarize_diagnosis(diagnosis: Diagnosis) -> Summary:
    """Of a log or of a table."""
    if diagnosis.table is None:
        return summarize_log_diagnosis(diagnosis)
    return summarize_table_diagnosis(diagnosis, diagnosis.table)


def summarize_table_diagnosis(diagnosis: Diagnosis, table: TableInfo) -> Summary:
    """The headline; findings with sizes and gain; the alternatives; the untestable causes."""
    name = Path(table.file).name or f"{table.response} over {pluralize(table.rows, 'row')}"
    source = f"sha256 {table.sha256}" if table.sha256 else "no hash"
    return Summary(
        f"Diagnosis of {name}",
        tuple(map(typeset_text, write_table_headline(diagnosis, table))),
        (
            Section(tables=(*_findings_tables(diagnosis, table), *_gain_tables(diagnosis, table))),
            Section(
                "What else it could be",
                tuple(_alternatives(diagnosis)),
                tuple(ranking_tables(diagnosis)),
                key="alternatives",
            ),
            Section("What this table could not have shown", tuple(list_untestable(diagnosis)), key="unseen"),
        ),
        provenance=(
            (name, source),
            ("columns", "; ".join(_list_columns(table))),
            ("false-alarm rate, seed", f"{diagnosis.alpha:g}, {diagnosis.seed}"),
        ),
    )


def _list_columns(table: TableInfo) -> list[str]:
    unit = f" in {table.unit}" if table.unit else ""
    roles = [f"{role}: {column}" for role, column in table.roles.items() if column]
    return [f"response: {table.response}{unit}", *roles]


def write_table_headline(diagnosis: Diagnosis, table: TableInfo) -> list[str]:
    """Sentences: what is wrong, what to do about it, what else is wrong, and how much the table tells."""
    if not diagnosis.findings:
        sentences = [
            describe_no_misfit(diagnosis, table),
            *describe_nearest(diagnosis, table),
            *describe_suspects(diagnosis, table),
            describe_untestable(diagnosis),
        ]
    else:
        first, *others = diagnosis.findings
        sentences = [
            f"{_describe_finding(first, diagnosis, table)}.",
            *(_describe_side_effect(finding, table) for finding in others),
            _describe_gain(diagnosis, table),
        ]
    flags = flag_law(diagnosis, table)
    notes = (*table.notes, *diagnosis.notes)
    return [*flags, *sentences, *notes, describe_independence(table, diagnosis.findings)]


def describe_table_effect(finding: Finding, table: TableInfo) -> str:
    """What a named cause does, without a full stop."""
    if finding.traverses is not None:
        if len(finding.traverses) == 1:
            return f"1 value of {table.response} does not belong to the rest, by {_largest(finding, table)}"
        count = pluralize(len(finding.traverses), "value")
        return f"{count} of {table.response} do not belong to the rest, by up to {_largest(finding, table)}"
    if getattr(finding.version, "sentence", ""):
        text = finding.version.describe(finding.shown_parameters)
        return text if finding.parameters else f"{text}, by {_format_rms(finding, table)}"
    phrase = capitalize_first(getattr(finding.version, "phrase", "") or finding.cause)
    source = getattr(finding.version, "source", None)
    if source is not None and not source.phrase:  # the phrase is then the formula, which does not name it
        phrase = f"{capitalize_first(finding.cause)}: {lower_first(phrase)}"
    sizes = [f"{one.name} = {format_measured(shown_size(one), one.unit)}" for one in finding.shown_parameters]
    if 0 < len(sizes) <= MAX_PARAMETERS_NAMED:
        return f"{phrase} ({', '.join(sizes)})"
    return f"{phrase}, by {_format_rms(finding, table)}"


def _largest(finding: Finding, table: TableInfo) -> str:
    assert finding.traverses is not None
    return format_size(float(finding.traverses["departure"].abs().max()), table)


def _describe_finding(finding: Finding, diagnosis: Diagnosis, table: TableInfo) -> str:
    if finding.cause == UNKNOWN:
        return _describe_shape(finding, table)
    effect = f"{describe_table_effect(finding, table)}{describe_company(finding)}"
    if not finding.equivalent:
        return effect
    either = join_words([name_table_cause(cause, diagnosis) for cause in finding.cause_set], "or")
    return f"This table cannot tell what is wrong: {either}. If it is the first: {lower_first(effect)}"


def _describe_shape(finding: Finding, table: TableInfo) -> str:
    if finding.version is not None:
        return _describe_proposal(finding, table)
    if finding.withdrawn:
        first, *others = (_describe_withdrawn(one, table) for one in finding.withdrawn)
        return ". Besides that: ".join([first, *map(lower_first, others)])
    text = (
        f"What the law leaves of {table.response}, {_format_rms(finding, table)}, "
        f"{describe_table_carrier(finding.carrier, table)}, "
    )
    if finding.carrier.endswith(TO_SOME_EXTENT):
        return f"{text}but by the evidence of one or two rows, so that no cause is named"
    text += "and has the shape of no cause that was searched"
    if not finding.closest or finding.share < MIN_SHARE:
        return text
    return f"{text}; the closest, {finding.closest}, explains {100 * finding.share:.0f} % of it"


def _describe_withdrawn(finding: Finding, table: TableInfo) -> str:
    """What fits best but is not named, with the reason, without a full stop."""
    assert finding.gain is not None
    before, after = (format_size(error, table) for error in finding.gain.judged)
    given = f", {GIVEN_BEFORE}," if finding.gain.given_before else ""
    return (
        f"{describe_table_effect(finding, table)}: of all that was searched this fits best "
        f"(p {format_p_value(finding.p_value, relation=True)}), but held-out rows{given} are not predicted "
        f"better with it ({after}, without it {before}), so that {finding.cause} is not named"
    )


def _format_rms(finding: Finding, table: TableInfo) -> str:
    """The size of an effect in a sentence; where its estimate is 0, the most that it may be."""
    if finding.effect.estimate > 0:
        return f"{format_size(finding.effect.estimate, table)} rms"
    return f"at most {format_size(finding.effect.high, table)} rms"


def _describe_proposal(finding: Finding, table: TableInfo) -> str:
    """What is put into the law for structure without a name, without a full stop."""
    text = (
        f"What the law leaves of {table.response} {describe_table_carrier(finding.carrier, table)}, by "
        f"{_format_rms(finding, table)}, in a way that no cause that was searched describes"
    )
    sizes = [f"{one.name} = {format_measured(shown_size(one), one.unit)}" for one in finding.parameters]
    if finding.term:
        return f"{text}; a term is proposed: {', '.join([finding.term, *sizes])}"
    wave = "wave" if finding.carrier.startswith("period of ") else "smooth function of it"
    return f"{text}; a {wave} is proposed"


def _describe_gain(diagnosis: Diagnosis, table: TableInfo) -> str:
    """What the named causes gain together; of what has no name, what to do about it."""
    noise, gain = format_size(diagnosis.repeatability, table), diagnosis.gain
    named = [finding for finding in diagnosis.findings if finding.version is not None]
    if not named:
        if any(finding.cause == UNKNOWN for finding in diagnosis.findings):
            return (
                "The figures show it: compare them with whatever changed meanwhile, and add that as a column "
                "or a cause; until it has a name, count on errors of "
                f"{format_size(diagnosis.misfit, table)}, where the noise is {noise}."
            )
        alone = sum(len(one.traverses) for one in diagnosis.findings if one.traverses is not None) == 1
        left_out = "It is left out" if alone else "They are left out"
        return f"{left_out}; of all others the law leaves {format_size(diagnosis.misfit, table)} rms."
    what = f"The law extended by {join_words(name_findings(named))}"
    if gain is None:
        left = f"leaves {format_size(rms_after(diagnosis), table)} rms, instead of "
        cut = f"{left}{format_size(diagnosis.misfit, table)}"
    elif gain.extended >= gain.baseline:
        cut = f"predicts held-out rows no better, to {format_size(gain.extended, table)} rms"
    else:
        cut = (
            f"cuts the prediction error on held-out rows from {format_significant(gain.baseline)} to "
            f"{format_size(gain.extended, table)}"
        )
    if gain is not None and gain.given_before:
        before, after = gain.given_before
        cut += f" ({GIVEN_BEFORE}: from {format_significant(before)} to {format_size(after, table)})"
    advice = "".join(_what_separates(finding, diagnosis) for finding in named)
    return f"{what} {cut}; the noise is {noise}.{advice}"


def rms_after(diagnosis: Diagnosis) -> float:
    """Rms residual with all that was found in the law."""
    last = diagnosis.selection.linearized
    return float(np.sqrt(np.mean(last.unwhiten(last.residual) ** 2)))


def _what_separates(finding: Finding, diagnosis: Diagnosis) -> str:
    """Which data would separate a cause from its rivals, where the causes say what shows them best."""
    if not finding.equivalent:
        return ""
    known = {cause.name: getattr(cause, "shows_best", "") for cause in diagnosis.selection.problem.causes}
    advice = [f"for {name}, {known[name]}" for name in finding.cause_set if known.get(name)]
    if not advice:
        return " Data in which the two differ more would separate them."
    return f" What would separate them: {'; '.join(advice)}."


def _describe_side_effect(finding: Finding, table: TableInfo) -> str:
    if finding.cause == UNKNOWN:
        return f"Besides that: {lower_first(_describe_shape(finding, table))}."
    rivals = f"; or it is {join_words(finding.equivalent, 'or')}" if finding.equivalent else ""
    company = describe_company(finding)
    return f"Besides that: {lower_first(describe_table_effect(finding, table))}{rivals}{company}."


def _findings_tables(diagnosis: Diagnosis, table: TableInfo) -> list[Table]:
    if not diagnosis.findings:
        return []
    columns = (
        Column("found", text=True),
        *numbers("effect, rms", "95 % interval", unit=table.unit),
        Column("p"),
        Column("not separable from", text=True),
    )
    rows = tuple(
        (
            name,
            _format_effect(finding.effect),
            format_measured_range(finding.effect),
            format_p_value(finding.p_value),
            ", ".join(finding.equivalent) or MISSING,
        )
        for name, finding in zip(name_findings(diagnosis.findings), diagnosis.findings, strict=True)
    )
    note = (
        f"Effect: rms over all rows of what the cause does to {table.response}, beyond what the law's own "
        "parameters absorb. p: the chance of anything as far off, anywhere that was searched, if nothing "
        "were wrong."
    )
    outliers = [
        _outliers_table(finding, table) for finding in diagnosis.findings if finding.traverses is not None
    ]
    found = Table("What is wrong", columns, rows, note=note)
    return [found, *_parameter_tables(diagnosis.findings), *outliers]


def _format_effect(effect: Interval) -> str:
    return format_measured(effect) if effect.estimate > 0 else f"< {format_significant(effect.high, 2)}"


def _parameter_tables(findings: Sequence[Finding]) -> list[Table]:
    columns: tuple[Column, ...] = (
        *words("cause", "parameter"),
        *numbers("estimate", "95 % interval"),
        Column("of", text=True),
    )
    rows: list[tuple[str, ...]] = [
        (
            name,
            parameter.name,
            format_measured(shown_size(parameter), parameter.unit),
            format_measured_range(shown_size(parameter)),
            f"session {parameter.session}" if parameter.session else "",
        )
        for name, finding in zip(name_findings(findings), findings, strict=True)
        if finding.traverses is None
        for parameter in finding.shown_parameters
    ]
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    note = f"The first {MAX_PARAMETERS} of {len(rows)}." if len(rows) > MAX_PARAMETERS else ""
    shown = tuple(rows[:MAX_PARAMETERS])
    return [Table("Parameters of what was named", columns, shown, stubs=2, note=note)] if rows else []


def _outliers_table(finding: Finding, table: TableInfo) -> Table:
    assert finding.traverses is not None
    outliers = finding.traverses
    largest = outliers.loc[outliers["departure"].abs().sort_values(ascending=False).index].head(MAX_OUTLIERS)
    named = [table.roles[role] for role in ("session", "time") if table.roles.get(role) in outliers]
    columns = (Column("row", text=True), *words(*named), Column("residual", table.unit))
    rows = tuple(
        (
            str(row[ROW_NUMBER] + 1),
            *(_cell(row[name]) for name in named),
            format_signed(float(row["departure"])),
        )
        for _, row in largest.iterrows()
    )
    of_all = f"The {MAX_OUTLIERS} largest of {pluralize(len(outliers), 'value')}; rows" * (
        len(largest) < len(outliers)
    )
    return Table("Outlying values", columns, rows, note=f"{of_all or 'Rows'} count from 1, below the header.")


def _cell(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _gain_tables(diagnosis: Diagnosis, table: TableInfo) -> list[Table]:
    named = [finding for finding in diagnosis.findings if finding.version is not None]
    gain = diagnosis.gain
    if not named or gain is None:
        return []
    names = name_findings(named)
    steps = [(f"with {name}", one.gain) for name, one in zip(names, named, strict=True)] if names[1:] else []
    lines: list[tuple[str, Gain | None]] = [
        ("held-out rows", gain),
        *steps,
        ("a new session", diagnosis.gain_new_session),
    ]
    rows = [(name, *_gain_cells(one)) for name, one in lines if one is not None]
    heads = ("law", "extended law", "gain", "95 % interval", "noise")
    columns = (Column("predicted", text=True), *(Column(head, table.unit) for head in heads))
    note = (
        f"Rms error of {table.response} on rows that took no part in choosing or fitting anything: "
        f"{gain.held_out} were held out. The interval is for a fresh replicate of this table."
    )
    if gain.given_before:
        before, after = gain.given_before
        cells = (*map(format_significant, (before, after, before - after)), MISSING, MISSING)
        rows.insert(1, (GIVEN_BEFORE, *cells))
        note += (
            " Noise that persists hides in such an error what is smaller than its slow part: a finding is "
            "judged by the error of each row given those of the rows before it that were held out with it."
        )
    return [Table("What the extended law gains", columns, tuple(rows), note=note)]


def _gain_cells(gain: Gain) -> tuple[str, ...]:
    difference = Interval(gain.baseline - gain.extended, gain.low, gain.high)
    sides = tuple(map(format_significant, (gain.baseline, gain.extended)))
    interval = format_measured_range(difference)
    return (*sides, format_measured(difference), interval, format_significant(gain.noise_floor))


def _alternatives(diagnosis: Diagnosis) -> list[str]:
    sentences = [
        f"Whatever {first} would do in this table, {second} could have done too."
        for first, second in diagnosis.aliased_causes
    ]
    return [*sentences, *describe_proposals(diagnosis.findings, "table")]
