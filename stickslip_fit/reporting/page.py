"""The report of a log: what it needs is fitted and tested, then laid out as one HTML page with figures.

The page makes no request and runs only its own script. The same input gives the same page.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from math import ceil, isfinite, log10
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    STEP_DECIMALS,
    capitalize_first,
    format_configuration,
    format_direction,
    join_words,
    joint_name,
    step_unit,
    typeset_text,
)
from stickslip_fit._io import ProgressCallback, ignore_progress, write_atomically
from stickslip_fit._summary import Section, Summary, Table, embed_json, load_page_assets, load_template
from stickslip_fit._typing import Array
from stickslip_fit.anova import Anova, analyze_variance
from stickslip_fit.anova._summary import sentences_by_joint
from stickslip_fit.causes import Cause
from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.diagnosis.residuals import ResidualComparison, compare_residuals, finding_shape
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.estimation import (
    Result,
    fit_closed_form,
    fit_least_squares,
    held_out_errors,
)
from stickslip_fit.estimation._summary import departures_tables, flags
from stickslip_fit.estimation.load_coefficient import tabulate_load_coefficients
from stickslip_fit.estimation.prediction import collect_traverses
from stickslip_fit.estimation.profile import make_comparable
from stickslip_fit.estimation.result import choose_repeatability
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import Elbow, Laws, is_published
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import has_times, position_columns
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.plotting._style import select_recent, thin_rows
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.accuracy import configurations_picture, errors_picture, load_coefficient_picture
from stickslip_fit.plotting.anova import factor_pictures
from stickslip_fit.plotting.diagnosis import confusion_picture, gain_picture, ranking_picture
from stickslip_fit.plotting.parameters import control_picture
from stickslip_fit.plotting.profile import profile_pictures
from stickslip_fit.plotting.residuals import (
    FIT_MAX_POINTS,
    SESSION_HOURS,
    collect_covariates,
    finding_picture,
    fit_residuals_picture,
    residuals_overview_picture,
)
from stickslip_fit.plotting.strategies import pareto_picture
from stickslip_fit.plotting.sweeps import prismatic_pictures, rotary_pictures
from stickslip_fit.reporting.accuracy import (
    configuration_table,
    direction_table,
    explain_tables,
    headline_table,
    session_table,
    summarize_configurations,
    write_headline,
)
from stickslip_fit.reporting.calibration import (
    compare_estimators,
    describe_agreement,
    load_coefficient_table,
    parameter_tables,
    repeatability_table,
)
from stickslip_fit.reporting.table import make_table_section
from stickslip_fit.strategies import (
    Comparison,
    causes_from_other_sessions,
    compare_strategies,
    default_strategies,
    default_strategies_with_causes,
)
from stickslip_fit.strategies.claims import claims_table
from stickslip_fit.units import from_si

SLOW_SECTIONS = ("diagnosis", "strategies")
MAX_COMPARED_SESSIONS = 12  # each is calibrated from all others, so that many sessions take hours


@dataclass(frozen=True)
class Report:
    """A page that needs nothing but itself: it makes no request and says the same without its script.

    Attributes
    ----------
    title : str
    html : str
    log_files : tuple of str
        Files of the log, which `save` does not replace.
    """

    title: str
    html: str = field(repr=False)
    log_files: tuple[str, ...] = ()

    def save(self, path: str | Path) -> None:
        """Write the page.

        Raises
        ------
        InputError
            If the file cannot be written, or is the log.
        """
        write_atomically(path, self.html, self.log_files)

    def _repr_html_(self) -> str:
        page = escape(self.html)
        return (
            f'<iframe srcdoc="{page}" title="{escape(self.title)}" style="width:100%;height:80vh"></iframe>'
        )


def report(
    log: Log | Diagnosis,
    *,
    calibration: Result | None = None,
    fit: Result | None = None,
    anova: Anova | None = None,
    diagnosis: Diagnosis | None = None,
    comparison: Comparison | None = None,
    laws: Laws | None = None,
    causes: Sequence[Cause] = (),
    sections: Collection[str] = SLOW_SECTIONS,
    command: str = "",
    progress: ProgressCallback = ignore_progress,
) -> Report:
    """The report of a log, or of the diagnosis of a table; what is not given is made.

    A section for which this log is too small says why.

    Parameters
    ----------
    log : Log or Diagnosis
        A diagnosis of a table is laid out as it is, and takes no other option than `command`.
    calibration, fit : Result, optional
        In closed form, and by least squares.
    anova : Anova, optional
    diagnosis : Diagnosis, optional
    comparison : Comparison, optional
        Of strategies; made of the default ones on the latest 12 sessions.
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes : sequence of Cause, optional
        Extend the laws of what is made.
    sections : collection of {"diagnosis", "strategies"}, optional
        Which slow sections to make where no result is given for them.
    command : str, optional
        As typed; where empty, the fit's own.
    progress : callable, optional
        Called with each step and the share of the work done.

    Raises
    ------
    InputError
        If a section is unknown, or the log has no traverse to fit.
    """
    if isinstance(log, Diagnosis):
        return _report_diagnosis(log, command)
    if unknown := set(sections) - set(SLOW_SECTIONS):
        raise InputError(f"no section {', '.join(sorted(unknown))}; sections are {', '.join(SLOW_SECTIONS)}")
    found: Diagnosis | InputError | None = diagnosis
    compared: Comparison | InputError | None = comparison
    if diagnosis is None and "diagnosis" in sections:
        found = _try_section(
            lambda: diagnose(log, laws=laws, progress=lambda step, done: progress(step, 0.7 * done))
        )
    if comparison is None and "strategies" in sections:
        progress("comparing strategies", 0.7)
        compared = _try_section(lambda: _compare_strategies(log, laws, causes, command))
    progress("fitting and drawing", 0.9)
    if fit is None:
        fit = fit_least_squares(log, laws=laws, causes=causes, command=command)
    if calibration is None:
        calibration = fit_closed_form(log, laws=laws, causes_from=fit if causes else None, command=command)
    html = _render(log, calibration, fit, anova or analyze_variance(log), found, compared, command)
    return Report(_write_title(log), html, log.files)


def _report_diagnosis(diagnosis: Diagnosis, command: str) -> Report:
    if diagnosis.table is None and diagnosis.log is not None:
        raise InputError("the report of a log begins with the log: report(log, diagnosis=diagnosis)")
    title = Path(diagnosis.log_file).name or "a table"
    return Report(title, diagnosis_page(diagnosis, command=command), diagnosis.files)


def _try_section[Section](make: Callable[[], Section]) -> Section | InputError:
    """A section of the report, or why this log has none, which leaves the other sections as they are."""
    try:
        return make()
    except InputError as error:
        return error
    except np.linalg.LinAlgError as error:
        where = _name_computation(error)
        return InputError(f"{where} did not converge ({error}); look for gross errors in the log")


def _name_computation(error: Exception) -> str:
    """The innermost function of this package that an error came from."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    frame = [each for each in frames if each.f_globals["__name__"].startswith("stickslip_fit")][-1]
    return f"{frame.f_globals['__name__']}.{frame.f_code.co_name}"


