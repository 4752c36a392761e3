"""Learners given the columns and asked what matters: lasso, trees, additive models, sparse dynamics."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.naming.problem import Answer, Array, Indices, Problem

FOLDS, SHUFFLES = 4, 5
# The machine's defaults, 14 bags at a rate of 0.015, take half a minute a log.
BAGS, RATE, ROUNDS = 1, 0.1, 200
# Defaults of sparse dynamics: the smallest coefficient that is kept, of the residual's spread, and the ridge.
FAINT, RIDGE = 0.1, 0.05


def lasso(problem: Problem) -> Answer:
    """LassoCV with folds of whole configurations; each cause's share in what it saves of held-out error."""
    from sklearn.linear_model import LassoCV

    y = problem.y / problem.noise
    model = LassoCV(cv=list(_folds(problem)), alphas=30, eps=0.03, max_iter=500, tol=1e-3).fit(problem.x, y)
    error = model.mse_path_.mean(axis=1)  # from the strongest penalty, which leaves nothing, downwards
    added = {
        cause: problem.x[:, problem.cause == cause] @ model.coef_[problem.cause == cause]
        for cause in problem.causes
    }
    shares = _shares({cause: float(each @ each) for cause, each in added.items()})
    scores = {cause: len(y) * float(error[0] - error.min()) * share for cause, share in shares.items()}
    return _answer(scores, 0.0, shares, problem.noise * sum(added.values())[None])


def trees(problem: Problem) -> Answer:
    """Gradient-boosted trees, by permutation importance on folds of whole configurations."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    return _by_permutation(problem, lambda: HistGradientBoostingRegressor(max_iter=60, random_state=0))


def explainable(problem: Problem) -> Answer:
    """An explainable boosting machine without interactions, by the same importance."""
    from interpret.glassbox import ExplainableBoostingRegressor

    machine = partial(
        ExplainableBoostingRegressor,
        feature_names=problem.causes, feature_types=["continuous"] * len(problem.causes), interactions=0,
        outer_bags=BAGS, learning_rate=RATE, max_rounds=ROUNDS, n_jobs=1, random_state=0,
    )  # fmt: skip
    return _by_permutation(problem, machine)


def additive(problem: Problem) -> Answer:
    """A generalised additive model of each cause's best column: smooth terms and their p-values."""
    from pygam import LinearGAM, s

    x = _leading(problem, np.arange(len(problem.y)))
    terms = s(0, n_splines=6)
    for number in range(1, x.shape[1]):
        terms += s(number, n_splines=6)
    model = LinearGAM(terms).fit(x, problem.y / problem.noise)
    p = np.maximum(model.statistics_["p_values"][: x.shape[1]], 1e-300)
    scores = {
        cause: -2.0 - float(np.log10(each * len(p))) for cause, each in zip(problem.causes, p, strict=True)
    }
    certain = {cause: float(1 - each) for cause, each in zip(problem.causes, p, strict=True)}
    return _answer(scores, 0.0, certain, problem.noise * model.predict(x)[None])


def sparse_dynamics(problem: Problem) -> Answer:
    """Sequentially thresholded least squares, bagged: each cause's best column, and how often it stays."""
    from pysindy import STLSQ, EnsembleOptimizer

    x = _leading(problem, np.arange(len(problem.y)))
    np.random.seed(0)  # noqa: NPY002 - pysindy draws from the global generator
    model = EnsembleOptimizer(STLSQ(threshold=FAINT, alpha=RIDGE * len(x)), bagging=True, n_models=20)
    model.fit(x, problem.y[:, None] / problem.noise)
    size = np.median(model.coef_list, axis=0).ravel()
    often = np.mean(np.array(model.coef_list) != 0, axis=0).ravel()
    loud = np.sqrt(len(x)) * np.abs(size)
    scores = dict(zip(problem.causes, map(float, loud), strict=True))
    inclusion = dict(zip(problem.causes, map(float, often), strict=True))
    return _answer(scores, 0.0, inclusion, problem.noise * (x @ size)[None])


def _answer(
    scores: dict[str, float], threshold: float, inclusion: dict[str, float], departures: Array
) -> Answer:
    loudest = sorted(scores.items(), key=lambda each: -each[1])
    return Answer(loudest, threshold, inclusion, departures)


def _shares(squares: dict[str, float]) -> dict[str, float]:
    """Share of each in what all explain."""
    whole = sum(max(each, 0.0) for each in squares.values()) or 1.0
    return {cause: max(each, 0.0) / whole for cause, each in squares.items()}


def _folds(problem: Problem) -> Any:
    from sklearn.model_selection import GroupKFold

    return GroupKFold(FOLDS, shuffle=True, random_state=0).split(problem.x, problem.y, problem.groups)


def _by_permutation(problem: Problem, model: Callable[[], Any]) -> Answer:
    """What shuffling a cause's column costs in held-out folds; it counts where two errors above 0."""
    y, rng = problem.y / problem.noise, np.random.default_rng(0)
    lost = np.zeros((len(problem.causes), SHUFFLES))
    for training, held in _folds(problem):
        x = _leading(problem, training)
        fitted = model().fit(x[training], y[training])
        square = np.sum((y[held] - fitted.predict(x[held])) ** 2)
        for place, shuffle in np.ndindex(lost.shape):
            shuffled = x[held].copy()
            shuffled[:, place] = rng.permutation(shuffled[:, place])
            lost[place, shuffle] += np.sum((y[held] - fitted.predict(shuffled)) ** 2) - square
    loud = lost.mean(axis=1) - 2 * lost.std(axis=1)
    scores = dict(zip(problem.causes, map(float, loud), strict=True))
    x = _leading(problem, np.arange(len(y)))
    departure = problem.noise * model().fit(x, y).predict(x)
    return _answer(scores, 0.0, _shares(scores), departure[None])


def _leading(problem: Problem, rows: Indices) -> Array:
    """A column of unit rms for each cause, shape (n, causes): its best candidate's, fitted to some rows."""
    y, columns = problem.y[rows], []
    for cause in problem.causes:
        best, most = np.zeros(len(problem.y)), -1.0
        for number in np.unique(problem.candidate[problem.cause == cause]):
            x = problem.x[:, problem.candidate == number]
            slope = x[rows].T @ y
            if x.shape[1] > 1:
                beta = np.linalg.lstsq(x[rows], y)[0]
            else:
                beta = slope / max(float(np.sum(x[rows] ** 2)), 1e-9)
            if slope @ beta / len(beta) > most:
                best, most = x @ beta, float(slope @ beta) / len(beta)
        columns.append(best / np.sqrt(np.mean(best**2)))
    return np.stack(columns, axis=1)
