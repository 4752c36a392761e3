"""The report of a log as one self-contained HTML page: sections in order, figures, provenance.

The page makes no request and runs only its own script. The same input gives the same page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, isfinite, log10
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    STEP_DECIMALS,
    format_configuration,
    format_direction,
    joint_name,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Summary, Table, embed_json, load_page_assets, load_template
from stickslip_fit._typing import Array
from stickslip_fit.anova import Anova, analyze_variance
from stickslip_fit.anova._summary import CAUTIONS, sentences_by_joint
from stickslip_fit.diagnosis import Diagnosis
from stickslip_fit.errors import InputError, shorten
from stickslip_fit.estimation import Result
from stickslip_fit.estimation import held_out_errors as errors_of
from stickslip_fit.estimation._summary import departures_tables, flags
from stickslip_fit.estimation.load_coefficient import tabulate_load_coefficients
from stickslip_fit.estimation.prediction import POSITION_COLUMNS, collect_traverses
from stickslip_fit.estimation.result import choose_repeatability
from stickslip_fit.logs import Log
from stickslip_fit.plotting._style import select_recent, thin_rows
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.accuracy import configurations_picture, errors_picture, load_coefficient_picture
from stickslip_fit.plotting.anova import factor_pictures
from stickslip_fit.plotting.parameters import control_picture
from stickslip_fit.plotting.residuals import (
    FIT_MAX_POINTS,
    SESSION_HOURS,
    collect_covariates,
    fit_residuals_picture,
)
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
from stickslip_fit.reporting.diagnosis import make_diagnosis_section
from stickslip_fit.reporting.strategies import make_comparison_section
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies.claims import claims_table
from stickslip_fit.units import from_si


def accuracy_pictures(log: Log, calibration: Result, fit: Result, errors: pd.DataFrame) -> list[Picture]:
    """Errors of the two models over all traverses, and where the law is worst."""
    joints = sorted(errors["joint"].unique())
    worst = [
        configurations_picture(summarize_configurations(errors, joint), log.machine.span(joint))
        for joint in joints
    ]
    return [errors_picture(errors, calibration, fit), *worst]


def joint_pictures(
    joint: int, log: Log, calibration: Result, fit: Result, coefficients: pd.DataFrame
) -> list[Picture]:
    """One joint's sweeps, what the law leaves over, and its parameters."""
    rows = collect_traverses(joint, log, calibration, fit)
    sweeps = prismatic_pictures(rows, fit) if joint == 3 else rotary_pictures(rows, fit)
    d = [load_coefficient_picture(coefficients, fit)] if joint == 2 else []
    return [fit_residuals_picture(rows), *sweeps, *d, control_picture(joint, fit)]


def make_figure_groups(
    log: Log, calibration: Result, fit: Result, errors: pd.DataFrame, coefficients: pd.DataFrame
) -> list[tuple[str, list[Picture]]]:
    """Headed groups of figures."""
    groups = [("Accuracy", accuracy_pictures(log, calibration, fit, errors))]
    for joint in fit.joints:
        pictures = joint_pictures(joint, log, calibration, fit, coefficients)
        groups.append((joint_name(joint).capitalize(), pictures))
    return groups


MAX_TRAVERSES, MAX_OUTLYING = 5000, 500  # traverses of a joint
SIGNIFICANT_DIGITS = 4  # of the largest value on an axis: finer than a screen
MAX_NOTE_LENGTH = 200


def make_traverses_payload(log: Log, calibration: Result, fit: Result) -> dict[str, Any]:
    """What a page tells of each traverse that can be pointed at.

    Of a joint with more than `MOST` traverses it is those that the figures draw, the furthest from the law,
    and others by lot.

    Returns
    -------
    dict
        sessions (names); begun (s since 1970, the zero of all times); and joints, each with its number,
        name, unit, how many traverses it has in all, repeatability by direction, and columns that belong
        together: row (its number among the log's usable traverses), session (which of the names), time (s),
        sign, configuration (which of the texts), steps, seen and law (step sizes times `per`), and of each
        quantity its values times `per`; None where something is not known.
    """
    sessions = list(log.sessions)
    begun = log.rows["time"].min()
    joints = [_joint_payload(joint, log, calibration, fit, sessions, begun) for joint in fit.joints]
    return {"sessions": sessions, "begun": int(begun.timestamp()), "joints": joints}


