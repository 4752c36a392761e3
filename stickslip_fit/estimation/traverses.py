"""The traverses of one joint as points of a figure: step size, its error bar, and what the law has for it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.estimation.noise import NoiseLevel
from stickslip_fit.estimation.result import Result
from stickslip_fit.laws import expected_steps, rounding_variance, traverse_length
from stickslip_fit.logs import Log

MIN_REPLICATE_DF = 3  # degrees of freedom
MAX_SESSIONS = 3
POSITION_COLUMNS = ["q1", "q2", "q3", "theta", "psi"]


def choose_repeatability(joint: int, direction: str, calibration: Result, fit: Result) -> NoiseLevel:
    """The replicates' repeatability; the fit's residuals' where there are hardly any replicates."""
    replicates = calibration.joints[joint].repeatability[direction]
    return replicates if has_enough_replicates(replicates) else fit.joints[joint].repeatability[direction]


def has_enough_replicates(found: NoiseLevel) -> bool:
    """Whether replicates, not what a law leaves over, say how well a traverse repeats."""
    return found.source == "replicates" and found.df >= MIN_REPLICATE_DF


def collect_traverses(joint: int, log: Log, calibration: Result, fit: Result) -> pd.DataFrame:
    """Usable traverses of a joint with what figures show of them.

    Returns
    -------
    DataFrame
        The log's columns, positions rounded to 1e-9, and centre (middle of the traverse, rad or m),
        step_size (mean over the traverse), error (one repeatability, rounding included; 0 where it is
        not known), model (by the fitted law), departure (step_size / model - 1).
    """
    rows = log.usable
    rows = rows[rows["joint"] == joint].copy()
    rows[POSITION_COLUMNS] = rows[POSITION_COLUMNS].round(9) + 0.0
    seen = expected_steps(rows["steps"], rows["check_every"])
    rows["centre"] = (rows["start"] + rows["stop"]) / 2
    rows["step_size"] = traverse_length(rows) / seen
    noise = {
        direction: choose_repeatability(joint, direction, calibration, fit).value for direction in ("+", "-")
    }
    spread = np.nan_to_num(rows["direction"].astype(object).map(noise).to_numpy(float))
    rows["error"] = rows["step_size"] * np.sqrt(
        spread**2 + rounding_variance(rows["steps"], rows["check_every"])
    )
    rows["model"] = fit.predict(rows)["step_size"]
    rows["departure"] = rows["step_size"] / rows["model"] - 1.0
    return rows


def is_full(rows: pd.DataFrame, span: float) -> pd.Series[bool]:
    """Which traverses run the joint's whole range."""
    return pd.Series(np.isclose(traverse_length(rows), span, rtol=1e-6), index=rows.index)


def select_recent(rows: pd.DataFrame, most: int = MAX_SESSIONS) -> pd.DataFrame:
    """The rows of the most recent sessions; more of them would hide each other."""
    sessions = rows["session"].astype(object).unique()
    return rows[rows["session"].isin(list(sessions[-most:]))]


def thin_rows(rows: pd.DataFrame, most: int) -> pd.DataFrame:
    """At most `most` of the rows, chosen at random but the same each time.

    Every k-th row would not do: directions take turns, so that an even k would leave only one.
    """
    return rows if len(rows) <= most else rows.sample(most, random_state=0).sort_index()
