"""What a study says: each joint's answer and strategies, the tip, and what was left out."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    capitalize_first,
    format_direction,
    format_number,
    format_percent,
    format_percent_range,
    format_range,
    format_value,
    joint_name,
    pluralize,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.estimation.result import library_versions
from stickslip_fit.studies.study import SimulationStudy
from stickslip_fit.units import JOINTS

MIN_COVERAGE = 0.9  # of stated 95 % intervals


@summarize.register
def summarize_study(study: SimulationStudy) -> Summary:
    """Which strategy survives what, joint by joint; where the tip ends; who takes no part."""
    sections = [
        Section(tables=(overview_table(study),)),
        Section("What was simulated", (typeset_text(_heading(study)),)),
    ]
    for joint in study.joints:
        answer = typeset_text(describe_study_joint(study, joint))
        title = capitalize_first(joint_name(joint, study.plan.machine))
        sections.append(Section(title, (answer,), (_joint_table(study, joint),)))
    tips = study.tips()
    if len(tips):
        sections.append(Section(_tip_title(study), (_tip_answer(tips),), (_tips_table(study, tips),)))
    left_out = _left_out(study)
    plan = study.plan
    return Summary(
        "Calibration strategies in simulation",
        (_describe_limit(study), *(typeset_text(write_study_headline(study, one)) for one in study.joints)),
        (*sections, *([Section("Left out", tables=(left_out,))] if left_out.rows else [])),
        provenance=(
            *(
                (f"scenario {scenario.name}", f"sha256 {plan.sha256(scenario)}")
                for scenario in plan.scenarios
            ),
            (f"machine {plan.machine.name}", f"sha256 {plan.machine.sha256}"),
            ("versions", ", ".join(f"{name} {version}" for name, version in library_versions().items())),
            ("command", study.command or "none: made from Python"),
            ("seed", str(plan.seed)),
        ),
    )


def _heading(study: SimulationStudy) -> str:
    """What was simulated."""
    plan = study.plan
    return (
        f"{plan.name}: {plan.campaigns:,} campaigns of {len(plan.plan.sessions)} sessions with "
        f"{'each of ' * (len(plan.scenarios) > 1)}{pluralize(len(plan.scenarios), 'scenario')}, "
        f"{len(plan.strategies)} calibration strategies. Each "
        "calibrates a session from its own traverses, which it chooses once, before any campaign. Errors are "
        "predicted less true mean step size, of all configurations of the plan, with 95 % intervals over "
        "campaigns; held is the share of stated 95 % intervals that hold the truth; a traverse costs "
        f"{study.design.handling_seconds:.0f} s beside its steps."
    )


def _joint_table(study: SimulationStudy, joint: int) -> Table:
    """One joint's strategies in each scenario."""
    unit = step_unit(joint, study.plan.machine)
    columns = (
        *words("scenario", "strategy"),
        Column("each way", group="a session"),
        Column("time", "min", "a session"),
        *numbers("rms", "95 %", "bias", "worst", unit="%"),
        Column("rms", unit),
        *numbers("held", "failed", unit="%"),
    )
    table = study.accuracy()
    rows = tuple(_cells(row, unit) for _, row in table[table["joint"] == joint].iterrows())
    return Table(f"Strategies for {joint_name(joint, study.plan.machine)}", columns, rows, stubs=2)


def _cells(row: pd.Series, unit: str) -> tuple[str, ...]:
    return (
        str(row["scenario"]),
        str(row["strategy"]),
        f"{row['traverses']:.3g}",
        f"{row['seconds'] / 60:.0f}",
        format_percent(row["rms_relative"], with_unit=False),
        format_percent_range(row["rms_relative_low"], row["rms_relative_high"]),
        format_percent(row["bias_relative"], with_unit=False),
        format_percent(row["worst_relative"], with_unit=False),
        format_number(row["rms"], unit),
        f"{100 * row['covered']:.0f}" if np.isfinite(row["covered"]) else "",
        format_percent(row["failed"], with_unit=False) if row["failed"] > 0 else "0",
    )


