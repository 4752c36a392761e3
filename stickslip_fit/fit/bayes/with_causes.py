"""Causes that act on every joint and direction alike, sampled with all of them together.

What joints, directions and sessions have of their own is walked through for each joint and direction by
itself, with the causes held in the middle of a guess. The causes are drawn from that guess, a draw of
theirs is put beside one of each walk, and the importance weight is the whole posterior over what was drawn
from. The counts know the causes' sizes from all rows, a joint's own levels from its rows alone, so the two
hardly depend on each other and the weights are nearly even; k-hat says whether they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.cause_priors import CausePriors
from stickslip_fit.fit.bayes.exact import NUMBERS_AT_A_TIME, Draws, log_ratio
from stickslip_fit.fit.bayes.laplace import Guess, find_mode, fit_guess
from stickslip_fit.fit.bayes.marginal import Marginal
from stickslip_fit.fit.bayes.traverses import Traverses
from stickslip_fit.fit.known_causes import HeldLaw

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Part:
    """One joint and direction, expanded with the causes held.

    Attributes
    ----------
    traverses : Traverses
        Under a HeldLaw.
    marginal : Marginal
    mode : array, shape (p + 1,)
    covariance : array, shape (p + 1, p + 1)
        Of its levels.
    """

    traverses: Traverses
    marginal: Marginal
    mode: Array
    covariance: Array

    @property
    def whole(self) -> Traverses:
        """The traverses under the law with the causes' parameters among its own."""
        law = self.traverses.law
        assert isinstance(law, HeldLaw)
        return replace(self.traverses, law=law.extended)

    def holding(self, sizes: Array) -> Traverses:
        """The traverses with the causes held at other sizes, shape (q,)."""
        law = self.traverses.law
        assert isinstance(law, HeldLaw)
        return replace(self.traverses, law=HeldLaw(law.law, law.extended.causes, sizes))

    def shift(self, sizes: Array) -> Array:
        """By how much other sizes of the causes change each response, (k, q) -> (S, m, k)."""
        prior, whole = self.marginal.prior, self.whole
        own = prior.centre + prior.width * self.marginal.z
        response = whole.predict(beside(np.broadcast_to(own, (len(sizes), *own.shape)), sizes))
        held = self.traverses.predict(own[None])
        return self.traverses.padded((response - held).T, 0.0)

    def log_likelihood(self, sizes: Array) -> Array:
        """Of other sizes at the likeliest levels, (k, q) -> (k,); -inf where the law stalls."""
        levels = np.broadcast_to(self.mode, (len(sizes), len(self.mode)))
        return _sure(self.marginal.conditional(levels, self.shift(sizes)).log_likelihood)

    def draw_back(self, x: Array, sizes: Array, rng: np.random.Generator) -> tuple[Draws, Array]:
        """Draw the campaign's mean and the sessions at each x, (k, p + 1), and sizes, (k, q).

        Returns
        -------
        draws : Draws
            With the causes' parameters after the others; they do not spread between sessions.
        log_weight : array, shape (k,)
            Exact likelihood over that by which `x` was walked through.
        """
        at_a_time = max(NUMBERS_AT_A_TIME // len(self.traverses.y), 1)
        parts = [
            self._draw_back(x[first : first + at_a_time], sizes[first : first + at_a_time], rng)
            for first in range(0, len(x), at_a_time)
        ]
        draws, weights = zip(*parts, strict=True)
        both = [np.concatenate([getattr(part, name) for part in draws]) for name in Draws.__annotations__]
        return Draws(*both), np.concatenate(weights)

    def _draw_back(self, x: Array, sizes: Array, rng: np.random.Generator) -> tuple[Draws, Array]:
        prior, shift = self.marginal.prior, self.shift(sizes)
        given = self.marginal.conditional(x, np.nan_to_num(shift))
        mean = given.draw_mean(rng)
        z = (given.sessions(mean) + given.draw_departures(rng)).T
        spread, repeatability = prior.levels(x)
        values = beside(prior.centre + prior.width * z, sizes)
        draws = Draws(
            np.concatenate([prior.centre + prior.width * mean.T, sizes], axis=1),
            np.concatenate([spread, np.zeros_like(sizes)], axis=1),
            repeatability,
            values,
        )
        exact = log_ratio(self.whole, self.marginal, z, values, repeatability, shift)
        walked = self.marginal.conditional(x).log_likelihood
        return draws, _sure(given.log_likelihood - walked + exact)


def propose(parts: Sequence[Part], priors: CausePriors, start: Array, error: Array, seed: int) -> Proposal:
    """A guess at the posterior of the causes' parameters, at the likeliest levels of each part.

    Parameters
    ----------
    parts : sequence of Part
    priors : CausePriors
    start, error : array, shape (q,)
        About where they are, and how well known; NaN or 0 where that is not known.
    seed : int
    """
    eta, free = priors.at(start), priors.free
    apart = 1e-4
    slope = (priors.values(eta + apart) - priors.values(eta - apart)) / (2 * apart)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(free, np.abs(error / slope), 1.0)
    root = np.where((width > 0) & (width < 1), width, 1.0)
    blank = Proposal(priors, eta, root, free, Guess(np.zeros(free.sum()), np.eye(free.sum())))

    def log_density(xi: Array) -> Array:
        points, sizes = blank.points(xi)
        found = np.sum([part.log_likelihood(sizes) for part in parts], axis=0)
        return _sure(found - 0.5 * np.sum(points**2, axis=1))

    mode, covariance = find_mode(log_density, np.zeros(free.sum()))
    return replace(blank, guess=fit_guess(log_density, mode, covariance, np.random.default_rng(seed)))


@dataclass(frozen=True, eq=False)
class Proposal:
    """Where draws of the causes' parameters come from.

    Attributes
    ----------
    priors : CausePriors
    centre, root : array, shape (q,)
        Origin and unit of what the guess knows, where the prior is standard normal.
    free : array of bool, shape (q,)
    guess : Guess
        Of the free ones.
    """

    priors: CausePriors
    centre: Array
    root: Array
    free: npt.NDArray[np.bool_]
    guess: Guess

    @property
    def middle(self) -> Array:
        """All the parameters in the middle of the guess, shape (q,)."""
        return self.points(self.guess.centre[None])[1][0]

    def points(self, xi: Array) -> tuple[Array, Array]:
        """Where the prior is standard normal, of the free ones; and all the parameters, shape (k, q)."""
        eta = np.tile(self.centre, (len(xi), 1))
        eta[:, self.free] += self.root[self.free] * xi
        return eta[:, self.free], self.priors.values(eta)

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Parameters, shape (size, q), and the log of the prior over what they were drawn from, (size,)."""
        xi = self.guess.draw(size, rng)
        eta, values = self.points(xi)
        return values, -0.5 * np.sum(eta**2, axis=1) - self.guess.log_density(xi)


def draw_together(
    parts: Mapping[tuple[int, str], Part],
    levels: Mapping[tuple[int, str], Array],
    proposal: Proposal,
    rng: np.random.Generator,
) -> tuple[dict[tuple[int, str], Draws], Array]:
    """Draws of everything.

    Parameters
    ----------
    parts : mapping of (int, str) to Part
    levels : mapping of (int, str) to array, shape (d, p + 1)
        Walked through with the causes held.
    proposal : Proposal
    rng : Generator

    Returns
    -------
    draws : dict of (int, str) to Draws
    log_weight : array, shape (d,)
        Of each draw of all parts together.
    """
    size = len(next(iter(levels.values())))
    sizes, log_weight = proposal.draw(size, rng)
    draws = {}
    for group, part in parts.items():
        draws[group], more = part.draw_back(levels[group], sizes, rng)
        log_weight = log_weight + more
    return draws, log_weight


def beside(own: Array, sizes: Array) -> Array:
    """Each session's own parameters and those of the causes, (k, S, p) and (k, q) -> (k, S, p + q)."""
    return np.concatenate([own, np.broadcast_to(sizes[:, None], (*own.shape[:2], sizes.shape[1]))], axis=2)


def _sure(log_density: Array) -> Array:
    return np.where(np.isfinite(log_density), log_density, -np.inf)