def thin_traverses(rows: pd.DataFrame) -> pd.DataFrame:
    """As many of a joint's traverses as a page holds."""
    if len(rows) <= MAX_TRAVERSES:
        return rows
    extreme_levels = rows["departure"].abs().nlargest(MAX_OUTLYING).index
    drawn = thin_rows(select_recent(rows), MAX_TRAVERSES // 2).index.union(
        thin_rows(rows, FIT_MAX_POINTS).index
    )
    chosen = drawn.union(extreme_levels)
    others = rows.drop(index=chosen)
    return rows.loc[chosen.union(thin_rows(others, max(MAX_TRAVERSES - len(chosen), 0)).index)]


def _joint_payload(
    joint: int, log: Log, calibration: Result, fit: Result, sessions: Sequence[str], begun: pd.Timestamp
) -> dict[str, Any]:
    everything = collect_traverses(joint, log, calibration, fit)
    rows, unit = thin_traverses(everything), step_unit(joint)
    places, texts = _number_configurations(rows, log.machine.span(joint))
    per = 10 ** (STEP_DECIMALS[unit] + 1)
    return {
        "joint": joint,
        "name": joint_name(joint),
        "unit": unit,
        "all": len(everything),
        "repeatability": [
            _format_share(choose_repeatability(joint, sign, calibration, fit).value) for sign in "+-"
        ],
        "per": per,
        "configurations": texts,
        "row": [int(row) for row in rows.index],
        "session": rows["session"].astype(object).map({name: k for k, name in enumerate(sessions)}).tolist(),
        "time": [int(passed) for passed in (rows["time"] - begun).dt.total_seconds()],
        "sign": "".join(map(format_direction, rows["direction"])),
        "configuration": places,
        "steps": rows["steps"].astype(int).tolist(),
        "seen": _scale_to_integers(from_si(rows["step_size"].to_numpy(float), unit), per),
        "law": _scale_to_integers(from_si(rows["model"].to_numpy(float), unit), per),
        "notes": {
            str(row): shorten(str(note), MAX_NOTE_LENGTH) for row, note in rows["note"].items() if note
        },
        "quantities": [_quantity_payload(label, values) for label, values in _axis_payload(rows).items()],
    }


def _number_configurations(rows: pd.DataFrame, span: float) -> tuple[list[int], list[str]]:
    """Which configuration each row has, and all of them in words."""
    names = ["joint", *POSITION_COLUMNS, "start", "stop"]
    places = rows.groupby(names, sort=False, dropna=False).ngroup()
    first = rows.loc[~places.duplicated(), names]
    texts = [format_configuration(row, span) for _, row in first.iterrows()]
    different = list(dict.fromkeys(texts))  # both directions of a full traverse read alike
    return [different.index(texts[place]) for place in places], different


def _axis_payload(rows: pd.DataFrame) -> dict[str, Array]:
    """What varied; the hours where nothing did."""
    return collect_covariates(rows) or {SESSION_HOURS: from_si(rows["session_seconds"].to_numpy(float), "h")}


def _quantity_payload(label: str, values: Array) -> dict[str, Any]:
    largest = float(np.nanmax(np.abs(values)))
    per = 10.0 ** (SIGNIFICANT_DIGITS - ceil(log10(largest))) if largest > 0 else 1.0
    return {"label": label, "per": per, "values": _scale_to_integers(values, per)}


def _scale_to_integers(values: Array, per: float) -> list[int | None]:
    return [round(value * per) if isfinite(value) else None for value in values.tolist()]


def _format_share(value: float) -> float | None:
    return round(value, 6) if isfinite(value) else None


