"""Unstructured alternatives, which stand for "unknown": in time, by configuration, harmonics."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.function_of_cause import FunctionOfCause
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.proposed import LOAD, SMOOTH_SCALE, JointTerm, PeriodicTerm, SmoothTerm
from stickslip_fit.diagnosis.carriers import find_load, traverse_average
from stickslip_fit.diagnosis.hypotheses import (
    Hypothesis,
    SessionFit,
    make_hypothesis,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1, memory_alternatives
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.diagnosis.session_stacks import build_per_session_hypotheses
from stickslip_fit.diagnosis.smooth_alternatives import build_smooth_alternatives
from stickslip_fit.logs.log import number_configurations
from stickslip_fit.logs.schema import has_times
from stickslip_fit.units import PRISMATIC

N_WAVES = 6
MAX_PERIODS = 600
MAX_ELEMENTS = 20_000_000  # of the configuration indicators; larger ones are left out
MIN_TRAVERSES_PER_PERIOD = 2.0
# The same of traverses at uneven intervals, whose quartiles are so much of the median apart: no two waves
# have the same values there (L. Eyer and P. Bartholdi, Astron. Astrophys. Suppl. 135:1, 1999).
MIN_UNEVEN_PER_PERIOD, MIN_SPREAD = 1.0, 0.2
MIN_ALTERNATION = 0.9  # of the product of direction and parity, its mean in a session


def build_unstructured_alternatives(linearized: LinearizedFit) -> Iterator[Hypothesis | AR1]:
    """Every unstructured alternative for which the rows have the columns; none in time without times."""
    rows, scale = linearized.rows, linearized.scale[:, None]
    for name, columns in chain(_configuration_indicators(rows), _harmonics(rows)):
        if one := make_hypothesis(f"unknown:{name}", None, None, linearized.project(columns / scale)):
            yield one
    yield from build_smooth_alternatives(linearized)
    if has_times(rows):
        yield from _alternatives_in_time(linearized)
        yield from memory_alternatives(linearized)


def _alternatives_in_time(linearized: LinearizedFit) -> Iterator[Hypothesis]:
    """Smooth and periodic in time, alike in all sessions or of each."""
    sessions, rows = list(split_sessions(linearized).values()), linearized.rows
    n, scale = len(rows), linearized.scale[:, None]
    seconds = rows["session_seconds"].to_numpy(float)
    session = pd.factorize(rows["session"].astype(object))[0]
    waves = smooth_in_time(seconds, session) / scale
    orders = range(1, N_WAVES + 1)
    alike = SmoothTerm(
        ("session_seconds",),
        ((0.0, float(seconds.max())),),
        tuple((k,) for k in orders),
        tuple(1 / k for k in orders),
    )
    name = "unknown:time, the same in each session"
    if one := make_hypothesis(name, alike, None, linearized.project(waves)):
        yield one
    own = replace(alike, sessions=tuple(map(str, dict.fromkeys(rows["session"].astype(object)))))
    yield from build_per_session_hypotheses(["unknown:time"], n, sessions, waves[:, None], [own])
    columns, terms = [], []
    for joint in map(int, rows["joint"].unique()):
        columns.append(waves * (rows["joint"] == joint).to_numpy()[:, None])
        terms.append(replace(own, on=((joint, "+"), (joint, "-"))))
        name = f"unknown:time, joint {joint}"
        yield from build_per_session_hypotheses([name], n, sessions, columns[-1][:, None], [terms[-1]])
    if len(terms) > 1:
        effects, each = np.concatenate(columns, axis=1)[:, None], JointTerm.of(terms)
        yield from build_per_session_hypotheses(["unknown:time, each joint"], n, sessions, effects, [each])
    for clock in ("session_seconds", "session_order"):
        yield from _periodic_alternatives(linearized, sessions, clock)
    yield from _waves_by_load(linearized, sessions)
    yield from _waves_of_joints(linearized, sessions)


def _waves_by_load(linearized: LinearizedFit, sessions: Sequence[SessionFit]) -> list[Hypothesis]:
    """Waves in time in proportion to the load, each session's its own."""
    load = find_load(linearized.table)
    if load is None:
        return []
    of_traverse = np.nan_to_num(traverse_average(load.values))
    limits = ((0.0, float(linearized.rows["session_seconds"].max())), (load.low, load.high))
    orders: Any = {"orders": ((1, 1), (2, 1))}
    return _plain_waves(linearized, sessions, ("session_seconds", LOAD), limits, of_traverse, **orders)


