"""The sections of a log's report, each with a one-line conclusion, a figure, and tables."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import pandas as pd

from stickslip_fit._format import (
    capitalize_first,
    format_configuration,
    format_direction,
    format_percent,
    join_words,
    joint_name,
    typeset_text,
)
from stickslip_fit._summary import Section, Summary
from stickslip_fit.anova import Anova
from stickslip_fit.anova._summary import NO_ANSWER, tests_tables
from stickslip_fit.anova.position import POSITION
from stickslip_fit.causes import Cause
from stickslip_fit.estimation import Result
from stickslip_fit.estimation._summary import departures_tables, flags
from stickslip_fit.estimation.prediction import MIN_EARLIER_SESSIONS, collect_traverses
from stickslip_fit.estimation.profile import make_comparable
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine
from stickslip_fit.plotting._svg import Picture
from stickslip_fit.plotting.accuracy import configurations_picture, errors_picture, load_coefficient_picture
from stickslip_fit.plotting.anova import factor_pictures, sessions_picture
from stickslip_fit.plotting.parameters import control_picture
from stickslip_fit.plotting.profile import profile_pictures
from stickslip_fit.plotting.readings import readings_picture
from stickslip_fit.plotting.residuals import fit_residuals_picture
from stickslip_fit.plotting.strategies import pareto_picture
from stickslip_fit.plotting.sweeps import prismatic_pictures, rotary_pictures
from stickslip_fit.reporting.accuracy import (
    configuration_table,
    direction_table,
    explain_tables,
    session_table,
    summarize_configurations,
)
from stickslip_fit.reporting.calibration import (
    compare_estimators,
    describe_agreement,
    load_coefficient_table,
    parameter_tables,
    repeatability_table,
)
from stickslip_fit.strategies import Comparison
from stickslip_fit.strategies._summary import compare_with_best
from stickslip_fit.strategies.claims import claims_table
from stickslip_fit.strategies.library import WITH_CAUSES


def measured_section(log: Log) -> Section:
    """What was measured."""
    summary = log.summary()
    conclusion, *others = summary.headline
    tables = tuple(table for section in summary.sections for table in section.tables)
    figures = (readings_picture(log),)
    said = (*others, *summary.flags)
    return Section("What was measured", said, tables, figures, key="measured", conclusion=conclusion)


def parameters_section(
    log: Log, calibration: Result, fit: Result, coefficients: pd.DataFrame, versions: Sequence[Cause]
) -> Section:
    """The calibrated parameters by both estimators, and how they change from session to session."""
    both = compare_estimators(calibration, fit)
    tables = [*parameter_tables(both, fit), *departures_tables(fit), repeatability_table(calibration, fit)]
    if len(coefficients):
        tables.append(load_coefficient_table(coefficients))
    control: list[Picture] = []
    if len(log.sessions) > MIN_EARLIER_SESSIONS:  # with fewer a chart has no limits
        comparable = make_comparable(log, fit, versions)
        control = [control_picture(joint, comparable.fit, comparable.note) for joint in fit.joints]
    return Section(
        "Calibrated parameters",
        (
            "Closed form: as many traverses as parameters, the first of each calibration configuration in a "
            "session. Least squares: all usable traverses of a session.",
        ),
        tuple(tables),
        _drawn(control),
        key="parameters",
        conclusion=capitalize_first(describe_agreement(both)),
    )


def accuracy_section(
    log: Log,
    calibration: Result,
    fit: Result,
    errors: pd.DataFrame,
    published: Collection[int],
    *,
    drawn: bool,
) -> Section:
    """Held-out errors of the law and of a constant step; without the figure where it is `drawn` elsewhere."""
    tables, worst = [], []
    for joint in sorted(errors["joint"].unique()):
        summary = summarize_configurations(errors, joint)
        tables.append(direction_table(errors, joint, log.machine))
        if len(log.sessions) > 1:
            tables.append(session_table(errors, joint, log.machine))
        tables.append(configuration_table(summary, log.machine))
        worst.append(_name_worst(summary.iloc[0], log))
    claimed = errors[errors["joint"].isin(published)]
    if len(claimed):
        tables.append(claims_table(claimed, log.machine))
    others = [str(joint) for joint in fit.joints if joint not in published]
    no_claims = f"joint{'s' if len(others) > 1 else ''} {join_words(others)}"
    left_out = (
        (f"What the thesis says is left out for {no_claims}: it is about its own laws.",) if others else ()
    )
    explained = explain_tables(errors)
    return Section(
        "Accuracy",
        (explained, *left_out) if len(errors) else left_out,
        tuple(tables),
        () if drawn or errors.empty else (errors_picture(errors, calibration, fit),),
        key="accuracy",
        conclusion=f"The calibrated law is furthest off at: {'; '.join(worst)}." if worst else explained,
    )


def _name_worst(worst: pd.Series, log: Log) -> str:
    """The configuration in which the law is furthest off."""
    size = format_percent(float(worst["law_rms_relative"]))
    place, sign = format_configuration(worst, log.machine), format_direction(worst["direction"])
    return f"joint {worst['joint']}: {size} rms at {place} ({sign})"


FACTORS_EXPLAINED = (
    "Does the step size change from session to session, with the direction, between configurations, or when "
    "the base is turned about the joint's axis, which leaves the load along it as it is? The first three are "
    "tested by all traverses of a joint together, against what these leave unexplained, for the sessions of "
    "the log. Day, direction and the turned base are also tested at one configuration, the one with most "
    "traverses, as in the thesis's Sections 4.2, 4.4 and 5.2: day against the scatter of traverses within a "
    "session, the others in each session against the same, and over all sessions against how differently "
    "sessions differ. Whether it differs along the joint's own travel is tested on all stretches together."
)


def factors_section(anova: Anova, corrected: Anova | None = None, causes: Sequence[str] = ()) -> Section:
    """Which factors matter; of `corrected`, without the effect of `causes`, where it is given."""
    told = corrected or anova
    summary = told.summary()
    # Without an answer the conclusion has it.
    paragraphs = [line for line in summary.headline if line != NO_ANSWER]
    if corrected is not None:
        paragraphs.insert(0, describe_correction(causes))
    tables = [table for section in summary.sections for table in section.tables]
    as_counted = [
        replace(table, caption=f"{table.caption}, counts as they are")
        for table in (tests_tables(anova) if corrected is not None else ())
    ]
    figure = sessions_picture(told.factor_tests)
    words = _take_words(summary)
    return Section(
        "Which factors matter",
        tuple(paragraphs),
        (*tables, *as_counted),
        _drawn([figure]),
        key="factors",
        conclusion=_conclude_factors(told),
        folded=(*words, Section("How it is tested", (FACTORS_EXPLAINED,))),
    )


def describe_correction(causes: Sequence[str]) -> str:
    """That fitted effects were taken out of the counts."""
    names = join_words(list(causes))
    return (
        f"The fitted effect of {names} is taken out of the counts first, so that it does not pass for "
        "scatter or for a factor; p-values take it for known."
    )


def _conclude_factors(anova: Anova) -> str:
    """The factors that matter, for each joint."""
    named: dict[int, dict[str, None]] = {}
    for test in anova.factor_tests:
        found = named.setdefault(test.design.joint, {})
        if test.is_significant:
            found[test.design.analysis] = None
    for analysis in anova.models:
        found = named.setdefault(analysis.joint, {})
        for term in [test.term for test in analysis.tests if test.is_significant]:
            found["position along the travel" if term == POSITION else term] = None
    if not named:
        return NO_ANSWER
    parts = [
        f"joint {joint}: {join_words(list(found)) or 'none that shows'}" for joint, found in named.items()
    ]
    return f"What matters at 5 %, adjusted for everything asked: {'; '.join(parts)}."


STRATEGIES = "Which calibration to choose"


def strategies_section(
    comparison: Comparison, sessions_in_log: int = 0, causes: Sequence[str] = ()
) -> Section:
    """Which calibration to choose; says where it is over fewer than the log's sessions."""
    summary = comparison.summary()
    paragraphs = list(summary.headline)
    n_compared = len({*comparison.costs["session"], *comparison.left_out["session"]} - {""})
    if n_compared < sessions_in_log:
        latest = f"Compared on the latest {n_compared} of {sessions_in_log:,} sessions"
        paragraphs.append(f"{latest}; stickslip-fit compare takes all.")
    if causes and comparison.costs["strategy"].str.endswith(WITH_CAUSES).any():
        paragraphs.append(
            f"With causes: {join_words(list(causes))} in the law, of the size that the other sessions give."
        )
    words = _take_words(summary)
    figures = (pareto_picture(comparison),) if comparison.joints else ()
    return Section(
        STRATEGIES,
        tuple(paragraphs),
        tuple(table for section in summary.sections for table in section.tables),
        figures,
        key="strategies",
        conclusion=_conclude_strategies(comparison),
        folded=tuple(words),
    )