def _tip_title(study: SimulationStudy) -> str:
    return (
        f"The tip after {study.plan.moves} open-loop moves of {format_value(study.plan.length, 'mm', 2)} "
        "a session"
    )


def _tip_answer(tips: pd.DataFrame) -> str:
    """Where the tip ends with the best strategy of each scenario."""
    closest = []
    for scenario, rows in tips.groupby("scenario", sort=False):
        best = rows.loc[rows["often"].idxmin()]
        reach = format_value(best["often"], "µm", 1)
        closest.append(f"{scenario}: {best['strategy']}, 95 % of moves within {reach}")
    return f"Closest to where they should end: {'; '.join(closest)}."


def _tips_table(study: SimulationStudy, tips: pd.DataFrame) -> Table:
    heads = ("rms", "half within", "95 % within", "in 9 campaigns of 10", "worst")
    columns = (
        *words("scenario", "strategy"),
        *(Column(head, "µm") for head in heads),
        *(Column(f"joint {joint}", "%", "share of the mean square") for joint in JOINTS),
        Column("unknown", "%"),
    )
    rows = tuple(
        (
            str(row["scenario"]),
            str(row["strategy"]),
            *(format_number(row[name], "µm") for name in ("rms", "median", "often")),
            format_range(row["often_low"], row["often_high"], "µm"),
            format_number(row["worst"], "µm"),
            *(format_number(row[f"share_{joint}"], "%", 0) for joint in JOINTS),
            format_percent(row["unknown"], with_unit=False) if row["unknown"] > 0 else "0",
        )
        for _, row in tips.iterrows()
    )
    return Table(_tip_title(study), columns, rows, stubs=2)


def _left_out(study: SimulationStudy) -> Table:
    """Which strategies take no part where, and why."""
    columns = tuple(Column(head, text=True) for head in ("strategy", "joint", "direction", "why"))
    groups = study.design.left_out.groupby(["strategy", "joint", "reason"], sort=False)["direction"]
    rows = tuple(
        (strategy, str(joint), " and ".join(map(format_direction, dict.fromkeys(directions))), reason)
        for (strategy, joint, reason), directions in groups
    )
    return Table("Left out", columns, rows)


def _describe_limit(study: SimulationStudy) -> str:
    """The limit by which a strategy is accurate enough, as a sentence."""
    interval = "the upper end of the 95 % interval over campaigns"
    by = interval if study.plan.campaigns > 1 else "its one campaign"
    return f"Limit: {100 * study.plan.good_enough:g} % rms (good_enough_pct of the plan), judged by {by}."


def _sufficient(study: SimulationStudy, joint: int) -> tuple[pd.DataFrame, dict[str, list[str]]]:
    """A joint's accuracy, and by scenario the strategies within the limit, cheapest first.

    That is judged by the upper end of the rms error's 95 % interval; with one campaign, which has no
    interval, by the rms error.
    """
    table = study.accuracy()
    table = table[table["joint"] == joint]
    sufficient = table[_upper_rms(table) <= study.plan.good_enough].sort_values("seconds", kind="stable")
    return table, {
        name: list(sufficient.loc[sufficient["scenario"] == name, "strategy"]) for name in study.scenarios
    }


def _upper_rms(table: pd.DataFrame) -> pd.Series:
    return table["rms_relative_high"].fillna(table["rms_relative"])


def write_study_headline(study: SimulationStudy, joint: int) -> str:
    """The cheapest strategy that is within the limit in all scenarios, as a sentence."""
    table, accurate = _sufficient(study, joint)
    names = [name for name in accurate[study.scenarios[0]] if all(name in each for each in accurate.values())]
    if not names:
        return f"Joint {joint}: no strategy is within the limit in every scenario."
    minutes = float(table.loc[table["strategy"] == names[0], "seconds"].mean()) / 60
    scenarios = f"all {len(accurate)} scenarios" if len(accurate) > 1 else "the scenario"
    return (
        f"Joint {joint}: {len(names)} of {len(study.strategies(joint))} strategies are within the limit in "
        f"{scenarios}; the cheapest is {names[0]}, {minutes:.0f} min a session."
    )