def _compare_strategies(log: Log, laws: Laws | None, causes: Sequence[Cause], command: str) -> Comparison:
    log = log.select(log.rows["session"].isin(log.sessions[-MAX_COMPARED_SESSIONS:]))
    strategies = default_strategies()
    if causes:
        strategies += default_strategies_with_causes(causes_from_other_sessions(log, causes, laws=laws))
    return compare_strategies(log, strategies, laws=laws, command=command)


def _render(
    log: Log,
    calibration: Result,
    fit: Result,
    anova: Anova,
    diagnosis: Diagnosis | InputError | None,
    comparison: Comparison | InputError | None,
    command: str,
) -> str:
    errors = held_out_errors(log, calibration).si
    published = [joint for joint, each in fit.joints.items() if is_published(law_without_causes(each.law))]
    coefficients = (
        tabulate_load_coefficients(log, calibration, fit) if Elbow.joint in published else pd.DataFrame()
    )
    both = compare_estimators(calibration, fit)
    traverses, claimed = (
        make_traverses_payload(log, calibration, fit),
        errors[errors["joint"].isin(published)],
    )
    return load_template("report.html.j2").render(
        title=_write_title(log),
        answer=write_headline(log, calibration, errors),
        answer_table=headline_table(log, calibration, fit, errors) if len(errors) else None,
        measured=log.summary(),
        agreement=describe_agreement(both),
        parameters=[*parameter_tables(both, fit), *departures_tables(fit)],
        repeatability=repeatability_table(calibration, fit),
        d_table=load_coefficient_table(coefficients) if len(coefficients) else None,
        figures=_figure_groups(log, calibration, fit, diagnosis, errors, coefficients, published),
        accuracy_explained=explain_tables(errors),
        accuracy=_accuracy_sections(errors, log),
        claims=claims_table(claimed, log.machine) if len(claimed) else None,
        no_claims=_explain_no_claims(fit, published),
        factors=make_anova_section(anova),
        diagnosed=make_diagnosis_section(diagnosis) if isinstance(diagnosis, Diagnosis) else None,
        not_diagnosed=_explain_missing(diagnosis),
        compared=(
            make_comparison_section(comparison, len(log.sessions))
            if isinstance(comparison, Comparison)
            else None
        ),
        not_compared=_explain_missing(comparison),
        flags=flags(calibration, fit),
        provenance=_provenance(log, fit, command),
        joints=traverses["joints"],
        traverses=embed_json(traverses),
        assets=load_page_assets(script=True),
    )