def _conclude_strategies(comparison: Comparison) -> str:
    cost = comparison.cost()
    if cost.empty:
        return "No session is left in which they can be compared."
    minutes = cost.set_index(["joint", "strategy"])["seconds"] / 60
    best = [(joint, compare_with_best(comparison, joint)[0]) for joint in comparison.joints]
    told = [f"joint {joint} by {name} ({minutes[joint, name]:.0f} min a session)" for joint, name in best]
    return f"Least error: {join_words(told)}."


def uncompared_section(machine: Machine) -> Section:
    """Why calibration strategies are not compared of a machine other than the published arm."""
    conclusion = (
        "Not compared: the strategies choose among traverses that calibrate the published arm, and "
        f"{machine.name} is another machine. All its traverses are in the fit above."
    )
    return Section(STRATEGIES, key="strategies", conclusion=conclusion)


def missing_section(title: str, key: str, reason: str) -> Section:
    """A section that this log is too small for."""
    return Section(title, key=key, conclusion=f"This log cannot say: {typeset_text(reason)}.")


def remarks_section(calibration: Result, fit: Result) -> Section:
    """Flags on single parameters and counts."""
    found = tuple(map(str, flags(calibration, fit)))
    fine = "None: every parameter can be known from this log, with an error bar."
    return Section("Remarks", found, key="remarks", conclusion="" if found else fine)


