"""The shapes that known causes would give a log."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis, hypothesis
from stickslip_fit.diagnose.shapes.within import Session, of_one, sessions

Array = npt.NDArray[np.float64]

SMALLER = 20.0


def effects(study: Study, version: Any, trials: Array) -> Array:
    """Change of every response, in units of its noise, recalibration taken out; trials (m, q) -> (n, m)."""
    return study.project(changes(study, version, trials) / study.scale[:, None])


def session_effects(study: Study, session: Session, version: Any, trials: Array) -> Array:
    """As `effects`, of a version that acts in one session alone, s rows; trials (m, q) -> (s, m)."""
    return session.project(changes(session, version, trials) / study.scale[session.rows, None])


def changes(study: Study | Session, version: Any, trials: Array) -> Array:
    """Change of every response; trials (m, q) -> (n, m).

    A trial by which a law has no answer (a joint would stall) stands for a smaller one of its kind; without
    effect if that has none either.
    """
    found = _changes(study, version, trials)
    if (stalled := ~np.isfinite(found).all(axis=0)).any():
        smaller, absent = trials[stalled].copy(), np.array(version.absent)
        sizes = slice(None) if version.joined else slice(0, 1)
        smaller[:, sizes] = absent[sizes] + (smaller[:, sizes] - absent[sizes]) / SMALLER
        again = SMALLER * _changes(study, version, smaller)
        found[:, stalled] = np.where(np.isfinite(again).all(axis=0), again, 0.0)
    return found


def _changes(study: Study | Session, version: Any, trials: Array) -> Array:
    found = np.zeros((len(study), len(trials)))
    for part, table in zip(study.parts, study.tables, strict=True):
        if acts_on(version, part.law):
            found[part.rows] = version.changes(part.law, table, part.values, trials)
    return found


def acts_on(version: Any, law: Any) -> bool:
    """Whether a cause concerns a law; laws of joints say of which one, and causes on which ones they act."""
    return not hasattr(law, "joint") or law.joint in version.joints


def candidates(study: Study, causes: Iterable[Any]) -> list[Hypothesis]:
    """Every shape of every cause."""
    found: list[Hypothesis | None] = []
    every = sessions(study)
    for cause in causes:
        for version, trials in cause.trials(study.rows):
            if version.session:
                session = every[version.session]
                shape = session_effects(study, session, version, trials)
                found += of_one(cause.name, version, trials, len(study), session, shape)
                continue
            columns = effects(study, version, trials)
            if version.joined:
                found.append(hypothesis(cause.name, version, None, columns))
            else:
                found += [
                    hypothesis(cause.name, version, trial, column[:, None])
                    for trial, column in zip(trials, columns.T, strict=True)
                ]
    return [each for each in found if each is not None]
