"""Marginal likelihood of spread and repeatability, its mode, importance weights of the exact model.

With phi = centre + width z, each session's law is linearized at its mode z*: f(z) = f(z*) + J (z - z*).
Then y ~ N(f(z), v), z ~ N(m, tau^2), m ~ N(0, 1), v = repeatability^2 + rounding, so that z and m
integrate out in closed form and p + 1 dimensions remain. Sessions are sampled from their Gaussian given
these; each draw's weight is the exact over the linearized likelihood, Pareto-smoothed (A. Vehtari et
al., JMLR 25:72, 2024). The mode and a Student-t proposal serve the sampler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.bayes.priors import GroupData, Prior
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import Groups
from stickslip_fit.estimation._optimize import minimize

LogDensity = Callable[[Array], Array]
"""Points, shape (..., k, d), to log densities, (..., k); all at once, since one costs as much as many."""

DIFFERENCE_STEP = 1e-2  # of the finite differences, in standard deviations of the prior
MIN_CURVATURE = 0.2  # least curvature believed, where the prior alone has 1
PROPOSAL_DF = 6.0
ADAPTATION_DRAWS, ADAPTATION_ROUNDS = 1000, 2


@dataclass(frozen=True, eq=False)
class StudentTProposal:
    """A multivariate Student's t: centre, shape (d,), and Cholesky root of the scale matrix, (d, d)."""

    centre: Array
    root: Array

    def draw(self, size: int, rng: np.random.Generator | np.random.RandomState, wider: float = 1.0) -> Array:
        """Points, shape (size, d)."""
        noise = rng.normal(size=(size, len(self.centre)))
        stretch = np.sqrt(PROPOSAL_DF / rng.chisquare(PROPOSAL_DF, size))[:, None]
        return self.centre + wider * stretch * noise @ self.root.T

    def log_density(self, x: Array) -> Array:
        """Log density at points, shape (k, d) -> (k,)."""
        d = len(self.centre)
        distance = np.sum(np.linalg.solve(self.root, (x - self.centre).T) ** 2, axis=0)
        constant = (
            gammaln((PROPOSAL_DF + d) / 2) - gammaln(PROPOSAL_DF / 2) - d / 2 * np.log(PROPOSAL_DF * np.pi)
        )
        constant -= np.log(np.diag(self.root)).sum()
        return constant - (PROPOSAL_DF + d) / 2 * np.log1p(distance / PROPOSAL_DF)


def find_mode(log_density: LogDensity, start: Array) -> tuple[Array, Array]:
    """Mode, shape (..., d), and covariance there, (..., d, d), by Newton's method; each by itself."""
    x, moves = start, np.ones(start.shape[:-1], dtype=bool)
    covariance = np.zeros((*x.shape, x.shape[-1]))
    for _ in range(100):
        gradient, curvature = _differentiate(log_density, x)
        value, vector = np.linalg.eigh(-curvature)
        value = np.maximum(value, MIN_CURVATURE)[..., None, :]
        inverse = (vector / value) @ vector.swapaxes(-2, -1)
        step = (inverse @ gradient[..., None])[..., 0]
        step = step / np.maximum(1.0, np.linalg.norm(step, axis=-1, keepdims=True) / 2)
        trials = x[..., None, :] + 2.0 ** -np.arange(12)[:, None] * step[..., None, :]
        best = np.nanargmax(log_density(trials), axis=-1)
        x_new = np.take_along_axis(trials, best[..., None, None], axis=-2)[..., 0, :]
        moved = np.abs(x_new - x).max(axis=-1)
        x = np.where(moves[..., None], x_new, x)
        covariance = np.where(moves[..., None, None], inverse, covariance)
        moves = moves & (moved >= DIFFERENCE_STEP / 10)
        if not moves.any():
            break
    return x, covariance


