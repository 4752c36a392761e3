"""A Comparison as text: for each joint the best strategy, the cheapest one as good, and the tables."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from stickslip_fit._format import (
    MINUS,
    MISSING,
    capitalize_first,
    format_configuration,
    format_direction,
    format_number,
    format_p_value,
    format_percent,
    format_percent_range,
    format_range,
    format_value,
    joint_name,
    step_unit,
    typeset_text,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.strategies.claims import claimed_table, implied_table
from stickslip_fit.strategies.compare import Comparison
from stickslip_fit.strategies.evaluation import POSITION_COLUMNS
from stickslip_fit.strategies.statistics import BETTER, INDISTINGUISHABLE, SESSION_UNIT, WORSE

REVERSED_VERDICTS = {BETTER: WORSE, WORSE: BETTER, INDISTINGUISHABLE: INDISTINGUISHABLE}
FEW_SESSIONS = 3
DIFFERENCE_COLUMNS = ("difference", "difference_relative")


def compare_with_best(comparison: Comparison, joint: int) -> tuple[str, pd.DataFrame]:
    """The strategy with the least relative rms, and its pair with every other strategy.

    The pairs are rows of `Comparison.pairs`, reversed where needed so that `other` is the best. Their
    p-values are adjusted for all pairs, so that they stay valid for the best, which the data choose.
    """
    subset = _rows_of_joint(comparison.accuracy(), joint)
    best = str(subset.loc[subset["rms_relative"].idxmin(), "strategy"])
    if comparison.pairs.empty:
        return best, comparison.pairs
    pairs = comparison.pairs[comparison.pairs["joint"] == joint]
    straight, reversed_pairs = pairs[pairs["other"] == best], _reverse_pairs(pairs[pairs["strategy"] == best])
    both = pd.concat([straight, reversed_pairs])
    order = {name: place for place, name in enumerate(comparison.strategies)}
    return best, both.sort_values("strategy", key=lambda names: names.map(order)).reset_index(drop=True)


@dataclass(frozen=True, eq=False)
class JointStrategies:
    """What the comparison says of one joint, each part computed once.

    `minutes` and `errors` (relative rms) are by strategy; `others` are pairs with the best.
    """

    comparison: Comparison
    joint: int

    @cached_property
    def best(self) -> str:
        return self._with_best[0]

    @cached_property
    def others(self) -> pd.DataFrame:
        return self._with_best[1]

    @cached_property
    def _with_best(self) -> tuple[str, pd.DataFrame]:
        return compare_with_best(self.comparison, self.joint)

    @cached_property
    def minutes(self) -> pd.Series:
        return _rows_of_joint(self.comparison.cost(), self.joint).set_index("strategy")["seconds"] / 60

    @cached_property
    def errors(self) -> pd.Series:
        return _rows_of_joint(self.comparison.accuracy(), self.joint).set_index("strategy")["rms_relative"]

    @property
    def scatter(self) -> dict[str, float]:
        """The replicate scatter of a traverse in each direction."""
        known = self.comparison.repeatability.items()
        return {direction: value for (of, direction), value in known if of == self.joint}

    @cached_property
    def cheapest(self) -> str:
        """The cheapest strategy whose difference from the best is below the scatter in its whole interval."""
        is_equal = self.others["difference_relative_high"] < min(self.scatter.values())
        equivalent = [self.best, *self.others.loc[is_equal, "strategy"]]
        return min(equivalent, key=lambda name: float(self.minutes[name]))


def write_headline(own: JointStrategies) -> str:
    """The strategy with the least error, and the cheapest one that is sure to be as good."""
    best, minutes = own.best, own.minutes
    error = format_percent(own.errors[best])
    text = f"least error by {best} ({error} rms, {minutes[best]:.0f} min a session)"
    caution = ""
    if own.comparison.unit(own.joint) != SESSION_UNIT:
        caution = " Intervals are over its configurations, since there is one session."
    if not len(own.others):
        return f"{text}.{caution}"
    cheapest, scatter = own.cheapest, format_percent(min(own.scatter.values()))
    if cheapest == best:
        return f"{text}; no cheaper one is sure to come within a traverse's scatter ({scatter}).{caution}"
    return (
        f"{text}; cheapest that is sure to come within a traverse's scatter ({scatter}) of it: "
        f"{cheapest} ({minutes[cheapest]:.0f} min).{caution}"
    )


def describe_joint(own: JointStrategies) -> str:
    """What was predicted, what limits the comparison, and its answer in a few sentences."""
    comparison, joint, best, others = own.comparison, own.joint, own.best, own.others
    shared, sessions = comparison.shared, comparison.sessions(joint)
    traverses = shared.loc[shared["joint"] == joint, "traverse"].nunique()
    whose = f"{len(sessions)} sessions" if len(sessions) > 1 else f"the one session {sessions[0]}"
    repeat = " and ".join(
        f"{format_value(value, '%', 2)} ({direction})" for direction, value in own.scatter.items()
    )
    sentences = [f"Traverses predicted: {traverses:,}, of {whose}; they scatter by {repeat}."]
    if comparison.unit(joint) != SESSION_UNIT:
        sentences.append(
            "Intervals and verdicts are over its configurations, since there is one session: they say "
            "nothing of how another session's calibration would turn out."
        )
    elif len(sessions) <= FEW_SESSIONS:
        pairs = int((comparison.pairs["joint"] == joint).sum()) if len(comparison.pairs) else 0
        multiplicity = f" where {pairs} pairs are compared at once" if pairs > 1 else ""
        sentences.append(
            f"So few sessions show only large differences{multiplicity}; the intervals of single "
            "differences show more."
        )
    sentences.append(f"Least rms: {best}, {own.minutes[best]:.0f} min a session.")
    if len(others):
        n_alike = int((others["verdict"] == INDISTINGUISHABLE).sum())
        told = "cannot" if n_alike else "can"
        share = "All of" if n_alike in (0, len(others)) else f"{n_alike} of"
        sentences.append(f"{share} the {len(others)} others {told} be told from it on this log.")
        sentences.append(_describe_cheapest(own))
    return " ".join(sentences)


def _describe_cheapest(own: JointStrategies) -> str:
    cheapest = own.cheapest
    if cheapest == own.best:
        return "No cheaper one is sure to come within a traverse's scatter of it."
    high = float(own.others.set_index("strategy").loc[cheapest, "difference_relative_high"])
    return (
        f"The cheapest that is sure to come within a traverse's scatter of it: {cheapest}, "
        f"{own.minutes[cheapest]:.0f} min, at most {format_value(max(high, 0.0), '%', 2)} of "
        "a step more (95 %)."
    )


SHORT_VERDICTS = {BETTER: "better", WORSE: "worse", INDISTINGUISHABLE: "cannot tell"}


def overview_table(joints: Sequence[JointStrategies]) -> Table:
    """Time and error of every strategy, joint beside joint."""
    cells: dict[str, list[str]] = {name: [] for name in joints[0].comparison.strategies}
    columns = [Column("strategy", text=True)]
    for own in joints:
        others, minutes, errors = own.others, own.minutes, own.errors
        verdicts = {} if others.empty else dict(zip(others["strategy"], others["verdict"], strict=True))
        group = f"joint {own.joint}"
        columns += [
            Column("time", "min", group),
            Column("rms", "%", group),
            Column("verdict", "", group, text=True),
        ]
        for name, row in cells.items():
            if name in errors:
                verdict = "best" if name == own.best else SHORT_VERDICTS.get(verdicts.get(name, ""), "")
                row += [f"{minutes[name]:.0f}", format_percent(errors[name], with_unit=False), verdict]
            else:
                row += [MISSING, MISSING, "left out"]
    rows = tuple((name, *row) for name, row in cells.items())
    note = (
        "Time: for each session. Rms of errors on held-out traverses. Cannot tell: where all pairs are "
        "compared at once, this log does not show whether it or the best errs less."
    )
    if any("left out" in row for row in rows):
        note += " Left out: the table of that name says why."
    return Table("Strategies", tuple(columns), rows, note=note)


def _reverse_pairs(pairs: pd.DataFrame) -> pd.DataFrame:
    names = {"strategy": "other", "other": "strategy"}
    for name in DIFFERENCE_COLUMNS:
        names |= {f"{name}_low": f"{name}_high", f"{name}_high": f"{name}_low"}
    reversed_pairs = pairs.rename(columns=names)
    signed = [column for column in reversed_pairs if str(column).startswith("difference")]
    return reversed_pairs.assign(
        **{column: -reversed_pairs[column] for column in signed},
        verdict=reversed_pairs["verdict"].map(REVERSED_VERDICTS),
    )


NOTE = "p and verdicts allow for all pairs of strategies being compared at once (Holm); intervals do not."
WORST_NOTE = (
    "Rms over the traverses of a configuration and direction, all sessions; the largest relative ones are "
    "shown. Times scatter: over the replicate scatter in that direction. Among many configurations "
    "the largest comes to about 2 by chance, and to more where a calibration is itself uncertain."
)
MAX_WORST = 2


def _claims(comparison: Comparison, joint: int) -> tuple[Table, ...]:
    """The thesis's claims, where the joint has the law that they are about."""
    if joint not in comparison.published_joints:
        return ()
    return implied_table(comparison, joint), claimed_table(comparison, joint)


