"""Drops as a DiagnosisProblem: free fall, its causes, and unstructured alternatives."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis.cross_validation import Split
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis, make_hypothesis
from stickslip_fit.diagnosis.linearized import LawBlock, LinearizedFit
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from tests.balls.cause import FallCause
from tests.balls.causes import library
from tests.balls.fall import Fall

REPEATABILITY = 0.05  # m, to begin with
WAVES, CARRIED = 6, (0.2, 0.35, 0.5, 0.65, 0.8)


def make_problem(
    rows: pd.DataFrame, causes: Iterable[FallCause] | None = None
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """Drops under free fall, and the causes that they cannot show for want of a column, and why."""
    rows = rows.reset_index(drop=True)
    known = library() if causes is None else tuple(causes)
    missing = {cause.name: why for cause in known if (why := cause.explain_missing(rows)) is not None}
    law, drop = Fall(), pd.factorize(rows["session"])[0].astype(np.intp)
    height, rounding = law.response(rows)
    seconds = rows["seconds"].to_numpy(float)
    values = np.empty((len(rows), 2))
    for subset in (drop == each for each in np.unique(drop)):
        fall = height[subset] - law.predict(rows[subset], np.zeros(2))
        values[subset] = np.polynomial.Polynomial.fit(seconds[subset], fall, 1).convert().coef
    problem = DiagnosisProblem(
        rows=rows,
        parts=(LawBlock(law, np.arange(len(rows)), drop, values),),
        responses=height,
        rounding=rounding,
        noise_group=np.zeros(len(rows), dtype=np.intp),
        repeatability=np.array([REPEATABILITY]),
        causes=tuple(cause for cause in known if cause.name not in missing),
        alternatives=build_alternatives,
        configuration=drop,
        noise_ratio=np.ones(len(rows)),
    )
    return problem, missing


def build_alternatives(study: LinearizedFit) -> list[Hypothesis | AR1]:
    """What follows time smoothly, in each drop by itself or alike in all, or carries over between frames."""
    rows = study.rows
    drop, seconds = pd.factorize(rows["session"])[0], rows["seconds"].to_numpy(float)
    waves = np.stack([np.cos(np.pi * k * seconds / seconds.max()) / k for k in range(1, WAVES + 1)], axis=-1)
    own = (waves[:, :, None] * np.eye(drop.max() + 1)[drop][:, None, :]).reshape(len(rows), -1)
    found = [
        make_hypothesis(f"unknown:{name}", None, None, study.project(columns / study.scale[:, None]))
        for name, columns in (("time", own), ("time, the same in each drop", waves))
    ]
    before = np.where(np.diff(drop, prepend=-1) == 0, np.arange(-1, len(rows) - 1), -1)
    return [each for each in found if each is not None] + [
        AR1("unknown:memory", before, carried) for carried in CARRIED
    ]


def later_half_of_the_last_drop(rows: pd.DataFrame) -> list[Split]:
    """Causes from the other drops, height and velocity at release from the last one's earlier half."""
    seconds, session = rows["seconds"].to_numpy(float), rows["session"].to_numpy(object)
    last = session == session[-1]
    late = seconds > np.median(seconds[last])
    return [Split(*(np.flatnonzero(subset) for subset in (~last, last & ~late, last & late)))]
