"""Predicts the counts of planned traverses and of drives, with 95 % intervals, by a fit or a posterior."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from stickslip_fit._typing import Int64Array
from stickslip_fit.bayes import Posterior
from stickslip_fit.errors import InputError, InputIssue, check_type
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.result import convert_predictions
from stickslip_fit.laws import observed_count
from stickslip_fit.logs.history import FURTHER_HISTORY
from stickslip_fit.logs.plan import Plan
from stickslip_fit.moves.arm import check_given_conditions
from stickslip_fit.moves.drives import drive_columns, fill_conditions
from stickslip_fit.simulation.campaign import INITIAL_HISTORY, drive_through, uses_history

TRAVERSE_COLUMNS = ["joint", "direction", "q1", "q2", "q3", "theta", "psi", "start", "stop"]
NEW_SESSION_LABEL = ""  # no session of a log has this name


def predict(
    fitted: Result | Posterior,
    plan: Plan | pd.DataFrame,
    session: str | None = None,
    conditions: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Predicted counts of the traverses of a plan, or of drives.

    Parameters
    ----------
    fitted : Result or Posterior
    plan : Plan or DataFrame
        Or drives of any machine, as `read_drives` returns them: rows of a log without counts, SI.
    session : str, optional
        Whose parameters to use. Without it, a Result takes for each joint and direction the latest session
        with all parameters; a Posterior predicts a future session, from the campaign's mean and spread. Of
        drives, the session of those that name none.
    conditions : mapping of str to float, optional
        Other columns on which laws with causes depend, the same for all traverses, by the log's columns, SI:
        ``temperature``, or ``steps_before`` the first. Time and history are the plan's own. Of drives, for
        cells that are empty or missing.

    Returns
    -------
    DataFrame, indexed as `Plan.rows` or as the drives
        calibration (the session whose parameters were used, empty for a future one), steps (rounded up to the
        next check of the end stop), low, high (95 % interval of that count, its own scatter included),
        step_size (mean over the traverse) in unit, nm or µrad, and extrapolated_pct, see `Result.predict`.
        low and high are NaN without error bars. What a law has for single sessions alone is unknown of a
        plan's and of drives without a session, see `JointFit.for_session_to_come`.

    Raises
    ------
    InputError
        For a joint, direction or session that was not fitted, one whose parameters are not all identifiable,
        a traverse in which the joint would stall, or a condition that no drive has.
    """
    check_type("fitted", fitted, Result, Posterior)
    check_type("plan", plan, Plan, pd.DataFrame)
    own = drive_columns(_result_of(fitted).machine) if isinstance(plan, pd.DataFrame) else []
    check_given_conditions(conditions or {}, fitted, own)
    if isinstance(plan, pd.DataFrame):
        return _predict_drives(fitted, plan, session, conditions or {})
    if isinstance(fitted, Result):
        fitted = fitted.for_session_to_come()
    rows = _add_expected_history(fitted, plan, session, conditions or {})
    # A plan repeats traverses; each is predicted once.
    differing = (*TRAVERSE_COLUMNS, *INITIAL_HISTORY, *FURTHER_HISTORY, *(conditions or ()))
    keys = [name for name in differing if name in rows]
    index = rows.groupby(keys, dropna=False, sort=False, observed=True).ngroup().to_numpy()
    _, first = np.unique(index, return_index=True)
    distinct = rows.iloc[first].reset_index(drop=True)
    distinct["session"] = _calibration_sessions(fitted, distinct, session)
    predicted = fitted.si.predict(distinct)
    _check_predictions(_result_of(fitted), distinct, predicted)
    counts = predicted.drop(columns="relative_error").assign(calibration=distinct["session"])
    counts = counts.iloc[index].set_axis(rows.index)
    return convert_predictions(_as_counts(counts, rows), rows, _result_of(fitted).machine)


