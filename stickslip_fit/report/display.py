"""Logs and results as a notebook shows them: one small piece of HTML that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from stickslip_fit.anova import Anova, Answer, FormulaTable
from stickslip_fit.anova.formula_text import formula_text
from stickslip_fit.anova.linear import RESIDUAL
from stickslip_fit.anova.text import told_by_joint
from stickslip_fit.anova.verdict import doubts, reasons
from stickslip_fit.anova.wording import bare_probability
from stickslip_fit.fit import JointFit, Result
from stickslip_fit.fit.expectation import expectation, expectation_text
from stickslip_fit.fit.provenance import Provenance
from stickslip_fit.fit.repeatability import Repeatability
from stickslip_fit.logs import Log
from stickslip_fit.report.calibrated import departures_tables, own_parameters
from stickslip_fit.report.jinja import template
from stickslip_fit.report.measured import coverage_table, facts, sessions_table
from stickslip_fit.report.remarks import remarks
from stickslip_fit.report.table import Column, Table
from stickslip_fit.report.wording import (
    MINUS,
    count,
    joint_name,
    listed,
    number,
    percent,
    step_unit,
    typeset,
    uncertain,
    way,
)
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.text import heading, left_out_text
from stickslip_fit.strategies.verdict import answer

if TYPE_CHECKING:
    from stickslip_fit.capture.tuning import Tuning
    from stickslip_fit.fit.bayes import Posterior

MOST_SESSIONS = 12
MOST_FILES = 3
MOST_REMARKS = 8
OF_COMPARISON = (0, 1, 2, 6, 7, 8, 10)  # columns for which a notebook has the width
ALL_SESSIONS = "all sessions"
FLAGS = {
    "at_bound": "at the edge of what is possible",
    "not_identified": "cannot be known from this log",
    "not_converged": "not converged",
    "few_replicates": "too few replicates for error bars",
    "repeatability_doubted": "counts scatter unlike the repeatability given",
    "outlier": "an outlying count",
    "chosen": "chosen among the gaps between traverses",
}


def result_html(result: Result) -> str:
    """A result: what is wrong with it, parameters by session, provenance."""
    return _result_html(result, [], [])


def posterior_html(posterior: Posterior) -> str:
    """A posterior: as a result, with how good its draws are, and its priors."""
    return _result_html(posterior.result, [posterior.quality], [("Priors", str(posterior.priors))])


def log_html(log: Log) -> str:
    """A log: what was driven in its latest sessions, what it covers, its files."""
    latest = log.sessions[-MOST_SESSIONS:]
    sessions = sessions_table(log.select(log.rows["session"].isin(latest)))
    return template("display.html.j2").render(
        title=f"Log {_files([name for name, _ in log.sources])}".strip(),
        said=[facts(log)],
        remarks=log.notes[:MOST_REMARKS],
        tables=[replace(sessions, note=_latest(len(log.sessions))), coverage_table(log)],
        folded=[],
        provenance=[
            *((name, f"sha256 {sha}") for name, sha in log.sources),
            (f"machine {log.machine.name}", f"sha256 {log.machine.sha256}"),
        ],
    )


def anova_html(found: Anova) -> str:
    """Which factors matter: the sentences, a table of answers for each joint, and all else as text."""
    told = told_by_joint(found)
    joints = sorted({each.question.joint for each in found.answers})
    return template("display.html.j2").render(
        title="Which factors matter",
        said=[f"Joint {joint}. {typeset(' '.join(said))}" for joint, said in told.items()]
        or ["Nothing can be answered from this log."],
        remarks=[typeset(each) for each in (*doubts(found.answers), *reasons(found.refusals))][:MOST_REMARKS],
        tables=[_answers_table(joint, found.answers) for joint in joints],
        folded=[("Everything as text", found.summary())],
        provenance=[],
    )


def formula_html(found: FormulaTable) -> str:
    """A formula's table, what it shows in a sentence."""
    heads = ("sum of squares", "degrees of freedom", "F")
    columns = (Column("term", text=True), *map(Column, heads), Column("p"), Column("p, adjusted"))
    body = tuple(
        (
            str(row.term),
            f"{row.ss:.4g}",
            f"{row.df}",
            *_tested(row),
        )
        for row in found.table.itertuples(index=False)
    )
    note = f"Type {found.kind}; {count(found.count, 'reading')}. Sums of squares in the response's SI unit."
    return template("display.html.j2").render(
        title=found.formula,
        said=[typeset(formula_text(found).partition("\n")[0])],
        remarks=[],
        tables=[Table(f"Analysis of variance, {joint_name(found.joint)}", columns, body, note=note)],
        folded=[],
        provenance=[],
    )