@summarize.register
def summarize_comparison(comparison: Comparison) -> Summary:
    """Each joint's answer, all strategies in one table, then each joint's, and what was left out."""
    heading = typeset_text(format_heading(comparison))
    joints = [JointStrategies(comparison, joint) for joint in comparison.joints]
    sections = [Section(tables=(overview_table(joints),))] if joints else []
    sections += [Section("How they are compared", (heading,))] if joints else []
    for own in joints:
        joint = own.joint
        tables = (
            strategies_table(own),
            errors_table(comparison, joint),
            _directions_table(comparison, joint),
            worst_table(comparison, joint),
            *_claims(comparison, joint),
        )
        title = capitalize_first(joint_name(joint, comparison.machine))
        answer = typeset_text(describe_joint(own)).replace("(-)", f"({MINUS})")
        sections.append(Section(title, (answer,), tuple(filter(None, tables))))
    missing = left_out_table(comparison)
    answers = [f"Joint {own.joint}: {write_headline(own)}" for own in joints]
    return Summary(
        "Calibration strategies compared",
        tuple(map(typeset_text, answers)) or (heading,),
        (*sections, *([Section("Sessions without a calibration", tables=(missing,))] if missing else [])),
        provenance=comparison.provenance.lines(),
    )


def format_heading(comparison: Comparison) -> str:
    """What was compared, and how."""
    files = ", ".join(comparison.provenance.log_files) or "a log"
    text = (
        f"{len(comparison.strategies)} calibration strategies on {files}. Each calibrates a session from its "
        f"own traverses only, and may look back on {comparison.session_scope}. Errors are predicted less "
        "measured mean step size, of traverses that none of them calibrates from; a traverse costs "
        f"{comparison.handling_seconds:.0f} s beside its steps. Intervals are made to hold 95 % under "
        "scatter with heavy tails too, so that they are wide where it is Gaussian."
    )
    return text if comparison.joints else f"{text} No session is left in which they can be compared."


