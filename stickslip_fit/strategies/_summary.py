"""A Comparison as text: for each joint the best strategy, the cheapest one as good, and the tables."""

from __future__ import annotations

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


def compare_with_best(found: Comparison, joint: int) -> tuple[str, pd.DataFrame]:
    """The strategy with the least relative rms, and every other's pair with it.

    The p-values are adjusted for all pairs, so that choosing the best afterwards is allowed for.

    Returns
    -------
    best : str
    others : DataFrame
        Rows of `Comparison.pairs` turned so that `other` is the best.
    """
    accuracy = found.accuracy()
    subset = accuracy[accuracy["joint"] == joint]
    best = str(subset.loc[subset["rms_relative"].idxmin(), "strategy"])
    if found.pairs.empty:
        return best, found.pairs
    pairs = found.pairs[found.pairs["joint"] == joint]
    straight, turned = pairs[pairs["other"] == best], _reverse_pairs(pairs[pairs["strategy"] == best])
    both = pd.concat([straight, turned])
    order = {name: place for place, name in enumerate(found.strategies)}
    return best, both.sort_values("strategy", key=lambda names: names.map(order)).reset_index(drop=True)


def write_headline(found: Comparison, joint: int) -> str:
    """The answer in a few sentences."""
    best, others = compare_with_best(found, joint)
    shared, sessions = found.shared, found.sessions(joint)
    traverses = shared.loc[shared["joint"] == joint, "traverse"].nunique()
    where = f"{len(sessions)} sessions" if len(sessions) > 1 else f"the one session {sessions[0]}"
    noise = _describe_repeatability(found, joint)
    told = [f"Traverses predicted: {traverses:,}, of {where}; they repeat to {' and '.join(noise)}."]
    if found.unit(joint) != SESSION_UNIT:
        told.append(
            "Intervals and verdicts are over its configurations, since there is one session: they say "
            "nothing of how another session's calibration would turn out."
        )
    elif len(sessions) <= FEW_SESSIONS:
        pairs = int((found.pairs["joint"] == joint).sum()) if len(found.pairs) else 0
        told.append(
            f"So few sessions show only large differences{_describe_multiplicity(pairs)}; the intervals of single "
            "differences show more."
        )
    told.append(f"Least rms: {best}, {_minutes(found, joint)[best]:.0f} min a session.")
    if len(others):
        alike = int((others["verdict"] == INDISTINGUISHABLE).sum())
        whole = {0: "None of", len(others): "All of"}.get(alike, f"{alike} of")
        told.append(f"{whole} the {len(others)} others cannot be told from it on this log.")
        told.append(_describe_cheapest(found, joint, best, others))
    return " ".join(told)


def _describe_multiplicity(pairs: int) -> str:
    return f" where {pairs} pairs are compared at once" if pairs > 1 else ""


def _describe_cheapest(found: Comparison, joint: int, best: str, others: pd.DataFrame) -> str:
    """That no difference was seen proves no equality; an interval that stays below the scatter does."""
    scatter = min(value for (of, _), value in found.repeatability.items() if of == joint)
    good = [best, *others.loc[others["difference_relative_high"] < scatter, "strategy"]]
    minutes = _minutes(found, joint)
    cheapest = min(good, key=lambda name: float(minutes[name]))
    if cheapest == best:
        return "No cheaper one is sure to come within a traverse's scatter of it."
    high = float(others.set_index("strategy").loc[cheapest, "difference_relative_high"])
    return (
        f"The cheapest that is sure to come within a traverse's scatter of it: {cheapest}, "
        f"{minutes[cheapest]:.0f} min, at most {format_value(max(high, 0.0), '%', 2)} of a step more (95 %)."
    )


def _minutes(found: Comparison, joint: int) -> pd.Series:
    cost = found.cost()
    return cost[cost["joint"] == joint].set_index("strategy")["seconds"] / 60


def _reverse_pairs(pairs: pd.DataFrame) -> pd.DataFrame:
    names = {"strategy": "other", "other": "strategy"}
    for name in DIFFERENCE_COLUMNS:
        names |= {f"{name}_low": f"{name}_high", f"{name}_high": f"{name}_low"}
    turned = pairs.rename(columns=names)
    signed = [column for column in turned if str(column).startswith("difference")]
    return turned.assign(
        **{column: -turned[column] for column in signed}, verdict=turned["verdict"].map(REVERSED_VERDICTS)
    )


