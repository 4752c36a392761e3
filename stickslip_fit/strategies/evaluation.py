"""Evaluates strategies on a log: each calibrates every session and predicts its other traverses.

An `EvaluationCase` is one session, joint and direction. The result is one table each of errors, costs,
and cases that a strategy cannot calibrate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._progress import ProgressCallback, ignore_progress
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.closed_form import solve_calibration
from stickslip_fit.estimation.result import JointFit
from stickslip_fit.laws import Laws, StepLaw, choose_laws, expected_steps, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.strategies.base import (
    CalibrationPlan,
    CalibrationTask,
    CombinedPredictor,
    LawEstimate,
    NotApplicable,
    Predictor,
    SessionSelector,
    SessionSolutions,
    Strategy,
    UncertainLaw,
    plan_calibration,
    predict_together,
    select_first_traverses,
    solve_together,
    stepping_seconds,
)

PLANNING_SHARE = 0.4  # of the time
POSITION_COLUMNS = ["q1", "q2", "q3", "theta", "psi", "start", "stop"]


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """A task, with every usable traverse of its session, joint and direction, counts included."""

    task: CalibrationTask
    rows: pd.DataFrame


@dataclass(frozen=True, eq=False)
class EvaluationTables:
    """Results of all strategies in all cases; SI.

    Attributes
    ----------
    errors : DataFrame
        A row for each strategy and held-out traverse: strategy, traverse (index among the log's usable
        ones), session, joint, direction, the columns of its position, measured and predicted mean step
        size, and sd, the prediction's relative standard deviation.
    costs : DataFrame
        strategy, session, joint, direction; traverses, steps and seconds of stepping.
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    """

    errors: pd.DataFrame
    costs: pd.DataFrame
    left_out: pd.DataFrame


def make_cases(
    log: Log, session_selector: SessionSelector, laws: Laws | None = None
) -> Iterator[EvaluationCase]:
    """One for each joint, session and direction of a log; `laws` of your own as of `choose_laws`.

    Raises
    ------
    InputError
        If the log has no usable traverse, or a joint's repeatability cannot be estimated.
    """
    rows = usable_rows(log)
    # Plain text, and few blocks of columns, are selected, grouped and joined several times as fast.
    texts = [name for name in rows if isinstance(rows[name].dtype, pd.StringDtype | pd.CategoricalDtype)]
    rows = rows.astype(dict.fromkeys(texts, object)).copy()
    chosen = choose_laws(rows, log.machine, laws)
    calibration = solve_calibration(log, chosen, "closed-form")
    for joint, law in chosen.items():
        subset = rows[rows["joint"] == joint]
        noise = _choose_noise(law, calibration.joints[joint])
        for direction in ("+", "-"):
            own = subset[subset["direction"] == direction]
            by_session = SessionSolutions(law, own, noise[direction])
            for session in own["session"].unique():
                measured = own[own["session"] == session]
                offered = select_first_traverses(measured).drop(columns="steps")
                others = own[own["session"].isin(session_selector(log.sessions, session))]
                task = CalibrationTask(
                    session, direction, law, log.machine, offered, others, noise[direction], by_session
                )
                yield EvaluationCase(task, measured)


def evaluate_strategies(
    cases: Sequence[EvaluationCase],
    strategies: Sequence[Strategy],
    progress: ProgressCallback = ignore_progress,
) -> EvaluationTables:
    """Let every strategy calibrate every case and predict the traverses that it did not calibrate from.

    Raises
    ------
    InputError
        If a strategy chooses what is not offered.
    """
    planned = []
    for done, case in enumerate(cases):
        progress("choosing traverses by each strategy", PLANNING_SHARE * done / len(cases))
        planned.append([_plan(strategy, case) for strategy in strategies])
    made = [one for of_case in planned for one in of_case if isinstance(one, _Measurement)]
    estimates = iter(solve_together([fit for one in made for fit in one.plan.fits]))
    errors, costs, left_out = [], [], []
    for done, (case, of_case) in enumerate(zip(cases, planned, strict=True)):
        progress("calibrating by each strategy", PLANNING_SHARE + (1 - PLANNING_SHARE) * done / len(cases))
        predictions = []
        predictors = [_finish(one, estimates) for one in of_case]
        for strategy, one, found in zip(
            strategies, of_case, _predict(case, of_case, predictors), strict=True
        ):
            label = (strategy.name, case.task.session, case.task.law.joint, case.task.direction)
            if isinstance(one, NotApplicable) or isinstance(found, NotApplicable):
                left_out.append((*label, str(found)))
                continue
            predictions.append(_Prediction(strategy.name, *found))
            steps, seconds = int(one.traverses["steps"].sum()), float(stepping_seconds(one.traverses).sum())
            costs.append((*label, len(one.traverses), steps, seconds))
        if predictions:
            errors.append(_tabulate_errors(case, predictions))
    none = pd.DataFrame(columns=[*_ERROR_COLUMNS, "strategy"])
    return EvaluationTables(
        pd.concat(errors, ignore_index=True) if errors else none,
        pd.DataFrame(costs, columns=[*_LABEL_COLUMNS, "traverses", "steps", "seconds"]),
        pd.DataFrame(left_out, columns=[*_LABEL_COLUMNS, "reason"]),
    )


_LABEL_COLUMNS = ("strategy", "session", "joint", "direction")
_ERROR_COLUMNS = ["traverse", *_LABEL_COLUMNS[1:], *POSITION_COLUMNS, "measured", "predicted", "sd"]


def choose_traverses(strategy: Strategy, task: CalibrationTask) -> npt.NDArray[np.intp]:
    """The traverses that a strategy chooses, as positions among those offered.

    Raises
    ------
    NotApplicable
        If the session does not offer what it needs.
    InputError
        If it chooses one that is not offered, or one twice.
    """
    chosen = np.asarray(strategy.choose(task))
    if len(set(chosen.tolist())) < len(chosen) or not np.all(np.isin(chosen, np.arange(len(task.offered)))):
        raise InputError(
            f"strategy {strategy.name!r} chose traverses {chosen.tolist()}; each is to be one of "
            f"0 to {len(task.offered) - 1}, and none twice"
        )
    return chosen


@dataclass(frozen=True, eq=False)
class _Prediction:
    """What a strategy predicts of m traverses; `rows` are their positions among the case's.

    `response` is the mean of log(steps), `sd` its standard deviation, each shape (m,).
    """

    strategy: str
    rows: npt.NDArray[np.intp]
    response: npt.NDArray[np.float64]
    sd: npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Measurement:
    """The traverses that a strategy chose, their positions among the case's, and its plan."""

    chosen: npt.NDArray[np.intp]
    traverses: pd.DataFrame
    plan: CalibrationPlan


