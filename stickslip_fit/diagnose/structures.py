"""Shapes that no cause has: what is left may follow time, the configuration or the traverse before.

They stand for ``unknown``. Each is as flexible as it must be to catch what it is named after.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.hypothesis import Hypothesis, hypothesis
from stickslip_fit.diagnose.study import Study

Array = npt.NDArray[np.float64]

WAVES = 6
PERIODS = 40


def structures(study: Study) -> list[Hypothesis]:
    """Every structure that the rows have the columns for."""
    found = [
        hypothesis(f"unknown:{name}", None, None, study.project(columns / study.scale[:, None]))
        for name, columns in _shapes(study.rows)
    ]
    return [each for each in found if each is not None]


def _shapes(rows: pd.DataFrame) -> Iterator[tuple[str, Array]]:
    session = pd.factorize(rows["session"].astype(object))[0]
    seconds = rows["session_seconds"].to_numpy(float)
    phase = seconds / np.maximum(pd.Series(seconds).groupby(session).transform("max").to_numpy(), 1.0)
    own = np.eye(session.max() + 1)[session]
    waves = np.stack([np.cos(np.pi * k * phase) / k for k in range(1, WAVES + 1)], axis=-1)
    yield "time", (waves[:, :, None] * own[:, None, :]).reshape(len(rows), -1)
    yield "time, the same in each session", waves
    for joint in rows["joint"].unique():
        mine = (rows["joint"] == joint).to_numpy()
        yield (
            f"time, joint {joint}",
            (waves[:, :, None] * own[:, None, :]).reshape(len(rows), -1) * mine[:, None],
        )
    kinds = configuration(rows)
    if kinds.max() < len(rows) / 3:
        backwards = (rows["direction"] == "-").to_numpy()
        yield "configuration", np.eye(kinds.max() + 1)[kinds]
        yield "configuration and direction", np.eye(2 * kinds.max() + 2)[2 * kinds + backwards]
    for joint, angle in ((3, "q2"),):
        mine = (rows["joint"] == joint).to_numpy()
        q = np.nan_to_num(rows[angle].to_numpy(float))
        columns = np.stack([f(k * q) for k in (2, 3, 4) for f in (np.cos, np.sin)], axis=-1) * mine[:, None]
        yield f"harmonics of {angle}, joint {joint}", columns
    longest = float(seconds.max())
    shortest = 4 * float(np.median(np.diff(np.unique(seconds))))
    for period in np.geomspace(shortest, longest / 2, PERIODS):
        angle = 2 * np.pi * seconds / period
        pair = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        yield f"period of {period / 60:.1f} min", (pair[:, :, None] * own[:, None, :]).reshape(len(rows), -1)


def configuration(rows: pd.DataFrame) -> npt.NDArray[np.intp]:
    """A number for each configuration: joint, where the others stand, base, and the stretch, not the way."""
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    keys = rows[["joint", "q1", "q2", "q3", "theta", "psi"]].astype(float).fillna(9.0)
    keys = np.column_stack([keys.to_numpy(), ends]).round(6)
    return np.unique(keys, axis=0, return_inverse=True)[1].ravel()
