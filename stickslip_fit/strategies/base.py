"""Strategy, the interface of calibration strategies: what one is given, returns and costs.

A strategy chooses among the traverses that a session offers before any count is known, then returns a
predictor of log(steps) with its standard deviation. `solve_law` fits a law with known noise;
`LawSolution` holds the inverse of the Fisher information.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.estimation._groups import Groups, group_rows, mean_step_sizes
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, JointProblem, single_problem
from stickslip_fit.estimation.closed_form import pick_calibration
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.estimation.noise import configuration_columns
from stickslip_fit.estimation.with_causes import FixedCauseLaw, FixedCauses
from stickslip_fit.laws import StepLaw
from stickslip_fit.laws.base import Model
from stickslip_fit.logs.plan import Timing
from stickslip_fit.machine import Machine

SessionSelector = Callable[[Sequence[str], str], tuple[str, ...]]
"""From all sessions in order of time, and one of them, to those that its calibration may use."""


def other_sessions(sessions: Sequence[str], session: str) -> tuple[str, ...]:
    """All but itself: right where sessions differ at random, and most data from a short log."""
    return tuple(other for other in sessions if other != session)


def earlier_sessions(sessions: Sequence[str], session: str) -> tuple[str, ...]:
    """Those before it, which are known on the day."""
    return tuple(sessions[: list(sessions).index(session)])


def stepping_seconds(rows: pd.DataFrame) -> Array:
    """Steps times step period, shape (n,); the default period of plans where the log has none."""
    return rows["steps"].to_numpy(float) * rows["step_period"].fillna(Timing().step_period).to_numpy(float)


def handling_seconds(rows: pd.DataFrame) -> float:
    """Median time from the end of a traverse to the beginning of the next in its session; 0 for one traverse.

    The rows are all of a log, in order of time. The median does not depend on a few long breaks.

    Examples
    --------
    >>> times = pd.to_datetime(["2012-03-05T09:00:00", "2012-03-05T09:03:00", "2012-03-05T09:05:00"])
    >>> rows = pd.DataFrame({"session": "Mon", "time": times, "steps": 10_000, "step_period": 0.01})
    >>> handling_seconds(rows)
    50.0
    """
    following = rows["session"].to_numpy()[1:] == rows["session"].to_numpy()[:-1]
    spacing = rows["time"].diff().dt.total_seconds().to_numpy()[1:]
    idle = (spacing - stepping_seconds(rows)[:-1])[following]
    return float(np.median(np.maximum(idle, 0.0))) if len(idle) else 0.0


@dataclass(frozen=True, eq=False)
class LawSolution:
    """Least squares with known repeatability.

    Attributes
    ----------
    groups : Groups
        Of session and direction.
    values : array, shape (g, p)
        Parameters, SI.
    known : array of bool, shape (g, p)
        Which of them are identifiable.
    covariance : array, shape (g, p, p)
        The inverse of the Fisher information.
    """

    groups: Groups
    values: Array
    known: BoolArray
    covariance: Array

    def select(self, some: BoolArray) -> LawSolution:
        """That of some of the groups."""
        parts = self.values[some], self.known[some], self.covariance[some]
        return LawSolution(self.groups.select(some), *parts)


def solve_law(law: StepLaw, rows: pd.DataFrame, repeatability: float) -> LawSolution:
    """Fit a law to rows, each session and direction by itself.

    With as many traverses as parameters, the solution is that of the closed form.

    Parameters
    ----------
    rows : DataFrame, n rows of one joint
    repeatability : float
        Standard deviation of log(steps); the counts' rounding comes on top.
    """
    return _solve(single_problem(law, rows, DEFAULT_OPTIONS), repeatability)


def _solve(problem: JointProblem, repeatability: Array | float) -> LawSolution:
    minimum = problem.minimize(1.0 / (repeatability**2 + problem.rounding), problem.start)
    known, _, covariance = identifiable_parameters(minimum.curvature, problem.scales)
    return LawSolution(problem.groups, minimum.values, known & minimum.converged[:, None], covariance)


def response_sd(jacobian: Array, covariance: Array) -> Array:
    """Standard deviation of responses under uncertain parameters, (n, p) and (p, p) -> (n,)."""
    return np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance, jacobian))


Predictor = Callable[[pd.DataFrame], tuple[Array, Array]]
"""From rows of a log to the mean of log(steps) and its standard deviation without repeatability; (n,)."""


class NotApplicable(Exception):
    """A strategy cannot calibrate this session; the message says why, and what it would need."""


@dataclass(frozen=True, eq=False)
class SessionSolutions:
    """A law fitted to each session of a direction, which the tasks of these sessions have in common."""

    law: StepLaw
    rows: pd.DataFrame
    repeatability: float

    @cached_property
    def solution(self) -> LawSolution:
        """All of them, once one is asked for."""
        return solve_law(self.law, self.rows, self.repeatability)


@dataclass(frozen=True, eq=False)
class CalibrationTask:
    """One joint and direction of a session that is to be calibrated.

    Attributes
    ----------
    direction : {"+", "-"}
    law : StepLaw
        The published one of the joint, or its replacement.
    offered : DataFrame
        The first traverse of each of the session's configurations, in order of time and without the counts.
    others : DataFrame
        All usable traverses, counts included, of the other sessions that the calibration may use.
    repeatability : float
        Standard deviation of log(steps), as the lab knows it.
    by_session : SessionSolutions, optional
        Of all sessions of the joint and direction, by the joint's law without causes.
    """

    session: str
    direction: str
    law: StepLaw
    machine: Machine
    offered: pd.DataFrame
    others: pd.DataFrame
    repeatability: float
    by_session: SessionSolutions | None = None

    @cached_property
    def nominal(self) -> tuple[Array, Array]:
        """Parameters to linearize a design at, and their scales, each shape (p,).

        The mean over the other sessions in which all parameters are identifiable; without any, those of a
        constant step of length one: a traverse's information does not depend on the length of a step.
        """
        if len(self.others):
            solution = self.solution_of_others
            if solution.known.all(axis=1).any():
                values = solution.values[solution.known.all(axis=1)].mean(axis=0)
                y, _ = self.law.response(self.others)
                step = mean_step_sizes(solution.groups, self.others, y).mean(keepdims=True)
                return values, self.law.scales(step)[0]
        one = np.ones(1)
        return self.law.start_values(one)[0], self.law.scales(one)[0]

    @cached_property
    def scaled_jacobian(self) -> Array:
        """Change of each offered traverse's response with each parameter in units of its scale, (n, p)."""
        values, scales = self.nominal
        return (
            self.law.jacobian(self.offered, np.broadcast_to(values, (len(self.offered), len(values))))
            * scales
        )

    @cached_property
    def calibration_traverses(self) -> IntArray:
        """The law's own calibration: positions among those offered, shape (p,); -1 for none."""
        return pick_calibration(self.law, self.offered, group_rows(self.offered), self.machine)[0]

    @cached_property
    def solution_of_others(self) -> LawSolution:
        """The law fitted to the other sessions, each by itself."""
        if self.by_session is None or self.by_session.law is not self.law:
            return solve_law(self.law, self.others, self.repeatability)
        solution = self.by_session.solution
        return solution.select(solution.groups.table["session"].isin(self.others["session"]).to_numpy())

    def with_causes(self, known: FixedCauses) -> CalibrationTask:
        """The same task with causes of known size in the law; the same one each time."""
        if known not in self._with_causes:
            self._with_causes[known] = replace(self, law=FixedCauseLaw(self.law, known.causes, known.values))
        return self._with_causes[known]

    @cached_property
    def _with_causes(self) -> dict[FixedCauses, CalibrationTask]:
        return {}


