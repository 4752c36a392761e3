"""The traverses that would tell apart what a log cannot.

Between two causes a reading is worth [f_i - f_j]^2 / (2 sigma^2 + V_i + V_j), f being what each would make
it and V how well the log knows that (G. E. P. Box and W. J. Hill, Technometrics 9:57, 1967). With nothing
but sigma in the way, n = 10.8 sigma^2 / (f_i - f_j)^2 readings confuse the two once in twenty times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.diagnosis import Finding, NextTraverse
from stickslip_fit.diagnose.experiments.forecast import Forecast
from stickslip_fit.diagnose.laid_out.refit import Refit
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.searching.search import Found, Search

Array = npt.NDArray[np.float64]

ONCE_IN_TWENTY = 1.644854
MOST_REPEATS = 50
AS_FAST = 2.0  # times the least time in which anything decides; what takes longer is not looked at
WHOLE = 1e-9  # share of a range


@dataclass(frozen=True, eq=False)
class _Choice:
    """All that could be made next, one after the other: who would expect what, and what one costs."""

    forecasts: Sequence[Forecast]
    expected: dict[str, Array]
    doubt: dict[str, Array]
    variance: Array
    wait: Array
    seconds: Array

    def repeats(self, one: str, other: str) -> Array:
        """Readings, of calibration and traverse alike, until two causes are confused once in twenty times.

        Infinite beyond `MOST_REPEATS`. Each cause's reading is normal about what it makes expected, so that
        the two are best told apart at the same number of standard deviations from both.
        """
        number = np.arange(1, MOST_REPEATS + 1)[:, None]
        spread = sum(np.sqrt(self.variance / number + self.doubt[cause]) for cause in (one, other))
        enough = np.abs(self.expected[one] - self.expected[other]) >= ONCE_IN_TWENTY * spread
        return np.where(enough.any(axis=0), 1.0 + np.argmax(enough, axis=0), np.inf)

    def worth(self, one: str, other: str) -> Array:
        """What one reading of each traverse is worth."""
        apart = (self.expected[one] - self.expected[other]) ** 2
        return apart / (2 * self.variance + self.doubt[one] + self.doubt[other])

    def best(self, one: str, other: str) -> int | None:
        """Of the traverses that decide in about the least time, the one that is worth most."""
        return worthiest(self.wait + self.repeats(one, other) * self.seconds, self.worth(one, other))


def next_experiment(
    searched: Search, findings: Sequence[Finding], ahead: Sequence[Forecast]
) -> tuple[NextTraverse, ...]:
    """Traverses that tell apart the causes that a diagnosis could not.

    Parameters
    ----------
    searched : Search
    findings : sequence of Finding
        With their `equivalent`.
    ahead : sequence of Forecast
        What can be made.

    Returns
    -------
    tuple of NextTraverse
        Empty where nothing is left to tell apart, or nothing within reach does; see `out_of_reach`.
    """
    chosen: list[NextTraverse] = []
    for finding in findings:
        if finding.equivalent and finding.cause != UNKNOWN:
            (found,) = (each for each in searched.found if each.cause == finding.cause)
            choice = _choice({each: _fit(searched, found, each) for each in _set(finding)}, ahead)
            chosen += _chosen(choice, _set(finding))
    return tuple(chosen)


def out_of_reach(
    findings: Sequence[Finding], traverses: Sequence[NextTraverse]
) -> tuple[tuple[str, str], ...]:
    """Pairs of causes that the log cannot tell apart and no traverse within reach would."""
    told = [set(each.tells_apart) for each in traverses]
    return tuple(
        pair
        for finding in findings
        for pair in combinations(_set(finding), 2)
        if not any(set(pair) <= each for each in told)
    )


def worthiest(time: Array, worth: Array) -> int | None:
    """Of the choices that take about the least time, the one worth most; None if all take for ever."""
    if not np.isfinite(time).any():
        return None
    return int(np.argmax(np.where(time <= AS_FAST * time.min(), worth, -np.inf)))


def _set(finding: Finding) -> tuple[str, ...]:
    return (finding.cause, *finding.equivalent)


def _fit(searched: Search, found: Found, cause: str) -> Refit:
    """The law with a rival in the place of what was named, everything fitted anew."""
    looked = found.misfit
    assert looked is not None
    shape: Any = looked.best_of(cause)
    start = np.array(shape.version.absent) if shape.values is None else shape.values
    rival = found if cause == found.cause else replace(found, cause=cause, version=shape.version, start=start)
    acting = [rival if each is found else each for each in searched.found if each.version is not None]
    return searched.bench.fitted(
        [each.version for each in acting], np.concatenate([each.start for each in acting])
    )


def _choice(fits: dict[str, Refit], ahead: Sequence[Forecast]) -> _Choice:
    expected: dict[str, list[Array]] = {cause: [] for cause in fits}
    doubt: dict[str, list[Array]] = {cause: [] for cause in fits}
    for each in ahead:
        for cause, fit in fits.items():
            (law,) = (part.law for part in fit.parts if part.law.joint == each.law.joint)
            expected[cause].append(each.shown(law, fit.values))
            doubt[cause].append(each.uncertainty(law, fit.values, fit.covariance))
    return _Choice(
        ahead,
        {cause: np.concatenate(values) for cause, values in expected.items()},
        {cause: np.concatenate(values) for cause, values in doubt.items()},
        np.concatenate([each.variance for each in ahead]),
        np.concatenate([each.wait for each in ahead]),
        np.concatenate([each.seconds for each in ahead]),
    )


def _chosen(choice: _Choice, causes: Sequence[str]) -> list[NextTraverse]:
    """A traverse for each pair that none of those before it tells apart."""
    found: list[NextTraverse] = []
    for one, other in combinations(causes, 2):
        if any({one, other} <= set(each.tells_apart) for each in found):
            continue
        place = choice.best(one, other)
        if place is not None:
            repeats = int(choice.repeats(one, other)[place])
            found.append(
                _traverse(choice, place, repeats, _told(choice, place, repeats, (one, other), causes))
            )
    return found


def _told(
    choice: _Choice, place: int, repeats: int, pair: tuple[str, str], causes: Sequence[str]
) -> tuple[str, ...]:
    """The pair, and each further cause that these readings tell from all of those."""
    told = list(pair)
    for cause in causes:
        if cause not in told and all(choice.repeats(cause, each)[place] <= repeats for each in told):
            told.append(cause)
    return tuple(told)


def _traverse(choice: _Choice, place: int, repeats: int, told: tuple[str, ...]) -> NextTraverse:
    for each in choice.forecasts:
        if place < len(each.traverses):
            return traverse_at(each, place, repeats, told)
        place -= len(each.traverses)
    raise IndexError(place)


def traverse_at(ahead: Forecast, place: int, repeats: int, told: tuple[str, ...]) -> NextTraverse:
    """One of the traverses of a forecast, to be made and calibrated so many times."""
    row = ahead.traverses.iloc[place]
    longest = np.abs(ahead.traverses["stop"] - ahead.traverses["start"]).max()
    whole = abs(row["stop"] - row["start"]) > longest * (1 - WHOLE)
    return NextTraverse(
        session="new",
        joint=int(row["joint"]),
        direction=str(row["direction"]),
        **{name: float(row[name]) for name in ("q1", "q2", "q3", "theta", "psi")},
        start=np.nan if whole else float(row["start"]),
        stop=np.nan if whole else float(row["stop"]),
        repeats=repeats,
        tells_apart=told,
        note=str(row["note"]) + (f"; calibrate {repeats} times too" if repeats > 1 else ""),
    )
