"""Whether a session lies where the sessions before it lead one to expect."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit._format import format_direction
from stickslip_fit.fit.result import Result
from stickslip_fit.units import from_si

FEWEST = 3  # sessions before; with two, anything would be as expected
SURPRISE = 0.01  # over all parameters of a session together


def control_chart(result: Result) -> pd.DataFrame:
    """Every session's parameters beside what the sessions before it predict for them.

    Parameters
    ----------
    result : Result
        By any estimator.

    Returns
    -------
    DataFrame
        name, joint, direction, session, unit, estimate, low, high (its 95 %), expected_low, expected_high
        (SI) and surprising. The range holds all parameters of a drive that changes from session to session
        as it did so far in 99 of 100 sessions (Student's t, Bonferroni over the session's parameters that
        have a range); it is NaN with fewer than three earlier sessions. Parameters that are not known, and
        those that all sessions share, are not listed.
    """
    table = result.parameters.dropna(subset=["estimate", "session"])
    chart = table[["name", "joint", "direction", "session", "unit", "estimate", "low", "high"]]
    chart = chart.reset_index(drop=True)
    histories = chart.groupby(["joint", "direction", "name"], sort=False)["estimate"]
    earlier = histories.cumcount().to_numpy()
    middle, spread = np.full(len(chart), np.nan), np.full(len(chart), np.nan)
    for _, history in histories:
        middle[history.index], spread[history.index] = _expected(history.to_numpy(float))
    told = earlier >= FEWEST
    together = np.maximum(pd.Series(told).groupby(chart["session"]).transform("sum").to_numpy(), 1)
    freedom = np.where(told, earlier - 1, 1)
    reach = spread * student_t.ppf(1 - SURPRISE / 2 / together, freedom)
    chart["expected_low"], chart["expected_high"] = middle - reach, middle + reach
    chart["surprising"] = np.abs(chart["estimate"] - middle) > reach
    return chart


def expectation(result: Result) -> pd.DataFrame:
    """The latest session's parameters beside what the earlier sessions predict for them.

    Returns
    -------
    DataFrame
        The last row of each parameter in `control_chart`. Parameters with fewer than three earlier sessions
        are not listed.
    """
    chart = control_chart(result)
    latest = chart.groupby(["joint", "direction", "name"], sort=False).tail(1)
    return latest.dropna(subset=["expected_low"]).reset_index(drop=True)


def expectation_text(found: pd.DataFrame) -> str:
    """One sentence where all is as expected, else a line for each surprise.

    Parameters
    ----------
    found : DataFrame
        As `expectation` returns it.
    """
    if found.empty:
        return f"Fewer than {FEWEST} earlier sessions: too few to say what to expect of the latest."
    session, odd = found["session"].iloc[-1], found[found["surprising"].astype(bool)]
    if odd.empty:
        return f"Session {session} lies where the sessions before it lead one to expect."
    lines = [
        f"  joint {row.joint} {format_direction(row.direction)} {row.name}: "
        f"{from_si(row.estimate, row.unit):.4g}, expected {from_si(row.expected_low, row.unit):.4g} to "
        f"{from_si(row.expected_high, row.unit):.4g}{'' if row.unit == '1' else ' ' + row.unit}"
        for row in odd.itertuples(index=False)
    ]
    return "\n".join([f"Session {session} is not where the sessions before it lead one to expect:", *lines])


def _expected(estimates: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean and standard deviation of the next estimate after each stretch of the past, shape (2, n)."""
    found = np.full((2, len(estimates)), np.nan)
    for k in range(FEWEST, len(estimates)):
        past = estimates[:k]
        found[:, k] = past.mean(), past.std(ddof=1) * np.sqrt(1 + 1 / k)
    return found
