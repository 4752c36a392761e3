"""simulate: a plan and laws with known parameters become a log.

For each traverse: the steps of its law, times the session's own variation and the noise of the
repeatability, rounded up to the next check of the end stop. Where a law depends on time or history,
counts and times are iterated until they agree. `step_through` simulates single steps and is the
reference for the integrals.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, Int64Array, IntArray
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import InputError, check_count, check_type
from stickslip_fit.laws import Rows, StepLaw, expected_steps, float_column, observed_count
from stickslip_fit.logs import Log, add_history
from stickslip_fit.logs.history import DEPARTURES, FURTHER_HISTORY, follow_departures
from stickslip_fit.logs.plan import NoiseKind, Plan
from stickslip_fit.logs.reader import DIRECTIONS
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine
from stickslip_fit.simulation.truth import LawValues
from stickslip_fit.units import JOINTS


def begin_times(plan: Plan, rows: pd.DataFrame, waiting: Array) -> npt.NDArray[np.datetime64]:
    """The time at which each traverse of a plan begins, to the second.

    Parameters
    ----------
    rows : DataFrame
        The plan's rows, with steps.
    waiting : array, shape (n,)
        Pause before each traverse, 0 for the shortest of the plan and 1 for the longest; a session's first
        entry is not used.

    Raises
    ------
    InputError
        If a session is not over when the next one begins.
    """
    count = plan.traverses_per_session
    driving = (rows["steps"] * rows["step_period"]).to_numpy().reshape(-1, count)
    is_new_visit = np.diff(rows["visit"], prepend=0).reshape(-1, count) != 0
    (quick_pause, slow_pause), (quick_turn, slow_turn) = plan.timing.pause, plan.timing.turn
    shortest_pause, longest_pause = (
        np.where(is_new_visit, quick_pause, quick_turn),
        np.where(is_new_visit, slow_pause, slow_turn),
    )
    pauses = shortest_pause + (longest_pause - shortest_pause) * waiting.reshape(-1, count)
    # At least a second apart, so that no two traverses of a joint carry the same time.
    gaps = np.maximum(np.ceil(driving[:, :-1] + pauses[:, 1:]), 1).astype(np.int64)
    elapsed = np.cumsum(np.concatenate([np.zeros((len(gaps), 1), np.int64), gaps], axis=1), axis=1)
    begins = np.array([session.begins for session in plan.sessions], dtype="datetime64[s]")
    _check_overlap(plan, begins, elapsed[:, -1] + np.ceil(driving[:, -1]).astype(np.int64))
    return (begins[:, None] + elapsed).ravel()


def _check_overlap(plan: Plan, begins: npt.NDArray[np.datetime64], length: Int64Array) -> None:
    overlaps = begins[:-1] + length[:-1] > begins[1:]
    if overlaps.any():
        number = int(np.argmax(overlaps))
        session, following = plan.sessions[number : number + 2]
        raise InputError(
            f"session {session.label!r} takes {length[number] / 3600:.1f} h and is not over when session "
            f"{following.label!r} begins; plan fewer traverses, shorter pauses or a later date"
        )


MAX_PASSES = 20
INITIAL_HISTORY = {"session_seconds": 0.0, "before_direction": "", "before_load": 0.0, "steps_before": 0}


def drive_through(
    plan: Plan,
    rows: pd.DataFrame,
    waiting: Array,
    count_steps: Callable[[pd.DataFrame], Int64Array],
    laws: Iterable[StepLaw],
) -> pd.DataFrame:
    """A plan's rows with steps, time and history.

    Where a law depends on time or history, counts and history are iterated until they agree.

    Parameters
    ----------
    rows : DataFrame
        Its rows, with all other columns that the laws depend on.
    waiting : array, shape (n,)
        See `begin_times`.
    count_steps : callable
        From rows with their history to the counts, shape (n,).
    laws : iterable of StepLaw
        Those of `count_steps`.
    """
    passes = MAX_PASSES if any(uses_history(law) or follows_departures(law) for law in laws) else 1
    rows_with_history = rows.assign(**INITIAL_HISTORY)
    for _ in range(passes):
        steps = count_steps(rows_with_history)
        if "steps" in rows_with_history and np.array_equal(steps, rows_with_history["steps"]):
            break
        rows_with_history["steps"] = steps
        rows_with_history["time"] = begin_times(plan, rows_with_history, waiting).astype("datetime64[ns]")
        rows_with_history = add_history(rows_with_history)
    return rows_with_history


def uses_history(law: StepLaw) -> bool:
    """Whether a law's counts depend on time or history."""
    return not {*INITIAL_HISTORY, *FURTHER_HISTORY}.isdisjoint(law.columns)