def _explain_missing(section: object) -> str:
    return typeset_text(str(section)) if isinstance(section, InputError) else ""


def _explain_no_claims(fit: Result, published: Collection[int]) -> str:
    others = [str(joint) for joint in fit.joints if joint not in published]
    if not others:
        return ""
    joints = f"joint{'s' if len(others) > 1 else ''} {join_words(others)}"
    return f"What the thesis says is left out for {joints}: it is about its own laws."


def _write_title(log: Log) -> str:
    names = [Path(name).name for name, _ in log.sources]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1:,} more"


def _accuracy_sections(errors: pd.DataFrame, log: Log) -> list[tuple[str, list[Table]]]:
    """A heading and three tables for each joint that has errors."""
    sections = []
    for joint in sorted(errors["joint"].unique()):
        tables = [direction_table(errors, joint, log.machine)]
        if len(log.sessions) > 1:
            tables.append(session_table(errors, joint, log.machine))
        tables.append(configuration_table(summarize_configurations(errors, joint), log.machine))
        sections.append((capitalize_first(joint_name(joint, log.machine)), tables))
    return sections


def _figure_groups(
    log: Log,
    calibration: Result,
    fit: Result,
    diagnosis: Diagnosis | InputError | None,
    errors: pd.DataFrame,
    coefficients: pd.DataFrame,
    published: Collection[int],
) -> list[tuple[str, list[Picture]]]:
    """Headed groups of figures: accuracy, then each joint's residuals, sweeps and parameters."""
    accuracy = [errors_picture(errors, calibration, fit)]
    for joint in sorted(errors["joint"].unique()):
        summary = summarize_configurations(errors, joint)
        accuracy.append(configurations_picture(summary, log.machine))
    groups = [("Accuracy", accuracy)]
    findings = diagnosis.findings if isinstance(diagnosis, Diagnosis) else ()
    versions = [finding.version for finding in findings if finding.version is not None]
    comparable = make_comparable(log, fit, versions)
    for joint in fit.joints:
        rows = collect_traverses(joint, log, calibration, fit)
        sweeps, d = [], []
        if log.machine.has_published_geometry:
            sweeps = prismatic_pictures(rows, fit) if joint == 3 else rotary_pictures(rows, fit)
            d = [load_coefficient_picture(coefficients, fit)] if joint == 2 and joint in published else []
        along = profile_pictures(collect_traverses(joint, log, calibration, comparable.fit), comparable.fit)
        control = control_picture(joint, comparable.fit, comparable.note)
        pictures = [fit_residuals_picture(rows, fit.machine), *sweeps, *d, *along, control]
        groups.append((capitalize_first(joint_name(joint, log.machine)), pictures))
    return groups