class Strategy(Protocol):
    """A calibration method: any object with a name and these two methods.

    Examples
    --------
    The mean step of the first traverse:

    >>> class FirstOfAll:
    ...     name = "first traverse"
    ...     def choose(self, task):
    ...         return np.array([0])
    ...     def calibrate(self, task, made):
    ...         step = abs(made["stop"] - made["start"]).sum() / made["steps"].sum()
    ...         return lambda rows: (np.log(abs(rows["stop"] - rows["start"]) / step), np.zeros(len(rows)))
    """

    @property
    def name(self) -> str:
        """In tables and figures; different for all strategies of a comparison."""
        ...

    def choose(self, task: CalibrationTask) -> IntArray:
        """Traverses to measure, as positions among those offered.

        Raises
        ------
        NotApplicable
            If the session does not offer what the strategy needs.
        """
        ...

    def calibrate(self, task: CalibrationTask, measured: pd.DataFrame) -> Predictor:
        """A predictor of the session's other traverses from the chosen ones, now with their counts.

        Raises
        ------
        NotApplicable
            If they do not determine the parameters.
        """
        ...


def select_first_traverses(rows: pd.DataFrame) -> pd.DataFrame:
    """The earliest traverse of each configuration."""
    return rows[~rows[configuration_columns(rows)].round(9).duplicated()]