def comparison_html(found: Comparison) -> str:
    """Strategies compared: for each joint what they cost and reach, and what the thesis claims beside it."""
    from stickslip_fit.report.claimed import claimed_table
    from stickslip_fit.report.compared import comparison_table
    from stickslip_fit.report.implied import implied_table

    unsuited = left_out_text(found)
    tables = []
    for joint in found.joints:
        whole = comparison_table(found, joint)
        said = typeset(answer(found, joint)).replace("(-)", f"({MINUS})")
        short = replace(
            whole,
            columns=tuple(whole.columns[k] for k in OF_COMPARISON),
            rows=tuple(tuple(row[k] for k in OF_COMPARISON) for row in whole.rows),
            note=f"{said} {whole.note}",
        )
        tables += [short, implied_table(found, joint), claimed_table(found, joint)]
    return template("display.html.j2").render(
        title="Calibration strategies compared",
        said=[typeset(heading(found))],
        remarks=[],
        tables=tables,
        folded=[("Left out", unsuited)] if unsuited else [],
        provenance=provenance_of(found.provenance),
    )


def tuning_html(tuning: Tuning) -> str:
    """What to listen for, in words."""
    return template("display.html.j2").render(
        title="Tuning of the ear", said=[tuning.summary()], remarks=[], tables=[], folded=[], provenance=[]
    )


def _answers_table(joint: int, answers: Sequence[Answer]) -> Table:
    unit = step_unit(joint)
    columns = (
        Column("question", text=True),
        Column("session", text=True),
        Column("largest difference", unit),
        Column("95 % interval", unit),
        Column("p, adjusted"),
        Column("would show", unit),
    )
    mine = [each for each in answers if each.question.joint == joint]
    note = (
        "Adjusted: for everything asked (Holm). Would show: the smallest difference that is seen at 5 % in "
        "80 of 100 such logs."
    )
    return Table(joint_name(joint).capitalize(), columns, tuple(map(_answer_row, mine)), stubs=2, note=note)


def _answer_row(answer: Answer) -> tuple[str, ...]:
    asked, effect, unit = answer.question, answer.effect, step_unit(answer.question.joint)
    return (
        f"{asked.analysis} {way(asked.direction)}" if asked.direction else asked.analysis,
        asked.session or "all",
        number(effect.difference, unit),
        f"{number(effect.low, unit)} to {number(effect.high, unit)}",
        bare_probability(answer.p_holm),
        number(answer.detectable, unit),
    )


def _tested(row: Any) -> list[str]:
    if row.term == RESIDUAL or not row.df:
        return ["", "", ""]
    return [f"{row.F:.3g}", bare_probability(row.p), bare_probability(row.p_holm)]