def render_report(
    log: Log,
    calibration: Result,
    constant: Result,
    fit: Result,
    *,
    diagnosis: Diagnosis | InputError | None = None,
    comparison: Comparison | InputError | None = None,
    command: str = "",
) -> str:
    """The report of a log.

    Parameters
    ----------
    log : Log
    calibration : Result
        Closed form.
    constant : Result
        The constant step of each session and direction.
    fit : Result
        Least squares.
    diagnosis : Diagnosis or InputError, optional
        For a section on what the laws get wrong; or why this log has none.
    comparison : Comparison or InputError, optional
        For a section on calibration strategies; or why this log has none.
    command : str, optional
        As typed; where empty, the fit's own.

    Returns
    -------
    str
        An HTML page that needs nothing but itself: it makes no request, runs no script but its own, and says
        the same without that. The same input gives the same page.
    """
    errors = errors_of(log, calibration, constant)
    coefficients = tabulate_load_coefficients(log, calibration, fit)
    both = compare_estimators(calibration, fit)
    variance = analyze_variance(log)
    traverses = make_traverses_payload(log, calibration, fit)
    return load_template("report.html.j2").render(
        title=_write_title(log),
        answer=write_headline(log, calibration, errors),
        answer_table=headline_table(log, calibration, fit, errors) if len(errors) else None,
        measured=log.summary(),
        agreement=describe_agreement(both),
        parameters=[*parameter_tables(both, fit), *departures_tables(fit)],
        repeatability=repeatability_table(calibration, fit),
        d_table=load_coefficient_table(coefficients) if len(coefficients) else None,
        figures=make_figure_groups(log, calibration, fit, errors, coefficients),
        accuracy_explained=explain_tables(errors),
        accuracy=_accuracy_sections(errors, log),
        claims=claims_table(errors) if len(errors) else None,
        factors=factors(variance),
        diagnosed=make_diagnosis_section(diagnosis) if isinstance(diagnosis, Diagnosis) else None,
        not_diagnosed=_explain_missing(diagnosis),
        compared=make_comparison_section(comparison, len(log.sessions))
        if isinstance(comparison, Comparison)
        else None,
        not_compared=_explain_missing(comparison),
        flags=flags(calibration, fit),
        provenance=_provenance(log, fit, command),
        joints=traverses["joints"],
        traverses=embed_json(traverses),
        trusted=load_page_assets(script=True),
    )


def factors(variance: Anova) -> Summary:
    """The section on factors, each joint's sentences and figures beside its tables."""
    summary, sentences = variance.summary(), sentences_by_joint(variance)
    sections = [
        replace(
            section,
            paragraphs=tuple(map(typeset_text, sentences[joint])),
            figures=tuple(factor_pictures(joint, variance.answers)),
        )
        for joint, section in zip(sentences, summary.sections, strict=False)
    ]
    rest = [section for section in summary.sections if section.title == CAUTIONS]
    return replace(summary, headline=(), sections=(*sections, *rest))


def _explain_missing(section: object) -> str:
    return typeset_text(str(section)) if isinstance(section, InputError) else ""


def _write_title(log: Log) -> str:
    names = [Path(name).name for name, _ in log.sources]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1:,} more"


def _accuracy_sections(errors: pd.DataFrame, log: Log) -> list[tuple[str, list[Table]]]:
    """A heading and three tables for each joint that has errors."""
    sections = []
    for joint in sorted(errors["joint"].unique()):
        worst = summarize_configurations(errors, joint)
        tables = [direction_table(errors, joint)]
        if len(log.sessions) > 1:
            tables.append(session_table(errors, joint))
        tables.append(configuration_table(worst, log.machine))
        sections.append((joint_name(joint).capitalize(), tables))
    return sections


def _provenance(log: Log, fit: Result, command: str) -> list[tuple[str, str]]:
    source = fit.provenance
    return [
        *((name, f"sha256 {sha}") for name, sha in log.sources),
        *([("all files together", f"sha256 {log.sha256}")] if len(log.sources) > 1 else []),
        (f"machine {source.machine_name}", f"sha256 {source.machine_sha256}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in source.versions.items())),
        ("command", command or source.command or "none: made from Python"),
    ]