def fit_proposal(
    log_density: LogDensity, mode: Array, covariance: Array, rng: np.random.Generator
) -> StudentTProposal:
    """A Student's t adapted from the mode to the posterior's mean and covariance."""
    proposal = StudentTProposal(mode, np.linalg.cholesky(covariance))
    for _ in range(ADAPTATION_ROUNDS):
        x = proposal.draw(ADAPTATION_DRAWS, rng)
        log_weight = log_density(x) - proposal.log_density(x)
        weight = np.exp(log_weight - log_weight.max())
        # No one point may dominate.
        weight = np.minimum(weight, 10 * weight.mean())
        centre = weight @ x / weight.sum()
        spread = (weight[:, None] * (x - centre)).T @ (x - centre) / weight.sum()
        # A share of the old scale, so that a few heavy points cannot make it singular.
        proposal = StudentTProposal(
            centre, np.linalg.cholesky(0.9 * spread + 0.1 * proposal.root @ proposal.root.T)
        )
    return proposal


def _differentiate(log_density: LogDensity, x: Array) -> tuple[Array, Array]:
    """Gradient and Hessian by central differences, all points in one call."""
    d = x.shape[-1]
    steps, (i, j) = DIFFERENCE_STEP * np.eye(d), np.triu_indices(d)
    pairs = steps[i] + steps[j]
    points = np.concatenate([[np.zeros(d)], steps, -steps, pairs, -pairs])
    density = log_density(x[..., None, :] + points)
    here, up, down, both_up, both_down = np.split(density, np.cumsum([1, d, d, len(i)]), axis=-1)
    gradient = (up - down) / (2 * DIFFERENCE_STEP)
    alone, both = up + down, np.empty((*x.shape, d))
    both[..., i, j] = both[..., j, i] = both_up + both_down
    both += 2 * here[..., None] - alone[..., :, None] - alone[..., None, :]
    hessian = both / (2 * DIFFERENCE_STEP**2)
    return gradient, hessian


def solve_spd_batched(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Solve small positive definite systems, (p, p, ...), (p, k, ...) -> (p, k, ...); and log determinants.

    A loop over the p pivots, each for all systems, is several times faster than a call of LAPACK for each.

    Examples
    --------
    >>> matrix, right = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[3.0], [3.0]])
    >>> solution, log_determinant = solve_spd_batched(matrix, right)
    >>> solution.ravel(), float(np.exp(log_determinant).round(12))
    (array([1., 1.]), 3.0)
    """
    p = len(matrix)
    work = np.concatenate([matrix, right], axis=1)
    determinant = np.ones(matrix.shape[2:])
    for k in range(p):
        determinant = determinant * work[k, k]
        row = work[k] / work[k, k]
        work -= work[:, k, None] * row
        work[k] = row
    return work[:, p:], np.log(determinant)


@dataclass(frozen=True, eq=False)
class MarginalLikelihood:
    """The linearized model; sessions S, traverses of a session m, parameters p.

    Of T campaigns, the shapes of all but `z` and of what its methods take begin with T.

    Attributes
    ----------
    response : array, shape (S, m)
        e = y - f(z*) + J z*.
    slopes : array, shape (S, m, p)
        J by z.
    products : array, shape (S, m, (p + 1)^2)
        Of each row's [J, e] with itself.
    rounding : array, shape (S, m)
        Infinite, i.e. of no weight, where a session has no such traverse.
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
        return self.conditional(x).log_likelihood.reshape(x.shape[:-1]) - 0.5 * np.sum(x**2, axis=-1)

    def conditional(self, x: Array, shift: Array | None = None) -> ConditionalPosterior:
        """The Gaussians that remain at each x, (k, p + 1); `shift`, (S, m, k), adds to the responses.

        Of T campaigns all k of one come before those of the next.
        """
        spread, repeatability = self.prior.levels(x)
        p = spread.shape[-1]
        tau = np.moveaxis(spread / self.prior.width, -1, 0).reshape(p, 1, -1)
        weight = 1.0 / (repeatability[..., None, None, :] ** 2 + self.rounding[..., None])
        sums = np.moveaxis(np.matmul(self.products.swapaxes(-2, -1), weight), (-2, -3), (0, 1))
        sums = sums.reshape(p + 1, p + 1, sums.shape[1], -1)
        slopes_response, cost = sums[:p, p], sums[p, p]
        if shift is not None:
            weighted = weight * shift
            slopes_response = slopes_response - np.matmul(self.slopes.swapaxes(1, 2), weighted).swapaxes(0, 1)
            cost = cost + np.sum(weighted * (shift - 2 * self.response[:, :, None]), axis=1)
        form, linear_form = tau * tau[:, None] * sums[:p, :p], tau * slopes_response
        eye = np.eye(p)[:, :, None]
        solution, log_det = solve_spd_batched(
            eye[..., None] + form, np.concatenate([form, linear_form[:, None]], axis=1)
        )
        kept, best = solution[:, :p], solution[:, p]
        # The sessions' information about m, given the spread between them.
        precision = eye + kept.sum(axis=2) / (tau * tau[:, None])[:, :, 0]
        pull = best.sum(axis=1) / tau[:, 0]
        centre, log_det_mean = solve_spd_batched(precision, pull[:, None])
        log_weight = np.log(np.where(weight > 0, weight / (2 * np.pi), 1.0)).sum(axis=(-3, -2)).ravel()
        squares = (cost - np.sum(linear_form * best, axis=0)).sum(axis=0) - np.sum(
            pull * centre[:, 0], axis=0
        )
        log_likelihood = 0.5 * (log_weight - log_det.sum(axis=0) - log_det_mean - squares)
        return ConditionalPosterior(
            tau[:, 0], repeatability.ravel(), form, linear_form, precision, centre[:, 0], log_likelihood
        )


