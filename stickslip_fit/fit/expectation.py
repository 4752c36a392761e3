"""Whether the latest session lies where the sessions before it lead one to expect."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import t as student_t

from stickslip_fit.fit.result import Result
from stickslip_fit.units import from_si

FEWEST = 3  # sessions before; with two, anything would be as expected
SURPRISE = 0.01  # over all parameters together


def expectation(result: Result) -> pd.DataFrame:
    """The latest session's parameters beside what the earlier sessions predict for them.

    Parameters
    ----------
    result : Result
        By any estimator.

    Returns
    -------
    DataFrame
        name, joint, direction, session, unit, estimate, expected_low, expected_high (SI), surprising.
        The range holds all parameters of a drive that changes from session to session as it did so far
        in 99 of 100 cases (Student's t, Bonferroni over the parameters listed). Parameters with fewer
        than three earlier sessions are not listed.
    """
    table = result.parameters.dropna(subset=["estimate"])
    rows = []
    for _, history in table.groupby(["joint", "direction", "name"], sort=False):
        earlier, today = history["estimate"].to_numpy()[:-1], history.iloc[-1]
        if len(earlier) >= FEWEST:
            rows.append(
                (today, earlier.mean(), earlier.std(ddof=1) * np.sqrt(1 + 1 / len(earlier)), len(earlier))
            )
    found = pd.DataFrame([today for today, *_ in rows], columns=table.columns).reset_index(drop=True)
    found = found[["name", "joint", "direction", "session", "unit", "estimate"]]
    middle, spread, sessions = (np.array([row[k] for row in rows], dtype=float) for k in (1, 2, 3))
    reach = spread * student_t.ppf(1 - SURPRISE / 2 / max(len(rows), 1), sessions - 1)
    found["expected_low"], found["expected_high"] = middle - reach, middle + reach
    found["surprising"] = np.abs(found["estimate"].to_numpy(float) - middle) > reach
    return found


def expectation_text(found: pd.DataFrame) -> str:
    """One sentence where all is as expected, else a line for each surprise.

    Parameters
    ----------
    found : DataFrame
        As `expectation` returns it.
    """
    if found.empty:
        return f"fewer than {FEWEST} earlier sessions: too few to say what to expect of the latest"
    session, odd = found["session"].iloc[-1], found[found["surprising"].astype(bool)]
    if odd.empty:
        return f"session {session} lies where the sessions before it lead one to expect"
    lines = [
        f"  joint {row.joint} {row.direction} {row.name}: {from_si(row.estimate, row.unit):.4g}, expected "
        f"{from_si(row.expected_low, row.unit):.4g} to {from_si(row.expected_high, row.unit):.4g}"
        f"{'' if row.unit == '1' else ' ' + row.unit}"
        for row in odd.itertuples(index=False)
    ]
    return "\n".join([f"session {session} is not where the sessions before it lead one to expect:", *lines])
