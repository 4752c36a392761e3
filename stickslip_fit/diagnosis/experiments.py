"""next_experiment: the traverses that best discriminate between causes that a log cannot separate.

The criterion for causes i and j is [f_i - f_j]^2 / (2 sigma^2 + V_i + V_j), with f the predicted
responses and V their variances given the log (G. E. P. Box and W. J. Hill, Technometrics 9:57, 1967).
Each new session is calibrated first, which absorbs a part of every effect (`candidate_traverses`).
`suggest_traverses` does the same for causes that were untestable.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes import Cause, covariates, library
from stickslip_fit.diagnosis.candidate_traverses import Forecast, forecast_candidates
from stickslip_fit.diagnosis.extension import SelectedCause, fit_causes
from stickslip_fit.diagnosis.finding import Finding, NextTraverse
from stickslip_fit.diagnosis.linearized import ExtendedFit
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.errors import check_type

Z_95_ONE_SIDED = 1.644854
MAX_REPEATS = 50
MAX_TIME_FACTOR = 2.0  # over the least time that suffices; slower candidates are left out
RANGE_TOL = 1e-9  # share of a range
DETECTION_STRENGTH = 5.0  # at which about every other log raises an alarm
POSITION_COLUMNS = {"q1", "q2", "q3"}  # empty for the joint that moves


def next_experiment(diagnosis: Diagnosis) -> tuple[NextTraverse, ...]:
    """Traverses that separate the causes that a diagnosis could not.

    Returns
    -------
    tuple of NextTraverse
        Empty where every cause is separate, or no traverse within reach separates them (see
        `find_inseparable_pairs`), and for a table, which has no traverses.

    Raises
    ------
    InputError
        If causes are left and the data were neither a log nor a table.
    """
    check_type("diagnosis", diagnosis, Diagnosis)
    selection = diagnosis.selection
    doubtful = [finding for finding in diagnosis.findings if finding.equivalent and finding.cause != UNKNOWN]
    if not doubtful or diagnosis.table is not None:
        return ()
    forecasts = forecast_candidates(selection.problem, diagnosis.require_log().machine)
    if not forecasts:
        return ()
    traverses: list[NextTraverse] = []
    for finding in doubtful:
        (selected,) = (one for one in selection.selected if one.cause == finding.cause)
        fits = {cause: _fit_rival(selection, selected, cause) for cause in finding.cause_set}
        traverses += _choose_traverses(_evaluate_candidates(fits, forecasts), finding.cause_set)
    return tuple(traverses)


def find_inseparable_pairs(
    findings: Sequence[Finding], traverses: Sequence[NextTraverse]
) -> tuple[tuple[str, str], ...]:
    """Pairs of causes that neither the log nor any of these traverses separates."""
    return tuple(
        pair
        for finding in findings
        for pair in combinations(finding.cause_set, 2)
        if not any(set(pair) <= set(traverse.tells_apart) for traverse in traverses)
    )


@dataclass(frozen=True, eq=False)
class _Candidates:
    """All candidate traverses in sequence, with each cause's prediction and its variance."""

    forecasts: Sequence[Forecast]
    expected: dict[str, Array]
    effect_variance: dict[str, Array]
    variance: Array
    wait: Array
    seconds: Array

    def repeats(self, one: str, other: str) -> Array:
        """Readings of calibration and traverse until two causes are confused once in twenty times.

        Infinite beyond `MAX_REPEATS`. The threshold between two normal distributions is the same number of
        standard deviations from both.
        """
        number = np.arange(1, MAX_REPEATS + 1)[:, None]
        spread = sum(np.sqrt(self.variance / number + self.effect_variance[cause]) for cause in (one, other))
        enough = np.abs(self.expected[one] - self.expected[other]) >= Z_95_ONE_SIDED * spread
        return np.where(enough.any(axis=0), 1.0 + np.argmax(enough, axis=0), np.inf)

    def criterion(self, one: str, other: str) -> Array:
        """The Box-Hill criterion of one reading of each traverse."""
        difference2 = (self.expected[one] - self.expected[other]) ** 2
        return difference2 / (2 * self.variance + self.effect_variance[one] + self.effect_variance[other])

    def best(self, one: str, other: str) -> int | None:
        """The traverse with the highest criterion among those that take about the least time."""
        return choose_place(self.wait + self.repeats(one, other) * self.seconds, self.criterion(one, other))

    def next_traverse(self, place: int, repeats: int, causes: tuple[str, ...]) -> NextTraverse:
        """A candidate by its place in the sequence."""
        ends = np.cumsum([len(forecast.traverses) for forecast in self.forecasts])
        number = int(np.searchsorted(ends, place, side="right"))
        forecast = self.forecasts[number]
        return make_next_traverse(
            forecast, place - int(ends[number]) + len(forecast.traverses), repeats, causes
        )


def choose_place(time: Array, criterion: Array) -> int | None:
    """Of the candidates that take about the least time, the best; None if all times are infinite."""
    if not np.isfinite(time).any():
        return None
    return int(np.argmax(np.where(time <= MAX_TIME_FACTOR * time.min(), criterion, -np.inf)))


def _fit_rival(selection: Selection, selected: SelectedCause, cause: str) -> ExtendedFit:
    """The law with a rival in the place of a selected cause, refitted."""
    misfit = selected.test
    shape: Any = misfit.best_hypothesis(cause)
    start = np.array(shape.version.start_values) if shape.values is None else shape.values
    rival = replace(selected, cause=cause, version=shape.version, start=start)
    chosen = selected if cause == selected.cause else rival
    causes = [chosen if one is selected else one for one in selection.law_causes]
    return fit_causes(selection.problem, causes)


