"""One question to a log: which readings, compared between which levels, against which error."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import pandas as pd

READINGS = "readings within session"
Choose = Callable[[pd.DataFrame, list[str]], Iterable[pd.DataFrame]]


@dataclass(frozen=True)
class Question:
    """What is asked, and of which readings.

    Attributes
    ----------
    analysis : str
        ``day``, ``direction`` or ``normal-force``.
    joint : int
    direction, session : str or None
        None where the question is about both, or all.
    configuration : str
        Where everything else stood, in words.
    factor : str
        Column of `readings` whose levels are compared.
    error_term : str
        What the difference between levels is measured against.
    readings : DataFrame
        See `readings.readings`; with a column level, the names of the levels.
    """

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str
    factor: str
    error_term: str
    readings: pd.DataFrame

    @property
    def units(self) -> pd.DataFrame:
        """What is compared: readings, or their mean in each session and level.

        Returns
        -------
        DataFrame
            step_size, level, block.
        """
        if self.error_term == READINGS:
            return self.readings[["step_size", "level"]].assign(block="")
        cells = self.readings.groupby(["session", "level"], sort=False, as_index=False)["step_size"].mean()
        return cells.rename(columns={"session": "block"})


@dataclass(frozen=True)
class Refusal:
    """A question that the log cannot answer, and why; attributes as of `Question`."""

    analysis: str
    joint: int
    direction: str | None
    session: str | None
    configuration: str | None
    reason: str


def most_read(rows: pd.DataFrame, by: list[str]) -> list[pd.DataFrame]:
    """The configuration that says most: seen in several sessions, repeated most, read most, read first.

    Nothing but the design decides, never what was read.

    Parameters
    ----------
    rows : DataFrame
        Readings of one joint.
    by : list of str
        Columns that make a configuration.
    """
    place, order = _ranked(rows, by)
    return [rows[place == order[0]]]


def every(rows: pd.DataFrame, by: list[str]) -> list[pd.DataFrame]:
    """Each configuration, the one that says most first."""
    place, order = _ranked(rows, by)
    parts = dict(list(rows.groupby(place, sort=False)))
    return [parts[one] for one in order]


def _ranked(rows: pd.DataFrame, by: list[str]) -> tuple[pd.Series[int], list[int]]:
    """The number of each row's configuration, and these numbers, the one that says most first."""
    place = rows.groupby(by, dropna=False, sort=False).ngroup()
    cells = rows.groupby([place, "session", "direction", "orientation"], sort=False).size()
    places = cells.groupby(level=0, sort=False)
    repeats = places.sum() - places.size()
    again = rows.groupby(place)["session"].nunique() > 1
    ranking = pd.DataFrame(
        {"both": again & (repeats > 0), "again": again, "repeats": repeats, "readings": places.sum()}
    )
    return place, list(ranking.sort_values(list(ranking), ascending=False, kind="stable").index)
