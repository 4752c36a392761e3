"""next_experiment: the traverses that best discriminate between causes that a log cannot separate.

The criterion for causes i and j is [f_i - f_j]^2 / (2 sigma^2 + V_i + V_j), with f the predicted
responses and V their variances given the log (G. E. P. Box and W. J. Hill, Technometrics 9:57, 1967).
Each new session is calibrated first, which absorbs a part of every effect: e - g (J'J)^-1 J' e_cal,
with J and g the Jacobians of the calibration and of the traverse. `suggest_traverses` does the same for
causes that were untestable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.linearized import ExtendedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Finding, NextTraverse
from stickslip_fit.diagnosis.selection import SelectedCause, Selection

MIN_CALIBRATION_WEIGHT = 1e-3  # share of a calibrating reading below which a traverse does without it


@dataclass(frozen=True, eq=False)
class Forecast:
    """Traverses under one law in a session to come, after those by which the session is calibrated.

    Attributes
    ----------
    law : object
        With `model` and `predict`, as of a `StepLaw`; it says nothing of causes.
    values : array, shape (p,)
        Its parameters, about as they will be.
    calibration : DataFrame
        k rows, enough to make all p parameters known.
    traverses : DataFrame
        m rows, each a choice.
    calibration_weights : array, shape (m, k)
        By how much what is expected of each traverse follows each reading of the calibration.
    variance : array, shape (m,)
        Of one reading of each traverse about what one calibration makes expected.
    wait : array, shape (m,)
        Seconds of the session until the first reading and the calibration are there.
    seconds : array, shape (m,)
        What each further reading takes, and one of each calibrating traverse that it leans on.
    """

    law: Any
    values: Array
    calibration: pd.DataFrame
    traverses: pd.DataFrame
    calibration_weights: Array
    variance: Array
    wait: Array
    seconds: Array

    def predict_effect(self, law: Any, sizes: Array) -> Array:
        """What each traverse would show of causes, shape (m,).

        Parameters
        ----------
        law : object
            `self.law` with causes in it.
        sizes : array, shape (q,)
            Of their parameters.
        """
        both = np.concatenate([self.values, sizes])
        ahead, calibration = (
            law.predict(rows, both) - self.law.predict(rows, self.values)
            for rows in (self.traverses, self.calibration)
        )
        return np.asarray(ahead - self.calibration_weights @ calibration)

    def effect_variance(self, law: Any, sizes: Array, covariance: Array) -> Array:
        """Variance of `shown` by what the log leaves open of the causes' parameters, shape (m,)."""
        both, own = np.concatenate([self.values, sizes]), len(self.values)
        ahead, calibration = (
            law.model(rows)(np.broadcast_to(both, (len(rows), len(both))))[1][:, own:]
            for rows in (self.traverses, self.calibration)
        )
        slopes = ahead - self.calibration_weights @ calibration
        return np.asarray(np.einsum("mi,ij,mj->m", slopes, covariance, slopes))


def forecast_session(
    law: Any,
    values: Array,
    calibration: pd.DataFrame,
    traverses: pd.DataFrame,
    repeatability: float,
    rounding: Array,
) -> Forecast:
    """Look ahead at a session.

    Parameters
    ----------
    law : object
    values : array, shape (p,)
    calibration, traverses : DataFrame
        k and m rows, with ``session_seconds`` and ``seconds``, when each begins and how long it takes.
    repeatability : float
        Standard deviation of a response.
    rounding : array, shape (m,)
        Variance that rounding adds to each traverse; a calibration's long traverses have next to none.
    """
    known = law.model(calibration)(values)[1]
    slopes = law.model(traverses)(values)[1]
    follow = slopes @ np.linalg.pinv(known)
    variance = repeatability**2 * (1.0 + np.sum(follow**2, axis=1)) + rounding
    leans = np.abs(follow) > MIN_CALIBRATION_WEIGHT
    seconds = traverses["seconds"].to_numpy(float) + leans @ calibration["seconds"].to_numpy(float)
    wait = np.maximum(traverses["session_seconds"], calibration["session_seconds"].max()).to_numpy(float)
    return Forecast(law, values, calibration, traverses, follow, variance, wait, seconds)