def follows_departures(law: StepLaw) -> bool:
    """Whether what a traverse departs by carries over to the next."""
    return not DEPARTURES.keys().isdisjoint(law.columns)


T_NOISE_DF = 5


@dataclass(frozen=True)
class RandomDraws:
    """The draws for a campaign of n traverses.

    Attributes
    ----------
    day : array, shape (sessions, groups)
        Deviation of each group's step size in the session; mean 0, standard deviation 1.
    noise : array, shape (n,)
        Deviations of log(steps); mean 0, standard deviation 1.
    wait : array, shape (n,)
        See `begin_times`; uniform between 0 and 1.
    misfire_draws : array, shape (n, 3)
        Decide whether a stop is missed or detected too early, and by how much; uniform between 0 and 1.
    """

    day: Array
    noise: Array
    wait: Array
    misfire_draws: Array


def draw_random(seed: int, sessions: int, traverses: int, groups: int, kind: NoiseKind) -> RandomDraws:
    """Draw for every session from its own random streams, so that adding a session changes no other.

    Parameters
    ----------
    sessions, traverses, groups : int
        Number of sessions, of traverses in each, and of groups of traverses that share a law.
    kind : {'gaussian', 't5'}

    Examples
    --------
    >>> two, three = (draw_random(7, sessions, 100, 6, "t5") for sessions in (2, 3))
    >>> bool(np.all(three.noise[:200] == two.noise))
    True
    """
    streams = np.random.SeedSequence(seed).spawn(sessions)
    draws = [_draw_session(stream, traverses, groups, kind) for stream in streams]
    days, *others = zip(*draws, strict=True)
    return RandomDraws(np.stack(days), *map(np.concatenate, others))


def _draw_session(
    stream: np.random.SeedSequence, traverses: int, groups: int, kind: NoiseKind
) -> tuple[Array, Array, Array, Array]:
    day, noise, waiting, misfires = (np.random.default_rng(child) for child in stream.spawn(4))
    deviations = draw_noise(kind, traverses, noise)
    return (
        day.standard_normal(groups),
        deviations,
        waiting.random(traverses),
        misfires.random((traverses, 3)),
    )


def draw_noise(kind: NoiseKind, size: int, rng: np.random.Generator) -> Array:
    """Independent deviations with mean 0 and standard deviation 1, shape (size,)."""
    if kind == "t5":
        return rng.standard_t(T_NOISE_DF, size) * sqrt((T_NOISE_DF - 2) / T_NOISE_DF)
    return rng.standard_normal(size)


def expected_counts(law: StepLaw, rows: Rows, values: Array) -> Array:
    """Steps that each traverse takes by the law, shape (n,).

    Raises
    ------
    InputError
        If the joint stalls within one.
    """
    counts, _ = law.counts(rows, values)
    if not np.all(np.isfinite(counts)):
        first = int(np.argmin(np.isfinite(counts)))
        row = {name: np.asarray(rows[name]) for name in law.columns if name in rows}
        place = ", ".join(f"{name} = {of[first]:.4g}" for name, of in row.items() if of.dtype.kind in "fiu")
        raise InputError(
            f"joint {law.joint} comes to a halt (step size 0 or less) with {place} (rad, m); "
            "change the law's parameters or leave that traverse out of the plan"
        )
    return counts


