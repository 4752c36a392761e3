"""What a study says of a joint: which strategies stay good enough when something is hidden."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit.strategies.study.study import Study

HONEST = 0.9  # share of 95 % intervals that hold the truth, below which nobody should believe them


def answer(found: Study, joint: int) -> str:
    """What a lab can act on, in a few sentences."""
    table, limit = of_joint(found.accuracy(), joint), found.plan.good_enough
    good = {scenario: survivors(table, scenario, limit) for scenario in found.scenarios}
    lasting = [name for name in good[found.scenarios[0]] if all(name in own for own in good.values())]
    count = len(found.scenarios)
    never = [name for name in found.strategies(joint) if not any(name in own for own in good.values())]
    whatever = f" in {'all ' * (count > 1)}{count} scenario{'s' * (count > 1)}"
    told = [f"Within {100 * limit:g} % rms{whatever}: {_listed(lasting) or 'none'}."]
    if lasting:
        told.append(f"The cheapest, {lasting[0]}, takes {minutes(table, lasting[0]):.0f} min a session.")
    if never:
        told.append(f"In none: {_listed(never)}.")
    for scenario, own in good.items():
        lost = [name for name in found.strategies(joint) if name not in own and name not in never]
        if not own:
            told.append(f"With {scenario}, the least wrong is {_least_wrong(table, scenario)}.")
        elif lost:
            told.append(f"Lost to {scenario}: {_listed(lost)}.")
    return " ".join([*told, *_doubted(table, found)])


def survivors(table: pd.DataFrame, scenario: str, good_enough: float) -> list[str]:
    """Strategies of a joint whose rms error is sure to be good enough, the cheapest first."""
    mine = table[table["scenario"] == scenario].sort_values("seconds", kind="stable")
    # One campaign has no interval.
    high = mine["rms_relative_high"].fillna(mine["rms_relative"])
    return list(mine.loc[high <= good_enough, "strategy"])


def of_joint(table: pd.DataFrame, joint: int) -> pd.DataFrame:
    """The rows of a joint."""
    return table[table["joint"] == joint]


def minutes(table: pd.DataFrame, strategy: str) -> float:
    """What a strategy's calibration of a session takes, over all scenarios."""
    return float(table.loc[table["strategy"] == strategy, "seconds"].mean()) / 60


def _least_wrong(table: pd.DataFrame, scenario: str) -> str:
    mine = table[table["scenario"] == scenario]
    best = mine.loc[mine["rms_relative"].idxmin()]
    return f"{best['strategy']} ({format_value(best['rms_relative'], '%', 2)})"


def _doubted(table: pd.DataFrame, found: Study) -> list[str]:
    """Where intervals cannot be believed any more that could while nothing was hidden."""
    by = table.pivot(index="strategy", columns="scenario", values="covered")
    plain = [scenario.name for scenario in found.plan.scenarios if not scenario.causes]
    honest = by[(by[plain] >= HONEST).all(axis=1)] if plain else by
    lowest = honest.min()
    broken = [
        f"{scenario} (down to {format_value(lowest[scenario], '%', 0)})"
        for scenario in found.scenarios
        if lowest[scenario] < HONEST
    ]
    if not broken:
        return []
    return [f"Stated 95 % intervals hold the truth too rarely with {_listed(broken)}."]


def _listed(names: Sequence[str]) -> str:
    return "; ".join(names)