Z_95_ONE_SIDED = 1.644854
MAX_REPEATS = 50
MAX_TIME_FACTOR = 2.0  # times the least time in which anything decides; what takes longer is not looked at
RANGE_TOL = 1e-9  # share of a range


@dataclass(frozen=True, eq=False)
class _Candidates:
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
        number = np.arange(1, MAX_REPEATS + 1)[:, None]
        spread = sum(np.sqrt(self.variance / number + self.doubt[cause]) for cause in (one, other))
        enough = np.abs(self.expected[one] - self.expected[other]) >= Z_95_ONE_SIDED * spread
        return np.where(enough.any(axis=0), 1.0 + np.argmax(enough, axis=0), np.inf)

    def criterion(self, one: str, other: str) -> Array:
        """What one reading of each traverse is worth."""
        apart = (self.expected[one] - self.expected[other]) ** 2
        return apart / (2 * self.variance + self.doubt[one] + self.doubt[other])

    def best(self, one: str, other: str) -> int | None:
        """Of the traverses that decide in about the least time, the one that is worth most."""
        return choose_place(self.wait + self.repeats(one, other) * self.seconds, self.criterion(one, other))


def next_experiment(
    selection: Selection, findings: Sequence[Finding], ahead: Sequence[Forecast]
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
            (found,) = (each for each in selection.found if each.cause == finding.cause)
            choice = _evaluate_candidates(
                {each: _fit_rival(selection, found, each) for each in _cause_set(finding)}, ahead
            )
            chosen += _choose_traverses(choice, _cause_set(finding))
    return tuple(chosen)


def find_inseparable_pairs(
    findings: Sequence[Finding], traverses: Sequence[NextTraverse]
) -> tuple[tuple[str, str], ...]:
    """Pairs of causes that the log cannot tell apart and no traverse within reach would."""
    told = [set(each.tells_apart) for each in traverses]
    return tuple(
        pair
        for finding in findings
        for pair in combinations(_cause_set(finding), 2)
        if not any(set(pair) <= each for each in told)
    )


def choose_place(time: Array, worth: Array) -> int | None:
    """Of the choices that take about the least time, the one worth most; None if all take for ever."""
    if not np.isfinite(time).any():
        return None
    return int(np.argmax(np.where(time <= MAX_TIME_FACTOR * time.min(), worth, -np.inf)))


def _cause_set(finding: Finding) -> tuple[str, ...]:
    return (finding.cause, *finding.equivalent)


def _fit_rival(selection: Selection, found: SelectedCause, cause: str) -> ExtendedFit:
    """The law with a rival in the place of what was named, everything fitted anew."""
    misfit = found.misfit
    assert misfit is not None
    shape: Any = misfit.best_hypothesis(cause)
    start = np.array(shape.version.absent) if shape.values is None else shape.values
    rival = found if cause == found.cause else replace(found, cause=cause, version=shape.version, start=start)
    acting = [rival if each is found else each for each in selection.found if each.version is not None]
    return selection.problem.fit_extended(
        [each.version for each in acting], np.concatenate([each.start for each in acting])
    )


def _evaluate_candidates(fits: dict[str, ExtendedFit], ahead: Sequence[Forecast]) -> _Candidates:
    expected: dict[str, list[Array]] = {cause: [] for cause in fits}
    doubt: dict[str, list[Array]] = {cause: [] for cause in fits}
    for each in ahead:
        for cause, fit in fits.items():
            (law,) = (part.law for part in fit.parts if part.law.joint == each.law.joint)
            expected[cause].append(each.predict_effect(law, fit.values))
            doubt[cause].append(each.effect_variance(law, fit.values, fit.covariance))
    return _Candidates(
        ahead,
        {cause: np.concatenate(values) for cause, values in expected.items()},
        {cause: np.concatenate(values) for cause, values in doubt.items()},
        np.concatenate([each.variance for each in ahead]),
        np.concatenate([each.wait for each in ahead]),
        np.concatenate([each.seconds for each in ahead]),
    )


def _choose_traverses(choice: _Candidates, causes: Sequence[str]) -> list[NextTraverse]:
    """A traverse for each pair that none of those before it tells apart."""
    found: list[NextTraverse] = []
    for one, other in combinations(causes, 2):
        if any({one, other} <= set(each.tells_apart) for each in found):
            continue
        place = choice.best(one, other)
        if place is not None:
            repeats = int(choice.repeats(one, other)[place])
            found.append(
                _traverse_at_place(
                    choice, place, repeats, _separated_causes(choice, place, repeats, (one, other), causes)
                )
            )
    return found


def _separated_causes(
    choice: _Candidates, place: int, repeats: int, pair: tuple[str, str], causes: Sequence[str]
) -> tuple[str, ...]:
    """The pair, and each further cause that these readings tell from all of those."""
    told = list(pair)
    for cause in causes:
        if cause not in told and all(choice.repeats(cause, each)[place] <= repeats for each in told):
            told.append(cause)
    return tuple(told)


def _traverse_at_place(choice: _Candidates, place: int, repeats: int, told: tuple[str, ...]) -> NextTraverse:
    for each in choice.forecasts:
        if place < len(each.traverses):
            return make_next_traverse(each, place, repeats, told)
        place -= len(each.traverses)
    raise IndexError(place)


def make_next_traverse(ahead: Forecast, place: int, repeats: int, told: tuple[str, ...]) -> NextTraverse:
    """One of the traverses of a forecast, to be made and calibrated so many times."""
    row = ahead.traverses.iloc[place]
    longest = np.abs(ahead.traverses["stop"] - ahead.traverses["start"]).max()
    whole = abs(row["stop"] - row["start"]) > longest * (1 - RANGE_TOL)
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


DETECTION_STRENGTH = 5.0  # strength that raises an alarm about every other time
POSITION_COLUMNS = {"q1", "q2", "q3"}  # empty for the joint that moves


@dataclass(frozen=True)
class UntestableCause:
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


def suggest_traverses(
    untestable: Mapping[str, str], causes: Iterable[Any], rows: pd.DataFrame, ahead: Sequence[Forecast]
) -> tuple[UntestableCause, ...]:
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
        _suggest_traverse(cause, untestable[cause.name], rows, ahead)
        for cause in causes
        if cause.name in untestable
    ]
    return tuple(sorted(found, key=lambda each: each.seconds))


