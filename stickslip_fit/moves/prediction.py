"""What a plan's traverses will take, before anybody makes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.bayes import Posterior
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation import Result
from stickslip_fit.laws import observed_count
from stickslip_fit.logs.plan import Plan
from stickslip_fit.simulation.campaign import INITIAL_HISTORY, drive_through, uses_history

TRAVERSE_COLUMNS = ["joint", "direction", "q1", "q2", "q3", "theta", "psi", "start", "stop"]
NEW_SESSION_LABEL = ""  # no session of a log has this name


def predict_plan(
    fitted: Result | Posterior,
    plan: Plan,
    session: str | None = None,
    conditions: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Counts that the traverses of a plan will give.

    Parameters
    ----------
    fitted : Result or Posterior
    plan : Plan
    session : str, optional
        Whose parameters to use. Without it, a Result takes for each joint and direction the latest session
        that knows all of them; a Posterior predicts a session yet to come, from what the campaign's
        sessions have in common and how far they spread.
    conditions : mapping of str to float, optional
        What laws with causes look at besides, the same for all traverses, by the log's columns, SI:
        ``temperature``, or ``steps_before`` the first. Time and history are the plan's own.

    Returns
    -------
    DataFrame, indexed as `Plan.rows`
        calibration (the session whose parameters were used, empty for one yet to come), steps (as many as
        will be noted at the next look for the stop), low, high (95 % interval of that count, repeatability
        included) and step_size (mean over the traverse, rad or m). low and high are NaN where the fit
        knows no error bars.

    Raises
    ------
    InputError
        For a joint, direction or session that was not fitted, one whose parameters are not all known, or
        a traverse in which the joint would stall.
    """
    rows = _add_expected_history(fitted, plan, session, conditions or {})
    # A plan comes back to the same traverses; each is worked out once.
    keys = [name for name in (*TRAVERSE_COLUMNS, *INITIAL_HISTORY, *(conditions or ())) if name in rows]
    index = rows.groupby(keys, dropna=False, sort=False, observed=True).ngroup().to_numpy()
    _, first = np.unique(index, return_index=True)
    distinct = rows.iloc[first].reset_index(drop=True)
    distinct["session"] = _calibration_sessions(fitted, distinct, session)
    predicted = fitted.predict(distinct)
    _check_predictions(fitted, distinct, predicted)
    counts = predicted[["steps", "low", "high", "step_size"]].assign(calibration=distinct["session"])
    counts = counts.iloc[index].set_axis(rows.index)
    for name in ("steps", "low", "high"):
        counts[name] = _recorded_counts(counts[name], rows["check_every"])
    return counts[["calibration", "steps", "low", "high", "step_size"]]


def _add_expected_history(
    fitted: Result | Posterior, plan: Plan, session: str | None, conditions: Mapping[str, float]
) -> pd.DataFrame:
    """The plan's rows; where a law looks back, with their history as it will be on average."""
    result = fitted.result if isinstance(fitted, Posterior) else fitted
    laws, rows = [fit.law for fit in result.joints.values()], plan.rows()
    rows = rows.assign(**{name: value for name, value in conditions.items() if name not in INITIAL_HISTORY})
    if not any(map(uses_history, laws)):
        return rows

    def set_steps_before(rows_with_history: pd.DataFrame) -> pd.DataFrame:
        """How many steps the joints had made before the plan, nobody knows who was not told."""
        if "steps_before" in conditions:
            return rows_with_history.assign(
                steps_before=rows_with_history["steps_before"] + conditions["steps_before"]
            )
        return rows_with_history.drop(columns="steps_before")

    def count_steps(rows_with_history: pd.DataFrame) -> npt.NDArray[np.int64]:
        with_steps = set_steps_before(rows_with_history)
        steps = fitted.predict(with_steps.assign(session=_calibration_sessions(fitted, with_steps, session)))[
            "steps"
        ]
        return observed_count(np.nan_to_num(steps), rows_with_history["check_every"])

    traverses = drive_through(plan, rows, np.full(len(rows), 0.5), count_steps, laws)
    return set_steps_before(traverses).drop(columns=["steps", "time"])


def _calibration_sessions(fitted: Result | Posterior, rows: pd.DataFrame, session: str | None) -> list[str]:
    """Whose parameters each row is predicted by."""
    result = fitted.result if isinstance(fitted, Posterior) else fitted
    groups = [
        (int(joint), str(direction))
        for joint, direction in zip(rows["joint"], rows["direction"], strict=True)
    ]
    if session is not None:
        _check_session(result, session)
        return [session] * len(rows)
    if isinstance(fitted, Posterior):
        return [NEW_SESSION_LABEL] * len(rows)
    latest = {group: _latest_session(result, *group) for group in dict.fromkeys(groups)}
    return [latest[group] for group in groups]


def _latest_session(result: Result, joint: int, direction: str) -> str:
    """The latest session that knows every parameter of a joint and direction, or else its latest."""
    if joint not in result.joints:
        raise InputError(f"joint {joint} was not fitted; this result knows joints {list(result.joints)}")
    fit = result.joints[joint]
    subset = (fit.groups["direction"] == direction).to_numpy()
    if not subset.any():
        raise InputError(
            f"joint {joint} was not fitted in direction {direction}; leave it out of the plan, or log some "
            "traverses in that direction"
        )
    known = subset & fit.known.all(axis=1)
    return str(fit.groups["session"].to_numpy()[known if known.any() else subset][-1])


def _check_session(result: Result, session: str) -> None:
    sessions = list(
        dict.fromkeys(str(name) for fit in result.joints.values() for name in fit.groups["session"])
    )
    if session not in sessions:
        raise InputError(f"session {session!r} was not fitted; sessions fitted: {', '.join(sessions)}")


def _check_predictions(fitted: Result | Posterior, rows: pd.DataFrame, predicted: pd.DataFrame) -> None:
    """A number that leans on what the log does not know is none, and neither is one at a stall."""
    result = fitted.result if isinstance(fitted, Posterior) else fitted
    problems: list[str] = []
    for row, steps in zip(rows.itertuples(index=False), predicted["steps"], strict=True):
        lacking = _explain_unknown_parameters(result, int(row.joint), str(row.direction), str(row.session))
        if lacking:
            problems += lacking
        elif not np.isfinite(steps):
            problems.append(
                f"joint {row.joint} would stall in a planned traverse in direction {row.direction}: the law "
                "gives a step size of zero or less there; leave it out of the plan"
            )
    if problems:
        raise InputError([InputIssue(message) for message in dict.fromkeys(problems)])


def _explain_unknown_parameters(result: Result, joint: int, direction: str, session: str) -> list[str]:
    """Why the parameters for a session are not all known; empty where they are."""
    fit = result.joints[joint]
    subset = (fit.groups["direction"] == direction).to_numpy()
    if session != NEW_SESSION_LABEL:
        subset = subset & (fit.groups["session"] == session).to_numpy()
    if fit.known[subset].all():
        return []
    return [
        flag.message
        for flag in result.flags
        if (flag.joint, flag.direction) == (joint, direction)
        and flag.session in ("", session)
        and flag.flag in ("not_identified", "not_converged")
    ] or [f"joint {joint}, direction {direction}: not every parameter is known"]


def _recorded_counts(steps: pd.Series, check_every: pd.Series) -> pd.Series:
    """Counts as they will be noted; NaN stays NaN."""
    known = np.isfinite(steps.to_numpy(float))
    recorded = observed_count(np.where(known, steps, 1.0), check_every)
    return pd.Series(np.where(known, recorded, np.nan), index=steps.index)
