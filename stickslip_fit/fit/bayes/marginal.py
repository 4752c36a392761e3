"""The likelihood of spread and repeatability with everything else integrated out in closed form.

A session's law is all but linear in its parameters over the range that its counts leave open. With
phi = centre + width z, f(z) = f(z*) + J (z - z*), and v = repeatability^2 + rounding,

    y ~ N(f(z), v),   z ~ N(m, tau^2),   m ~ N(0, 1),

so z and m are Gaussian given (tau, repeatability), and what remains to be sampled has p + 1 dimensions.
All a session's traverses enter through J'WJ, J'We and e'We with e = y - f(z*) + J z* and W = 1 / v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.small import solve
from stickslip_fit.fit.bayes.traverses import Traverses

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Marginal:
    """The linearised model; sessions S, traverses of a session m, parameters p.

    Attributes
    ----------
    prior : Prior
    response : array, shape (S, m)
        e = y - f(z*) + J z*.
    slopes : array, shape (S, m, p)
        J by z.
    products : array, shape (S, m, (p + 1)^2)
        Of each row's [J, e] with itself.
    rounding : array, shape (S, m)
        Infinite, so that the weight is none, where a session has no such traverse.
    z : array, shape (S, p)
        z*.
    """

    prior: Prior
    response: Array
    slopes: Array
    products: Array
    rounding: Array
    z: Array

    def log_density(self, x: Array) -> Array:
        """Log posterior density, the evidence's constant left out; (k, p + 1) -> (k,).

        Parameters
        ----------
        x : array, shape (k, p + 1)
            log spread and log repeatability, standard normal under the prior; see `Prior.levels`.
        """
        return self.conditional(x).log_likelihood - 0.5 * np.sum(x**2, axis=1)

    def conditional(self, x: Array, shift: Array | None = None) -> Conditional:
        """The Gaussians that remain at each x, shape (k, p + 1).

        A `shift`, shape (S, m, k), is what the law's responses are more at each of them.
        """
        spread, repeatability = self.prior.levels(x)
        tau = (spread / self.prior.width).T[:, None, :]
        weight = 1.0 / (repeatability**2 + self.rounding[:, :, None])
        p = len(tau)
        sums = np.matmul(self.products.swapaxes(1, 2), weight).swapaxes(0, 1)
        sums = sums.reshape(p + 1, p + 1, *sums.shape[1:])
        slopes_response, cost = sums[:p, p], sums[p, p]
        if shift is not None:
            weighted = weight * shift
            slopes_response = slopes_response - np.matmul(self.slopes.swapaxes(1, 2), weighted).swapaxes(0, 1)
            cost = cost + np.sum(weighted * (shift - 2 * self.response[:, :, None]), axis=1)
        form, pull = tau * tau[:, None] * sums[:p, :p], tau * slopes_response
        eye = np.eye(p)[:, :, None]
        solution, log_det = solve(eye[..., None] + form, np.concatenate([form, pull[:, None]], axis=1))
        kept, best = solution[:, :p], solution[:, p]
        # What the sessions say of m, each blurred by the spread between them.
        precision = eye + kept.sum(axis=2) / (tau * tau[:, None])[:, :, 0]
        drawn = best.sum(axis=1) / tau[:, 0]
        centre, log_det_mean = solve(precision, drawn[:, None])
        log_weight = np.log(np.where(weight > 0, weight / (2 * np.pi), 1.0)).sum(axis=(0, 1))
        squares = (cost - np.sum(pull * best, axis=0)).sum(axis=0) - np.sum(drawn * centre[:, 0], axis=0)
        log_likelihood = 0.5 * (log_weight - log_det.sum(axis=0) - log_det_mean - squares)
        return Conditional(tau[:, 0], repeatability, form, pull, precision, centre[:, 0], log_likelihood)


@dataclass(frozen=True, eq=False)
class Conditional:
    """Campaign mean and sessions given k draws of spread and repeatability; own axes first, k last.

    Attributes
    ----------
    tau : array, shape (p, k)
    repeatability : array, shape (k,)
    form : array, shape (p, p, S, k)
        tau J'WJ tau.
    pull : array, shape (p, S, k)
        tau J'We.
    precision : array, shape (p, p, k)
        Of the campaign mean m.
    centre : array, shape (p, k)
        Its expectation.
    log_likelihood : array, shape (k,)
        Of the counts, linearised, with z and m integrated out.
    """

    tau: Array
    repeatability: Array
    form: Array
    pull: Array
    precision: Array
    centre: Array
    log_likelihood: Array

    def draw_mean(self, rng: np.random.Generator) -> Array:
        """One campaign mean m for each, shape (p, k)."""
        return self.centre + _with_precision(self.precision, rng)

    def sessions(self, mean: Array) -> Array:
        """Expected z of each session given the campaign mean, shape (p, S, k)."""
        pull = self.pull - np.einsum("ijsk,jk->isk", self.form, mean / self.tau)
        eye = np.eye(len(mean))[:, :, None, None]
        return mean[:, None] + self.tau[:, None] * solve(eye + self.form, pull[:, None])[0][:, 0]

    def draw_departures(self, rng: np.random.Generator) -> Array:
        """How far one z of each session lies from its expectation, shape (p, S, k)."""
        eye = np.eye(len(self.tau))[:, :, None, None]
        return self.tau[:, None] * _with_precision(eye + self.form, rng)


def linearise(traverses: Traverses, prior: Prior, z: Array) -> Marginal:
    """Linearise each session about its own z, shape (S, p)."""
    values = (prior.centre + prior.width * z)[traverses.groups.of_row]
    predicted, slopes = traverses.law.model(traverses.rows)(values)
    slopes = slopes * prior.width
    response = traverses.y - predicted + np.sum(slopes * z[traverses.groups.of_row], axis=1)
    both = np.concatenate([slopes, response[:, None]], axis=1)
    products = (both[:, :, None] * both[:, None, :]).reshape(len(both), -1)
    return Marginal(
        prior,
        traverses.padded(response, 0.0),
        traverses.padded(slopes, 0.0),
        traverses.padded(products, 0.0),
        traverses.padded(traverses.rounding, np.inf),
        z,
    )


def _with_precision(precision: Array, rng: np.random.Generator) -> Array:
    """A draw from each N(0, 1 / precision), shape (p, p, ...) -> (p, ...)."""
    root = np.linalg.cholesky(np.moveaxis(precision, (0, 1), (-2, -1)))
    noise = rng.standard_normal((*root.shape[:-1], 1))
    return np.moveaxis(np.linalg.solve(root.swapaxes(-2, -1), noise)[..., 0], -1, 0)