@dataclass(frozen=True, eq=False)
class LawEstimate:
    """Parameters, shape (p,), which of them are known, and their covariance, (p, p), of one fit."""

    values: Array
    known: BoolArray
    covariance: Array


class Fit(Protocol):
    """A fit of a law in one session and direction."""

    @property
    def law(self) -> StepLaw:
        """The law."""
        ...

    @classmethod
    def solve(cls, fits: Sequence[Any]) -> list[LawEstimate]:
        """Solve some of this kind in one go, each by itself; their laws differ in sizes of causes only."""
        ...


@dataclass(frozen=True, eq=False)
class LawFit:
    """A least-squares fit to the traverses that were measured in one session and direction.

    Attributes
    ----------
    repeatability : float
        Standard deviation of log(steps); the counts' rounding comes on top.
    """

    law: StepLaw
    measured: pd.DataFrame
    repeatability: float

    @classmethod
    def solve(cls, fits: Sequence[LawFit]) -> list[LawEstimate]:
        """See `Fit.solve`."""
        laws, number = [fit.law for fit in fits], repeat_numbers([fit.measured for fit in fits])
        rows = pd.concat([fit.measured for fit in fits])
        # A number for the session makes each fit a group of its own; causes may act in a session by name.
        problem = single_problem(laws[0], rows.assign(session=number), DEFAULT_OPTIONS)

        def model(some: IntArray) -> Model:
            return join_family(laws, number[some]).model(rows.iloc[some])

        problem = replace(problem, model=model(np.arange(len(rows))), subset=model)
        solution = _solve(problem, np.array([fit.repeatability for fit in fits])[number])
        found = zip(solution.values, solution.known, solution.covariance, strict=True)
        return [LawEstimate(*each) for each in found]


@dataclass(frozen=True, eq=False)
class CalibrationPlan:
    """The fits that a calibration takes, and how its predictor follows from them.

    Plans of many calibrations are made first, so that all their fits can be solved together.

    Attributes
    ----------
    finish : callable
        From an estimate for each fit to the predictor; may raise NotApplicable.
    """

    fits: Sequence[Fit]
    finish: Callable[[Sequence[LawEstimate]], Predictor]

    def calibrate(self) -> Predictor:
        """The predictor.

        Raises
        ------
        NotApplicable
            If the traverses do not determine the parameters.
        """
        return self.finish(solve_together(self.fits))


class PlannedStrategy(Strategy, ABC):
    """A strategy that calibrates by least squares, whose fits can be solved together with those of others."""

    @abstractmethod
    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        """The plan of `calibrate`, which may raise NotApplicable."""

    def calibrate(self, task: CalibrationTask, measured: pd.DataFrame) -> Predictor:
        return self.plan(task, measured).calibrate()