def _describe_repeatability(found: Comparison, joint: int) -> list[str]:
    return [
        f"{format_value(value, '%', 2)} ({direction})"
        for (of, direction), value in found.repeatability.items()
        if of == joint
    ]


NOTE = "p and verdicts allow for all pairs of strategies being compared at once (Holm); intervals do not."
WORST_NOTE = (
    "Rms over the traverses of a configuration and direction, all sessions; the largest relative ones are "
    "shown. Times scatter: over how well a traverse repeats in that direction. Among many configurations the "
    "largest comes to about 2 by chance, and to more where a calibration is itself not sure."
)
MAX_WORST = 2


@summarize.register
def summarize_comparison(found: Comparison) -> Summary:
    """Each joint's answer, then its strategies' cost and errors, and what was left out."""
    sections = [Section(paragraphs=(typeset_text(format_heading(found)),))] if found.joints else []
    for joint in found.joints:
        tables = (
            strategies_table(found, joint),
            errors_table(found, joint),
            _directions_table(found, joint),
            worst_table(found, joint),
            implied_table(found, joint),
            claimed_table(found, joint),
        )
        sections.append(Section(capitalize_first(joint_name(joint)), tables=tuple(filter(None, tables))))
    missing = left_out_table(found)
    answers = [f"Joint {joint}. {write_headline(found, joint)}" for joint in found.joints]
    return Summary(
        "Calibration strategies compared",
        tuple(typeset_text(each).replace("(-)", f"({MINUS})") for each in answers)
        or (typeset_text(format_heading(found)),),
        (*sections, *([Section(tables=(missing,))] if missing else [])),
        provenance=found.provenance.lines(),
    )


def format_heading(found: Comparison) -> str:
    """What was compared, and how."""
    files = ", ".join(found.provenance.log_files) or "a log"
    said = (
        f"{len(found.strategies)} calibration strategies on {files}. Each calibrates a session from its own "
        f"traverses only, and may look back on {found.session_scope}. Errors are predicted less measured mean "
        "step size, of traverses that none of them calibrates from; a traverse costs "
        f"{found.handling_seconds:.0f} s beside its steps. Intervals are made to hold 95 % under scatter with heavy "
        "tails too, so that they are wide where it is Gaussian."
    )
    return said if found.joints else f"{said} No session is left in which they can be compared."


def strategies_table(found: Comparison, joint: int) -> Table:
    """One joint's strategies: cost, relative errors, and what is seen of a difference from the best."""
    best, others = compare_with_best(found, joint)
    pairs = others.set_index("strategy") if len(others) else pd.DataFrame()
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
            *(("", "", "least rms") if row["strategy"] == best else _against(pairs.loc[row["strategy"]])),
        )
        for _, row in _with_cost(found, joint).iterrows()
    )
    return Table(f"Strategies for {joint_name(joint)}", columns, rows, note=NOTE)


def errors_table(found: Comparison, joint: int) -> Table:
    """One joint's absolute errors."""
    unit = step_unit(joint)
    heads = ("rms", "95 % interval", "bias", "95 % interval", "worst", "typical worst")
    columns = (Column("strategy", text=True), *(Column(head, unit) for head in heads))
    rows = tuple(
        (
            str(row["strategy"]),
            format_number(row["rms"], unit),
            format_range(row["rms_low"], row["rms_high"], unit),
            format_number(row["bias"], unit),
            format_range(row["bias_low"], row["bias_high"], unit),
            format_number(row["worst"], unit),
            format_number(row["typical_worst"], unit),
        )
        for _, row in _with_cost(found, joint).iterrows()
    )
    caption = f"{capitalize_first(joint_name(joint))}: errors of the step size"
    return Table(caption, columns, rows, folded=True)


def _with_cost(found: Comparison, joint: int) -> pd.DataFrame:
    cost = found.cost()
    return _rows_of_joint(found.accuracy(), joint).merge(
        _rows_of_joint(cost, joint), on="strategy", suffixes=("", "_made")
    )


