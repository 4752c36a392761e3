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

from stickslip_fit.errors import InputError
from stickslip_fit.estimation._optimize import usable_rows
from stickslip_fit.estimation.closed_form import MIN_DF
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.estimation.noise import estimate_from_replicates
from stickslip_fit.laws import StepLaw, expected_steps, published_law, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.strategies.base import (
    CalibrationTask,
    NotApplicable,
    SessionSelector,
    Strategy,
    select_first_traverses,
    stepping_seconds,
)

POSITION_COLUMNS = ["q1", "q2", "q3", "theta", "psi", "start", "stop"]


@dataclass(frozen=True, eq=False)
class EvaluationCase:
    """A task, with all that was measured in its session.

    Attributes
    ----------
    task : Task
    rows : DataFrame
        Every usable traverse of the joint and direction, counts included.
    """

    task: CalibrationTask
    rows: pd.DataFrame


@dataclass(frozen=True, eq=False)
class EvaluationTables:
    """What came of all trials; SI.

    Attributes
    ----------
    errors : DataFrame
        Of each strategy, each traverse that it did not calibrate from: strategy, traverse (its place among
        the log's usable ones), session, joint, direction, where everything stood, measured and predicted
        mean step size, and sd, the relative standard deviation of what is predicted.
    costs : DataFrame
        strategy, session, joint, direction; traverses, steps and seconds of stepping.
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    """

    errors: pd.DataFrame
    costs: pd.DataFrame
    left_out: pd.DataFrame


def make_cases(log: Log, session_selector: SessionSelector) -> Iterator[EvaluationCase]:
    """One for each joint, session and direction of a log.

    Raises
    ------
    InputError
        If the log has no usable traverse, or a joint none that repeats or is left over by a fit.
    """
    rows = usable_rows(log)
    for joint in log.joints:
        subset = rows[rows["joint"] == joint]
        if subset.empty:
            continue
        law = published_law(joint, subset, log.machine)
        noise = _estimate_repeatability(law, subset, log)
        for direction in ("+", "-"):
            yield from _cases_of_direction(
                log, law, subset[subset["direction"] == direction], noise, session_selector
            )


def evaluate_strategies(trials: Sequence[EvaluationCase], strategies: Sequence[Strategy]) -> EvaluationTables:
    """Let every strategy calibrate in every trial.

    Raises
    ------
    InputError
        If a strategy chooses what is not offered.
    """
    errors, spent, left_out = [], [], []
    for trial in trials:
        task = trial.task
        for strategy in strategies:
            label = {
                "strategy": strategy.name, "session": task.session,
                "joint": task.law.joint, "direction": task.direction,
            }  # fmt: skip
            try:
                made, predicted = _evaluate_case(strategy, trial)
            except NotApplicable as why:
                left_out.append({**label, "reason": str(why)})
                continue
            errors.append(predicted.assign(strategy=strategy.name))
            seconds, steps = float(stepping_seconds(made).sum()), int(made["steps"].sum())
            spent.append({**label, "traverses": len(made), "steps": steps, "seconds": seconds})
    return EvaluationTables(
        pd.concat(errors, ignore_index=True) if errors else _empty_errors(),
        pd.DataFrame(spent, columns=[*_LABEL_COLUMNS, "traverses", "steps", "seconds"]),
        pd.DataFrame(left_out, columns=[*_LABEL_COLUMNS, "reason"]),
    )


_LABEL_COLUMNS = ("strategy", "session", "joint", "direction")
_ERROR_COLUMNS = [
    "traverse",
    "session",
    "joint",
    "direction",
    *POSITION_COLUMNS,
    "measured",
    "predicted",
    "sd",
]


def _empty_errors() -> pd.DataFrame:
    return pd.DataFrame(columns=[*_ERROR_COLUMNS, "strategy"])


def _cases_of_direction(
    log: Log, law: StepLaw, rows: pd.DataFrame, noise: dict[str, float], session_selector: SessionSelector
) -> Iterator[EvaluationCase]:
    for session in rows["session"].unique():
        subset = rows[rows["session"] == session]
        direction = str(subset["direction"].iloc[0])
        offered = select_first_traverses(subset).drop(columns="steps")
        others = rows[rows["session"].isin(session_selector(log.sessions, session))]
        task = CalibrationTask(session, direction, law, log.machine, offered, others, noise[direction])
        yield EvaluationCase(task, subset)


def choose_traverses(strategy: Strategy, task: CalibrationTask) -> npt.NDArray[np.intp]:
    """The traverses that a strategy chooses, as positions among those offered.

    Raises
    ------
    Unsuited
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


def _evaluate_case(strategy: Strategy, trial: EvaluationCase) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The traverses made, and what is predicted of the others."""
    task = trial.task
    made = trial.rows.loc[task.offered.index[choose_traverses(strategy, task)]]
    held_out = trial.rows.drop(index=made.index)
    try:
        mean, sd = strategy.calibrate(task, made)(held_out)
    except InputError as why:
        raise NotApplicable(str(why)) from None
    if not np.all(np.isfinite(mean)):
        raise NotApplicable("its law would stall in a traverse that is to be predicted")
    seen = expected_steps(held_out["steps"], held_out["check_every"])
    table = held_out[["session", "joint", "direction", *POSITION_COLUMNS]].assign(
        traverse=held_out.index,
        measured=traverse_length(held_out) / seen,
        predicted=traverse_length(held_out) / np.exp(np.asarray(mean)),
        sd=np.asarray(sd),
    )
    return made, table[_ERROR_COLUMNS]


def _estimate_repeatability(law: StepLaw, rows: pd.DataFrame, log: Log) -> dict[str, float]:
    """Of each direction, from replicates where there are enough, else from what a fit leaves over."""
    replicates = estimate_from_replicates(law, rows)
    left_over = fit_joint(law, rows, log.machine)[0].repeatability
    found = {
        direction: replicates[direction] if replicates[direction].df >= MIN_DF else left_over[direction]
        for direction in rows["direction"].unique()
    }
    known = {direction: each.value for direction, each in found.items() if each.df > 0 and each.value > 0}
    if not known:
        raise InputError(
            f"joint {law.joint}: nothing shows how well a traverse repeats, so that no difference between "
            "strategies could be judged; log some traverses twice"
        )
    # A direction of which nothing is known borrows the other's.
    return {direction: known.get(direction, float(np.mean(list(known.values())))) for direction in found}
