"""What an extension of the laws is worth: errors on traverses that took no part in choosing or fitting it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.diagnosis import Finding, Gain
from stickslip_fit.diagnose.searching.evidence import STRENGTHS
from stickslip_fit.diagnose.searching.misfit import UNKNOWN, Misfit
from stickslip_fit.diagnose.searching.search import Found, Search, others_level
from stickslip_fit.diagnose.shapes.candidates import changes
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.sizes.amplitude import threshold_length
from stickslip_fit.diagnose.worth.folds import Split
from stickslip_fit.diagnose.worth.held_out import Seek, errors
from stickslip_fit.diagnose.worth.replicates import (
    LARGEST_LEVERAGE,
    Campaign,
    Rivals,
    left_over,
    log_likelihood_ratio,
    spread,
)

Array = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]


def gain(
    searched: Search,
    findings: Sequence[Finding],
    splits: Sequence[Split],
    seek: Seek,
    *,
    others: Sequence[Sequence[Split]] = (),
    alpha: float,
    seed: int = 0,
    workers: int = -1,
    progress: Progress | None = None,
) -> tuple[Gain, tuple[Finding, ...]]:
    """Repeat the search in each split and see how much better it predicts what was held out.

    Parameters
    ----------
    searched : Search
        Of the whole log; what it called misfires takes no part.
    findings : sequence of Finding
        Of the whole log. Those that extend no law gain nothing.
    splits : sequence of Split
        Of the rows of `searched.bench`; at least one.
    seek : callable
        The search, from a bench and a generator.
    others : sequence of sequence of Split, optional
        As the splits of a fresh replicate may be; the same without them.
    alpha : float
        Of that search.
    seed : int, optional
    workers : int, optional
        Processes; all cores without it. The answer is the same.
    progress : callable, optional
        Told how many splits are done, and of how many.

    Returns
    -------
    gain : Gain
    findings : tuple of Finding
        The same, each with its own gain.
    """
    extending = [each for each in findings if each.version is not None]
    if extending:
        off = _all_errors(searched, extending, splits, seek, seed, workers, progress)
        found = [_found(searched, each) for each in extending]
        rms, rng = np.sqrt(np.mean(off**2, axis=1)), np.random.default_rng([seed, 1])
        limits = spread(_campaign(searched, found, alpha), splits, others or (splits,), rms, rng)
    else:
        off, limits = _baseline_errors(searched, splits)[None], np.zeros((2, 1))
    steps = np.cumsum([0, *(each.version is not None for each in findings)])
    gains = [
        _between(searched, splits, off[[before, after]], (after > before) * limits[:, before])
        for before, after in pairwise(steps)
    ]
    own = tuple(replace(each, gain=one) for each, one in zip(findings, gains, strict=True))
    return _between(searched, splits, off[[0, -1]], limits[:, -1]), own


def _all_errors(
    searched: Search,
    findings: Sequence[Finding],
    splits: Sequence[Split],
    seek: Seek,
    seed: int,
    workers: int,
    progress: Progress | None,
) -> Array:
    from joblib import Parallel, delayed

    tasks = (
        delayed(errors)(searched.bench, split, findings, seek, (seed, number))
        for number, split in enumerate(splits)
    )
    done = []
    for each in Parallel(n_jobs=workers, return_as="generator")(tasks):
        done.append(each)
        if progress is not None:
            progress(len(done), len(splits))
    return np.concatenate(done, axis=1)


def _baseline_errors(searched: Search, splits: Sequence[Split]) -> Array:
    """By linear algebra: no fold is searched where there is nothing to extend."""
    study = searched.bench.study()
    residual = study.residual[:, None]
    off = [left_over(study.basis, each.calibrating, each.held, residual)[:, 0] for each in splits]
    return np.concatenate(off) * study.scale[np.concatenate([each.held for each in splits])]


def _campaign(searched: Search, found: Sequence[Found], alpha: float) -> Campaign:
    study, fit = searched.bench.study(), searched.fit
    sizes = [len(each.start) for each in _named(searched)]
    places = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
    own = [places[[each is one for one in _named(searched)].index(True)] for each in found]
    made = [changes(study, each.version, fit.values[None, at]) for each, at in zip(found, own, strict=True)]
    effects, slopes = np.concatenate(made, axis=1) / study.scale[:, None], _slopes(searched)
    leverage = np.minimum(searched.study.leverage, LARGEST_LEVERAGE)
    return Campaign(
        study.basis,
        study.scale,
        searched.study.residual / np.sqrt(1.0 - leverage),
        effects,
        tuple(slopes[:, at] / study.scale[:, None] for at in own),
        np.array([_threshold(searched, each, alpha) for each in found]),
        tuple(_rivals(each, study.freedom) for each in found),
    )


def _rivals(found: Found, freedom: int) -> Rivals:
    looked = found.misfit
    assert looked is not None
    others = [
        cause
        for cause in looked.by_cause
        if cause != found.cause and isinstance(looked.best_of(cause), Hypothesis)
    ]
    _, own = _explained(looked, found.cause, freedom)
    explained = [_explained(looked, cause, freedom) for cause in others]
    shapes = [np.zeros((len(looked.residual), 0)), *(shape[:, None] for shape, _ in explained)]
    return Rivals(
        np.concatenate(shapes, axis=1),
        np.array([ahead - own for _, ahead in explained]),
        np.array([cause != UNKNOWN for cause in others], dtype=bool),
    )


def _explained(looked: Misfit, cause: str, freedom: int) -> tuple[Array, float]:
    """What a cause makes of the residuals, (n,), and its log evidence beyond the best likelihood ratio."""
    best = looked.best_of(cause)
    assert isinstance(best, Hypothesis)
    along = best.along(looked.residual)
    share = float(along @ along) / float(looked.residual @ looked.residual)
    return best.sum_of(along), looked.by_cause[cause] - float(log_likelihood_ratio(share, freedom))


def _named(searched: Search) -> list[Found]:
    return [each for each in searched.found if each.version is not None]


def _found(searched: Search, finding: Finding) -> Found:
    return next(each for each in _named(searched) if each.cause == finding.cause)


def _slopes(searched: Search) -> Array:
    """Change of every response with each parameter of the causes found, shape (n, q)."""
    bench, shared = searched.bench, len(searched.fit.values)
    slopes = np.zeros((len(bench), shared))
    for part in searched.fit.parts:
        slopes[part.rows] = part.law.jacobian(bench.rows.iloc[part.rows], part.values)[:, -shared:]
    return slopes


def _threshold(searched: Search, found: Found, alpha: float) -> float:
    """Length of an effect that makes the search find it."""
    looked = found.misfit
    assert looked is not None
    shapes = max(sum(each.cause == found.cause for each in looked.hypotheses), 1)
    critical, freedom = searched.first.critical(others_level(alpha)), searched.bench.study().freedom
    return threshold_length(critical, shapes, freedom, STRENGTHS)


def _between(searched: Search, splits: Sequence[Split], off: Array, limits: Array) -> Gain:
    """From the errors before to those after, shape (2, number held out)."""
    held = np.concatenate([split.held for split in splits])
    before, after = np.sqrt(np.mean(off**2, axis=1))
    floor = np.sqrt(np.mean(searched.bench.scale[held] ** 2))
    session = searched.bench.rows["session"].to_numpy(object)[held]
    squares = pd.DataFrame({"session": session, "baseline": off[0] ** 2, "extended": off[1] ** 2})
    grouped = squares.groupby("session", sort=False)
    table = np.sqrt(grouped[["baseline", "extended"]].mean()).reset_index()
    table = table.assign(traverses=grouped.size().to_numpy())
    return Gain(float(before), float(after), float(floor), float(limits[0]), float(limits[1]), table)
