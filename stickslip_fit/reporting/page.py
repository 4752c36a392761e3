"""The report of a log: what it needs is fitted and tested, then laid out as one HTML page with figures.

The page makes no request and runs only its own script. The same input gives the same page.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit._io import write_atomically
from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._summary import Section, embed_json, load_page_assets, load_template
from stickslip_fit.anova import Anova, analyze_variance
from stickslip_fit.causes import Cause
from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.diagnosis._methods import describe_methods, list_references
from stickslip_fit.diagnosis._unknown_summary import name_findings
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.errors import InputError, check_type
from stickslip_fit.estimation import Result, fit_closed_form, fit_least_squares, held_out_errors
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.closed_form import solve_calibration
from stickslip_fit.estimation.load_coefficient import tabulate_load_coefficients
from stickslip_fit.estimation.prediction import collect_traverses
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import Elbow, Laws, choose_laws, is_published
from stickslip_fit.logs import Log
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.accuracy import overview_picture
from stickslip_fit.reporting.diagnosis import diagnosis_page, diagnosis_section, first_finding_picture
from stickslip_fit.reporting.headline import headline_table, is_extended, write_headline
from stickslip_fit.reporting.sections import (
    STRATEGIES,
    accuracy_section,
    factors_section,
    figures_section,
    measured_section,
    missing_section,
    parameters_section,
    remarks_section,
    strategies_section,
    uncompared_section,
)
from stickslip_fit.reporting.traverses import make_traverses_payload
from stickslip_fit.strategies import (
    Comparison,
    causes_from_other_sessions,
    compare_strategies,
    default_strategies,
    default_strategies_with_causes,
)

SLOW_SECTIONS = ("diagnosis", "strategies")
OPTIONAL_SECTIONS = (*SLOW_SECTIONS, "figures")
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
    sections : collection of {"diagnosis", "strategies", "figures"}, optional
        Which sections to make: slow ones where no result is given for them, and further figures, which
        are folded at the end of the page. The first two without it.
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
    check_type("log", log, Log, Diagnosis)
    if unknown := set(sections) - set(OPTIONAL_SECTIONS):
        raise InputError(
            f"no section {', '.join(sorted(unknown))}; sections are {', '.join(OPTIONAL_SECTIONS)}"
        )
    found: Diagnosis | InputError | None = diagnosis
    compared: Comparison | InputError | None = comparison
    common: list[Finding] = []
    if diagnosis is None and "diagnosis" in sections:
        found = _try_section(
            lambda: diagnose(log, laws=laws, progress=lambda step, done: progress(step, 0.7 * done))
        )
    if comparison is None and "strategies" in sections:
        progress("comparing strategies", 0.7)
        # What extends the law alike in all sessions, so that a session's is known from the others.
        common = [one for one in _extending(found) if not getattr(one.version, "sessions", ())]
        known = [*causes, *(finding.version for finding in common)]
        compared = _try_section(lambda: _compare_strategies(log, laws, known, command))
    progress("fitting and drawing", 0.9)
    if fit is None:
        fit = fit_least_squares(log, laws=laws, causes=causes, command=command)
    if calibration is None:
        calibration = _calibrate(log, laws, fit if causes else None, command)
    known_causes = [*(cause.name for cause in causes), *name_findings(common)]
    results = _Results(log, calibration, fit, anova or analyze_variance(log), found, compared, known_causes)
    return Report(_write_title(log), _render(results, command, figures="figures" in sections), log.files)


def _calibrate(log: Log, laws: Laws | None, causes_from: Result | None, command: str) -> Result:
    """The closed form; outlying counts are looked for in the fit alone."""
    if causes_from is not None:
        return fit_closed_form(log, laws=laws, causes_from=causes_from, command=command)
    chosen = choose_laws(usable_rows(log), log.machine, laws)
    return solve_calibration(log, chosen, "closed-form", command=command)


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


@dataclass(frozen=True, eq=False)
class _Results:
    """What a page is made of; in place of a result, why the log has none.

    `known_causes` are in the law of some of the strategies compared.
    """

    log: Log
    calibration: Result
    fit: Result
    anova: Anova
    found: Diagnosis | InputError | None
    compared: Comparison | InputError | None
    known_causes: Sequence[str]

    @property
    def diagnosis(self) -> Diagnosis | None:
        return self.found if isinstance(self.found, Diagnosis) else None


def _extending(found: object) -> list[Finding]:
    """Findings that extend the law."""
    return [one for one in found.findings if one.version] if isinstance(found, Diagnosis) else []


def _render(results: _Results, command: str, *, figures: bool) -> str:
    log, calibration, fit, diagnosis = results.log, results.calibration, results.fit, results.diagnosis
    errors = held_out_errors(log, calibration).si
    table = headline_table(log, calibration, fit, errors, diagnosis) if len(errors) else None
    first = first_finding_picture(diagnosis) if diagnosis is not None else None
    traverses = make_traverses_payload(log, calibration, fit)
    return load_template("report.html.j2").render(
        title=_write_title(log),
        answer=write_headline(log, calibration, errors, diagnosis),
        answer_table=table,
        answer_figure=first or _overview(results, errors),
        sections=_make_sections(results, errors, first is None, figures=figures),
        provenance=_provenance(log, fit, command),
        joints=traverses["joints"],
        traverses=embed_json(traverses),
        assets=load_page_assets(script=True),
    )


def _overview(results: _Results, errors: pd.DataFrame) -> Picture:
    log, calibration, fit = results.log, results.calibration, results.fit
    rows = pd.concat([collect_traverses(joint, log, calibration, fit) for joint in fit.joints])
    return overview_picture(rows, errors, calibration, fit)


def _make_sections(
    results: _Results, errors: pd.DataFrame, errors_drawn: bool, *, figures: bool
) -> list[Section]:
    log, calibration, fit, diagnosis = results.log, results.calibration, results.fit, results.diagnosis
    extending = _extending(diagnosis)
    versions = [one.version for one in extending]
    published = [joint for joint, each in fit.joints.items() if is_published(law_without_causes(each.law))]
    coefficients = (
        tabulate_load_coefficients(log, calibration, fit) if Elbow.joint in published else pd.DataFrame()
    )
    named, corrected = [], None
    if diagnosis is not None and is_extended(diagnosis):
        named = name_findings(extending)
        corrected = analyze_variance(diagnosis.corrected_log())
    sections = [
        measured_section(log),
        parameters_section(log, calibration, fit, coefficients, versions),
        accuracy_section(log, calibration, fit, errors, published, drawn=errors_drawn),
        factors_section(results.anova, corrected, named),
    ]
    if diagnosis is not None:
        sections.append(diagnosis_section(diagnosis))
    elif isinstance(results.found, InputError):
        reason = str(results.found)
        sections.append(missing_section("What the simulation gets wrong", "diagnosis", reason))
    if results.compared is not None and not log.machine.has_published_geometry:
        sections.append(uncompared_section(log.machine))
    elif isinstance(results.compared, Comparison):
        sections.append(strategies_section(results.compared, len(log.sessions), results.known_causes))
    elif results.compared is not None:
        reason = str(results.compared)
        sections.append(missing_section(STRATEGIES, "strategies", reason))
    if figures:
        anova = corrected or results.anova
        given = (log, calibration, fit, anova, errors, coefficients, published, versions)
        sections.append(figures_section(*given))
    if diagnosis is not None:
        references = "\n".join(["References", *list_references(diagnosis)])
        sections.append(Section("Methods", (*describe_methods(diagnosis), references), key="methods"))
    return [*sections, remarks_section(calibration, fit)]


def _write_title(log: Log) -> str:
    names = [Path(name).name for name, _ in log.sources]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1:,} more"


def _provenance(log: Log, fit: Result, command: str) -> list[tuple[str, str]]:
    source = fit.provenance
    return [
        *log.provenance,
        *([("all files together", f"sha256 {log.file_sha256}")] if len(log.sources) > 1 else []),
        (f"machine {source.machine_name}", f"sha256 {source.machine_sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
        ("command", command or source.command or "none: made from Python"),
    ]
