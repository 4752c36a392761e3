"""The traverses of one joint as points of a figure: step size, its error bar, and what the law has for it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit.fit import Repeatability, Result
from stickslip_fit.laws import expected_steps, rounding_variance, travel
from stickslip_fit.logs import Log

ENOUGH_REPLICATES = 3  # degrees of freedom
SESSIONS_SHOWN = 3
POSITION = ["q1", "q2", "q3", "theta", "psi"]


def repeatability_of(joint: int, direction: str, calibration: Result, fit: Result) -> Repeatability:
    """The replicates' repeatability; the fit's residuals' where there are hardly any replicates."""
    replicates = calibration.joints[joint].repeatability[direction]
    return replicates if enough_replicates(replicates) else fit.joints[joint].repeatability[direction]


def enough_replicates(found: Repeatability) -> bool:
    """Whether replicates, not what a law leaves over, say how well a traverse repeats."""
    return found.source == "replicates" and found.freedom >= ENOUGH_REPLICATES


def traverses_of(joint: int, log: Log, calibration: Result, fit: Result) -> pd.DataFrame:
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
    rows[POSITION] = rows[POSITION].round(9) + 0.0
    seen = expected_steps(rows["steps"], rows["check_every"])
    rows["centre"] = (rows["start"] + rows["stop"]) / 2
    rows["step_size"] = travel(rows) / seen
    noise = {way: repeatability_of(joint, way, calibration, fit).value for way in ("+", "-")}
    spread = np.nan_to_num(rows["direction"].astype(object).map(noise).to_numpy(float))
    rows["error"] = rows["step_size"] * np.sqrt(
        spread**2 + rounding_variance(rows["steps"], rows["check_every"])
    )
    rows["model"] = fit.predict(rows)["step_size"]
    rows["departure"] = rows["step_size"] / rows["model"] - 1.0
    return rows


def is_full(rows: pd.DataFrame, span: float) -> pd.Series[bool]:
    """Which traverses run the joint's whole range."""
    return pd.Series(np.isclose(travel(rows), span, rtol=1e-6), index=rows.index)


def recent(rows: pd.DataFrame, most: int = SESSIONS_SHOWN) -> pd.DataFrame:
    """The rows of the most recent sessions; more of them would hide each other."""
    sessions = rows["session"].astype(object).unique()
    return rows[rows["session"].isin(list(sessions[-most:]))]


def thinned(rows: pd.DataFrame, most: int) -> pd.DataFrame:
    """At most `most` of the rows, chosen at random but the same each time.

    Every k-th row would not do: directions take turns, so that an even k would leave only one.
    """
    return rows if len(rows) <= most else rows.sample(most, random_state=0).sort_index()
