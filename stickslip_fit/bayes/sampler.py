"""Sampling of the hyperparameters: independent emcee ensembles, run until they have converged.

D. Foreman-Mackey et al., PASP 125:306 (2013). Most moves propose from a fitted Student t independently
of the walker, the others by differential evolution (C. ter Braak, Stat. Comput. 16:239, 2006). An
ensemble counts as one chain for R-hat (A. Vehtari et al., Bayesian Analysis 16:667, 2021), since its
walkers depend on each other; the effective sample size comes from the autocorrelation of each walker.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from pandas.api.types import is_numeric_dtype

from stickslip_fit._typing import Array
from stickslip_fit.bayes.marginal import (
    LogDensity,
    MarginalLikelihood,
    PosteriorDraws,
    StudentTProposal,
    fit_proposal,
    linearize_at_mode,
    psis_smooth,
    resample,
    sample_sessions,
)
from stickslip_fit.bayes.priors import CausePriors, GroupData, Prior
from stickslip_fit.causes import ExtendedLaw, describe
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.laws import StepLaw

if TYPE_CHECKING:
    import h5py
    from emcee import EnsembleSampler
    from emcee.backends import Backend, HDFBackend

ENSEMBLE_COUNT = 4


def memory_backends() -> list[Backend]:
    """Backends that are gone with the process, one for each ensemble."""
    from emcee.backends import Backend

    return [Backend() for _ in range(ENSEMBLE_COUNT)]


def file_backends(
    path: str | Path, name: str, traverses: GroupData, prior: Prior, seed: int
) -> list[HDFBackend]:
    """Backends in an HDF5 file, one for each ensemble; `name` is of the joint and direction.

    Raises
    ------
    InputError
        If the file cannot be used, or holds under this name chains of other traverses, prior or seed.
    """
    import h5py
    from emcee.backends import HDFBackend

    wanted = _hash_inputs(traverses, prior, seed)
    try:
        with h5py.File(path, "a") as file:
            reason = _refuse_chains(file, name, wanted)
    except Exception as error:  # HDF5 fails in any way on a damaged file
        message = f"is no HDF5 file that can be read and written to ({error}); give another path"
        raise InputError(InputIssue(message, str(path))) from None
    if reason:
        raise InputError(InputIssue(f"{reason}; give another path, or delete it", str(path)))
    return [HDFBackend(str(path), name=f"{name}/ensemble_{number}") for number in range(ENSEMBLE_COUNT)]


FORMAT, VERSION = "stickslip-fit/chains", 1


def _refuse_chains(file: h5py.File, name: str, wanted: str) -> str:
    """Why chains cannot be continued; else empty, and the file, which may be new, is marked as theirs."""
    schema = file.attrs.get("schema", "" if len(file) else f"{FORMAT}/{VERSION}")
    version = str(schema).removeprefix(f"{FORMAT}/")
    if version.isdecimal() and int(version) > VERSION:
        return "was made by a newer version of stickslip-fit"
    if schema != f"{FORMAT}/{VERSION}":
        return "holds something other than chains"
    file.attrs["schema"] = schema
    group = file.require_group(name)
    if group.attrs.setdefault("fingerprint", wanted) != wanted:
        return f"holds the chains of another log, law, prior or seed for {name}"
    for ensemble in group.values():
        steps = int(ensemble.attrs["iteration"])
        chain, density = ensemble["chain"][:steps], ensemble["log_prob"][:steps]
        if density.shape != (steps, *chain.shape[1:2]) or not np.isfinite(chain).all():
            return f"holds damaged chains for {name}"
    return ""


def _hash_inputs(traverses: GroupData, prior: Prior, seed: int) -> str:
    """Hash of all that determines the chains."""
    law = traverses.law
    text = repr((_describe_law(law), prior.names, list(traverses.groups.table["session"]), seed))
    digest = hashlib.sha256(text.encode())
    columns = [_to_numbers(traverses.rows[name]) for name in dict.fromkeys((*law.columns, "start", "stop"))]
    levels = np.array([prior.repeatability, prior.spread_factor, prior.repeatability_factor])
    numbers = [*columns, traverses.y, traverses.rounding, prior.centre, prior.width, prior.spread, levels]
    for array in (*numbers, traverses.groups.of_row):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _describe_law(law: StepLaw) -> dict[str, Any]:
    if isinstance(law, FixedCauseLaw):
        return {"held": law.sizes.tolist(), **describe(law.extended)}
    return describe(law)


def _to_numbers(column: pd.Series[Any]) -> npt.NDArray[Any]:
    """A column as numbers, text by its hash."""
    if is_numeric_dtype(column):
        return column.to_numpy(float)
    return np.asarray(pd.util.hash_array(column.astype(str).to_numpy(dtype=object)))


def r_hat(draws: Array) -> Array:
    """Rank-normalised split R-hat between ensembles (Vehtari et al., Bayesian Analysis 16:667, 2021).

    Of draws as for `effective_sample_sizes`.
    """
    from arviz_stats.base import array_stats

    return np.asarray(array_stats.rhat(draws.reshape(*draws.shape[:2], -1)))


def effective_sample_sizes(draws: Array, kind: Literal["bulk", "tail"] = "bulk") -> Array:
    """Effective number of draws, (quantities, ensembles, steps, walkers) -> (quantities,)."""
    from arviz_stats.base import array_stats

    chains = draws.swapaxes(2, 3).reshape(len(draws), -1, draws.shape[2])
    prob = {"tail": (0.05, 0.95)}.get(kind)
    return np.asarray(array_stats.ess(chains, method=kind, prob=prob))


WALKERS_PER_ENSEMBLE = 32
STEPS_PER_CHECK = 50  # between tests of convergence
BURN_IN_FRACTION = 0.2  # share of the steps left out at the beginning
R_HAT_LIMIT = 1.01
PROPOSAL_FRACTION = 0.7  # share of steps that draw from the Student-t proposal
START_OVERDISPERSION = 2.0


@dataclass(frozen=True, eq=False)
class Chains:
    """Chains without their burn-in: x, shape (ensembles, steps, walkers, d), and its log density.

    `steps` are those of each ensemble, the burn-in included.
    """

    x: Array
    log_density: Array
    steps: int


def run_ensembles(
    log_density: LogDensity,
    proposal: StudentTProposal,
    seed: tuple[int, ...],
    backends: list[Backend],
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> Chains:
    """Sample until R-hat is small enough and the effective sample size is `target_ess`.

    Parameters
    ----------
    proposal : StudentTProposal
        Of moves, and twice as wide of the first points.
    backends : list of Backend
        One for each ensemble; chains that they already hold are continued, with the same outcome.
    on_step : callable
        Called with the number of new steps.
    """
    dimensions = len(proposal.centre)
    walkers = max(WALKERS_PER_ENSEMBLE, 4 * dimensions)
    samplers = [_build_sampler(log_density, proposal, walkers, backend) for backend in backends]
    turn = 0
    while True:
        turn += 1
        steps = min(turn * STEPS_PER_CHECK, max_steps)
        for number, sampler in enumerate(samplers):
            _continue_run(sampler, proposal, (*seed, number), steps, on_step)
        chains = _collect_chains(backends, steps)
        if steps == max_steps or _has_converged(chains, target_ess):
            return chains


def _build_sampler(
    log_density: LogDensity, proposal: StudentTProposal, walkers: int, backend: Backend
) -> EnsembleSampler:
    from emcee import EnsembleSampler
    from emcee.moves import DEMove, MHMove

    def propose(x: Array, rng: np.random.RandomState) -> tuple[Array, Array]:
        proposed = proposal.draw(len(x), rng)
        return proposed, proposal.log_density(x) - proposal.log_density(proposed)

    moves = [(MHMove(propose), PROPOSAL_FRACTION), (DEMove(), 1.0 - PROPOSAL_FRACTION)]
    return EnsembleSampler(
        walkers, len(proposal.centre), log_density, moves=moves, backend=backend, vectorize=True
    )


def _continue_run(
    sampler: EnsembleSampler,
    proposal: StudentTProposal,
    seed: tuple[int, ...],
    steps: int,
    on_step: Callable[[int], Any],
) -> None:
    from emcee.state import State

    done = sampler.backend.iteration
    if done:
        state = sampler.backend.get_last_sample()
    else:
        start = proposal.draw(sampler.nwalkers, np.random.default_rng(seed), wider=START_OVERDISPERSION)
        generator = np.random.MT19937(seed).state["state"]
        state = State(start, random_state=("MT19937", generator["key"], generator["pos"], 0, 0.0))
    for _ in sampler.sample(state, iterations=max(steps - done, 0)):
        on_step(1)


def _collect_chains(backends: list[Backend], steps: int) -> Chains:
    first = int(BURN_IN_FRACTION * steps)
    return Chains(
        np.stack([backend.get_chain()[first:steps] for backend in backends]),
        np.stack([backend.get_log_prob()[first:steps] for backend in backends]),
        steps,
    )


def _has_converged(chains: Chains, target_ess: int) -> bool:
    x = np.moveaxis(chains.x, -1, 0)
    return bool(np.max(r_hat(x)) < R_HAT_LIMIT and np.min(effective_sample_sizes(x)) >= target_ess)


K_HAT_LIMIT = 0.7  # largest k-hat at which importance weights can be smoothed
# More is sampled and kept than asked for, since every quantity must have enough effective draws, and R-hat
# itself scatters where draws are few.
STEP_RESERVE, DRAWS_PER_ESS, MIN_DRAWS = 1.5, 2.5, 2500
LENGTH_FACTORS = (1, 2, 4, 8)  # of the chains, where uneven weights leave too few effective draws


@dataclass(frozen=True, eq=False)
class PosteriorSample:
    """Draws of equal weight and their diagnostics.

    Attributes
    ----------
    prior : Prior
        Of the published law's parameters.
    draws : PosteriorDraws
        Ensemble after ensemble, each in order of time.
    log_density, log_weight : array, shape (d,)
        Of each draw's hyperparameters, and exact over linearized likelihood.
    ensembles, steps : int
        `steps` of each ensemble.
    quality : DataFrame
        Columns parameter, session (empty for the campaign), r_hat, ess_bulk, ess_tail and k_hat.
    causes : CausePriors or None
        Where the law has causes.
    """

    traverses: GroupData
    prior: Prior
    draws: PosteriorDraws
    log_density: Array
    log_weight: Array
    ensembles: int
    steps: int
    quality: pd.DataFrame
    target_ess: int
    causes: CausePriors | None = None

    @property
    def weights_reliable(self) -> bool:
        """Whether the importance weights can be smoothed."""
        return bool((self.quality["k_hat"] < K_HAT_LIMIT).all())

    @property
    def converged(self) -> bool:
        """Whether every quantity may be reported."""
        agreed = (self.quality["r_hat"] < R_HAT_LIMIT) & (self.quality["ess_bulk"] >= self.target_ess)
        return self.weights_reliable and bool(agreed.all())

    @property
    def names(self) -> tuple[str, ...]:
        """Of all the law's parameters."""
        return self.prior.names + (self.causes.names if self.causes else ())

    def draw_prior(self, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """As `Prior.draw`, of all the law's parameters; those of causes do not spread between sessions."""
        mean, spread, repeatability = self.prior.draw(size, rng)
        if self.causes is None:
            return mean, spread, repeatability
        sizes = self.causes.draw(size, rng)
        return np.hstack([mean, sizes]), np.hstack([spread, np.zeros_like(sizes)]), repeatability

    def without_causes(self) -> PosteriorSample:
        """The sample of the published law's parameters, with causes fixed at the means of their draws."""
        law = self.traverses.law
        if not isinstance(law, ExtendedLaw):
            return self
        own = len(self.prior.names)
        fixed = FixedCauseLaw(law.law, law.causes, self.draws.mean[:, own:].mean(axis=0))
        traverses = replace(self.traverses, law=fixed)
        return replace(self, traverses=traverses, draws=self.draws.law_part(own), causes=None)


def sample_posterior(
    traverses: GroupData,
    prior: Prior,
    backends: list[Backend],
    *,
    seed: tuple[int, ...],
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> PosteriorSample:
    """Sample the posterior of one joint and direction; see `run_ensembles` for the arguments."""
    rng = np.random.default_rng(seed)
    marginal, mode, covariance = linearize_at_mode(traverses, prior)
    proposal = fit_proposal(marginal.log_density, mode, covariance, rng)
    for factor in LENGTH_FACTORS:
        wanted = factor * target_ess
        chains = run_ensembles(
            marginal.log_density, proposal, seed, backends, int(STEP_RESERVE * wanted), max_steps, on_step
        )
        sample = _weight_draws(traverses, marginal, _thin_chains(chains, wanted), target_ess, rng)
        if sample.converged or not sample.weights_reliable or chains.steps == max_steps:
            break
    return sample


def _weight_draws(
    traverses: GroupData,
    marginal: MarginalLikelihood,
    chains: Chains,
    target_ess: int,
    rng: np.random.Generator,
) -> PosteriorSample:
    """Sessions sampled at the chains' hyperparameters, weighted to the exact posterior."""
    ensembles, *_, dimensions = chains.x.shape
    draws, log_weight = sample_sessions(traverses, marginal, chains.x.reshape(-1, dimensions), rng)
    weight, k_hat = psis_smooth(log_weight)
    quality = assess_draws(draws, traverses, marginal.prior, chains.x.shape[:3], weight, k_hat)
    by_ensemble = weight.reshape(ensembles, -1)
    size = by_ensemble.shape[1]
    taken = np.concatenate([i * size + resample(own, rng) for i, own in enumerate(by_ensemble)])
    log_densities = (chains.log_density.ravel()[taken], log_weight[taken])
    drawn = (draws.select(taken), *log_densities, ensembles, chains.steps)
    return PosteriorSample(traverses, marginal.prior, *drawn, quality, target_ess)


def _thin_chains(chains: Chains, target_ess: int) -> Chains:
    ensembles, steps, walkers, _ = chains.x.shape
    every = max(ensembles * steps * walkers // max(int(DRAWS_PER_ESS * target_ess), MIN_DRAWS), 1)
    return Chains(chains.x[:, ::every], chains.log_density[:, ::every], chains.steps)


def assess_draws(
    draws: PosteriorDraws,
    traverses: GroupData,
    prior: Prior,
    shape: tuple[int, ...],
    weight: Array,
    k_hat: float,
) -> pd.DataFrame:
    """Diagnostics of every quantity; see `assess_labelled_draws`."""
    names, sessions = list(prior.names), list(traverses.groups.table["session"])
    labels = [(name, "") for name in names] + [(f"spread of {name}", "") for name in names]
    labels += [("repeatability", "")] + [(name, session) for session in sessions for name in names]
    flat = [draws.mean, draws.spread, draws.repeatability[:, None], draws.parameters.reshape(len(draws), -1)]
    table = pd.DataFrame(labels, columns=["parameter", "session"])
    return assess_labelled_draws(table, np.concatenate(flat, axis=1), shape, weight, k_hat)


def assess_labelled_draws(
    labels: pd.DataFrame, draws: Array, shape: tuple[int, ...], weight: Array, k_hat: float
) -> pd.DataFrame:
    """Diagnostics of labelled draws, shape (d, quantities); uneven weights cost their share of the draws.

    `shape` says into how many ensembles, steps and walkers the draws fall.
    """
    columns = draws.T.reshape(-1, *shape)
    kept = 1.0 / (len(weight) * np.sum(weight**2))
    return labels.assign(
        r_hat=r_hat(columns),
        ess_bulk=kept * effective_sample_sizes(columns),
        ess_tail=kept * effective_sample_sizes(columns, "tail"),
        k_hat=k_hat,
    )
