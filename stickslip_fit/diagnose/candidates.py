"""The shapes that known causes would give a log."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.hypothesis import Hypothesis, hypothesis
from stickslip_fit.diagnose.study import Study

Array = npt.NDArray[np.float64]


def effects(study: Study, version: Any, trials: Array) -> Array:
    """Change of every response, in units of its noise, recalibration taken out; trials (m, q) -> (n, m)."""
    return study.project(changes(study, version, trials) / study.scale[:, None])


def changes(study: Study, version: Any, trials: Array) -> Array:
    """Change of every response; trials (m, q) -> (n, m)."""
    found = np.zeros((len(study), len(trials)))
    for part, table in zip(study.parts, study.tables, strict=True):
        if part.law.joint in version.joints:
            found[part.rows] = version.changes(part.law, table, part.values, trials)
    return found


def candidates(study: Study, causes: Iterable[Any]) -> list[Hypothesis]:
    """Every shape of every cause."""
    found = []
    for cause in causes:
        for version, trials in cause.trials(study.rows):
            columns = effects(study, version, trials)
            if version.joined:
                found.append(hypothesis(cause.name, version, None, columns))
            else:
                found += [
                    hypothesis(cause.name, version, trial, column[:, None])
                    for trial, column in zip(trials, columns.T, strict=True)
                ]
    return [each for each in found if each is not None]
