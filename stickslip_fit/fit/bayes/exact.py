"""From the sampled levels back to every session, and from the linearised posterior to the exact one.

Given a draw's levels, its sessions are Gaussian under the linearised law and are drawn as such. The draw's
importance weight is the exact over the linearised likelihood of all its sessions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.marginal import Marginal
from stickslip_fit.fit.bayes.traverses import Traverses

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Of rows times draws held at a time.
NUMBERS_AT_A_TIME = 2_000_000
# Weights that differ by less are equal but for rounding errors, and have no tail to be examined.
EQUAL = 1e-9


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of everything, SI.

    Attributes
    ----------
    mean, spread : array, shape (d, p)
        Of the campaign.
    repeatability : array, shape (d,)
    parameters : array, shape (d, S, p)
    """

    mean: Array
    spread: Array
    repeatability: Array
    parameters: Array

    def __len__(self) -> int:
        return len(self.mean)

    def take(self, which: Indices | slice) -> Draws:
        """Some of the draws."""
        return Draws(self.mean[which], self.spread[which], self.repeatability[which], self.parameters[which])

    def of_law(self, own: int) -> Draws:
        """Only the first parameters, so many of them."""
        return Draws(
            self.mean[:, :own], self.spread[:, :own], self.repeatability, self.parameters[:, :, :own]
        )


def draw_back(
    traverses: Traverses, marginal: Marginal, x: Array, rng: np.random.Generator
) -> tuple[Draws, Array]:
    """Draw the campaign's mean and the sessions at each x, shape (d, p + 1).

    Returns
    -------
    draws : Draws
    log_weight : array, shape (d,)
        Exact over linearised likelihood.
    """
    at_a_time = max(NUMBERS_AT_A_TIME // len(traverses.y), 1)
    parts = [
        _draw_back(traverses, marginal, x[first : first + at_a_time], rng)
        for first in range(0, len(x), at_a_time)
    ]
    draws, weights = zip(*parts, strict=True)
    both = [np.concatenate([getattr(part, name) for part in draws]) for name in Draws.__annotations__]
    return Draws(*both), np.concatenate(weights)


def smooth(log_weight: Array) -> tuple[Array, float]:
    """Pareto-smoothed importance weights, summing to 1, and k-hat (Vehtari et al., JMLR 25:72, 2024)."""
    from arviz_stats.base import array_stats

    # A draw under which some joint stalls has no weight; the fit of the other tail wants a number.
    log_weight = np.maximum(log_weight, log_weight.max() - 700.0)
    if np.ptp(log_weight) < EQUAL:
        return np.full(len(log_weight), 1.0 / len(log_weight)), 0.0
    smoothed, k_hat = array_stats.psislw(-log_weight)
    weight = np.exp(smoothed - np.max(smoothed))
    return weight / weight.sum(), float(k_hat)


def resample(weight: Array, rng: np.random.Generator) -> Indices:
    """As many draws of equal weight, in order, each taken in proportion to its weight as evenly as can be."""
    ladder = (np.arange(len(weight)) + rng.uniform()) / len(weight)
    steps = np.cumsum(weight)
    return np.minimum(np.searchsorted(steps / steps[-1], ladder), len(weight) - 1)


def _draw_back(
    traverses: Traverses, marginal: Marginal, x: Array, rng: np.random.Generator
) -> tuple[Draws, Array]:
    prior, given = marginal.prior, marginal.conditional(x)
    spread, repeatability = prior.levels(x)
    mean = given.draw_mean(rng)
    z = (given.sessions(mean) + given.draw_departures(rng)).T
    draws = Draws(prior.centre + prior.width * mean.T, spread, repeatability, prior.centre + prior.width * z)
    return draws, log_ratio(traverses, marginal, z, draws.parameters, repeatability)


def log_ratio(
    traverses: Traverses,
    marginal: Marginal,
    z: Array,
    values: Array,
    repeatability: Array,
    shift: Array | float = 0.0,
) -> Array:
    """Exact over linearised log likelihood, shape (d,); -inf where the law stalls.

    Parameters
    ----------
    traverses : Traverses
    marginal : Marginal
    z : array, shape (d, S, p)
    values : array, shape (d, S, p or more)
        The same as the law's parameters.
    repeatability : array, shape (d,)
    shift : array, shape (S, m, d), optional
        See `Marginal.conditional`.
    """
    exact = traverses.padded((traverses.y - traverses.predict(values)).T, 0.0)
    linear = marginal.response[:, :, None] - np.matmul(marginal.slopes, z.transpose(1, 2, 0)) - shift
    weight = 1.0 / (repeatability**2 + marginal.rounding[:, :, None])
    ratio = 0.5 * np.sum(weight * (linear**2 - exact**2), axis=(0, 1))
    return np.where(np.isfinite(ratio), ratio, -np.inf)
