"""A plan and a law make a log."""

from __future__ import annotations

import hashlib

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError
from stickslip_fit.laws import seen_count
from stickslip_fit.logs import Log
from stickslip_fit.logs.check import DIRECTIONS
from stickslip_fit.logs.columns import CONDITIONS
from stickslip_fit.logs.history import add_history
from stickslip_fit.logs.plan import Noise, Plan
from stickslip_fit.machine import JOINTS, Machine
from stickslip_fit.simulate.chance import draw_chance
from stickslip_fit.simulate.counts import expected_counts
from stickslip_fit.simulate.driven import drive_through
from stickslip_fit.simulate.law_values import LawValues

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
GROUPS = [(joint, direction) for joint in JOINTS for direction in DIRECTIONS]
COLUMNS = (
    *("session", "time", "joint", "direction", "steps", "q1", "q2", "q3", "theta", "psi", "start", "stop"),
    *("check_every", "status", *CONDITIONS, "note"),
)


def simulate(plan: Plan, truth: LawValues, machine: Machine, seed: int | None = None) -> Log:
    """Make the traverses of a plan under known laws.

    A count is what the law says, over the session's factor of the step size, times exp(noise), and seen
    at the next look for the end stop. Each session draws from a stream of its own, so that adding a
    session changes no other.

    Parameters
    ----------
    plan : Plan
    truth : LawValues
        A law may have causes in it; steps are counted from the plan's first traverse on.
    machine : Machine
        The one that `plan` and `truth` were made for.
    seed : int, optional
        Instead of the plan's, for everything but the order of the traverses.

    Returns
    -------
    Log
        Without a source; its hash is that of the counts.

    Raises
    ------
    InputError
        If the plan says nothing of noise, a law lacks parameters or comes to a halt within a traverse,
        parameters are given for a session that is not planned, or a session is not over when the next
        one begins.
    """
    if plan.noise is None:
        raise InputError("the plan has no [noise]; add one with repeatability_pct before simulating it")
    _check_sessions(plan, truth)
    rows = plan.rows()
    session, group = _sessions_and_groups(plan, rows)
    chance = draw_chance(
        plan.seed if seed is None else seed,
        len(plan.sessions),
        plan.traverses_per_session,
        len(GROUPS),
        plan.noise.kind,
    )
    day = np.array([truth.day_to_day.get(each, 0.0) for each in GROUPS])
    factor = 1.0 + day[group] * chance.day[session, group]
    departure = _repeatability(plan.noise, group) * chance.noise + _misfires(rows, truth, chance.luck)

    def seen(known: pd.DataFrame) -> npt.NDArray[np.int64]:
        return seen_count(_counts(known, truth, factor) * np.exp(departure), rows["check_every"])

    return _log(drive_through(plan, rows, chance.wait, seen, truth.laws.values()), machine)


def _misfires(rows: pd.DataFrame, truth: LawValues, luck: Array) -> Array:
    """Log steps by which a stop that is missed or imagined puts counts off, shape (n,)."""
    off = np.zeros(len(rows))
    for joint, law in truth.laws.items():
        mine = (rows["joint"] == joint).to_numpy()
        if isinstance(law, ExtendedLaw) and mine.any():
            off[mine] = law.misfires(truth.of_rows(rows[mine], joint)[0], luck[mine])
    return off


def _check_sessions(plan: Plan, truth: LawValues) -> None:
    """A misspelt session must not pass for one without parameters of its own, or in which nothing happens."""
    planned = {session.label for session in plan.sessions}
    causes = next((law.causes for law in truth.laws.values() if isinstance(law, ExtendedLaw)), ())
    for cause in causes:
        if getattr(cause, "session", "") not in ("", *planned):
            raise InputError(
                f"{cause.name} happens in session {cause.session!r}, which the plan does not have; its "
                f"sessions are {', '.join(map(repr, sorted(planned)))}"
            )
    for joint, direction, session in truth.values:
        if session is not None and session not in planned:
            raise InputError(
                f"joint {joint}, direction {direction} has parameters for session {session!r}, which the "
                f"plan does not have; its sessions are {', '.join(map(repr, sorted(planned)))}"
            )


def _sessions_and_groups(plan: Plan, rows: pd.DataFrame) -> tuple[Indices, Indices]:
    """Number of each row's session, and the place of its joint and direction in `GROUPS`."""
    backwards = (rows["direction"] == DIRECTIONS[1]).to_numpy()
    group = 2 * (rows["joint"].to_numpy() - JOINTS[0]) + backwards
    return np.repeat(np.arange(len(plan.sessions)), plan.traverses_per_session), group


def _counts(rows: pd.DataFrame, truth: LawValues, factor: Array) -> Array:
    """Steps of each traverse by its law, with the step sizes of all sessions changed by a factor."""
    counts = np.zeros(len(rows))
    for joint in rows["joint"].unique():
        mine = (rows["joint"] == joint).to_numpy()
        values, shared = truth.of_rows(rows[mine], joint)
        law = truth.laws[joint]
        expected = expected_counts(law, rows[mine], values)
        added = law.added(rows[mine], values) if isinstance(law, ExtendedLaw) else 0.0
        counts[mine] = (expected - added) / np.where(shared, factor[mine], 1.0) + added
    return counts


def _repeatability(noise: Noise, group: Indices) -> Array:
    known = np.array([noise.repeatability.get(each, np.nan) for each in GROUPS])[group]
    if np.isnan(known).any():
        joint, direction = GROUPS[group[int(np.argmax(np.isnan(known)))]]
        raise InputError(f'the plan drives "{joint}{direction}", but its repeatability_pct has no such entry')
    return known


def _log(rows: pd.DataFrame, machine: Machine) -> Log:
    """The log that a reader would have made of these rows."""
    said = {name: np.nan for name in CONDITIONS if name not in rows}
    rows = rows.assign(session=rows["session"].astype("str"), status="ok", note="", **said)
    counts = hashlib.sha256(rows["steps"].to_numpy().tobytes())
    return Log(add_history(rows[list(COLUMNS)]), (), counts.hexdigest(), machine)