def figures_section(
    log: Log,
    calibration: Result,
    fit: Result,
    anova: Anova,
    errors: pd.DataFrame,
    coefficients: pd.DataFrame,
    published: Collection[int],
    versions: Sequence[Cause],
) -> Section:
    """Every further figure, a folded part for each joint: sweeps, residuals, factors, the joint's travel."""
    comparable, parts = make_comparable(log, fit, versions), []
    for joint in fit.joints:
        rows = collect_traverses(joint, log, calibration, fit)
        pictures: list[Picture] = [fit_residuals_picture(rows, fit.machine)]
        if log.machine.has_published_geometry:
            pictures += prismatic_pictures(rows, fit) if joint == 3 else rotary_pictures(rows, fit)
            pictures += [load_coefficient_picture(coefficients, fit)] * (joint == 2 and joint in published)
        along = collect_traverses(joint, log, calibration, comparable.fit)
        pictures += profile_pictures(along, comparable.fit)
        pictures += factor_pictures(joint, anova.factor_tests)
        if (errors["joint"] == joint).any():
            pictures.append(configurations_picture(summarize_configurations(errors, joint), log.machine))
        name = capitalize_first(joint_name(joint, log.machine))
        parts.append(Section(name, figures=tuple(pictures)))
    return Section(
        "Further figures",
        ("Blue is direction +, orange direction −. A marker's shape is its session.",),
        key="figures",
        conclusion="Sweeps with the law, residuals against all that varied, factors, the joint's travel.",
        folded=tuple(parts),
    )


def _take_words(summary: Summary) -> list[Section]:
    """The sections that have sentences, without their tables; a joint's is named as such."""
    return [
        replace(each, tables=(), title=f"{each.title}, in words" if each.tables else each.title)
        for each in summary.sections
        if each.paragraphs
    ]


def _drawn(pictures: Sequence[Picture]) -> tuple[Picture, ...]:
    return tuple(picture for picture in pictures if picture.svg is not None)