@dataclass(frozen=True, eq=False)
class ConditionalPosterior:
    """Campaign mean and sessions given k draws of spread and repeatability; own axes first, k last.

    Attributes
    ----------
    tau : array, shape (p, k)
    repeatability : array, shape (k,)
    form : array, shape (p, p, S, k)
        tau J'WJ tau.
    linear_form : array, shape (p, S, k)
        tau J'We.
    precision : array, shape (p, p, k)
        Of the campaign mean m.
    centre : array, shape (p, k)
        Its expectation.
    log_likelihood : array, shape (k,)
        Of the counts, linearized, with z and m integrated out.
    """

    tau: Array
    repeatability: Array
    form: Array
    linear_form: Array
    precision: Array
    centre: Array
    log_likelihood: Array

    def draw_mean(self, rng: np.random.Generator) -> Array:
        """One campaign mean m for each, shape (p, k)."""
        return self.centre + _draw_with_precision(self.precision, rng)

    def sessions(self, mean: Array) -> Array:
        """Expected z of each session given the campaign mean, shape (p, S, k)."""
        pull = self.linear_form - np.einsum("ijsk,jk->isk", self.form, mean / self.tau)
        eye = np.eye(len(mean))[:, :, None, None]
        return mean[:, None] + self.tau[:, None] * solve_spd_batched(eye + self.form, pull[:, None])[0][:, 0]

    def draw_departures(self, rng: np.random.Generator) -> Array:
        """How far one z of each session lies from its expectation, shape (p, S, k)."""
        eye = np.eye(len(self.tau))[:, :, None, None]
        return self.tau[:, None] * _draw_with_precision(eye + self.form, rng)


def linearize(traverses: GroupData, prior: Prior, z: Array) -> MarginalLikelihood:
    """Linearize each session about its own z, shape (S, p)."""
    predicted, slopes = _session_model(traverses, prior, z[traverses.groups.of_row])
    response = traverses.y - predicted + np.sum(slopes * z[traverses.groups.of_row], axis=1)
    both = np.concatenate([slopes, response[:, None]], axis=1)
    products = (both[:, :, None] * both[:, None, :]).reshape(len(both), -1)
    return MarginalLikelihood(
        prior,
        traverses.pad(response, 0.0),
        traverses.pad(slopes, 0.0),
        traverses.pad(products, 0.0),
        traverses.pad(traverses.rounding, np.inf),
        z,
    )


def _of_sessions(values: Array, traverses: GroupData) -> Array:
    """What is the same in all sessions, shape (n,), or in those of a campaign, (T, 1, n), of each: (S, n)."""
    if traverses.campaign is None:
        return np.broadcast_to(values, (len(traverses.groups), values.shape[-1]))
    return np.broadcast_to(values, (len(traverses.row_index), 1, values.shape[-1]))[traverses.campaign, 0]


