"""Calibration strategies compared on a measured log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stickslip_fit.errors import InputError
from stickslip_fit.fit.provenance import provenance
from stickslip_fit.logs import Log
from stickslip_fit.strategies.accuracy import CONFIGURATIONS, SESSIONS, with_errors
from stickslip_fit.strategies.at_hand import AtHand, other_sessions
from stickslip_fit.strategies.bound import bounds
from stickslip_fit.strategies.comparison import Comparison
from stickslip_fit.strategies.cost import handling_seconds
from stickslip_fit.strategies.paired import pair_up
from stickslip_fit.strategies.task import Strategy
from stickslip_fit.strategies.trials import Outcomes, Trial, attempt_all, trials_of

EVERYBODY = ""  # in place of a strategy, where something is said of all
NOTHING_LEFT = "no traverse is left that none of the strategies calibrates from"
BEYOND = 4  # traverses by which the bound goes on after the most that a strategy makes


def compare(
    log: Log, strategies: Sequence[Strategy], *, at_hand: AtHand = other_sessions, command: str = ""
) -> Comparison:
    """Let each strategy calibrate every session of a log from its own traverses, and predict all others.

    Only the first traverse of a configuration is there to be chosen, and its count is not known when it is.
    Errors are summed up over the sessions that all strategies can calibrate, and there over the traverses
    that none calibrates from, so that all are judged by the same. A strategy that suits no session of a joint
    takes no part in that joint's comparison.

    Parameters
    ----------
    log : Log
    strategies : sequence of Strategy
    at_hand : callable, optional
        On which sessions a session may look back; `earlier_sessions` as on the day.
    command : str, optional
        Kept in the comparison's provenance.

    Raises
    ------
    InputError
        If two strategies have one name, no traverse of the log is usable, a strategy chooses what is not
        offered, or nothing shows how well a traverse repeats.
    """
    names = [strategy.name for strategy in strategies]
    if len(set(names)) < len(names) or not names:
        raise InputError(f"strategies need names that differ, and there must be one; these are {names}")
    trials = list(trials_of(log, at_hand))
    handling = handling_seconds(log.rows)
    found = attempt_all(trials, strategies)
    errors = with_errors(_marked(found))
    spent = found.spent.assign(seconds=found.spent["seconds"] + handling * found.spent["traverses"])
    left_out = pd.concat([found.left_out, _without_traverses(found, errors)], ignore_index=True)
    return Comparison(
        tuple(names), errors, spent, left_out, _pairs(errors), _bounds(trials, errors, spent, handling),
        {(trial.task.law.joint, trial.task.direction): trial.task.repeatability for trial in trials},
        handling, at_hand.__name__.replace("_", " "), log.machine, provenance(log, command),
    )  # fmt: skip


def shared_sessions(found: Outcomes) -> set[tuple[int, str]]:
    """Joints and sessions that every strategy compared there can calibrate, in each direction driven."""
    tried = pd.concat([found.spent, found.left_out])
    suited = {(row.strategy, row.joint) for row in found.spent.itertuples()}
    out = {
        (row.joint, row.session) for row in found.left_out.itertuples() if (row.strategy, row.joint) in suited
    }
    return {(row.joint, row.session) for row in tried.itertuples() if (row.joint, row.session) not in out}


def _marked(found: Outcomes) -> pd.DataFrame:
    errors = found.errors
    compared = errors.groupby("joint")["strategy"].nunique()
    everywhere = errors.groupby("traverse")["strategy"].transform("nunique") == errors["joint"].map(compared)
    kept = shared_sessions(found)
    shared = [
        (joint, session) in kept for joint, session in zip(errors["joint"], errors["session"], strict=True)
    ]
    return errors.assign(shared=everywhere.to_numpy(bool) & np.array(shared, dtype=bool))


def _without_traverses(found: Outcomes, errors: pd.DataFrame) -> pd.DataFrame:
    there = set(zip(errors["joint"][errors["shared"]], errors["session"][errors["shared"]], strict=True))
    suited = set(zip(found.spent["joint"], found.spent["session"], strict=True))
    lost = sorted((shared_sessions(found) & suited) - there)
    rows = [(EVERYBODY, session, joint, "", NOTHING_LEFT) for joint, session in lost]
    return pd.DataFrame(rows, columns=found.left_out.columns)


def _pairs(errors: pd.DataFrame) -> pd.DataFrame:
    parts = []
    for joint, mine in errors[errors["shared"]].groupby("joint"):
        unit = SESSIONS if mine["session"].nunique() > 1 else CONFIGURATIONS
        parts.append(pair_up(mine, unit).assign(joint=joint))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def _bounds(
    trials: Sequence[Trial], errors: pd.DataFrame, spent: pd.DataFrame, handling: float
) -> pd.DataFrame:
    parts = []
    for joint, mine in errors[errors["shared"]].groupby("joint"):
        most = int(spent.loc[spent["joint"] == joint, "traverses"].max()) + BEYOND
        own = [
            trial
            for trial in trials
            if trial.task.law.joint == joint and trial.task.session in set(mine["session"])
        ]
        parts.append(bounds(own, mine["traverse"].unique(), most, handling).assign(joint=joint))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
