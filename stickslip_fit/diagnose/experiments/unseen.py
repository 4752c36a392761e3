"""Causes that a log could not show, and the traverses that would make them testable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.diagnosis import NextTraverse
from stickslip_fit.diagnose.experiments.forecast import Forecast
from stickslip_fit.diagnose.experiments.next_experiment import MOST_REPEATS, traverse_at, worthiest

Array = npt.NDArray[np.float64]

FOUND = 5.0  # strength that raises an alarm about every other time
PLACES = {"q1", "q2", "q3"}  # empty for the joint that moves


@dataclass(frozen=True)
class Unseen:
    """A cause that a log could not show.

    Attributes
    ----------
    cause : str
    reason : str
    shows_best : str
        In words, what would show it.
    traverse : NextTraverse or None
        That shows it soonest, at its largest plausible size; None where no traverse does by itself.
    seconds : float
        What that takes.
    """

    cause: str
    reason: str
    shows_best: str
    traverse: NextTraverse | None
    seconds: float


def unseen(
    untestable: Mapping[str, str], causes: Iterable[Any], rows: pd.DataFrame, ahead: Sequence[Forecast]
) -> tuple[Unseen, ...]:
    """What would make untestable causes testable, what takes least time first.

    Parameters
    ----------
    untestable : mapping of str to str
        Cause and reason.
    causes : iterable of object
        Bound to the rows where these have the columns for it.
    rows : DataFrame
        Of the log.
    ahead : sequence of Forecast
        What can be made.
    """
    found = [
        _unseen(cause, untestable[cause.name], rows, ahead) for cause in causes if cause.name in untestable
    ]
    return tuple(sorted(found, key=lambda each: each.seconds))


def written_down(cause: Any, rows: pd.DataFrame) -> bool:
    """Whether the rows have all columns that a cause needs."""
    return all(name in rows and rows[name].notna().any() for name in set(cause.columns) - PLACES)


def _unseen(cause: Any, reason: str, rows: pd.DataFrame, ahead: Sequence[Forecast]) -> Unseen:
    best, seconds = None, np.inf
    for each in ahead if written_down(cause, rows) else ():
        if each.law.joint in cause.joints:
            strength = _strength(cause, each, rows)
            with np.errstate(divide="ignore"):
                repeats = np.ceil((FOUND / strength) ** 2)
            time = np.where(repeats <= MOST_REPEATS, each.wait + repeats * each.seconds, np.inf)
            place = worthiest(time, strength)
            if place is not None and time[place] < seconds:
                seconds = float(time[place])
                best = traverse_at(each, place, int(repeats[place]), (cause.name,))
    return Unseen(cause.name, reason, cause.shows_best, best, seconds)


def _strength(cause: Any, ahead: Forecast, rows: pd.DataFrame) -> Array:
    """Of the cause's largest plausible effect in one reading of each traverse, at its worst shape, (m,)."""
    shapes = [(cause, np.array(cause.largest()))] if cause.largest() else cause.trials(rows)
    shown = [
        np.abs(ahead.shown(version.extend(ahead.law), sizes))
        for version, values in shapes
        for sizes in values
    ]
    return np.min(shown, axis=0) / np.sqrt(ahead.variance) if shown else np.zeros(len(ahead.traverses))