def _draw_with_precision(precision: Array, rng: np.random.Generator) -> Array:
    """A draw from each N(0, 1 / precision), shape (p, p, ...) -> (p, ...)."""
    root = np.linalg.cholesky(np.moveaxis(precision, (0, 1), (-2, -1)))
    noise = rng.standard_normal((*root.shape[:-1], 1))
    return np.moveaxis(np.linalg.solve(root.swapaxes(-2, -1), noise)[..., 0], -1, 0)


EXPANSION_ROUNDS = 3  # more change next to nothing
EXPANSION_TOL = 1e-6  # of the prior's standard deviations; the error of a linearization goes with its square


def linearize_at_mode(traverses: GroupData, prior: Prior) -> tuple[MarginalLikelihood, Array, Array]:
    """Marginal likelihood of a joint and direction; its mode, (p + 1,), and the covariance there.

    Of T campaigns, each by itself, modes have shape (T, p + 1).

    Raises
    ------
    InputError
        If the joint stalls under the prior's own centre.
    """
    if not np.all(np.isfinite(_session_model(traverses, prior, np.zeros(len(prior.names)))[0])):
        raise InputError(
            f"joint {traverses.law.joint} would stall with the parameters at the centre of its prior; "
            "give a centre with step sizes above 0 in every traverse"
        )
    z, mean, x = _first_guess(traverses, prior)
    levels = prior.width, np.array(prior.repeatability)
    for _ in range(EXPANSION_ROUNDS):
        z = _session_modes(traverses, prior, z, mean, *levels)
        marginal = linearize(traverses, prior, z)
        x, covariance = find_mode(marginal.log_density, x)
        mean = marginal.conditional(x[..., None, :]).centre.T.reshape(mean.shape)
        levels = prior.levels(x if traverses.campaign is None else x[:, None])
    return marginal, x, covariance


def _first_guess(traverses: GroupData, prior: Prior) -> tuple[Array, Array, Array]:
    """Sessions' z, campaign mean and hyperparameters, all at the centre of the prior."""
    p = len(prior.names)
    x = np.zeros((*traverses.row_index.shape[:-2], p + 1))
    return np.zeros((len(traverses.groups), p)), np.zeros(prior.centre.shape), x


def _session_modes(
    traverses: GroupData, prior: Prior, start: Array, mean: Array, spread: Array, repeatability: Array
) -> Array:
    """Each session's mode z, shape (S, p): least squares with the campaign mean as p more responses."""
    sessions, p = start.shape
    tau = _of_sessions(spread / prior.width, traverses)
    noise = _of_sessions(repeatability[..., None], traverses)[traverses.groups.of_row, 0]
    owner = np.repeat(np.arange(sessions), p)
    n = len(traverses.y)

    def with_campaign(z: Array) -> tuple[Array, Array]:
        predicted, slopes = _session_model(traverses, prior, z[:n])
        own = np.tile(np.arange(p), sessions)
        return np.append(predicted, z[np.arange(n, len(z)), own]), np.concatenate([slopes, np.eye(p)[own]])

    weight = np.append(1.0 / (noise**2 + traverses.rounding), tau.ravel() ** -2)
    groups = Groups(traverses.groups.table, np.append(traverses.groups.of_row, owner))
    y = np.append(traverses.y, _of_sessions(mean, traverses))
    scales = np.ones_like(start)
    return minimize(
        with_campaign, y, weight, groups, start, scales, damping=0.0, tolerance=EXPANSION_TOL
    ).values


def _session_model(traverses: GroupData, prior: Prior, z: Array) -> tuple[Array, Array]:
    """Responses at each row's z, (n, p) or (p,) for all, and their derivatives by z, shape (n, p)."""
    of_row = traverses.groups.of_row
    centre, width = (_of_sessions(values, traverses)[of_row] for values in (prior.centre, prior.width))
    predicted, slopes = traverses.model(centre + width * z)
    return predicted, slopes * width


NUMBERS_PER_CHUNK = 2_000_000  # rows times draws held at a time
WEIGHT_TOL = 1e-9  # log weights that differ by less are equal but for rounding errors