def strategies_table(own: JointStrategies) -> Table:
    """One joint's strategies: cost, relative errors, and what is seen of a difference from the best."""
    comparison, joint = own.comparison, own.joint
    differences = {
        pair["strategy"]: (
            format_percent_range(pair["difference_relative_low"], pair["difference_relative_high"]),
            format_p_value(pair["p_adjusted"]),
            str(pair["verdict"]).removesuffix(" on this log"),
        )
        for pair in own.others.to_dict("records")
    }
    columns = (
        Column("strategy", text=True),
        Column("each way", "traverses", "a session"),
        Column("time", "min", "a session"),
        *numbers("rms", "95 % interval", "worst", unit="%", group="relative error"),
        Column("95 % interval", "%", "less the best's"),
        Column("p", group="less the best's"),
        Column("verdict", text=True),
    )
    rows = tuple(
        (
            str(row["strategy"]),
            f"{row['traverses_made']:.3g}",
            f"{row['seconds'] / 60:.0f}",
            format_percent(row["rms_relative"], with_unit=False),
            format_percent_range(row["rms_relative_low"], row["rms_relative_high"]),
            format_percent(row["worst_relative"], with_unit=False),
            *differences.get(row["strategy"], ("", "", "least rms")),
        )
        for row in _rows_of_joint(comparison.accuracy_and_cost(), joint).to_dict("records")
    )
    return Table(f"Strategies for {joint_name(joint, comparison.machine)}", columns, rows, note=NOTE)


def errors_table(comparison: Comparison, joint: int) -> Table:
    """One joint's absolute errors."""
    unit = step_unit(joint, comparison.machine)
    headings = ("rms", "95 % interval", "bias", "95 % interval", "worst", "typical worst")
    columns = (Column("strategy", text=True), *(Column(head, unit) for head in headings))
    rows = tuple(
        (
            str(row["strategy"]),
            *_with_interval(row, "rms", unit),
            *_with_interval(row, "bias", unit),
            *(format_number(row[name], unit) for name in ("worst", "typical_worst")),
        )
        for row in _rows_of_joint(comparison.accuracy(), joint).to_dict("records")
    )
    caption = f"{capitalize_first(joint_name(joint, comparison.machine))}: errors of the step size"
    return Table(caption, columns, rows, folded=True)


