"""Shapes that no cause has: what is left may follow time, the configuration or the traverse before.

They stand for ``unknown``. Each is as flexible as it must be to catch what it is named after.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis, hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory
from stickslip_fit.diagnose.shapes.within import of_each, sessions
from stickslip_fit.logs.history import previous

Array = npt.NDArray[np.float64]

WAVES = 6
MOST_PERIODS = 250
MOST_NUMBERS = 20_000_000  # held for the departures of configurations; with more they are not looked for
FEWEST_PER_PERIOD = 2.5  # traverses
CARRIED = (-0.3, 0.2, 0.35, 0.5, 0.65, 0.8)


def structures(study: Study) -> list[Hypothesis | Memory]:
    """Every structure that the rows have the columns for."""
    every, rows = list(sessions(study).values()), study.rows
    seconds, session = (
        rows["session_seconds"].to_numpy(float),
        pd.factorize(rows["session"].astype(object))[0],
    )
    waves = _slow(seconds, session) / study.scale[:, None]
    found: list[Hypothesis | Memory | None] = [
        hypothesis(f"unknown:{name}", None, None, study.project(columns / study.scale[:, None]))
        for name, columns in (*_by_configuration(rows), *_harmonics(rows))
    ]
    found.append(hypothesis("unknown:time, the same in each session", None, None, study.project(waves)))
    found += of_each(["unknown:time"], len(rows), every, waves[:, None])
    for joint in rows["joint"].unique():
        mine = (rows["joint"] == joint).to_numpy()[:, None]
        found += of_each([f"unknown:time, joint {joint}"], len(rows), every, (waves * mine)[:, None])
    order = rows.groupby(session).cumcount().to_numpy(float)
    for clock, unit, called in ((seconds, 60.0, "min"), (order, 1.0, "traverses")):
        periods = _periods(clock, session)
        angles = 2 * np.pi * clock[:, None] / periods
        pairs = np.stack([np.cos(angles), np.sin(angles)], axis=-1) / study.scale[:, None, None]
        names = [f"unknown:period of {period / unit:.1f} {called}" for period in periods]
        found += of_each(names, len(rows), every, pairs)
    return [each for each in found if each is not None] + list(_memories(rows))


def _slow(seconds: Array, session: npt.NDArray[np.intp]) -> Array:
    """Smooth in time, from each session's beginning to its end, shape (n, waves)."""
    last = pd.Series(seconds).groupby(session).transform("max").to_numpy()
    phase = seconds / np.maximum(last, 1.0)
    return np.stack([np.cos(np.pi * k * phase) / k for k in range(1, WAVES + 1)], axis=-1)


def _by_configuration(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """A departure of each configuration, where these come back often enough to show it."""
    kinds = configuration(rows)
    if kinds.max() < len(rows) / 3 and 3 * kinds.max() * len(rows) < MOST_NUMBERS:
        backwards = (rows["direction"] == "-").to_numpy()
        yield "configuration", np.eye(kinds.max() + 1)[kinds]
        yield "configuration and direction", np.eye(2 * kinds.max() + 2)[2 * kinds + backwards]


def _harmonics(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    """Waves of q2 that joint 3's law has not, one by one and together."""
    mine = (rows["joint"] == 3).to_numpy()
    if not mine.any():
        return
    q2 = np.nan_to_num(rows["q2"].to_numpy(float))
    columns = np.stack([f(k * q2) for k in (2, 3, 4) for f in (np.cos, np.sin)], axis=-1) * mine[:, None]
    yield "harmonics of q2, joint 3", columns
    for column, name in zip(columns.T, ("cos 2", "sin 2", "cos 3", "sin 3", "cos 4", "sin 4"), strict=True):
        yield f"{name} q2, joint 3", column[:, None]


def _periods(clock: Array, session: npt.NDArray[np.intp]) -> Array:
    """Periods that a session is long enough for and its traverses dense enough, evenly in frequency."""
    order = np.lexsort((clock, session))
    apart = np.diff(clock[order])[np.diff(session[order]) == 0]
    if not (apart > 0).any():
        return np.zeros(0)
    longest, step = float(clock.max()), float(np.median(apart[apart > 0]))
    if longest < 4 * FEWEST_PER_PERIOD * step:
        return np.zeros(0)
    slowest, fastest = 2.0 / longest, 1.0 / (FEWEST_PER_PERIOD * step)
    number = min(MOST_PERIODS, int(np.ceil(2.0 * longest * (fastest - slowest))))
    return np.asarray(1.0 / np.linspace(slowest, fastest, number))


def _memories(rows: pd.DataFrame) -> Iterator[Memory]:
    session = pd.factorize(rows["session"].astype(object))[0]
    joint = rows["joint"].to_numpy()
    for name, group in (("", session), (" of each joint", 10 * session + joint)):
        before = previous(group.astype(np.int64)).astype(np.intp)
        for carried in CARRIED:
            yield Memory(f"unknown:memory{name}", before, carried)


def configuration(rows: pd.DataFrame) -> npt.NDArray[np.intp]:
    """A number for each configuration: joint, where the others stand, base, and the stretch, not the way."""
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    keys = rows[["joint", "q1", "q2", "q3", "theta", "psi"]].astype(float).fillna(9.0)
    keys = np.column_stack([keys.to_numpy(), ends]).round(6)
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()
