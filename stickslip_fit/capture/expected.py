"""What a reading should be, and whether it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Protocol

import pandas as pd

WITHOUT_INTERVAL = 0.10  # by how much a reading may miss a prediction that doesn't say how sure it is
WIDE = 2.0  # half-widths of the 95 % interval; one reading in 10,000 lies beyond by chance


class Predictor(Protocol):
    """Says beforehand what counts will be."""

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Counts of traverses to come.

        Parameters
        ----------
        rows : DataFrame
            Traverses in a plan's columns.

        Returns
        -------
        DataFrame
            steps, before they are rounded up to the next check, low and high (95 % of readings); NaN
            where they are not known.
        """


@dataclass(frozen=True)
class Expected:
    """A prediction of one count.

    Attributes
    ----------
    steps, low, high : float
        NaN where not known.

    Examples
    --------
    >>> Expected(12300.0, 12230.0, 12370.0).departure(12500)
    '1.6 % more steps than predicted (12,300)'
    >>> Expected(12300.0, 12230.0, 12370.0).departure(12400)
    ''
    """

    steps: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether anything was predicted."""
        return isfinite(self.steps) and self.steps > 0

    def departure(self, steps: float) -> str:
        """How far a count lies from what it should be; empty where that may be chance, or nobody knows."""
        if not self.known:
            return ""
        allowed = WITHOUT_INTERVAL * self.steps
        if isfinite(self.low) and isfinite(self.high):
            allowed = WIDE * max(self.high - self.steps, self.steps - self.low)
        if abs(steps - self.steps) <= allowed:
            return ""
        more = "more" if steps > self.steps else "fewer"
        share = abs(steps / self.steps - 1)
        return f"{share:.1%} {more} steps than predicted ({self.steps:,.0f})".replace("%", " %")


NOTHING = Expected(float("nan"), float("nan"), float("nan"))


def expected(predictor: Predictor | None, row: pd.Series) -> Expected:
    """What the predictor says of one traverse; nothing without one."""
    if predictor is None:
        return NOTHING
    found = predictor.predict(row.to_frame().T.infer_objects().reset_index(drop=True)).iloc[0]
    return Expected(float(found["steps"]), float(found["low"]), float(found["high"]))