def overview_table(study: SimulationStudy) -> Table:
    """Of every strategy in each scenario, the largest error of all joints."""
    accuracy = study.accuracy()
    accuracy = accuracy.assign(upper=_upper_rms(accuracy))
    minutes = accuracy.groupby(["strategy", "joint"])["seconds"].mean().groupby("strategy").sum() / 60
    rows = []
    for strategy in dict.fromkeys(accuracy["strategy"]):
        own = accuracy[accuracy["strategy"] == strategy]
        cells = []
        for scenario in study.scenarios:
            there = own[(own["scenario"] == scenario) & own["upper"].notna()]
            worst = there.loc[there["upper"].idxmax()] if len(there) else None
            cells.append(
                MISSING
                if worst is None
                else f"{format_percent(worst['upper'], with_unit=False)} ({int(worst['joint'])})"
            )
        rows.append((str(strategy), f"{minutes[strategy]:.0f}", *cells))
    columns = (
        Column("strategy", text=True),
        Column("time", "min"),
        *(Column(scenario, "% (joint)") for scenario in study.scenarios),
    )
    note = "Upper end of the rms error's 95 % interval, of the joint with the largest. Time of all joints."
    return Table("Largest error by scenario", columns, tuple(rows), note=note)


def describe_study_joint(study: SimulationStudy, joint: int) -> str:
    """Which strategies are accurate enough for the lab, in a few sentences."""
    (table, accurate), limit = _sufficient(study, joint), study.plan.good_enough
    first, strategies = study.scenarios[0], study.strategies(joint)
    in_all = [name for name in accurate[first] if all(name in names for names in accurate.values())]
    in_none = [name for name in strategies if not any(name in names for names in accurate.values())]
    scenarios = f"{'all ' * (len(accurate) > 1)}{pluralize(len(accurate), 'scenario')}"
    sentences = [f"Within {100 * limit:g} % rms in {scenarios}: {'; '.join(in_all) or 'none'}."]
    if in_all:
        minutes = float(table.loc[table["strategy"] == in_all[0], "seconds"].mean()) / 60
        sentences.append(f"The cheapest, {in_all[0]}, takes {minutes:.0f} min a session.")
    if in_none:
        sentences.append(f"In none: {'; '.join(in_none)}.")
    for scenario, names in accurate.items():
        insufficient = [name for name in strategies if name not in names and name not in in_none]
        if not names:
            own = table[table["scenario"] == scenario]
            best = own.loc[own["rms_relative"].idxmin()]
            error = format_value(best["rms_relative"], "%", 2)
            sentences.append(f"With {scenario}, the least wrong is {best['strategy']} ({error}).")
        elif insufficient:
            sentences.append(f"Lost to {scenario}: {'; '.join(insufficient)}.")
    return " ".join([*sentences, *_describe_undercoverage(table, study)])


def _describe_undercoverage(table: pd.DataFrame, study: SimulationStudy) -> list[str]:
    """Scenarios with too low a coverage, by the strategies whose coverage is right without causes."""
    coverage = table.pivot(index="strategy", columns="scenario", values="covered")
    without_causes = [scenario.name for scenario in study.plan.scenarios if not scenario.causes]
    lowest = coverage[(coverage[without_causes] >= MIN_COVERAGE).all(axis=1)].min()
    low = [
        f"{scenario} (down to {format_value(lowest[scenario], '%', 0)})"
        for scenario in study.scenarios
        if lowest[scenario] < MIN_COVERAGE
    ]
    return [f"Stated 95 % intervals hold the truth too rarely with {'; '.join(low)}."] if low else []
