"""A diagnosis of a campaign log with what its findings gain."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding, Gain
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.progress import Progress, silent
from stickslip_fit.diagnose.searching.search import Search, search
from stickslip_fit.diagnose.shapes.candidates import changes
from stickslip_fit.diagnose.shapes.structures import configuration
from stickslip_fit.diagnose.worth.folds import Split, folds
from stickslip_fit.diagnose.worth.gain import gain
from stickslip_fit.diagnose.worth.new_session import new_sessions
from stickslip_fit.machine import Machine

REDRAWN = 4  # ways in which a fresh replicate may hold configurations out
BEGUN, IN_FOLDS, DONE = 0.2, 0.7, 0.95  # shares of a diagnosis's work


def with_gain(
    decided: Diagnosis, machine: Machine, *, workers: int = -1, progress: Progress = silent
) -> Diagnosis:
    """Measure what each finding, and all of them together, gain on traverses held out.

    Parameters
    ----------
    decided : Diagnosis
    machine : Machine
        Whose calibration traverses a new session would have.
    workers : int, optional
        Processes; all cores without it.
    progress : callable, optional
    """
    began, searched = time.perf_counter(), decided.search
    if not len(searched.bench):
        return decided
    within, *others = (
        within_sessions(searched, np.random.default_rng([decided.seed, k])) for k in range(1 + REDRAWN)
    )
    between = new_sessions(searched.bench, machine)
    told = partial(_told, progress, "predicting held-out traverses", BEGUN, IN_FOLDS)
    whole, findings = _gain(decided, within, others, workers, told)
    told = partial(_told, progress, "predicting new sessions", IN_FOLDS, DONE)
    new, _ = _gain(decided, between, (), workers, told)
    return replace(
        decided,
        findings=findings,
        gain=whole,
        gain_new_session=new,
        seconds=decided.seconds + time.perf_counter() - began,
    )


def within_sessions(searched: Search, rng: np.random.Generator) -> list[Split]:
    """Hold out configurations of what was searched."""
    study, fit = searched.bench.study(), searched.fit
    sizes = np.cumsum([len(each.start) for each in searched.found if each.version is not None])[:-1]
    values = np.split(fit.values, sizes) if len(fit.values) else []
    made = [
        changes(study, version, own[None]) for version, own in zip(searched.versions, values, strict=True)
    ]
    effects = study.project(np.concatenate(made, axis=1) / study.scale[:, None]) if made else None
    return folds(study, configurations(searched.bench.rows), rng, effects)


def configurations(rows: pd.DataFrame) -> npt.NDArray[np.intp]:
    """A number for each session's each configuration: what is held out together, shape (n,)."""
    session, _ = pd.factorize(rows["session"].astype(object))
    return np.unique(np.column_stack([session, configuration(rows)]), axis=0, return_inverse=True)[1].ravel()


def seek(bench: Bench, rng: np.random.Generator, alpha: float) -> Search:
    """Search part of a log, by as few logs in which nothing is wrong as let it raise an alarm.

    Wild counts would take more; those of the whole log are out already.
    """
    return search(bench, alpha, int(np.ceil(2.0 / alpha)), rng)


def _gain(
    decided: Diagnosis,
    splits: Sequence[Split],
    others: Sequence[Sequence[Split]],
    workers: int,
    told: partial[None],
) -> tuple[Gain | None, tuple[Finding, ...]]:
    if not splits:
        return None, decided.findings
    return gain(
        decided.search,
        decided.findings,
        splits,
        partial(seek, alpha=decided.alpha),
        others=others,
        alpha=decided.alpha,
        seed=decided.seed,
        workers=workers,
        progress=told,
    )


def _told(progress: Progress, step: str, begun: float, ended: float, done: int, number: int) -> None:
    progress(step, begun + (ended - begun) * done / number)