def plan_calibration(strategy: Strategy, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
    """The plan of a strategy that has one; any other calibrates by itself, when the plan is finished."""
    if isinstance(strategy, PlannedStrategy) and type(strategy).calibrate is PlannedStrategy.calibrate:
        return strategy.plan(task, measured)
    return CalibrationPlan((), lambda _: strategy.calibrate(task, measured))


def plan_law(law: StepLaw, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
    """Predict by a law fitted to the measured traverses."""

    def finish(estimates: Sequence[LawEstimate]) -> Predictor:
        (estimate,) = estimates
        if not estimate.known.all():
            undetermined = ", ".join(
                parameter.name
                for parameter, known in zip(law.parameters, estimate.known, strict=True)
                if not known
            )
            raise NotApplicable(f"its {len(measured)} traverses leave {undetermined} open")
        return UncertainLaw(law, estimate.values, estimate.covariance)

    return CalibrationPlan((LawFit(law, measured, task.repeatability),), finish)


def solve_together(fits: Sequence[Fit]) -> list[LawEstimate]:
    """Solve each fit by itself; those of one kind and law, or law with the same fixed causes, in one go."""
    estimates: dict[int, LawEstimate] = {}
    kinds: dict[type[Fit], None] = dict.fromkeys(map(type, fits))
    for kind in kinds:
        places = [place for place, fit in enumerate(fits) if type(fit) is kind]
        for family in _group_families([fits[place].law for place in places]):
            own = [places[k] for k in family]
            estimates |= dict(zip(own, kind.solve([fits[place] for place in own]), strict=True))
    return [estimates[place] for place in range(len(fits))]


def _group_families(laws: Sequence[StepLaw]) -> list[list[int]]:
    """Positions of those that are one law, or one law with the same causes of other sizes."""
    places: dict[tuple[int, ...], list[int]] = {}
    for place, law in enumerate(laws):
        causes = law.extended if isinstance(law, FixedCauseLaw) else None
        family = (id(law),) if causes is None else (id(causes.law), id(causes.causes))
        places.setdefault(family, []).append(place)
    return list(places.values())


def join_family(laws: Sequence[StepLaw], number: IntArray) -> StepLaw:
    """The law of rows that are each of the law with their number, shape (n,); one family."""
    first = laws[0]
    if not isinstance(first, FixedCauseLaw):
        return first
    sizes = np.array([law.sizes for law in laws if isinstance(law, FixedCauseLaw)])
    return FixedCauseLaw(first.law, first.extended.causes, sizes[number])


def repeat_numbers(tables: Sequence[pd.DataFrame]) -> IntArray:
    """The number of each row's table."""
    return np.repeat(np.arange(len(tables)), [len(table) for table in tables])


@dataclass(frozen=True, eq=False)
class UncertainLaw:
    """A `Predictor` by parameters, shape (p,), that are uncertain by a covariance, shape (p, p)."""

    law: StepLaw
    values: Array
    covariance: Array

    def __call__(self, rows: pd.DataFrame) -> tuple[Array, Array]:
        """See `Predictor`."""
        return predict_together([self], rows)[0]


@dataclass(frozen=True, eq=False)
class CombinedPredictor:
    """A `Predictor` that makes one prediction of those by several laws."""

    parts: Sequence[UncertainLaw]
    combine: Callable[[Sequence[tuple[Array, Array]]], tuple[Array, Array]]

    def __call__(self, rows: pd.DataFrame) -> tuple[Array, Array]:
        """See `Predictor`."""
        return predict_together([self], rows)[0]


def predict_together(
    predictors: Sequence[UncertainLaw | CombinedPredictor], rows: pd.DataFrame
) -> list[tuple[Array, Array]]:
    """What each predicts of the same rows; one law, or one law with the same fixed causes, in one go."""
    parts = [one.parts if isinstance(one, CombinedPredictor) else [one] for one in predictors]
    laws = [part for own in parts for part in own]
    found: dict[int, tuple[Array, Array]] = {}
    for own in _group_families([part.law for part in laws]):
        family = [laws[place] for place in own]
        number, row = np.divmod(np.arange(len(own) * len(rows)), len(rows))
        law = join_family([part.law for part in family], number)
        response, jacobian = law.model(rows.iloc[row])(np.array([part.values for part in family])[number])
        each = zip(np.split(response, len(own)), np.split(jacobian, len(own)), family, strict=True)
        predicted = [(mean, response_sd(slopes, part.covariance)) for mean, slopes, part in each]
        found |= dict(zip(own, predicted, strict=True))
    each_part = iter(found[place] for place in range(len(laws)))
    by_predictor = [[next(each_part) for _ in own] for own in parts]
    return [
        one.combine(own) if isinstance(one, CombinedPredictor) else own[0]
        for one, own in zip(predictors, by_predictor, strict=True)
    ]
