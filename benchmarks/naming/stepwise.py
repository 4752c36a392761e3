"""Forward stepwise regression: by AIC, by BIC, and held at a family-wise error rate of 1 %."""

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from benchmarks.naming.problem import Answer, Array, Indices, Problem

MOST = 8  # candidates taken in, at most
Worth = Callable[[float, float, int, int, Problem], float]


def aic(before: float, after: float, columns: int, taken: int, problem: Problem) -> float:
    """Fall of Akaike's criterion, from the sums of squares before and after."""
    return len(problem.y) * float(np.log(before / after)) - 2 * columns


def bic(before: float, after: float, columns: int, taken: int, problem: Problem) -> float:
    """Fall of Schwarz's criterion."""
    n = len(problem.y)
    return n * float(np.log(before / after)) - columns * float(np.log(n))


def family_wise(before: float, after: float, columns: int, taken: int, problem: Problem) -> float:
    """Digits by which the p-value, times the number of candidates, is below 1 %."""
    from scipy.stats import f

    left = problem.df - taken - columns
    p = f.logsf((before - after) / columns / (after / left), columns, left) / np.log(10)
    return float(-2 - p - np.log10(len(set(problem.candidate))))


def stepwise(problem: Problem, worth: Worth) -> Answer:
    """Take in the candidate worth most, again and again, until none is worth anything."""
    chosen: list[Indices] = []
    found: list[tuple[str, float]] = []
    departures: list[Array] = []
    interval = None
    for columns, value in _forward(problem, worth):
        if chosen and value <= 0:
            break
        chosen.append(columns)
        fitted = _fitted(problem, np.concatenate(chosen))
        if interval is None:
            interval = _interval(problem, columns, fitted)
        cause = str(problem.cause[columns[0]])
        departure = problem.x[:, np.concatenate(chosen)] @ fitted.params[: sum(map(len, chosen))]
        if cause in dict(found):
            departures[-1] = departure
        else:
            found.append((cause, value))
            departures.append(departure)
    return Answer(found, 0.0, {cause: 1.0 for cause, _ in found}, np.stack(departures), interval=interval)


def _forward(problem: Problem, worth: Worth) -> Iterator[tuple[Indices, float]]:
    """Columns of the best candidate and what it is worth, given those before."""
    places = [np.flatnonzero(problem.candidate == each) for each in np.unique(problem.candidate)]
    y, x, taken = problem.y, problem.x, 0
    for _ in range(MOST):
        before = float(y @ y)
        length = np.sum(x**2, axis=0)
        alone = np.divide((y @ x) ** 2, length, where=length > 1e-3 * len(y), out=np.zeros(len(length)))
        drops = [alone[k[0]] if len(k) == 1 else _drop(y, x[:, k]) for k in places]
        worths = [
            worth(before, before - drop, len(k), taken, problem)
            for k, drop in zip(places, drops, strict=True)
        ]
        best = places[int(np.argmax(worths))]
        yield best, max(worths)
        q = np.linalg.qr(x[:, best])[0]
        y, x, taken = y - q @ (q.T @ y), x - q @ (q.T @ x), taken + len(best)


def _drop(y: Array, x: Array) -> float:
    left, spread, _ = np.linalg.svd(x, full_matrices=False)
    return float(np.sum((left[:, spread > 0.03 * np.sqrt(len(y))].T @ y) ** 2))


def _fitted(problem: Problem, columns: Indices) -> Any:
    """Ordinary least squares of the chosen columns beside the baseline's."""
    from statsmodels.api import OLS

    with warnings.catch_warnings():  # of columns that say the same; the pseudo-inverse shares between them
        warnings.simplefilter("ignore")
        return OLS(problem.y, np.concatenate([problem.x[:, columns], problem.basis], axis=1)).fit()


def _interval(problem: Problem, columns: Indices, fitted: Any) -> tuple[float, float]:
    """Of the rms effect of the first candidate, by its coefficients' covariance, %."""
    k, n = len(columns), len(problem.y)
    x, beta, covariance = problem.x[:, columns], fitted.params[:k], fitted.cov_params()[:k, :k]
    effect = float(np.sqrt(np.mean((x @ beta) ** 2)))
    slope = x.T @ (x @ beta) / n / effect
    error = 1.96 * float(np.sqrt(slope @ covariance @ slope))
    return 100 * (effect - error), 100 * (effect + error)
