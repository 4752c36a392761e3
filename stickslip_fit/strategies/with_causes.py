"""The extended law: what other sessions, or a diagnosis of another log, know of causes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError
from stickslip_fit.fit import Result, least_squares
from stickslip_fit.fit.closed_form import ENOUGH
from stickslip_fit.fit.known_causes import APART, HeldLaw, KnownCauses, known_causes
from stickslip_fit.fit.repeatability import pooled
from stickslip_fit.logs import Log
from stickslip_fit.strategies.at_hand import AtHand, other_sessions
from stickslip_fit.strategies.solve import solve, spread
from stickslip_fit.strategies.task import Predictor, Strategy, Task, Unsuited

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Predictions with one cause's size a little larger and a little smaller.

    Attributes
    ----------
    place : int
        Of the size among the causes' parameters.
    apart : float
        Between the two sizes, SI.
    ahead, behind : callable
    """

    place: int
    apart: float
    ahead: Predictor
    behind: Predictor


@dataclass(frozen=True, eq=False)
class WithCauses:
    """Another strategy, with causes of known size in the law.

    Attributes
    ----------
    strategy : Strategy
        Calibrates what the law has of its own.
    known : mapping of str to KnownCauses or str
        By session, from what it was not part of; or why that could not be known. What is not sure of them
        goes into the standard deviations of what is predicted, and what they explain leaves the scatter.
    """

    strategy: Strategy
    known: Mapping[str, KnownCauses | str]

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"{self.strategy.name}, with causes"

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return self.strategy.choose(replace(task, law=_held(task, self._known(task))))

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        known = self._known(task)
        repeatability = _repeatability(_held(task, known), task)

        def calibrated(sizes: Array) -> Predictor:
            law = HeldLaw(task.law, known.causes, sizes)
            return self.strategy.calibrate(replace(task, law=law, repeatability=repeatability), made)

        return _unsure(known, calibrated(known.values), _neighbours(task, known, calibrated))

    def _known(self, task: Task) -> KnownCauses:
        known = self.known[task.session]
        if isinstance(known, str):
            raise Unsuited(known)
        return known


def _held(task: Task, known: KnownCauses) -> HeldLaw:
    return HeldLaw(task.law, known.causes, known.values)


def _repeatability(law: HeldLaw, task: Task) -> float:
    """What is left of the scatter with the causes in the law.

    Replicates hours apart also hold what the causes did between them, and what the law leaves over of the
    other sessions also holds what it lacks: the scatter is no larger than either.
    """
    if task.others.empty:
        return task.repeatability
    found = solve(law, task.others, task.repeatability)
    y, rounding = law.response(task.others)
    residual = y - law.predict(task.others, found.values[found.groups.of_row])
    freedom = int(len(y) - found.known.sum())
    left_over = pooled(residual, rounding, freedom, "residuals")
    return min(task.repeatability, left_over.value) if left_over.freedom >= ENOUGH else task.repeatability


def _neighbours(task: Task, known: KnownCauses, calibrated: Callable[[Array], Predictor]) -> list[Neighbour]:
    """What would be predicted if each size that has an error bar were a little different.

    The calibration is made again: what a wrong size does to the traverses to predict, it did to those that
    were calibrated from, too.
    """
    scales = _held(task, known).extended.sizes
    found = []
    for k in np.flatnonzero(np.diagonal(known.covariance) != 0):
        step = APART * scales[k]
        aside = step * (np.arange(len(scales)) == k)
        ahead, behind = (calibrated(known.values + way * aside) for way in (1, -1))
        found.append(Neighbour(int(k), 2 * step, ahead, behind))
    return found


def _unsure(known: KnownCauses, middle: Predictor, neighbours: Sequence[Neighbour]) -> Predictor:
    def predict(rows: pd.DataFrame) -> tuple[Array, Array]:
        mean, sd = middle(rows)
        slopes = np.zeros((len(rows), len(known.values)))
        for near in neighbours:
            slopes[:, near.place] = (near.ahead(rows)[0] - near.behind(rows)[0]) / near.apart
        return mean, np.hypot(sd, spread(slopes, known.covariance))

    return predict


def from_other_sessions(
    log: Log, causes: Sequence[Cause], at_hand: AtHand = other_sessions
) -> dict[str, KnownCauses | str]:
    """Fit causes on the sessions that each session may look back on.

    Parameters
    ----------
    log : Log
    causes : sequence of Cause
        Such as a diagnosis named.
    at_hand : callable, optional
        Which sessions these are.
    """
    known: dict[str, KnownCauses | str] = {}
    for session in log.sessions:
        others = at_hand(log.sessions, session)
        if not others:
            known[session] = "there is no other session to fit its causes on"
            continue
        try:
            fitted = least_squares(log.select(log.rows["session"].isin(others)), causes=causes)
            known[session] = known_causes(fitted)
        except InputError as error:
            known[session] = f"its causes cannot be fitted on the other sessions: {error}"
    return known


def from_result(log: Log, result: Result) -> dict[str, KnownCauses | str]:
    """Take the causes of a saved result for known in every session.

    Raises
    ------
    InputError
        If it was fitted to this very log, is of another machine, or knows no causes.
    """
    if result.provenance.log_sha256 == log.sha256:
        raise InputError(
            "the causes of this result were fitted to the traverses that they would be judged by; name them "
            "with --cause, so that they are fitted to the other sessions, or take a result of another log"
        )
    if result.machine.sha256 != log.machine.sha256:
        raise InputError("the causes were fitted for another machine; read the log with that one")
    return dict.fromkeys(log.sessions, known_causes(result))