GROUPS = [(joint, direction) for joint in JOINTS for direction in DIRECTIONS]
LOG_COLUMNS = (
    *("session", "time", "joint", "direction", "steps", "q1", "q2", "q3", "theta", "psi", "start", "stop"),
    *("check_every", "status", *CONDITIONS, "note"),
)


def simulate(plan: Plan, truth: LawValues, machine: Machine, seed: int | None = None) -> Log:
    """Simulate the traverses of a plan under known laws.

    A count is the law's, over the session's factor of the step size, times exp(noise), rounded up to the
    next check of the end stop. Each session draws from its own random streams, so that adding a session
    changes no other.

    Parameters
    ----------
    truth : LawValues
        With or without causes; steps are counted from the plan's first traverse on.
    machine : Machine
        The one that `plan` and `truth` were made for.
    seed : int, optional
        Replaces the plan's, except for the order of the traverses.

    Returns
    -------
    Log
        Without a source; its hash is that of the counts.

    Raises
    ------
    InputError
        If an argument is of another type, the plan has no noise, a law lacks parameters or stalls within a
        traverse, parameters are given for a session that is not planned, a schedule lacks its column, a
        session is not over when the next one begins, or the seed is negative.
    """
    check_type("plan", plan, Plan)
    check_type("truth", truth, LawValues)
    check_type("machine", machine, Machine)
    if plan.noise is None:
        raise InputError("the plan has no [noise]; add one with repeatability_pct before simulating it")
    _check_sessions(plan, truth)
    rows = plan.rows()
    sessions, traverses = len(plan.sessions), plan.traverses_per_session
    truth = truth.in_campaign([each.label for each in plan.sessions], traverses)
    session, group = np.repeat(np.arange(sessions), traverses), group_index(rows)
    seed = plan.seed if seed is None else seed
    check_count("seed", seed, least=0)
    rows["traverse"] = np.arange(1, len(rows) + 1)
    for number, column in enumerate(truth.columns):
        rows[column.column] = column.draw(seed, number, sessions, traverses)
    draws = draw_random(seed, sessions, traverses, len(GROUPS), plan.noise.kind)
    day = np.array([truth.day_to_day.get(pair, 0.0) for pair in GROUPS])
    factor = 1.0 + day[group] * draws.day[session, group]
    repeatability = np.array([plan.noise.repeatability.get(pair, np.nan) for pair in GROUPS])[group]
    if np.isnan(repeatability).any():
        joint, direction = GROUPS[group[int(np.argmax(np.isnan(repeatability)))]]
        raise InputError(f'the plan drives "{joint}{direction}", but its repeatability_pct has no such entry')
    misfires = np.zeros(len(rows))  # deviations of log(steps) by stops missed or detected too early
    for joint, law in truth.laws.items():
        subset = (rows["joint"] == joint).to_numpy()
        if isinstance(law, ExtendedLaw) and subset.any():
            values, _ = truth.of_rows(rows[subset], joint)
            misfires[subset] = law.misfire_deviations(values, draws.misfire_draws[subset])
    noise = np.exp(repeatability * draws.noise + misfires)

    def count_steps(rows_with_history: pd.DataFrame) -> Int64Array:
        def count(rows: pd.DataFrame) -> tuple[Array, Int64Array]:
            expected = _count_steps(rows, truth, factor)
            return expected, observed_count(expected * noise, rows["check_every"])

        def depart(rows: pd.DataFrame) -> Array:
            expected, steps = count(rows)
            return expected / expected_steps(steps, rows["check_every"]) - 1.0

        if any(follows_departures(law) for law in truth.laws.values()):
            rows_with_history = follow_departures(rows_with_history, depart)
        return count(rows_with_history)[1]

    driven = drive_through(plan, rows, draws.wait, count_steps, truth.laws.values())
    missing = {name: np.nan for name in CONDITIONS if name not in driven}
    driven = driven.assign(session=driven["session"].astype("str"), note="", **missing)
    counts = hashlib.sha256(driven["steps"].to_numpy().tobytes())
    own = [each.column for each in truth.columns if each.column not in LOG_COLUMNS]
    made = add_history(driven[[*LOG_COLUMNS, *own]])
    return Log(made, (), counts.hexdigest(), machine, rows_as_read=made.copy())