def _waves_of_joints(linearized: LinearizedFit, sessions: Sequence[SessionFit]) -> Iterator[Hypothesis]:
    """Waves of a single joint in time or in its own travel, each session's its own.

    Among all joints its noise would be taken for large, in which a wave of all of them does not show.
    """
    joint = linearized.rows["joint"].to_numpy()
    numbers = np.unique(joint).tolist()
    for clock in ("session_seconds", "joint_travel") if len(numbers) > 1 else ("joint_travel",):
        limits = ((0.0, float(linearized.rows[clock].max())),)
        for number in numbers:
            on: Any = {"on": ((number, "+"), (number, "-"))}
            inside = (joint == number).astype(float)
            yield from _plain_waves(linearized, sessions, (clock,), limits, inside, **on)


def _plain_waves(
    linearized: LinearizedFit,
    sessions: Sequence[SessionFit],
    carriers: tuple[str, ...],
    limits: tuple[tuple[float, float], ...],
    size: Array,
    **attributes: Any,
) -> list[Hypothesis]:
    """Waves in a clock, the first of the carriers, times the `size` of each row, shape (n,)."""
    rows, acts = linearized.rows, size != 0
    session, labels = pd.factorize(rows["session"].astype(object))
    values = rows[carriers[0]].to_numpy(float)
    periods = choose_periods(values[acts], session[acts])
    pairs, factor = np.zeros((len(rows), len(periods), 2)), SMOOTH_SCALE * size / linearized.scale
    pairs[acts] = _cosines_and_sines(values[acts], 1.0 / periods) * factor[acts, None, None]
    plain = PeriodicTerm(carriers, limits, sessions=tuple(map(str, labels)), **attributes)
    names, waves = linearized.table.once(_name_waves, plain, *periods.tolist())
    own = [part for session in sessions if len(part := session.restrict(acts))]
    return build_per_session_hypotheses(names, len(rows), own, pairs, waves)


def _periodic_alternatives(
    linearized: LinearizedFit, sessions: Sequence[SessionFit], clock: str
) -> list[Hypothesis]:
    """Waves in time or in the number of traverses, each session's its own, alike or opposite by direction."""
    rows = linearized.rows
    session, labels = pd.factorize(rows["session"].astype(object))
    values = rows[clock].to_numpy(float)
    sign = linearized.direction_sign
    periods = choose_periods(values, session, MIN_UNEVEN_PER_PERIOD)
    if clock == "session_order" and _alternates(sign, values, session):
        periods = periods[periods >= 2 * MIN_TRAVERSES_PER_PERIOD]
    pairs = _cosines_and_sines(values, 1.0 / periods) * (SMOOTH_SCALE / linearized.scale)[:, None, None]
    plain = PeriodicTerm((clock,), ((0.0, float(values.max())),), sessions=tuple(map(str, labels)))
    same = linearized.table.once(_name_waves, plain, *periods.tolist())
    opposite = linearized.table.once(_name_waves, replace(plain, mode="opposite"), *periods.tolist())
    alike = build_per_session_hypotheses(same.names, len(rows), sessions, pairs, same.versions)
    if linearized.allows_opposite:
        turned = {one.period: (name, one) for name, one in zip(*opposite, strict=True)}
        signed = ((one, *turned[one.version.period]) for one in alike)
        return [*alike, *(replace(one, cause=name, version=own, sign=sign) for one, name, own in signed)]
    pairs = pairs * sign[:, None, None]
    return [
        *alike,
        *build_per_session_hypotheses(opposite.names, len(rows), sessions, pairs, opposite.versions),
    ]


def _alternates(sign: Array, order: Array, session: npt.NDArray[np.intp]) -> bool:
    """Whether traverses go to and fro, so that a wave is one of opposite sign with another period.

    Of f periods a traverse and of 1/2 - f the slower is meant. What changes slowly, alike in both directions,
    would else be a fast wave of opposite sign.
    """
    turns = pd.Series(sign * (-1.0) ** order).groupby(session).mean()
    return bool((turns.abs() > MIN_ALTERNATION).all())


class _Waves(NamedTuple):
    """Waves of some periods, and what their hypotheses are called."""

    names: list[str]
    versions: list[PeriodicTerm]


def _name_waves(_: RowTable, plain: PeriodicTerm, *periods: float) -> _Waves:
    versions = [replace(plain, period=period) for period in periods]
    return _Waves([f"unknown:{version}" for version in versions], versions)


