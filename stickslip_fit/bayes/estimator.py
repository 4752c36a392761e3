"""fit_bayes: hierarchical Bayesian fit of a log, its sessions drawn from a campaign distribution.

Start reading here, then `priors`, `marginal`, `sampler`, `posterior`. Joints and directions are
independent unless causes tie them together. With causes, each joint and direction is sampled with the
causes fixed; draws of the causes come from a Student-t proposal, and importance weights (Pareto k-hat
as their check) correct the combination to the joint posterior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._progress import progress_bar
from stickslip_fit._typing import Array
from stickslip_fit.bayes.marginal import (
    NUMBERS_PER_CHUNK,
    MarginalLikelihood,
    PosteriorDraws,
    StudentTProposal,
    find_mode,
    fit_proposal,
    linearize_at_mode,
    log_importance_ratio,
    psis_smooth,
    resample,
)
from stickslip_fit.bayes.posterior import Posterior
from stickslip_fit.bayes.priors import (
    CausePriors,
    Group,
    GroupData,
    Priors,
    build_group_data,
    iterate_groups,
    weak_cause_priors,
    weak_priors,
)
from stickslip_fit.bayes.result import build_datatree, build_result, group_name
from stickslip_fit.bayes.sampler import (
    LENGTH_FACTORS,
    MIN_DRAWS,
    STEP_RESERVE,
    Chains,
    PosteriorSample,
    assess_draws,
    assess_labelled_draws,
    file_backends,
    memory_backends,
    run_ensembles,
    sample_posterior,
)
from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import check_count
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.laws import Laws
from stickslip_fit.logs import Log


@dataclass(frozen=True, eq=False)
class LinearizedGroup:
    """One joint and direction under a `FixedCauseLaw`, linearized; mode, (p + 1,), and covariance there."""

    traverses: GroupData
    marginal: MarginalLikelihood
    mode: Array
    covariance: Array

    @property
    def whole(self) -> GroupData:
        """The traverses under the law with the causes' parameters among its own."""
        law = self.traverses.law
        assert isinstance(law, FixedCauseLaw)
        return replace(self.traverses, law=law.extended)

    def with_causes_fixed(self, sizes: Array) -> GroupData:
        """The traverses with the causes fixed at other sizes, shape (q,)."""
        law = self.traverses.law
        assert isinstance(law, FixedCauseLaw)
        return replace(self.traverses, law=FixedCauseLaw(law.law, law.extended.causes, sizes))

    def shift(self, sizes: Array) -> Array:
        """By how much other sizes of the causes change each response, (k, q) -> (S, m, k)."""
        prior, whole = self.marginal.prior, self.whole
        own = prior.centre + prior.width * self.marginal.z
        response = whole.predict(join_parameters(np.broadcast_to(own, (len(sizes), *own.shape)), sizes))
        fixed = self.traverses.predict(own[None])
        return self.traverses.pad((response - fixed).T, 0.0)

    def log_likelihood(self, sizes: Array) -> Array:
        """Of other sizes at the mode of the hyperparameters, (k, q) -> (k,); -inf where the law stalls."""
        levels = np.broadcast_to(self.mode, (len(sizes), len(self.mode)))
        return _finite_or_excluded(self.marginal.conditional(levels, self.shift(sizes)).log_likelihood)

    def sample_sessions(
        self, x: Array, sizes: Array, rng: np.random.Generator
    ) -> tuple[PosteriorDraws, Array]:
        """Draw campaign mean and sessions at each x, (k, p + 1), and sizes, (k, q); and log weights, (k,).

        The causes' parameters stand after the others and do not spread between sessions. A weight is the
        exact likelihood over that by which `x` was sampled.
        """
        size = max(NUMBERS_PER_CHUNK // len(self.traverses.y), 1)
        chunks = [slice(first, first + size) for first in range(0, len(x), size)]
        draws, weights = zip(*(self._sample_sessions(x[c], sizes[c], rng) for c in chunks), strict=True)
        return PosteriorDraws.concatenate(draws), np.concatenate(weights)

    def _sample_sessions(
        self, x: Array, sizes: Array, rng: np.random.Generator
    ) -> tuple[PosteriorDraws, Array]:
        prior, shift = self.marginal.prior, self.shift(sizes)
        conditional = self.marginal.conditional(x, np.nan_to_num(shift))
        mean = conditional.draw_mean(rng)
        z = (conditional.sessions(mean) + conditional.draw_departures(rng)).T
        spread, repeatability = prior.levels(x)
        values = join_parameters(prior.centre + prior.width * z, sizes)
        draws = PosteriorDraws(
            np.concatenate([prior.centre + prior.width * mean.T, sizes], axis=1),
            np.concatenate([spread, np.zeros_like(sizes)], axis=1),
            repeatability,
            values,
        )
        exact = log_importance_ratio(self.whole, self.marginal, z, values, repeatability, shift)
        sampled = self.marginal.conditional(x).log_likelihood
        return draws, _finite_or_excluded(conditional.log_likelihood - sampled + exact)


def build_proposal(
    parts: Sequence[LinearizedGroup], priors: CausePriors, start: Array, error: Array, seed: int
) -> CauseProposal:
    """A proposal of the causes' parameters, at the mode of each group's hyperparameters.

    `start` and `error`, shape (q,), are estimates and standard errors; NaN or 0 where these are unknown.
    """
    eta, free = priors.standardize(start), priors.free
    step = 1e-4
    slope = (priors.unstandardize(eta + step) - priors.unstandardize(eta - step)) / (2 * step)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(free, np.abs(error / slope), 1.0)
    root = np.where((width > 0) & (width < 1), width, 1.0)
    initial = CauseProposal(
        priors, eta, root, free, StudentTProposal(np.zeros(free.sum()), np.eye(free.sum()))
    )

    def log_density(xi: Array) -> Array:
        points, sizes = initial.points(xi)
        log_likelihood = np.sum([part.log_likelihood(sizes) for part in parts], axis=0)
        return _finite_or_excluded(log_likelihood - 0.5 * np.sum(points**2, axis=1))

    mode, covariance = find_mode(log_density, np.zeros(free.sum()))
    return replace(initial, proposal=fit_proposal(log_density, mode, covariance, np.random.default_rng(seed)))


@dataclass(frozen=True, eq=False)
class CauseProposal:
    """Proposal of the causes' parameters: Student's t in units of `root` about `centre`, both shape (q,).

    The coordinates are those in which the prior is standard normal; only the `free` parameters move.
    """

    priors: CausePriors
    centre: Array
    root: Array
    free: npt.NDArray[np.bool_]
    proposal: StudentTProposal

    @property
    def middle(self) -> Array:
        """All the parameters at the centre of the proposal, shape (q,)."""
        return self.points(self.proposal.centre[None])[1][0]

    def points(self, xi: Array) -> tuple[Array, Array]:
        """Standard normal coordinates of the free parameters; and all parameters, shape (k, q)."""
        eta = np.tile(self.centre, (len(xi), 1))
        eta[:, self.free] += self.root[self.free] * xi
        return eta[:, self.free], self.priors.unstandardize(eta)

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Parameters, shape (size, q), and the log of the prior over what they were drawn from, (size,)."""
        xi = self.proposal.draw(size, rng)
        eta, values = self.points(xi)
        return values, -0.5 * np.sum(eta**2, axis=1) - self.proposal.log_density(xi)


def join_parameters(own: Array, sizes: Array) -> Array:
    """Each session's own parameters and those of the causes, (k, S, p) and (k, q) -> (k, S, p + q)."""
    return np.concatenate([own, np.broadcast_to(sizes[:, None], (*own.shape[:2], sizes.shape[1]))], axis=2)


def _finite_or_excluded(log_density: Array) -> Array:
    return np.where(np.isfinite(log_density), log_density, -np.inf)


PROPOSAL_ROUNDS = 2  # the causes are fixed first at the least-squares fit, then at the proposal's centre
DRAWS_PER_ESS = 4.0  # draws for each effective one that is asked for: uneven weights cost some
CHAIN_LINE = "{desc}: {n_fmt}{unit}"  # of progress without a terminal
JOINT_SEED = 100_003  # of draws that concern all joints


def fit_jointly(
    log: Log,
    laws: Laws | None,
    causes: Sequence[Cause],
    priors: Priors,
    *,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    on_step: Callable[[int], Any],
) -> tuple[dict[Group, PosteriorSample], Priors]:
    """Sample the posterior of every joint and direction, and of the causes' parameters; see `fit_bayes`.

    Least squares chooses the causes' versions, and moments of sudden changes, which are fixed there.
    """
    start, error, extended = _least_squares_start(fit_least_squares(log, laws=laws, causes=causes))
    common = priors.causes or weak_cause_priors(next(iter(extended.values())), start, log.usable)
    fixed = common.unstandardize(common.standardize(start))
    data_by_group: dict[Group, GroupData] = {}
    backends: dict[Group, list[Any]] = {}
    for joint, direction, traverses in iterate_groups(log, laws):
        group, law = (joint, direction), extended[joint]
        data_by_group[group] = build_group_data(FixedCauseLaw(law.law, law.causes, fixed), traverses.rows)
        backends[group] = memory_backends()
        if backend is not None:
            prior, name = priors.prior(*group), group_name(*group)
            backends[group] = file_backends(backend, name, data_by_group[group], prior, seed)
    priors = replace(priors, causes=common)
    samples = sample_groups(
        data_by_group, priors, fixed, error, backends,
        seed=seed, target_ess=target_ess, max_steps=max_steps, on_step=on_step,
    )  # fmt: skip
    return samples, priors


def sample_groups(
    data_by_group: Mapping[Group, GroupData],
    priors: Priors,
    fixed: Array,
    error: Array,
    backends: Mapping[Group, list[Any]],
    *,
    seed: int,
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> dict[Group, PosteriorSample]:
    """Sample all groups and the causes' parameters.

    Parameters
    ----------
    data_by_group : mapping of (int, str) to GroupData
        Under laws with the causes fixed at `fixed`.
    priors : Priors
        With those of the causes.
    fixed, error : array, shape (q,)
        Estimates of the causes' parameters and their standard errors; 0 where these are unknown.
    backends : mapping of (int, str) to list of Backend
    seed, target_ess, max_steps, on_step
        See `run_ensembles`.
    """
    common = priors.causes
    assert common is not None
    for _ in range(PROPOSAL_ROUNDS):
        parts = {
            group: LinearizedGroup(traverses, *linearize_at_mode(traverses, priors.prior(*group)))
            for group, traverses in data_by_group.items()
        }
        proposal = build_proposal(list(parts.values()), common, fixed, error, seed)
        fixed = proposal.middle
        data_by_group = {group: part.with_causes_fixed(fixed) for group, part in parts.items()}
    proposals = {
        group: fit_proposal(
            part.marginal.log_density,
            part.mode,
            part.covariance,
            np.random.default_rng(_group_seed(seed, group)),
        )
        for group, part in parts.items()
    }
    for factor in LENGTH_FACTORS:
        wanted = factor * target_ess
        chains = {
            group: run_ensembles(
                part.marginal.log_density, proposals[group], _group_seed(seed, group), backends[group],
                int(STEP_RESERVE * wanted), max_steps, on_step,
            )
            for group, part in parts.items()
        }  # fmt: skip
        levels, shape = _align_chains(chains, max(int(DRAWS_PER_ESS * wanted), MIN_DRAWS))
        rng = np.random.default_rng((seed, JOINT_SEED))
        sizes, log_weight = proposal.draw(len(next(iter(levels.values()))), rng)
        draws = {}
        for group, part in parts.items():
            draws[group], group_log_weight = part.sample_sessions(levels[group], sizes, rng)
            log_weight = log_weight + group_log_weight
        samples = _build_samples(parts, draws, log_weight, shape, common, chains, target_ess, rng)
        result = samples.values()
        reliable = all(sample.weights_reliable for sample in result)
        if all(sample.converged for sample in result) or not reliable:
            break
        if all(sample.steps == max_steps for sample in result):
            break
    return samples


def _least_squares_start(result: Result) -> tuple[Array, Array, dict[int, ExtendedLaw]]:
    """Sizes of the causes by least squares, their standard errors, and the laws with the causes' versions."""
    laws = {joint: fit.law for joint, fit in result.joints.items() if isinstance(fit.law, ExtendedLaw)}
    last = slice(-len(next(iter(laws.values())).cause_parameters), None)
    fits = list(result.joints.values())
    variance = np.concatenate([np.diagonal(fit.covariance, axis1=1, axis2=2)[:, last] for fit in fits])
    sure = variance[np.argmax(np.isfinite(variance).all(axis=1))]
    return fits[0].values[0, last], np.sqrt(np.nan_to_num(sure)), laws


def _group_seed(seed: int, group: Group) -> tuple[int, ...]:
    return (seed, group[0], int(group[1] == "-"))


def _align_chains(chains: dict[Group, Chains], wanted: int) -> tuple[dict[Group, Array], tuple[int, ...]]:
    """As many draws of each group's hyperparameters, and the ensembles, steps and walkers they are from."""
    ensembles, walkers = (min(chain.x.shape[k] for chain in chains.values()) for k in (0, 2))
    steps = -(-wanted // (ensembles * walkers))
    levels = {}
    for group, chain in chains.items():
        taken = np.linspace(0, chain.x.shape[1] - 1, steps).round().astype(int)
        levels[group] = chain.x[:ensembles, taken, :walkers].reshape(-1, chain.x.shape[-1])
    return levels, (ensembles, steps, walkers)


def _build_samples(
    parts: dict[Group, LinearizedGroup],
    draws: dict[Group, PosteriorDraws],
    log_weight: Array,
    shape: tuple[int, ...],
    common: CausePriors,
    chains: dict[Group, Chains],
    target_ess: int,
    rng: np.random.Generator,
) -> dict[Group, PosteriorSample]:
    """Draws of equal weight, the same ones in all groups."""
    weight, k_hat = psis_smooth(log_weight)
    by_ensemble = weight.reshape(shape[0], -1)
    size = by_ensemble.shape[1]
    taken = np.concatenate([number * size + resample(own, rng) for number, own in enumerate(by_ensemble)])
    samples = {}
    for group, part in parts.items():
        own = len(part.marginal.prior.names)
        sizes = draws[group].mean[:, own:][:, common.free]
        names = [name for name, free in zip(common.names, common.free, strict=True) if free]
        labels = pd.DataFrame({"parameter": names, "session": ""})
        tables = [
            assess_draws(
                draws[group].law_part(own), part.traverses, part.marginal.prior, shape, weight, k_hat
            ),
            assess_labelled_draws(labels, sizes, shape, weight, k_hat),
        ]
        samples[group] = PosteriorSample(
            traverses=part.whole,
            prior=part.marginal.prior,
            draws=draws[group].select(taken),
            log_density=log_weight[taken],
            log_weight=log_weight[taken],
            ensembles=shape[0],
            steps=chains[group].steps,
            quality=pd.concat(tables, ignore_index=True),
            target_ess=target_ess,
            causes=common,
        )
    return samples


def fit_bayes(
    log: Log,
    *,
    laws: Laws | None = None,
    causes: Sequence[Cause] = (),
    priors: Priors | None = None,
    seed: int = 0,
    target_ess: int = 1000,
    max_steps: int = 5000,
    backend: str | Path | None = None,
    progress: bool = True,
    command: str = "",
) -> Posterior:
    """Fit the law of every joint to all usable traverses, each session drawn from a campaign.

    Parameters
    ----------
    log : Log
    laws : mapping of int to law, optional
        Laws of your own by joint, see `laws.choose_laws`; the published law for other joints.
    causes : sequence of Cause, optional
        Departures from the laws: one set of parameters for the whole campaign, which ties all
        joints and directions together.
    priors : Priors, optional
        `weak_priors` of the log without it.
    seed : int, optional
    target_ess : int, optional
        Effective draws that every parameter is to have, at R-hat below 1.01.
    max_steps : int, optional
        Steps of each ensemble after which a joint and direction is given up as not converged.
    backend : path, optional
        An HDF5 file in which the chains are kept step by step, at about a second for each joint and
        direction. After an interruption the same call carries on, with the same outcome.
    progress : bool, optional
        Show a progress bar.
    command : str, optional
        Kept in the result's provenance.

    Returns
    -------
    Posterior
        What has not converged is NaN and has a flag.

    Raises
    ------
    InputError
        If the log has no usable traverse, the priors lack a joint or direction, `backend` holds the
        chains of another log, law, prior or seed, or a seed or count is out of its range.

    Notes
    -----
    A session's parameters are normal about the campaign's; log(steps) is normal about the law, with the
    repeatability's variance and the rounding's. Sessions and campaign means are integrated out in closed
    form, what remains is sampled by ensembles, and the draws are weighted to the exact posterior. Causes'
    parameters are drawn beside it and weighted with it, all joints at once.
    """
    check_count("seed", seed, least=0)
    check_count("target_ess", target_ess)
    check_count("max_steps", max_steps)
    priors = weak_priors(log, laws) if priors is None else priors
    if causes:
        settings: dict[str, Any] = {"seed": seed, "target_ess": target_ess, "max_steps": max_steps}
        with progress_bar(progress, CHAIN_LINE, desc="all joints", unit=" steps") as bar:
            samples, priors = fit_jointly(
                log, laws, causes, priors, backend=backend, on_step=bar.update, **settings
            )
    else:
        samples = _fit_separately(log, laws, priors, seed, target_ess, max_steps, backend, progress)
    tables = [
        sample.quality.assign(joint=joint, direction=direction)
        for (joint, direction), sample in samples.items()
    ]
    diagnostics = pd.concat(tables, ignore_index=True)
    diagnostics = diagnostics[["joint", "direction", *diagnostics.columns.drop(["joint", "direction"])]]
    result = build_result(log, samples, seed, command)
    return Posterior(result, build_datatree(samples, np.random.default_rng(seed)), priors, diagnostics)


def _fit_separately(
    log: Log,
    laws: Laws | None,
    priors: Priors,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    progress: bool,
) -> dict[tuple[int, str], PosteriorSample]:
    """Sample every joint and direction by itself."""
    samples = {}
    for joint, direction, traverses in iterate_groups(log, laws):
        prior, name = priors.prior(joint, direction), group_name(joint, direction)
        backends = memory_backends()
        if backend is not None:
            backends = file_backends(backend, name, traverses, prior, seed)
        # Most chains end long before `max_steps`, so a share of it would mislead.
        with progress_bar(
            progress, CHAIN_LINE, desc=f"joint {joint}, direction {direction}", unit=" steps"
        ) as bar:
            samples[joint, direction] = sample_posterior(
                traverses,
                prior,
                backends,
                seed=_group_seed(seed, (joint, direction)),
                target_ess=target_ess,
                max_steps=max_steps,
                on_step=bar.update,
            )
    return samples