def _provenance(log: Log, fit: Result, command: str) -> list[tuple[str, str]]:
    source = fit.provenance
    return [
        *log.provenance,
        *([("all files together", f"sha256 {log.file_sha256}")] if len(log.sources) > 1 else []),
        (f"machine {source.machine_name}", f"sha256 {source.machine_sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
        ("command", command or source.command or "none: made from Python"),
    ]


MAX_TRAVERSES, MAX_OUTLYING = 5000, 500  # of a joint, that a page holds
SIGNIFICANT_DIGITS = 4  # of the largest value on an axis: finer than a screen
MAX_NOTE_LENGTH = 200


def make_traverses_payload(log: Log, calibration: Result, fit: Result) -> dict[str, Any]:
    """What a page tells of each traverse that can be pointed at.

    Of a joint with more than `MAX_TRAVERSES` these are the ones that the figures draw, the largest residuals,
    and a random sample.

    Returns
    -------
    dict
        sessions (names); begun (s since 1970, the zero of all times); and joints, each with its number,
        name, unit, how many traverses it has in all, repeatability by direction, and columns of equal
        length: row (number among the log's usable traverses), session (index into the names), time (s),
        sign, configuration (index into the texts), steps, seen and law (step sizes times `per`), and of
        each quantity its values times `per`; None where not known.
    """
    sessions = list(log.sessions)
    begin = log.rows["time"].min() if has_times(log.rows) else pd.Timestamp(0)
    joints = [_joint_payload(joint, log, calibration, fit, sessions, begin) for joint in fit.joints]
    return {"sessions": sessions, "begun": int(begin.timestamp()), "joints": joints}


def thin_traverses(rows: pd.DataFrame) -> pd.DataFrame:
    """As many of a joint's traverses as a page holds."""
    if len(rows) <= MAX_TRAVERSES:
        return rows
    drawn = thin_rows(select_recent(rows), MAX_TRAVERSES // 2).index.union(
        thin_rows(rows, FIT_MAX_POINTS).index
    )
    chosen = drawn.union(rows["departure"].abs().nlargest(MAX_OUTLYING).index)
    others = thin_rows(rows.drop(index=chosen), max(MAX_TRAVERSES - len(chosen), 0))
    return rows.loc[chosen.union(others.index)]


def _joint_payload(
    joint: int, log: Log, calibration: Result, fit: Result, sessions: Sequence[str], begin: pd.Timestamp
) -> dict[str, Any]:
    traverses = collect_traverses(joint, log, calibration, fit)
    rows, unit = thin_traverses(traverses), step_unit(joint, log.machine)
    configuration, texts = _number_configurations(rows, log.machine)
    repeatability = [choose_repeatability(joint, sign, calibration, fit).value for sign in "+-"]
    seconds = np.nan_to_num(rows["session_seconds"].to_numpy(float))
    quantities = collect_covariates(rows, log.machine) or {SESSION_HOURS: from_si(seconds, "h")}
    per = 10 ** (STEP_DECIMALS[unit] + 1)
    return {
        "joint": joint,
        "name": joint_name(joint, log.machine),
        "unit": unit,
        "all": len(traverses),
        "repeatability": [round(value, 6) if isfinite(value) else None for value in repeatability],
        "per": per,
        "configurations": texts,
        "row": [int(row) for row in rows.index],
        "session": rows["session"].astype(object).map({name: k for k, name in enumerate(sessions)}).tolist(),
        "time": _scale_to_integers(np.floor((rows["time"] - begin).dt.total_seconds().to_numpy(float)), 1.0),
        "sign": "".join(map(format_direction, rows["direction"])),
        "configuration": configuration,
        "steps": rows["steps"].astype(int).tolist(),
        "seen": _scale_to_integers(from_si(rows["step_size"].to_numpy(float), unit), per),
        "law": _scale_to_integers(from_si(rows["model"].to_numpy(float), unit), per),
        "notes": {
            str(row): shorten(str(note), MAX_NOTE_LENGTH) for row, note in rows["note"].items() if note
        },
        "quantities": [_quantity_payload(label, values) for label, values in quantities.items()],
    }


def _number_configurations(rows: pd.DataFrame, machine: Machine) -> tuple[list[int], list[str]]:
    """The number of each row's configuration, and all configurations in words."""
    names = ["joint", *position_columns(rows), "start", "stop"]
    codes = rows.groupby(names, sort=False, dropna=False).ngroup()
    first = rows.loc[~codes.duplicated(), names]
    texts = [format_configuration(row, machine) for _, row in first.iterrows()]
    unique = list(dict.fromkeys(texts))  # both directions of a full traverse have the same text
    return [unique.index(texts[code]) for code in codes], unique


def _quantity_payload(label: str, values: Array) -> dict[str, Any]:
    largest = float(np.nanmax(np.abs(values)))
    per = 10.0 ** (SIGNIFICANT_DIGITS - ceil(log10(largest))) if largest > 0 else 1.0
    return {"label": label, "per": per, "values": _scale_to_integers(values, per)}


def _scale_to_integers(values: Array, per: float) -> list[int | None]:
    return [round(value * per) if isfinite(value) else None for value in values.tolist()]


def make_anova_section(anova: Anova) -> Summary:
    """An analysis of variance, each joint's figures beside its tables."""
    summary, joints = anova.summary(), sentences_by_joint(anova)
    joint_of = {capitalize_first(joint_name(joint, anova.machine)): joint for joint in joints}
    sections = [
        replace(section, figures=tuple(factor_pictures(joint_of[section.title], anova.factor_tests)))
        if section.title in joint_of
        else section
        for section in summary.sections
    ]
    return replace(summary, headline=(), sections=tuple(sections))


def diagnosis_page(diagnosis: Diagnosis, *, command: str = "") -> str:
    """A diagnosis as a self-contained HTML page; `command` as typed."""
    table = diagnosis.table
    if table is None:
        diagnosed, data = make_diagnosis_section(diagnosis, command), "log"
    else:
        diagnosed, data = make_table_section(diagnosis, table, command), "table"
    return load_template("diagnosis.html.j2").render(
        diagnosed=diagnosed, data=data, assets=load_page_assets(script=False)
    )


def make_diagnosis_section(diagnosis: Diagnosis, command: str = "") -> Summary:
    """A diagnosis with its figures."""
    comparison = number_residuals(diagnosis)
    machine = load_machine() if diagnosis.log is None else diagnosis.log.machine
    selected = {cause.cause: cause for cause in diagnosis.selection.selected}
    pictures = [
        finding_picture(finding, cause, finding_shape(diagnosis.selection, cause), comparison, machine)
        for finding in diagnosis.findings
        if (cause := selected[finding.cause]).misfit is not None
    ]
    joints = sorted(comparison.rows["joint"].unique())
    pictures += [residuals_overview_picture(int(joint), comparison, machine) for joint in joints]
    summary = diagnosis.summary()
    findings, alternatives, untestable = summary.sections
    sections = (
        findings,
        Section("The evidence", figures=(*pictures, gain_picture(diagnosis)), key="evidence"),
        replace(alternatives, figures=(ranking_picture(diagnosis), confusion_picture(diagnosis))),
        untestable,
    )
    source = ("command", command or "none: made from Python")
    return replace(summary, sections=sections, provenance=(*summary.provenance, source))


def number_residuals(diagnosis: Diagnosis) -> ResidualComparison:
    """Residuals without outliers, each row by its number among the log's usable traverses."""
    comparison = compare_residuals(diagnosis.selection, diagnosis.seed)
    outliers = [
        row
        for finding in diagnosis.findings
        if finding.traverses is not None
        for row in finding.traverses.index
    ]
    numbers = np.delete(np.arange(len(comparison.rows) + len(outliers)), np.array(outliers, dtype=int))
    return replace(comparison, rows=comparison.rows.set_axis(numbers))


def make_comparison_section(comparison: Comparison, sessions_in_log: int = 0) -> Summary:
    """A comparison of strategies with its figures; says where it is over fewer than the log's sessions."""
    summary, sections = comparison.summary(), []
    joint_of = {capitalize_first(joint_name(one, comparison.machine)): one for one in comparison.joints}
    for section in summary.sections:
        joint = joint_of.get(section.title)
        figures = (pareto_picture(comparison, joint),) if joint else section.figures
        sections.append(replace(section, figures=figures))
    n_compared = len({*comparison.costs["session"], *comparison.left_out["session"]} - {""})
    headline = summary.headline
    if n_compared < sessions_in_log:
        latest = f"Compared on the latest {n_compared} of {sessions_in_log:,} sessions"
        headline = (*headline, f"{latest}; stickslip-fit compare takes all.")
    return replace(summary, headline=headline, sections=tuple(sections))
