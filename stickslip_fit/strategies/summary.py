"""What a comparison says: each joint's answer, what its strategies cost and reach, and where they fail."""

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
    joint_name,
    step_unit,
    typeset,
)
from stickslip_fit._summary import Column, Section, Summary, Table, numbers, summarize, words
from stickslip_fit.strategies.claims import claimed_table, implied_table
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.trials import WHERE
from stickslip_fit.strategies.verdict import against_best, answer

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
    sections = [Section(paragraphs=(typeset(heading(found)),))] if found.joints else []
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
    answers = [f"Joint {joint}. {answer(found, joint)}" for joint in found.joints]
    return Summary(
        "Calibration strategies compared",
        tuple(typeset(each).replace("(-)", f"({MINUS})") for each in answers) or (typeset(heading(found)),),
        (*sections, *([Section(tables=(missing,))] if missing else [])),
        provenance=found.provenance.lines(),
    )


def heading(found: Comparison) -> str:
    """What was compared, and how."""
    files = ", ".join(found.provenance.log_files) or "a log"
    said = (
        f"{len(found.strategies)} calibration strategies on {files}. Each calibrates a session from its own "
        f"traverses only, and may look back on {found.looks_back}. Errors are predicted less measured mean "
        "step size, of traverses that none of them calibrates from; a traverse costs "
        f"{found.handling:.0f} s beside its steps. Intervals are made to hold 95 % under scatter with heavy "
        "tails too, so that they are wide where it is Gaussian."
    )
    return said if found.joints else f"{said} No session is left in which they can be compared."


def strategies_table(found: Comparison, joint: int) -> Table:
    """One joint's strategies: cost, relative errors, and what is seen of a difference from the best."""
    best, others = against_best(found, joint)
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
    return _of(found.accuracy(), joint).merge(_of(cost, joint), on="strategy", suffixes=("", "_made"))


def _of(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    return table[table["joint"] == joint]


def _against(pair: pd.Series) -> tuple[str, str, str]:
    bounds = format_percent_range(pair["difference_relative_low"], pair["difference_relative_high"])
    verdict = str(pair["verdict"]).removesuffix(" on this log")
    return bounds, format_p_value(pair["p_adjusted"]), verdict


def _directions_table(found: Comparison, joint: int) -> Table | None:
    """Relative rms by direction; None where there is one only."""
    table = _of(found.accuracy("direction"), joint)
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
    table = _of(found.accuracy("direction", *WHERE), joint)
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
        (strategy, ", ".join(joints), signs, sessions, typeset(reason))
        for (strategy, signs, sessions, reason), joints in joints_of.items()
    )
    columns = tuple(Column(head, text=True) for head in ("strategy", "joint", "direction", "session", "why"))
    return Table("Left out", columns, rows) if rows else None