def _cosines_and_sines(clock: Array, frequencies: Array) -> Array:
    """Of evenly spaced frequencies, (m,), shape (n, m, 2): the first, turned, are the following ones."""
    waves = np.empty((len(clock), len(frequencies)), dtype=complex)
    waves[:, :1] = np.exp(2j * np.pi * clock[:, None] * frequencies[:1])
    turn, known = np.exp(2j * np.pi * clock[:, None] * np.diff(frequencies[:2])), 1
    while known < len(frequencies):
        following = waves[:, known : 2 * known]
        np.multiply(waves[:, : following.shape[1]], turn, out=following)
        turn, known = turn**2, 2 * known
    return waves.view(float).reshape(*waves.shape, 2)


def attribute_to_causes(
    alternatives: Iterable[Hypothesis | AR1], problem_causes: Sequence[Any], without: Sequence[str]
) -> list[Hypothesis | AR1]:
    """Alternatives in the name of the causes whose columns they follow.

    What a cause is a function of is its own, whatever the form of the function: one for all joints of a
    cause's only column is a more flexible form of that cause. Alternatives and causes in `without` are left
    out, and those of columns that may be labels, of which the labels are the most flexible form.
    """
    owner: dict[str, Any] = {}
    for cause in problem_causes:
        for name in cause.columns:
            is_only = name not in owner and len(cause.columns) == 1
            owner[name] = cause if is_only and cause.takes_functions else None
    attributed: list[Hypothesis | AR1] = []
    for one in alternatives:
        cause = owner.get(one.cause.removeprefix("unknown:"))
        if one.cause in without:
            continue
        if cause is None or one.version is None:
            attributed.append(one)
        elif cause.name not in without and (version := _as_function(cause, one.version)):
            attributed.append(replace(one, cause=cause.name, version=version, values=None))
    return attributed


def _as_function(cause: Any, term: Any) -> Any:
    """A cause as the smooth function that a term is; None if that is no form of it."""
    if isinstance(cause, FactorCause) and isinstance(term, SmoothTerm):
        return FunctionOfCause.of_term(cause, term)
    return cause.with_functions(term)


def smooth_in_time(seconds: Array, session: npt.NDArray[np.intp]) -> Array:
    """Cosines over each session, from its beginning to its end, shape (n, waves)."""
    last = pd.Series(seconds).groupby(session).transform("max").to_numpy()
    phase = seconds / np.maximum(last, 1.0)
    return np.stack([np.cos(np.pi * k * phase) / k for k in range(1, N_WAVES + 1)], axis=-1)


def _configuration_indicators(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """An indicator of each configuration, where these have enough replicates."""
    kinds = number_configurations(rows)
    if kinds.max() < len(rows) / 3 and 3 * kinds.max() * len(rows) < MAX_ELEMENTS:
        backwards = (rows["direction"] == "-").to_numpy()
        yield "configuration", np.eye(kinds.max() + 1)[kinds]
        yield "configuration and direction", np.eye(2 * kinds.max() + 2)[2 * kinds + backwards]


def _harmonics(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """Harmonics of q2 that joint 3's law lacks, together and one by one."""
    prismatic = (rows["joint"] == PRISMATIC).to_numpy() & rows["theta"].notna().to_numpy()
    if not prismatic.any():
        return
    q2 = np.nan_to_num(rows["q2"].to_numpy(float))
    columns = np.stack([f(k * q2) for k in (2, 3, 4) for f in (np.cos, np.sin)], axis=-1) * prismatic[:, None]
    yield "harmonics of q2, joint 3", columns
    for column, name in zip(columns.T, ("cos 2", "sin 2", "cos 3", "sin 3", "cos 4", "sin 4"), strict=True):
        yield f"{name} q2, joint 3", column[:, None]


def choose_periods(
    clock: Array, session: npt.NDArray[np.intp], least_uneven: float = MIN_TRAVERSES_PER_PERIOD
) -> Array:
    """Periods between the length of a session and the spacing of its traverses, evenly in frequency.

    At uneven intervals a period has at least `least_uneven` traverses.
    """
    order = np.lexsort((clock, session))
    spacing = np.diff(clock[order])[np.diff(session[order]) == 0]
    if not (spacing > 0).any():
        return np.zeros(0)
    lower, step, upper = np.quantile(spacing[spacing > 0], (0.25, 0.5, 0.75)).tolist()
    longest, is_uneven = float(clock.max()), upper - lower > MIN_SPREAD * step
    if longest < 4 * MIN_TRAVERSES_PER_PERIOD * step:
        return np.zeros(0)
    slowest = 2.0 / longest
    fastest = 1.0 / ((least_uneven if is_uneven else MIN_TRAVERSES_PER_PERIOD) * step)
    number = min(MAX_PERIODS, int(np.ceil(2.0 * longest * (fastest - slowest))))
    return np.asarray(1.0 / np.linspace(slowest, fastest, number))