def _as_counts(counts: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """Steps and their interval as the log of the rows would have them."""
    counts = counts.copy()
    for name in ("steps", "low", "high"):
        known = np.isfinite(counts[name].to_numpy(float))
        recorded = observed_count(np.where(known, counts[name], 1.0), rows.get("check_every", 1))
        counts[name] = np.where(known, recorded, np.nan)
    return counts


def _predict_drives(
    fitted: Result | Posterior, drives: pd.DataFrame, session: str | None, conditions: Mapping[str, float]
) -> pd.DataFrame:
    """See `predict`: drives that name their session by the law of that session, the others of one to come."""
    rows = fill_conditions(drives.reset_index(drop=True), conditions)
    label = rows["session"].astype(object) if "session" in rows else pd.Series("", rows.index, dtype=object)
    if session is not None:
        label = label.where(label.str.strip() != "", _calibration_sessions(fitted, rows, session)[0])
    named, result, parts = label.str.strip() != "", _result_of(fitted), []
    coming = fitted.for_session_to_come() if isinstance(fitted, Result) else fitted
    for law, is_named in ((fitted, True), (coming, False)):
        own = rows[named == is_named]
        if len(own):
            own = own.assign(session=label[named] if is_named else _calibration_sessions(law, own, None))
            predicted = law.si.predict(own)
            _check_predictions(result, own, predicted)
            parts.append(predicted.assign(calibration=own["session"]))
    if not parts:
        raise InputError("there is no drive to predict")
    counts = _as_counts(pd.concat(parts).loc[rows.index], rows)
    return convert_predictions(counts, rows, result.machine).set_axis(drives.index)


def _result_of(fitted: Result | Posterior) -> Result:
    return fitted.result if isinstance(fitted, Posterior) else fitted


def _add_expected_history(
    fitted: Result | Posterior, plan: Plan, session: str | None, conditions: Mapping[str, float]
) -> pd.DataFrame:
    """The plan's rows, with their expected history where a law depends on it."""
    laws, rows = [fit.law for fit in _result_of(fitted).joints.values()], plan.rows()
    rows = rows.assign(**{name: value for name, value in conditions.items() if name not in INITIAL_HISTORY})
    if not any(map(uses_history, laws)):
        return rows

    def set_steps_before(rows_with_history: pd.DataFrame) -> pd.DataFrame:
        """Counted from the given number; unknown without it."""
        if "steps_before" in conditions:
            total = rows_with_history["steps_before"] + conditions["steps_before"]
            return rows_with_history.assign(steps_before=total)
        return rows_with_history.drop(columns="steps_before")

    def count_steps(rows_with_history: pd.DataFrame) -> Int64Array:
        # Expected counts depart from no law.
        known = set_steps_before(rows_with_history).drop(columns="steps", errors="ignore")
        predicted = fitted.si.predict(known.assign(session=_calibration_sessions(fitted, known, session)))
        return observed_count(np.nan_to_num(predicted["steps"]), rows_with_history["check_every"])

    traverses = drive_through(plan, rows, np.full(len(rows), 0.5), count_steps, laws)
    return set_steps_before(traverses).drop(columns=["steps", "time"])


def _calibration_sessions(fitted: Result | Posterior, rows: pd.DataFrame, session: str | None) -> list[str]:
    """The session whose parameters predict each row."""
    result = _result_of(fitted)
    if session is not None:
        names = [str(name) for fit in result.joints.values() for name in fit.groups["session"]]
        if session not in names:
            sessions = ", ".join(dict.fromkeys(names))
            raise InputError(f"session {session!r} was not fitted; sessions fitted: {sessions}")
        return [session] * len(rows)
    if isinstance(fitted, Posterior):
        return [NEW_SESSION_LABEL] * len(rows)
    groups = list(zip(rows["joint"].astype(int), rows["direction"].astype(str), strict=True))
    latest = {group: _latest_session(result, *group) for group in dict.fromkeys(groups)}
    return [latest[group] for group in groups]


def _latest_session(result: Result, joint: int, direction: str) -> str:
    """The latest session with every parameter of a joint and direction, or else its latest."""
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


def _check_predictions(result: Result, rows: pd.DataFrame, predicted: pd.DataFrame) -> None:
    """Refuse predictions from parameters that are not identifiable, and stalls."""
    messages: list[str] = []
    for row, steps in zip(rows.itertuples(index=False), predicted["steps"], strict=True):
        unknown = _explain_unknown_parameters(result, int(row.joint), str(row.direction), str(row.session))
        messages += unknown
        if not unknown and not np.isfinite(steps):
            messages.append(
                f"joint {row.joint} would stall in a planned traverse in direction {row.direction}: the law "
                "gives a step size of zero or less there; leave it out"
            )
    if messages:
        raise InputError([InputIssue(message) for message in dict.fromkeys(messages)])


def _explain_unknown_parameters(result: Result, joint: int, direction: str, session: str) -> list[str]:
    """Why parameters of a session are not identifiable; empty where all are."""
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
