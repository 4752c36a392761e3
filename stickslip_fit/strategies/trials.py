"""Every strategy calibrates every session from its own traverses only, and predicts all others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.fit.closed_form import ENOUGH
from stickslip_fit.fit.groups import usable_rows
from stickslip_fit.fit.least_squares import fit_joint
from stickslip_fit.fit.repeatability import from_replicates
from stickslip_fit.laws import StepLaw, expected_steps, published_law, travel
from stickslip_fit.logs import Log
from stickslip_fit.strategies.at_hand import AtHand
from stickslip_fit.strategies.cost import stepping_seconds
from stickslip_fit.strategies.task import Strategy, Task, Unsuited, first_of_each

WHERE = ["q1", "q2", "q3", "theta", "psi", "start", "stop"]


@dataclass(frozen=True, eq=False)
class Trial:
    """A task, with all that was measured in its session.

    Attributes
    ----------
    task : Task
    rows : DataFrame
        Every usable traverse of the joint and direction, counts included.
    """

    task: Task
    rows: pd.DataFrame


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What came of all trials; SI.

    Attributes
    ----------
    errors : DataFrame
        Of each strategy, each traverse that it did not calibrate from: strategy, traverse (its place among
        the log's usable ones), session, joint, direction, where everything stood, measured and predicted
        mean step size, and sd, the relative standard deviation of what is predicted.
    spent : DataFrame
        strategy, session, joint, direction; traverses, steps and seconds of stepping.
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    """

    errors: pd.DataFrame
    spent: pd.DataFrame
    left_out: pd.DataFrame


def trials_of(log: Log, at_hand: AtHand) -> Iterator[Trial]:
    """One for each joint, session and direction of a log.

    Raises
    ------
    InputError
        If the log has no usable traverse, or a joint none that repeats or is left over by a fit.
    """
    rows = usable_rows(log)
    for joint in log.joints:
        mine = rows[rows["joint"] == joint]
        if mine.empty:
            continue
        law = published_law(joint, mine, log.machine)
        noise = _repeatability(law, mine, log)
        for direction in ("+", "-"):
            yield from _of_direction(log, law, mine[mine["direction"] == direction], noise, at_hand)


def attempt_all(trials: Sequence[Trial], strategies: Sequence[Strategy]) -> Outcomes:
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
                made, predicted = _attempt(strategy, trial)
            except Unsuited as why:
                left_out.append({**label, "reason": str(why)})
                continue
            errors.append(predicted.assign(strategy=strategy.name))
            seconds, steps = float(stepping_seconds(made).sum()), int(made["steps"].sum())
            spent.append({**label, "traverses": len(made), "steps": steps, "seconds": seconds})
    return Outcomes(
        pd.concat(errors, ignore_index=True) if errors else _no_errors(),
        pd.DataFrame(spent, columns=[*_LABEL, "traverses", "steps", "seconds"]),
        pd.DataFrame(left_out, columns=[*_LABEL, "reason"]),
    )


_LABEL = ("strategy", "session", "joint", "direction")
_ERRORS = ["traverse", "session", "joint", "direction", *WHERE, "measured", "predicted", "sd"]


def _no_errors() -> pd.DataFrame:
    return pd.DataFrame(columns=[*_ERRORS, "strategy"])


def _of_direction(
    log: Log, law: StepLaw, rows: pd.DataFrame, noise: dict[str, float], at_hand: AtHand
) -> Iterator[Trial]:
    for session in rows["session"].unique():
        mine = rows[rows["session"] == session]
        direction = str(mine["direction"].iloc[0])
        offered = first_of_each(mine).drop(columns="steps")
        others = rows[rows["session"].isin(at_hand(log.sessions, session))]
        task = Task(session, direction, law, log.machine, offered, others, noise[direction])
        yield Trial(task, mine)


def chosen_by(strategy: Strategy, task: Task) -> npt.NDArray[np.intp]:
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


def _attempt(strategy: Strategy, trial: Trial) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The traverses made, and what is predicted of the others."""
    task = trial.task
    made = trial.rows.loc[task.offered.index[chosen_by(strategy, task)]]
    held_out = trial.rows.drop(index=made.index)
    try:
        mean, sd = strategy.calibrate(task, made)(held_out)
    except InputError as why:
        raise Unsuited(str(why)) from None
    if not np.all(np.isfinite(mean)):
        raise Unsuited("its law would stall in a traverse that is to be predicted")
    seen = expected_steps(held_out["steps"], held_out["check_every"])
    table = held_out[["session", "joint", "direction", *WHERE]].assign(
        traverse=held_out.index,
        measured=travel(held_out) / seen,
        predicted=travel(held_out) / np.exp(np.asarray(mean)),
        sd=np.asarray(sd),
    )
    return made, table[_ERRORS]


def _repeatability(law: StepLaw, rows: pd.DataFrame, log: Log) -> dict[str, float]:
    """Of each direction, from replicates where there are enough, else from what a fit leaves over."""
    replicates = from_replicates(law, rows)
    left_over = fit_joint(law, rows, log.machine)[0].repeatability
    found = {
        way: replicates[way] if replicates[way].freedom >= ENOUGH else left_over[way]
        for way in rows["direction"].unique()
    }
    known = {way: each.value for way, each in found.items() if each.freedom > 0 and each.value > 0}
    if not known:
        raise InputError(
            f"joint {law.joint}: nothing shows how well a traverse repeats, so that no difference between "
            "strategies could be judged; log some traverses twice"
        )
    # A direction of which nothing is known borrows the other's.
    return {way: known.get(way, float(np.mean(list(known.values())))) for way in found}
