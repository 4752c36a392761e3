"""Day: does the step size change from session to session (thesis Section 4.2)."""

from __future__ import annotations

import pandas as pd

from stickslip_fit.anova.question import READINGS, Choose, Question, Refusal
from stickslip_fit.anova.readings import HELD, describe

POSITIONS = ["q1", "q2", "q3", "theta", "psi"]


def day(rows: pd.DataFrame, span: float, choose: Choose) -> list[Question | Refusal]:
    """One question for each direction: sessions against readings within them, at one configuration.

    Parameters
    ----------
    rows : DataFrame
        Readings of one joint.
    span : float
        The joint's full travel, rad or m.
    choose : callable
        Picks the configurations.
    """
    return [
        _ask(here[here["direction"] == direction], direction, describe(here.iloc[0], span, POSITIONS))
        for here in choose(rows, HELD)
        for direction in ("+", "-")
        if (here["direction"] == direction).any()
    ]


def _ask(rows: pd.DataFrame, direction: str, configuration: str) -> Question | Refusal:
    joint = int(rows["joint"].iloc[0])
    sessions = rows["session"].nunique()
    asked = ("day", joint, direction, None, configuration)
    if sessions < 2:
        return Refusal(*asked, "all readings are of one session: repeat this configuration in another")
    if len(rows) == sessions:
        return Refusal(
            *asked,
            "one reading in each session says nothing of scatter: read it twice in one session at least",
        )
    return Question(*asked, "session", READINGS, rows.assign(level=rows["session"]))