@dataclass(frozen=True, eq=False)
class PosteriorDraws:
    """Draws, SI: the campaign's mean and spread, (d, p), repeatability, (d,), and parameters, (d, S, p)."""

    mean: Array
    spread: Array
    repeatability: Array
    parameters: Array

    def __len__(self) -> int:
        return len(self.mean)

    def select(self, which: IntArray | slice) -> PosteriorDraws:
        """Some of the draws."""
        return PosteriorDraws(
            self.mean[which], self.spread[which], self.repeatability[which], self.parameters[which]
        )

    @classmethod
    def concatenate(cls, draws: Sequence[PosteriorDraws]) -> PosteriorDraws:
        """Draws, one after the other."""
        return cls(*(np.concatenate([getattr(part, name) for part in draws]) for name in cls.__annotations__))

    def law_part(self, own: int) -> PosteriorDraws:
        """Only the first `own` parameters."""
        return PosteriorDraws(
            self.mean[:, :own], self.spread[:, :own], self.repeatability, self.parameters[:, :, :own]
        )


def sample_sessions(
    traverses: GroupData, marginal: MarginalLikelihood, x: Array, rng: np.random.Generator
) -> tuple[PosteriorDraws, Array]:
    """Draw the campaign's mean and the sessions at each x, (d, p + 1); and log weights, shape (d,).

    A weight is the exact over the linearized likelihood.
    """
    size = max(NUMBERS_PER_CHUNK // len(traverses.y), 1)
    chunks = [x[first : first + size] for first in range(0, len(x), size)]
    draws, weights = zip(
        *(_sample_sessions(traverses, marginal, chunk, rng) for chunk in chunks), strict=True
    )
    return PosteriorDraws.concatenate(draws), np.concatenate(weights)


def psis_smooth(log_weight: Array) -> tuple[Array, float]:
    """Pareto-smoothed importance weights, summing to 1, and k-hat (Vehtari et al., JMLR 25:72, 2024)."""
    from arviz_stats.base import array_stats

    # A draw with a stall has no weight; the fit of the tail needs a finite number.
    log_weight = np.maximum(log_weight, log_weight.max() - 700.0)
    if np.ptp(log_weight) < WEIGHT_TOL:
        return np.full(len(log_weight), 1.0 / len(log_weight)), 0.0
    smoothed, k_hat = array_stats.psislw(-log_weight)
    weight = np.exp(smoothed - np.max(smoothed))
    return weight / weight.sum(), float(k_hat)


def resample(weight: Array, rng: np.random.Generator) -> IntArray:
    """Systematic resampling: indices, in order, of as many draws of equal weight."""
    points = (np.arange(len(weight)) + rng.uniform()) / len(weight)
    total = np.cumsum(weight)
    return np.minimum(np.searchsorted(total / total[-1], points), len(weight) - 1)


def _sample_sessions(
    traverses: GroupData, marginal: MarginalLikelihood, x: Array, rng: np.random.Generator
) -> tuple[PosteriorDraws, Array]:
    prior, conditional = marginal.prior, marginal.conditional(x)
    spread, repeatability = prior.levels(x)
    mean = conditional.draw_mean(rng)
    z = (conditional.sessions(mean) + conditional.draw_departures(rng)).T
    draws = PosteriorDraws(
        prior.centre + prior.width * mean.T, spread, repeatability, prior.centre + prior.width * z
    )
    return draws, log_importance_ratio(traverses, marginal, z, draws.parameters, repeatability)


def log_importance_ratio(
    traverses: GroupData,
    marginal: MarginalLikelihood,
    z: Array,
    values: Array,
    repeatability: Array,
    shift: Array | float = 0.0,
) -> Array:
    """Exact less linearized log likelihood, shape (d,); -inf where the law stalls.

    Parameters
    ----------
    z : array, shape (d, S, p)
    values : array, shape (d, S, p or more)
        The law's parameters at z.
    repeatability : array, shape (d,)
    shift : array, shape (S, m, d), optional
        See `MarginalLikelihood.conditional`.
    """
    exact = traverses.pad((traverses.y - traverses.predict(values)).T, 0.0)
    linear = marginal.response[:, :, None] - np.matmul(marginal.slopes, z.transpose(1, 2, 0)) - shift
    weight = 1.0 / (repeatability**2 + marginal.rounding[:, :, None])
    ratio = 0.5 * np.sum(weight * (linear**2 - exact**2), axis=(0, 1))
    return np.where(np.isfinite(ratio), ratio, -np.inf)
