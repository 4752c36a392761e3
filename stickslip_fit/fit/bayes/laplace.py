"""Where a posterior is and how wide: its mode and curvature, then its moments by importance sampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

Array = npt.NDArray[np.float64]
LogDensity = Callable[[Array], Array]
"""Points, shape (k, d), to log densities, shape (k,); all at once, since one costs as much as many."""

APART = 1e-2  # of the finite differences, in standard deviations of the prior
FLATTEST = 0.2  # least curvature believed, where the prior alone has 1
FREEDOM = 6.0
FITTED_TO, ROUNDS = 1000, 2


@dataclass(frozen=True, eq=False)
class Guess:
    """A multivariate Student's t that resembles the posterior, with tails that enclose it.

    Attributes
    ----------
    centre : array, shape (d,)
    root : array, shape (d, d)
        Cholesky factor of the scale matrix.
    """

    centre: Array
    root: Array

    def draw(self, size: int, rng: np.random.Generator | np.random.RandomState, wider: float = 1.0) -> Array:
        """Points, shape (size, d)."""
        noise = rng.normal(size=(size, len(self.centre)))
        stretch = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, size))[:, None]
        return self.centre + wider * stretch * noise @ self.root.T

    def log_density(self, x: Array) -> Array:
        """Log density at points, shape (k, d) -> (k,)."""
        d = len(self.centre)
        distance = np.sum(np.linalg.solve(self.root, (x - self.centre).T) ** 2, axis=0)
        constant = gammaln((FREEDOM + d) / 2) - gammaln(FREEDOM / 2) - d / 2 * np.log(FREEDOM * np.pi)
        constant -= np.log(np.diag(self.root)).sum()
        return constant - (FREEDOM + d) / 2 * np.log1p(distance / FREEDOM)


def find_mode(log_density: LogDensity, start: Array) -> tuple[Array, Array]:
    """Mode, shape (d,), and covariance there, shape (d, d), by Newton's method."""
    x = start
    for _ in range(100):
        gradient, curvature = _shape(log_density, x)
        value, vector = np.linalg.eigh(-curvature)
        value = np.maximum(value, FLATTEST)
        step = vector @ (vector.T @ gradient / value)
        step /= max(1.0, float(np.linalg.norm(step)) / 2)
        trials = x + 2.0 ** -np.arange(12)[:, None] * step
        x_new = trials[int(np.nanargmax(log_density(trials)))]
        x, moved = x_new, np.abs(x_new - x).max()
        if moved < APART / 10:
            break
    return x, (vector / value) @ vector.T


def fit_guess(log_density: LogDensity, mode: Array, covariance: Array, rng: np.random.Generator) -> Guess:
    """Adapt a guess to the posterior's mean and covariance, since few posteriors look like their mode."""
    guess = Guess(mode, np.linalg.cholesky(covariance))
    for _ in range(ROUNDS):
        x = guess.draw(FITTED_TO, rng)
        log_weight = log_density(x) - guess.log_density(x)
        weight = np.exp(log_weight - log_weight.max())
        # No one point may speak for the posterior.
        weight = np.minimum(weight, 10 * weight.mean())
        centre = weight @ x / weight.sum()
        spread = (weight[:, None] * (x - centre)).T @ (x - centre) / weight.sum()
        # A share of what it was, so that a few heavy points cannot make it flat.
        guess = Guess(centre, np.linalg.cholesky(0.9 * spread + 0.1 * guess.root @ guess.root.T))
    return guess


def _shape(log_density: LogDensity, x: Array) -> tuple[Array, Array]:
    """Gradient and Hessian by central differences, all points in one call."""
    d = len(x)
    apart = APART * np.eye(d)
    pairs = apart[:, None] + apart[None, :]
    points = np.concatenate([[np.zeros(d)], apart, -apart, pairs.reshape(-1, d), -pairs.reshape(-1, d)])
    here, up, down, both_up, both_down = np.split(log_density(x + points), np.cumsum([1, d, d, d * d]))
    gradient = (up - down) / (2 * APART)
    alone = up + down
    both = (both_up + both_down).reshape(d, d)
    hessian = (both - alone[:, None] - alone[None, :] + 2 * here) / (2 * APART**2)
    return gradient, hessian