def _plan(strategy: Strategy, case: EvaluationCase) -> _Measurement | NotApplicable:
    """What a strategy measures in a case, or why it cannot."""
    task = case.task
    try:
        chosen = case.rows.index.get_indexer(task.offered.index[choose_traverses(strategy, task)])
    except NotApplicable as error:
        return error
    traverses = case.rows.iloc[chosen]
    try:
        return _Measurement(chosen, traverses, plan_calibration(strategy, task, traverses))
    except (NotApplicable, InputError) as error:
        return NotApplicable(str(error))


def _finish(
    measured: _Measurement | NotApplicable, estimates: Iterator[LawEstimate]
) -> Predictor | NotApplicable:
    """The predictor of a measurement, or why there is none; `estimates` begin with those of its fits."""
    if isinstance(measured, NotApplicable):
        return measured
    own = [next(estimates) for _ in measured.plan.fits]
    try:
        return measured.plan.finish(own)
    except (NotApplicable, InputError) as error:
        return NotApplicable(str(error))


def _predict(
    case: EvaluationCase,
    measured: Sequence[_Measurement | NotApplicable],
    predictors: Sequence[Predictor | NotApplicable],
) -> Iterator[tuple[npt.NDArray[np.intp], Array, Array] | NotApplicable]:
    """What each predicts of the traverses that it did not choose: their positions, responses and sd."""
    laws = [one for one in predictors if isinstance(one, UncertainLaw | CombinedPredictor)]
    try:
        together = dict(zip(map(id, laws), predict_together(laws, case.rows), strict=True))
    except InputError:  # of one of them, which each by itself will tell
        together = {}
    for measurement, predictor in zip(measured, predictors, strict=True):
        if isinstance(predictor, NotApplicable):
            yield predictor
            continue
        assert isinstance(measurement, _Measurement)
        others = np.delete(np.arange(len(case.rows)), measurement.chosen)
        try:
            if id(predictor) in together:
                mean, sd = (part[others] for part in together[id(predictor)])
            else:
                mean, sd = map(np.asarray, predictor(case.rows.iloc[others]))
        except (NotApplicable, InputError) as error:
            yield NotApplicable(str(error))
            continue
        if not np.all(np.isfinite(mean)):
            yield NotApplicable("its law would stall in a traverse that is to be predicted")
            continue
        yield others, mean, sd


def _tabulate_errors(case: EvaluationCase, predictions: Sequence[_Prediction]) -> pd.DataFrame:
    """The rows of `EvaluationTables.errors` of one case, one strategy after the other."""
    place = np.concatenate([one.rows for one in predictions])
    names = np.array([one.strategy for one in predictions], dtype=object)
    rows = case.rows.iloc[place]
    return rows[["session", "joint", "direction", *POSITION_COLUMNS]].assign(
        traverse=rows.index,
        measured=traverse_length(rows) / expected_steps(rows["steps"], rows["check_every"]),
        predicted=traverse_length(rows) / np.exp(np.concatenate([one.response for one in predictions])),
        sd=np.concatenate([one.sd for one in predictions]),
        strategy=np.repeat(names, [len(one.rows) for one in predictions]),
    )[[*_ERROR_COLUMNS, "strategy"]]


def _choose_noise(law: StepLaw, calibration: JointFit) -> dict[str, float]:
    """Scatter of a traverse in each direction; one without data takes the other's value."""
    known = {
        direction: level.value
        for direction, level in calibration.repeatability.items()
        if level.df > 0 and level.value > 0
    }
    if not known:
        raise InputError(
            f"joint {law.joint}: nothing shows how well a traverse repeats, so that no difference between "
            "strategies could be judged; log some traverses twice"
        )
    mean = float(np.mean(list(known.values())))
    return {direction: known.get(direction, mean) for direction in ("+", "-")}
