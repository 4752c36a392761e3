"""What a comparison of laws says, in a few lines, and its tables."""

from __future__ import annotations

from math import isfinite, isinf, isnan

import numpy as np

from stickslip_fit._format import (
    MISSING,
    format_direction,
    format_measured,
    format_measured_range,
    format_percent,
    format_share,
    format_value,
    join_words,
    pluralize,
)
from stickslip_fit._summary import Section, Summary, Table, numbers, summarize, words
from stickslip_fit.law_comparison.comparison import JointComparison, LawComparison, Regime
from stickslip_fit.law_comparison.experiments import Experiment
from stickslip_fit.law_comparison.held_out import MAX_PARTS, MIN_CONFIGURATIONS, ErrorEstimate
from stickslip_fit.logs.log import file_names
from stickslip_fit.units import PRISMATIC, Interval

MAX_EXPERIMENTS = 3  # of a joint where there is little room


@summarize.register
def summarize_comparison(comparison: LawComparison) -> Summary:
    """A line for each joint; then errors, regimes and what would tell."""
    files = file_names(list(comparison.provenance.log_files))
    tables = [_errors(comparison), _regimes(comparison)]
    experiments = [(one, each) for one in comparison.joints for each in one.experiments]
    if experiments:
        tables.append(_experiments(comparison))
    return Summary(
        title=f"Published and physical laws of {files}" if files else "Published and physical laws",
        headline=tuple(_describe(one) for one in comparison.joints),
        sections=(Section(tables=tuple(tables)),),
        provenance=tuple(comparison.provenance.lines()),
    )


def _describe(one: JointComparison) -> str:
    """The verdict on a joint."""
    errors = one.errors
    if errors.configurations < MIN_CONFIGURATIONS:
        verdict = (
            "this log cannot tell which law predicts better: too few configurations can be left out "
            f"({errors.configurations})"
        )
    elif errors.better:
        better = getattr(errors, errors.better)
        worse = errors.published if errors.better == "physical" else errors.physical
        verdict = (
            f"the {errors.better} law predicts better, {format_percent(better.rms)} off against "
            f"{format_percent(worse.rms)} on configurations that it has not seen"
        )
    else:
        verdict = (
            f"this log cannot tell which law predicts better ({format_percent(errors.published.rms)} off and "
            f"{format_percent(errors.physical.rms)})"
        )
    if not errors.better or errors.better == "physical":
        return f"Joint {one.joint}: {verdict}. {_describe_regimes(one.regimes)}"
    return f"Joint {one.joint}: {verdict}; regimes below are those of the law that predicts worse."


def _describe_regimes(regimes: tuple[Regime, ...]) -> str:
    kinds = dict.fromkeys(regime.name for regime in regimes)
    parts = []
    for kind in kinds:
        own = [regime for regime in regimes if regime.name == kind]
        where = join_words([format_direction(regime.direction) for regime in own])
        if kind == "cannot tell":
            parts.append(f"in {where} it cannot tell the regime")
        else:
            why = (
                "the step goes by friction and mass"
                if kind == "friction-limited"
                else "the slider catches up"
            )
            parts.append(f"in {where} steps are {kind}: {why}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _errors(comparison: LawComparison) -> Table:
    columns = (
        *words("joint", "better"),
        *numbers("published", "physical", "replicate scatter", "configurations"),
    )
    rows = tuple(
        (
            str(one.joint),
            one.errors.better or "cannot tell",
            _error(one.errors.published),
            _error(one.errors.physical),
            MISSING if isnan(one.replicate_scatter) else format_percent(one.replicate_scatter),
            str(one.errors.configurations),
        )
        for one in comparison.joints
    )
    note = (
        f"Rms error of counts in configurations left out one at a time, or, of more than {MAX_PARTS}, in "
        f"{MAX_PARTS} parts; with its interval of 95 %."
    )
    return Table("Errors on configurations left out", columns, rows, stubs=1, note=note)


def _error(error: ErrorEstimate) -> str:
    if isnan(error.rms):
        return MISSING
    return format_share(Interval(error.rms, error.low, error.high))


def _regimes(comparison: LawComparison) -> Table:
    columns = (*words("joint", "regime"), *numbers("probability", "lambda", "r"), *words("drive"))
    rows = tuple(
        (
            f"{regime.joint} {format_direction(regime.direction)}",
            regime.name,
            _probability(regime.probability),
            _ratio(regime),
            _share(regime),
            _drive(regime),
        )
        for one in comparison.joints
        for regime in one.regimes
    )
    note = (
        "If the physical law holds. Probability: of friction-limited steps without load, lambda = D / (a_f "
        "T1²) above 1. r: full load over friction, with the arm out; its interval of 95 % allows for "
        "friction that is not Coulomb's. a_f: friction over mass, in units of g, the gravitational "
        "acceleration (9.81 m/s²); T1: time of the ramp; D: travel of the foot."
    )
    return Table("Regimes by the physical law", columns, rows, stubs=1, note=note)


def _probability(probability: float) -> str:
    if probability > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if probability < 0.001 else format_percent(probability)


def _ratio(regime: Regime) -> str:
    low, high = regime.ratio
    if low == 0.0 and isinf(high):
        return "not bounded"
    if isinf(high):
        return f"> {low:.2f}"
    return f"< {high:.2f}" if low == 0.0 else f"{low:.2f} to {high:.2f}"


def _share(regime: Regime) -> str:
    if isnan(regime.share):
        return MISSING
    low, high = regime.share_interval
    shown = Interval(regime.share, low, high)
    return f"{format_measured(shown)} ({format_measured_range(shown)})"


def _drive(regime: Regime) -> str:
    """What the numbers mean for friction, ramp and foot."""
    unit = "nm" if regime.joint == PRISMATIC else "µrad"
    low, high = regime.amplitude
    throw = f"D > {format_value(low, unit, 0)}" if isinf(high) else f"D {format_value(low, unit, 0)}"
    if regime.name == "cannot tell":
        return MISSING
    if not isfinite(regime.friction_acceleration):
        return throw
    g = regime.friction_acceleration / 9.80665
    return f"a_f {g:.1f} g, T1 {1e3 * regime.ramp_time:.3f} ms, {throw}"


def _experiments(comparison: LawComparison) -> Table:
    columns = (
        *words("joint", "traverse"),
        *numbers("friction-limited", "velocity-limited", "published", "traverses"),
    )
    rows = tuple(
        _experiment(one, each) for one in comparison.joints for each in one.experiments[:MAX_EXPERIMENTS]
    )
    note = (
        "Step size over that without load, by the fits to this log. Traverses: how many tell the regimes "
        "apart with 5 % confusion. A known mass adds to what slides or turns; the supply sets the amplitude."
    )
    return Table("Traverses that would tell", columns, rows, stubs=2, note=note)


def _experiment(one: JointComparison, each: Experiment) -> tuple[str, ...]:
    sizes = (each.friction_limited, each.velocity_limited, each.published)
    return (
        f"{one.joint} {format_direction(each.direction)}",
        each.description,
        *(MISSING if np.isnan(size) else f"{size:.3f}" for size in sizes),
        MISSING if each.traverses is None else pluralize(each.traverses, "traverse").split()[0],
    )