def _check_sessions(plan: Plan, truth: LawValues) -> None:
    """Refuse causes and parameters of sessions that are not planned, such as a misspelt one."""
    planned = {session.label for session in plan.sessions}
    causes = next((law.causes for law in truth.laws.values() if isinstance(law, ExtendedLaw)), ())
    uses = [(getattr(cause, "session", ""), f"{cause.name} happens in") for cause in causes]
    uses += [
        (session or "", f"joint {joint}, direction {direction} has parameters for")
        for joint, direction, session in truth.values
    ]
    for session, use in uses:
        if session not in ("", *planned):
            raise InputError(
                f"{use} session {session!r}, which the plan does not have; its sessions are "
                f"{', '.join(map(repr, sorted(planned)))}"
            )


def group_index(rows: pd.DataFrame) -> IntArray:
    """Index of each row's joint and direction in `GROUPS`."""
    backwards = (rows["direction"] == DIRECTIONS[1]).to_numpy()
    return 2 * (rows["joint"].to_numpy() - JOINTS[0]) + backwards


def _count_steps(rows: pd.DataFrame, truth: LawValues, factor: Array) -> Array:
    """Steps of each traverse by its law, with the step sizes of all sessions changed by a factor."""
    counts = np.zeros(len(rows))
    for joint in rows["joint"].unique():
        subset = (rows["joint"] == joint).to_numpy()
        values, shared = truth.of_rows(rows[subset], joint)
        law = truth.laws[joint]
        expected = expected_counts(law, rows[subset], values)
        added = law.steps_added_by_causes(rows[subset], values) if isinstance(law, ExtendedLaw) else 0.0
        counts[subset] = (expected - added) / np.where(shared, factor[subset], 1.0) + added
    return counts


MAX_STEPS_TO_STOP = 1e7  # at the present step size; more are taken for a stall


def step_through(law: StepLaw, rows: Rows, values: Array) -> Int64Array:
    """Steps of every traverse, counted one after another from its start to its stop, shape (n,).

    The reference that closed forms and quadrature approximate; for tests and benchmarks.

    Parameters
    ----------
    rows : mapping of str to array, shape (n,)
    values : array, shape (p,) or (n, p)

    Raises
    ------
    InputError
        If a joint stalls.

    Examples
    --------
    >>> from stickslip_fit.laws import Prismatic
    >>> row = {"q2": [-np.pi / 2], "theta": [0.0], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    >>> step_through(Prismatic(), row, np.array([976e-9, 0.3, 438e-9]))
    array([12296])
    """
    position, stop = float_column(rows, "start").copy(), float_column(rows, "stop")
    arrays = {name: rows[name] for name in (*law.columns, "start", "stop") if name in rows}
    values = np.broadcast_to(values, (len(position), len(law.parameters)))
    sign = np.sign(stop - position)
    steps = np.zeros(len(position), np.int64)
    moving = sign * (stop - position) > 0
    while moving.any():
        gamma = law.step_size(arrays, position[:, None], values)[:, 0]
        if np.any(MAX_STEPS_TO_STOP * gamma < np.abs(stop - position), where=moving):
            raise InputError(f"joint {law.joint} comes to a halt: its step size falls to 0 within a traverse")
        position = np.where(moving, position + sign * gamma, position)
        steps += moving
        moving = sign * (stop - position) > 0
    return steps