def _rows_of_joint(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    return table[table["joint"] == joint]


def _with_interval(row: Mapping[Hashable, Any], name: str, unit: str) -> tuple[str, str]:
    return format_number(row[name], unit), format_range(row[f"{name}_low"], row[f"{name}_high"], unit)


def _directions_table(comparison: Comparison, joint: int) -> Table | None:
    """Relative rms by direction; None where there is one only."""
    table = _rows_of_joint(comparison.accuracy("direction"), joint)
    directions = list(dict.fromkeys(table["direction"]))
    if len(directions) < 2:
        return None
    signs = [format_direction(direction) for direction in directions]
    headings = [Column(head, "%", f"direction {sign}") for sign in signs for head in ("rms", "95 % interval")]
    rows = {(row["strategy"], row["direction"]): row for row in table.to_dict("records")}
    body = []
    for strategy in dict.fromkeys(table["strategy"]):
        cells = []
        for row in (rows[strategy, direction] for direction in directions):
            cells.append(format_percent(row["rms_relative"], with_unit=False))
            cells.append(format_percent_range(row["rms_relative_low"], row["rms_relative_high"]))
        body.append((str(strategy), *cells))
    caption = f"{capitalize_first(joint_name(joint, comparison.machine))}: relative error by direction"
    return Table(caption, (Column("strategy", text=True), *headings), tuple(body), folded=True)


def worst_table(comparison: Comparison, joint: int) -> Table:
    """The configurations in which each strategy errs most, as shares of the step size."""
    table, unit = worst_configurations(comparison, joint), step_unit(joint, comparison.machine)
    columns = (
        *words("strategy", "configuration", "direction"),
        Column("traverses"),
        *numbers("rms", "bias", unit=unit),
        *numbers("rms", "worst", unit="%"),
        Column("times scatter"),
    )
    worst = table.groupby("strategy").head(MAX_WORST).to_dict("records")
    body = tuple(
        (
            strategy,
            format_configuration(row, comparison.machine),
            format_direction(str(row["direction"])),
            f"{int(row['traverses']):,}",
            format_number(row["rms"], unit),
            format_number(row["bias"], unit),
            format_percent(row["rms_relative"], with_unit=False),
            format_percent(row["worst_relative"], with_unit=False),
            f"{row['times_scatter']:.1f}",
        )
        for strategy in comparison.compared(joint)
        for row in worst
        if row["strategy"] == strategy
    )
    caption = f"{capitalize_first(joint_name(joint, comparison.machine))}: where each strategy errs most"
    return Table(caption, columns, body, note=WORST_NOTE, folded=True)


def worst_configurations(comparison: Comparison, joint: int) -> pd.DataFrame:
    """Errors by strategy, direction and configuration, the largest relative rms first.

    As `Comparison.accuracy` returns them, and times_scatter: the relative rms over the replicate scatter.
    """
    table = _rows_of_joint(comparison.accuracy("direction", *POSITION_COLUMNS), joint)
    scatter = [comparison.repeatability[joint, str(direction)] for direction in table["direction"]]
    table = table.assign(times_scatter=table["rms_relative"] / scatter)
    return table.sort_values("rms_relative", ascending=False, kind="stable")


def left_out_table(comparison: Comparison) -> Table | None:
    """Sessions that a strategy could not calibrate, and why, alike cases together; None if there is none."""
    joints_of: dict[tuple[str, str, str, str], list[str]] = {}
    keys = ["strategy", "reason", "joint"]
    for (strategy, reason, joint), cases in comparison.left_out.groupby(keys, sort=False):
        directions = dict.fromkeys(cases["direction"])
        signs = " and ".join(format_direction(sign) for sign in directions if sign) or MISSING
        sessions = ", ".join(dict.fromkeys(cases["session"]))
        joints_of.setdefault((strategy or "all strategies", signs, sessions, reason), []).append(str(joint))
    rows = tuple(
        (strategy, ", ".join(joints), signs, sessions, typeset_text(reason))
        for (strategy, signs, sessions, reason), joints in joints_of.items()
    )
    columns = tuple(Column(head, text=True) for head in ("strategy", "joint", "direction", "session", "why"))
    return Table("Left out", columns, rows) if rows else None
