"""How far off predictions are of traverses that took no part in choosing or fitting what predicts them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.diagnosis import Finding
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.searching.search import Found, Search
from stickslip_fit.diagnose.worth.folds import Split, blocks_of
from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.levenberg_marquardt import minimise

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Seek = Callable[[Bench, np.random.Generator], Search]

TOLERANCE, MOST = 1e-5, 60


def errors(bench: Bench, split: Split, findings: Sequence[Finding], seek: Seek, seed: Sequence[int]) -> Array:
    """Search the training rows, and predict those held out under ever more of what was found.

    Parameters
    ----------
    bench : Bench
        Without the log's misfires.
    split : Split
    findings : sequence of Finding
        Those of the whole log that extend its laws.
    seek : callable
        The search, from a bench and a generator.
    seed : sequence of int

    Returns
    -------
    array, shape (k + 1, number held out)
        Measured less predicted, relative: under the baseline, then with what the search made of the first
        finding, of the first two, and so on; in the last with everything it found.
    """
    training = bench.without(np.setdiff1d(np.arange(len(bench)), split.training))
    searched = seek(training, np.random.default_rng(seed))
    off = [_off(bench, split.calibrating, split.held, (), np.zeros(0))]
    named = [each for each in searched.found if each.version is not None]
    step_of = steps(named, findings)
    for step in range(len(findings)):
        chosen = [each for each, mine in zip(named, step_of, strict=True) if mine <= step]
        versions = [each.version for each in chosen]
        if len(chosen) == len(named):
            values = searched.fit.values
        else:
            start = np.concatenate([np.zeros(0), *(each.start for each in chosen)])
            values = searched.bench.fitted(versions, start).values
        off.append(_off(bench, split.calibrating, split.held, versions, values))
    return np.stack(off)


def steps(named: Sequence[Found], findings: Sequence[Finding]) -> list[int]:
    """Which finding of the whole log each cause found in a part of it stands for.

    That which names it, or names it as a rival; what no finding names stands for the last.
    """

    def step(found: Found) -> int:
        alike = [found.cause in (each.cause, *each.equivalent) for each in findings]
        return alike.index(True) if any(alike) else len(findings) - 1

    return [step(each) for each in named]


def _off(bench: Bench, calibrating: Indices, held: Indices, versions: Sequence[Any], values: Array) -> Array:
    """Errors on rows held out, of laws that hold causes of known size and are calibrated by some rows."""
    off, measured = np.zeros(len(bench)), bench.responses
    of_row = blocks_of(bench.parts, len(bench))
    for part in bench.parts:
        law = part.law
        for version in versions:
            law = version.extend(law)
        known, wanted = np.isin(part.rows, calibrating), np.isin(part.rows, held)
        if not wanted.any():
            continue
        mine, block = part.rows[known], of_row[part.rows]
        kinds, group = np.unique(block[known], return_inverse=True)
        start = part.values[known][np.unique(group, return_index=True)[1]]
        groups = Groups(pd.DataFrame({"block": kinds}), group.ravel())
        fitted = _calibrated(bench, law, mine, groups, start, values)
        rows, at = part.rows[wanted], np.searchsorted(kinds, block[wanted])
        both = np.concatenate([fitted[at], np.broadcast_to(values, (len(rows), len(values)))], axis=1)
        off[rows] = measured[rows] - law.predict(bench.rows.iloc[rows], both)
    return off[held]


def _calibrated(bench: Bench, law: Any, rows: Indices, groups: Groups, start: Array, values: Array) -> Array:
    """Own parameters of each group, shape (g, p), the causes' being known."""
    model = law.model(bench.rows.iloc[rows])
    shared = np.broadcast_to(values, (len(rows), len(values)))

    def own(each: Array) -> tuple[Array, Array]:
        predicted, slopes = model(np.concatenate([each, shared], axis=1))
        return predicted, slopes[:, : each.shape[1]]

    scales = np.maximum(np.abs(start), 0.1 * np.abs(start[:, :1]))
    weight = 1.0 / bench.scale[rows] ** 2
    return minimise(
        own, bench.responses[rows], weight, groups, start, scales, damping=0.0, tolerance=TOLERANCE, most=MOST
    ).values