def has_columns(cause: Any, rows: pd.DataFrame) -> bool:
    """Whether the rows have all columns that a cause needs."""
    return all(name in rows and rows[name].notna().any() for name in set(cause.columns) - POSITION_COLUMNS)


def _suggest_traverse(
    cause: Any, reason: str, rows: pd.DataFrame, ahead: Sequence[Forecast]
) -> UntestableCause:
    best, seconds = None, np.inf
    for each in ahead if has_columns(cause, rows) else ():
        if each.law.joint in cause.joints:
            strength = _min_strength(cause, each, rows)
            with np.errstate(divide="ignore"):
                repeats = np.ceil((DETECTION_STRENGTH / strength) ** 2)
            time = np.where(repeats <= MAX_REPEATS, each.wait + repeats * each.seconds, np.inf)
            place = choose_place(time, strength)
            if place is not None and time[place] < seconds:
                seconds = float(time[place])
                best = make_next_traverse(each, place, int(repeats[place]), (cause.name,))
    return UntestableCause(cause.name, reason, cause.shows_best, best, seconds)


def _min_strength(cause: Any, ahead: Forecast, rows: pd.DataFrame) -> Array:
    """Of the cause's largest plausible effect in one reading of each traverse, at its worst shape, (m,)."""
    shapes = [(cause, np.array(cause.largest()))] if cause.largest() else cause.trials(rows)
    shown = [
        np.abs(ahead.predict_effect(version.extend(ahead.law), sizes))
        for version, values in shapes
        for sizes in values
    ]
    return np.min(shown, axis=0) / np.sqrt(ahead.variance) if shown else np.zeros(len(ahead.traverses))