def parameters_table(result: Result, joint: int) -> Table:
    """One joint's parameters: sessions and directions down, parameters and remarks across."""
    fit, table = result.joints[joint], result.parameters
    table = table[table["joint"] == joint]
    sessions = list(fit.groups["session"].unique())
    shared = table["session"].isna()
    shown = pd.concat([table[table["session"].isin(sessions[-MOST_SESSIONS:])], table[shared]])
    heads = (Column("session", text=True), Column("direction", text=True))
    parameters = [Column(each.name, each.unit.replace("1", "")) for each in own_parameters(fit)]
    rows = [
        _row(fit, session, direction, mine)
        for (session, direction), mine in shown.groupby(["session", "direction"], sort=False, dropna=False)
    ]
    columns = (*heads, *parameters, Column("remarks", text=True))
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    note = " ".join(filter(None, ["± one standard error.", _repeatability(fit), _latest(len(sessions))]))
    return Table(f"Parameters of {joint_name(joint)}", columns, tuple(rows), stubs=2, note=note)


def _result_html(result: Result, said: Sequence[str], folded: Sequence[tuple[str, str]]) -> str:
    told = remarks(result)
    if len(told) > MOST_REMARKS:
        told = [
            *told[:MOST_REMARKS],
            f"{count(len(told) - MOST_REMARKS, 'more remark')}: print it to read all.",
        ]
    files, method = _files(result.provenance.log_files), result.method.replace("-", " ").capitalize()
    return template("display.html.j2").render(
        title=f"{method} fit of {files}" if files else f"{method} fit",
        said=[*said, _begun_large(expectation_text(expectation(result)))],
        remarks=told,
        tables=[*(parameters_table(result, joint) for joint in result.joints), *departures_tables(result)],
        folded=folded,
        provenance=provenance_of(result.provenance),
    )


def _row(fit: JointFit, session: str | None, direction: str, table: pd.DataFrame) -> tuple[str, ...]:
    found = {row.name: row for row in table.itertuples(index=False)}
    cells = [
        uncertain(row.estimate, row.standard_error, row.unit) if (row := found.get(each.name)) else ""
        for each in own_parameters(fit)
    ]
    label = ALL_SESSIONS if pd.isna(session) else str(session)
    return (label, way(direction), *cells, _flags(table))


def _flags(table: pd.DataFrame) -> str:
    """What is wrong with the parameters of a row, in words: "b, c: cannot be known from this log"."""
    raised: dict[str, list[str]] = {}
    for name, flags in zip(table["name"], table["flags"], strict=True):
        for flag in dict.fromkeys(flags):
            raised.setdefault(flag, []).append(name)
    return "; ".join(
        f"{listed(names) if len(names) < len(table) else 'all'}: {FLAGS.get(flag, flag.replace('_', ' '))}"
        for flag, names in raised.items()
    )


def _repeatability(fit: JointFit) -> str:
    known = [
        f"{percent(found.value)} ({way(sign)}, {_source(found)})"
        for sign, found in fit.repeatability.items()
        if found.freedom > 0
    ]
    return f"Repeatability {listed(known)}." if known else "Repeatability not known."


def _source(found: Repeatability) -> str:
    return (
        "given" if found.source == "given" else f"{found.source}, {count(found.freedom, 'degree')} of freedom"
    )


def _latest(sessions: int) -> str:
    return f"The latest {MOST_SESSIONS} of {count(sessions, 'session')}." if sessions > MOST_SESSIONS else ""


def _begun_large(text: str) -> str:
    return text[0].upper() + text[1:]


def _files(names: Sequence[str]) -> str:
    """The log's files in a title, without their folders; empty for a log that was never in a file."""
    short = [Path(name).name for name in names[:MOST_FILES]]
    if len(names) > MOST_FILES:
        short.append(count(len(names) - MOST_FILES, "more file"))
    return listed(short) if short else ""


def provenance_of(source: Provenance) -> list[tuple[str, str]]:
    """Where numbers come from, line by line."""
    return [
        ("log", f"{listed(source.log_files or ['no file'])}; sha256 {source.log_sha256}"),
        (f"machine {source.machine_name}", f"sha256 {source.machine_sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
        ("command", source.command or "none: made from Python"),
        *([("seed", str(source.seed))] if source.seed is not None else []),
    ]
