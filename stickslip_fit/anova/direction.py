"""Direction: does the step size depend on which way the joint is driven (thesis Section 4.4)."""

from __future__ import annotations

import pandas as pd

from stickslip_fit.anova.day import POSITIONS
from stickslip_fit.anova.question import Choose, Question, Refusal
from stickslip_fit.anova.readings import HELD, describe
from stickslip_fit.anova.within import within_sessions


def direction(rows: pd.DataFrame, span: float, choose: Choose) -> list[Question | Refusal]:
    """Direction + against -, at one configuration; parameters as of `day.day`."""
    joint = int(rows["joint"].iloc[0])
    driven = rows["direction"].unique()
    if len(driven) < 2:
        reason = f"joint {joint} was driven in direction {driven[0]} only"
        return [Refusal("direction", joint, None, None, None, reason)]
    return [
        asked
        for here in choose(rows, HELD)
        for asked in within_sessions(
            "direction",
            "direction",
            here.assign(level=here["direction"]),
            None,
            describe(here.iloc[0], span, POSITIONS),
        )
    ]
