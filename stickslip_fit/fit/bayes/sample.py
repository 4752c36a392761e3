"""The posterior of one joint and direction, from its traverses to draws that may be believed or not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.fit.bayes.agreement import effective_sizes, r_hat
from stickslip_fit.fit.bayes.cause_priors import CausePriors
from stickslip_fit.fit.bayes.ensembles import AGREED, Chains, walk
from stickslip_fit.fit.bayes.exact import Draws, draw_back, resample, smooth
from stickslip_fit.fit.bayes.expansion import expand
from stickslip_fit.fit.bayes.laplace import fit_guess
from stickslip_fit.fit.bayes.marginal import Marginal
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.traverses import Traverses
from stickslip_fit.fit.known_causes import HeldLaw

if TYPE_CHECKING:
    from emcee.backends import Backend

Array = npt.NDArray[np.float64]

TRUSTED = 0.7  # largest k-hat at which importance weights can be smoothed
# The levels are walked for a little longer than asked, and more draws are kept, since every quantity is to be
# known well, and R-hat itself scatters where draws are few.
RESERVE, KEPT, FEWEST = 1.5, 2.5, 2500
# Where uneven weights cost so many draws that too few are left, the walk goes on for so many times as many.
LONGER = (1, 2, 4, 8)


@dataclass(frozen=True, eq=False)
class Sample:
    """Draws of equal weight and what is known of their quality.

    Attributes
    ----------
    traverses : Traverses
    prior : Prior
        Of what is each session's own.
    draws : Draws
        Ensemble after ensemble, each in order of time.
    log_density, log_weight : array, shape (d,)
        Of each draw's levels, and exact over linearised likelihood.
    ensembles : int
    steps : int
        Taken by each ensemble.
    quality : DataFrame
        Columns parameter, session (empty for the campaign), r_hat, ess_bulk, ess_tail and k_hat.
    target_ess : int
    causes : CausePriors or None
        Where the law has causes in it.
    """

    traverses: Traverses
    prior: Prior
    draws: Draws
    log_density: Array
    log_weight: Array
    ensembles: int
    steps: int
    quality: pd.DataFrame
    target_ess: int
    causes: CausePriors | None = None

    @property
    def trusted(self) -> bool:
        """Whether the importance weights can be smoothed."""
        return bool((self.quality["k_hat"] < TRUSTED).all())

    @property
    def converged(self) -> bool:
        """Whether every quantity may be reported."""
        agreed = (self.quality["r_hat"] < AGREED) & (self.quality["ess_bulk"] >= self.target_ess)
        return self.trusted and bool(agreed.all())

    @property
    def names(self) -> tuple[str, ...]:
        """Of all the law's parameters."""
        return self.prior.names + (self.causes.names if self.causes else ())

    def from_prior(self, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """As `Prior.draw`, of all the law's parameters; those of causes do not spread between sessions."""
        mean, spread, repeatability = self.prior.draw(size, rng)
        if self.causes is None:
            return mean, spread, repeatability
        sizes = self.causes.draw(size, rng)
        return np.hstack([mean, sizes]), np.hstack([spread, np.zeros_like(sizes)]), repeatability

    def own_part(self) -> Sample:
        """What is each session's own, with causes held at the means of their draws."""
        law = self.traverses.law
        if not isinstance(law, ExtendedLaw):
            return self
        own = len(self.prior.names)
        held = HeldLaw(law.law, law.causes, self.draws.mean[:, own:].mean(axis=0))
        return replace(
            self, traverses=replace(self.traverses, law=held), draws=self.draws.of_law(own), causes=None
        )


def sample(
    traverses: Traverses,
    prior: Prior,
    backends: list[Backend],
    *,
    seed: tuple[int, ...],
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> Sample:
    """Sample the posterior of one joint and direction; see `walk` for the arguments."""
    rng = np.random.default_rng(seed)
    marginal, mode, covariance = expand(traverses, prior)
    guess = fit_guess(marginal.log_density, mode, covariance, rng)
    for longer in LONGER:
        wanted = longer * target_ess
        chains = walk(marginal.log_density, guess, seed, backends, int(RESERVE * wanted), max_steps, on_step)
        found = _weighted(traverses, marginal, _thinned(chains, wanted), target_ess, rng)
        if found.converged or not found.trusted or chains.steps == max_steps:
            break
    return found


def _weighted(
    traverses: Traverses, marginal: Marginal, chains: Chains, target_ess: int, rng: np.random.Generator
) -> Sample:
    """Sessions drawn back at the levels walked through, weighted to the exact posterior."""
    ensembles, *_, dimensions = chains.x.shape
    draws, log_weight = draw_back(traverses, marginal, chains.x.reshape(-1, dimensions), rng)
    weight, k_hat = smooth(log_weight)
    found = quality(draws, traverses, marginal.prior, chains.x.shape[:3], weight, k_hat)
    by_ensemble = weight.reshape(ensembles, -1)
    size = by_ensemble.shape[1]
    taken = np.concatenate([i * size + resample(own, rng) for i, own in enumerate(by_ensemble)])
    return Sample(
        traverses, marginal.prior, draws.take(taken), chains.log_density.ravel()[taken], log_weight[taken],
        ensembles, chains.steps, found, target_ess,
    )  # fmt: skip


def _thinned(chains: Chains, target_ess: int) -> Chains:
    ensembles, steps, walkers, _ = chains.x.shape
    every = max(ensembles * steps * walkers // max(int(KEPT * target_ess), FEWEST), 1)
    return Chains(chains.x[:, ::every], chains.log_density[:, ::every], chains.steps)


def quality(
    draws: Draws, traverses: Traverses, prior: Prior, shape: tuple[int, ...], weight: Array, k_hat: float
) -> pd.DataFrame:
    """Diagnostics of every quantity; see `quality_of`."""
    names, sessions = list(prior.names), list(traverses.groups.table["session"])
    labels = [(name, "") for name in names] + [(f"spread of {name}", "") for name in names]
    labels += [("repeatability", "")] + [(name, session) for session in sessions for name in names]
    flat = [draws.mean, draws.spread, draws.repeatability[:, None], draws.parameters.reshape(len(draws), -1)]
    table = pd.DataFrame(labels, columns=["parameter", "session"])
    return quality_of(table, np.concatenate(flat, axis=1), shape, weight, k_hat)


def quality_of(
    labels: pd.DataFrame, draws: Array, shape: tuple[int, ...], weight: Array, k_hat: float
) -> pd.DataFrame:
    """Diagnostics of labelled draws, shape (d, quantities); uneven weights cost their share of the draws.

    `shape` says into how many ensembles, steps and walkers the draws fall.
    """
    columns = draws.T.reshape(-1, *shape)
    kept = 1.0 / (len(weight) * np.sum(weight**2))
    return labels.assign(
        r_hat=r_hat(columns),
        ess_bulk=kept * effective_sizes(columns),
        ess_tail=kept * effective_sizes(columns, "tail"),
        k_hat=k_hat,
    )
