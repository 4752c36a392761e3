"""What a comparison says of a joint: which strategy is best, and how cheaply one that is as good is had."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import format_value
from stickslip_fit.strategies.accuracy import SESSIONS
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.paired import BETTER, INDISTINGUISHABLE, WORSE

TURNED = {BETTER: WORSE, WORSE: BETTER, INDISTINGUISHABLE: INDISTINGUISHABLE}
FEW = 3
DIFFERENCE = ("difference", "difference_relative")


def against_best(found: Comparison, joint: int) -> tuple[str, pd.DataFrame]:
    """The strategy with the least relative rms, and every other's pair with it.

    The p-values are adjusted for all pairs, so that choosing the best afterwards is allowed for.

    Returns
    -------
    best : str
    others : DataFrame
        Rows of `Comparison.pairs` turned so that `other` is the best.
    """
    accuracy = found.accuracy()
    mine = accuracy[accuracy["joint"] == joint]
    best = str(mine.loc[mine["rms_relative"].idxmin(), "strategy"])
    if found.pairs.empty:
        return best, found.pairs
    pairs = found.pairs[found.pairs["joint"] == joint]
    straight, turned = pairs[pairs["other"] == best], _turned(pairs[pairs["strategy"] == best])
    both = pd.concat([straight, turned])
    order = {name: place for place, name in enumerate(found.strategies)}
    return best, both.sort_values("strategy", key=lambda names: names.map(order)).reset_index(drop=True)


def answer(found: Comparison, joint: int) -> str:
    """The answer in a few sentences."""
    best, others = against_best(found, joint)
    shared, sessions = found.shared, found.sessions(joint)
    traverses = shared.loc[shared["joint"] == joint, "traverse"].nunique()
    where = f"{len(sessions)} sessions" if len(sessions) > 1 else f"the one session {sessions[0]}"
    noise = _noise(found, joint)
    told = [f"Traverses predicted: {traverses:,}, of {where}; they repeat to {' and '.join(noise)}."]
    if found.unit(joint) != SESSIONS:
        told.append(
            "Intervals and verdicts are over its configurations, since there is one session: they say "
            "nothing of how another session's calibration would turn out."
        )
    elif len(sessions) <= FEW:
        pairs = int((found.pairs["joint"] == joint).sum()) if len(found.pairs) else 0
        told.append(
            f"So few sessions show only large differences{_at_once(pairs)}; the intervals of single "
            "differences show more."
        )
    told.append(f"Least rms: {best}, {_minutes(found, joint)[best]:.0f} min a session.")
    if len(others):
        alike = int((others["verdict"] == INDISTINGUISHABLE).sum())
        whole = {0: "None of", len(others): "All of"}.get(alike, f"{alike} of")
        told.append(f"{whole} the {len(others)} others cannot be told from it on this log.")
        told.append(_cheapest(found, joint, best, others))
    return " ".join(told)


def _at_once(pairs: int) -> str:
    return f" where {pairs} pairs are compared at once" if pairs > 1 else ""


def _cheapest(found: Comparison, joint: int, best: str, others: pd.DataFrame) -> str:
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


def _turned(pairs: pd.DataFrame) -> pd.DataFrame:
    names = {"strategy": "other", "other": "strategy"}
    for name in DIFFERENCE:
        names |= {f"{name}_low": f"{name}_high", f"{name}_high": f"{name}_low"}
    turned = pairs.rename(columns=names)
    signed = [column for column in turned if str(column).startswith("difference")]
    return turned.assign(
        **{column: -turned[column] for column in signed}, verdict=turned["verdict"].map(TURNED)
    )


def _noise(found: Comparison, joint: int) -> list[str]:
    return [
        f"{format_value(value, '%', 2)} ({way})"
        for (of, way), value in found.repeatability.items()
        if of == joint
    ]