def _evaluate_candidates(fits: dict[str, ExtendedFit], forecasts: Sequence[Forecast]) -> _Candidates:
    expected: dict[str, list[Array]] = {cause: [] for cause in fits}
    variance: dict[str, list[Array]] = {cause: [] for cause in fits}
    for forecast in forecasts:
        for cause, fit in fits.items():
            (law,) = (part.law for part in fit.parts if part.law.joint == forecast.law.joint)
            expected[cause].append(forecast.predict_effect(law, fit.values))
            variance[cause].append(forecast.effect_variance(law, fit.values, fit.covariance))
    return _Candidates(
        forecasts,
        {cause: np.concatenate(values) for cause, values in expected.items()},
        {cause: np.concatenate(values) for cause, values in variance.items()},
        np.concatenate([forecast.variance for forecast in forecasts]),
        np.concatenate([forecast.wait for forecast in forecasts]),
        np.concatenate([forecast.seconds for forecast in forecasts]),
    )


def _choose_traverses(candidates: _Candidates, causes: Sequence[str]) -> list[NextTraverse]:
    """A traverse for each pair that none of those before it separates."""
    chosen: list[NextTraverse] = []
    for pair in combinations(causes, 2):
        if any(set(pair) <= set(traverse.tells_apart) for traverse in chosen):
            continue
        place = candidates.best(*pair)
        if place is not None:
            repeats = int(candidates.repeats(*pair)[place])
            separated = list(pair)
            for cause in causes:
                if cause not in separated and all(
                    candidates.repeats(cause, other)[place] <= repeats for other in separated
                ):
                    separated.append(cause)
            chosen.append(candidates.next_traverse(place, repeats, tuple(separated)))
    return chosen


def make_next_traverse(forecast: Forecast, place: int, repeats: int, causes: tuple[str, ...]) -> NextTraverse:
    """A traverse of a forecast, to be made and calibrated `repeats` times, for some causes."""
    row = forecast.traverses.iloc[place]
    longest = np.abs(forecast.traverses["stop"] - forecast.traverses["start"]).max()
    whole = abs(row["stop"] - row["start"]) > longest * (1 - RANGE_TOL)
    return NextTraverse(
        session="new",
        joint=int(row["joint"]),
        direction=str(row["direction"]),
        **{name: float(row[name]) for name in ("q1", "q2", "q3", "theta", "psi")},
        start=np.nan if whole else float(row["start"]),
        stop=np.nan if whole else float(row["stop"]),
        repeats=repeats,
        tells_apart=causes,
        note=str(row["note"]) + (f"; calibrate {repeats} times too" if repeats > 1 else ""),
    )


@dataclass(frozen=True)
class UntestableCause:
    """A cause that a log could not show.

    Attributes
    ----------
    shows_best : str
        The kind of traverse that shows it.
    traverse : NextTraverse or None
        The quickest at its largest plausible size; None where no single traverse shows it.
    seconds : float
        Duration with its repeats.
    """

    cause: str
    reason: str
    shows_best: str
    traverse: NextTraverse | None
    seconds: float


def suggest_traverses(
    diagnosis: Diagnosis, causes: Iterable[Cause] | None = None
) -> tuple[UntestableCause, ...]:
    """Traverses that would make untestable causes testable, the quickest first.

    Parameters
    ----------
    causes : iterable of Cause, optional
        Without it the library and the lab's own columns.

    Raises
    ------
    InputError
        If the data were no log.
    """
    problem, machine = diagnosis.selection.problem, diagnosis.require_log().machine
    rows, forecasts = problem.rows, forecast_candidates(problem, machine)
    suggestions = []
    for cause in (*library(), *covariates(rows)) if causes is None else causes:
        if cause.name in diagnosis.untestable:
            measured = all(
                name in rows and rows[name].notna().any() for name in set(cause.columns) - POSITION_COLUMNS
            )
            traverse, seconds = None, np.inf
            if measured:
                traverse, seconds = _quickest_traverse(cause.bind(rows, machine), rows, forecasts)
            reason = diagnosis.untestable[cause.name]
            suggestions.append(UntestableCause(cause.name, reason, cause.shows_best, traverse, seconds))
    return tuple(sorted(suggestions, key=lambda suggestion: suggestion.seconds))


def _quickest_traverse(
    cause: Cause, rows: pd.DataFrame, forecasts: Sequence[Forecast]
) -> tuple[NextTraverse | None, float]:
    best, least = None, np.inf
    for forecast in forecasts:
        if cause.acts_on(forecast.law):
            strength = _min_strength(cause, forecast, rows)
            with np.errstate(divide="ignore"):
                repeats = np.ceil((DETECTION_STRENGTH / strength) ** 2)
            time = np.where(repeats <= MAX_REPEATS, forecast.wait + repeats * forecast.seconds, np.inf)
            place = choose_place(time, strength)
            if place is not None and time[place] < least:
                least = float(time[place])
                best = make_next_traverse(forecast, place, int(repeats[place]), (cause.name,))
    return best, least


def _min_strength(cause: Cause, forecast: Forecast, rows: pd.DataFrame) -> Array:
    """Of the cause's largest plausible effect in one reading of each traverse, minimum over shapes, (m,)."""
    shapes = (
        [(cause, np.array(cause.largest_plausible()))] if cause.largest_plausible() else cause.trials(rows)
    )
    effects = [
        np.abs(forecast.predict_effect(version.extend(forecast.law), sizes))
        for version, values in shapes
        for sizes in values
    ]
    return (
        np.min(effects, axis=0) / np.sqrt(forecast.variance) if effects else np.zeros(len(forecast.traverses))
    )