def _rows_of_joint(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    return table[table["joint"] == joint]


def _against(pair: pd.Series) -> tuple[str, str, str]:
    bounds = format_percent_range(pair["difference_relative_low"], pair["difference_relative_high"])
    verdict = str(pair["verdict"]).removesuffix(" on this log")
    return bounds, format_p_value(pair["p_adjusted"]), verdict


def _directions_table(found: Comparison, joint: int) -> Table | None:
    """Relative rms by direction; None where there is one only."""
    table = _rows_of_joint(found.accuracy("direction"), joint)
    directions = list(dict.fromkeys(table["direction"]))
    if len(directions) < 2:
        return None
    signs = [format_direction(direction) for direction in directions]
    heads = [Column(head, "%", f"direction {sign}") for sign in signs for head in ("rms", "95 % interval")]
    body = []
    for strategy, own in table.groupby("strategy", sort=False):
        cells = []
        for _, row in own.set_index("direction").loc[directions].iterrows():
            cells.append(format_percent(row["rms_relative"], with_unit=False))
            cells.append(format_percent_range(row["rms_relative_low"], row["rms_relative_high"]))
        body.append((str(strategy), *cells))
    caption = f"{capitalize_first(joint_name(joint))}: relative error by direction"
    return Table(caption, (Column("strategy", text=True), *heads), tuple(body), folded=True)


def worst_table(found: Comparison, joint: int, most: int = MAX_WORST) -> Table:
    """The configurations in which each strategy errs most, as shares of the step size.

    Parameters
    ----------
    found : Comparison
    joint : int
    most : int, optional
        Configurations shown of each strategy.
    """
    table, unit = worst_configurations(found, joint), step_unit(joint)
    columns = (
        *words("strategy", "configuration", "direction"),
        Column("traverses"),
        *numbers("rms", "bias", unit=unit),
        *numbers("rms", "worst", unit="%"),
        Column("times scatter"),
    )
    low, high = found.machine.ranges[joint]
    body = tuple(
        (
            strategy,
            format_configuration(row, high - low),
            format_direction(str(row["direction"])),
            f"{int(row['traverses']):,}",
            format_number(row["rms"], unit),
            format_number(row["bias"], unit),
            format_percent(row["rms_relative"], with_unit=False),
            format_percent(row["worst_relative"], with_unit=False),
            f"{row['times_scatter']:.1f}",
        )
        for strategy in found.compared(joint)
        for _, row in table[table["strategy"] == strategy].head(most).iterrows()
    )
    caption = f"{capitalize_first(joint_name(joint))}: where each strategy errs most"
    return Table(caption, columns, body, note=WORST_NOTE, folded=True)


def worst_configurations(found: Comparison, joint: int) -> pd.DataFrame:
    """Errors by strategy, direction and configuration, each strategy's largest relative rms first.

    Returns
    -------
    DataFrame
        As `Comparison.accuracy` returns it, and times_scatter: the relative rms over the repeatability.
    """
    table = _rows_of_joint(found.accuracy("direction", *POSITION_COLUMNS), joint)
    scatter = [found.repeatability[joint, str(direction)] for direction in table["direction"]]
    table = table.assign(times_scatter=table["rms_relative"] / scatter)
    return table.sort_values("rms_relative", ascending=False, kind="stable")


def left_out_table(found: Comparison) -> Table | None:
    """Sessions that a strategy could not calibrate, and why, alike cases together; None if there is none."""
    joints_of: dict[tuple[str, str, str, str], list[str]] = {}
    keys = ["strategy", "reason", "joint"]
    for (strategy, reason, joint), cases in found.left_out.groupby(keys, sort=False):
        directions = dict.fromkeys(cases["direction"])
        signs = " and ".join(format_direction(each) for each in directions if each) or MISSING
        sessions = ", ".join(dict.fromkeys(cases["session"]))
        joints_of.setdefault((strategy or "all strategies", signs, sessions, reason), []).append(str(joint))
    rows = tuple(
        (strategy, ", ".join(joints), signs, sessions, typeset_text(reason))
        for (strategy, signs, sessions, reason), joints in joints_of.items()
    )
    columns = tuple(Column(head, text=True) for head in ("strategy", "joint", "direction", "session", "why"))
    return Table("Left out", columns, rows) if rows else None
