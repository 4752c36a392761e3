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

from stickslip_fit._io import progress_bar
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
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.logs import Log


@dataclass(frozen=True, eq=False)
class LinearizedGroup:
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
        """The traverses with the causes held at other sizes, shape (q,)."""
        law = self.traverses.law
        assert isinstance(law, FixedCauseLaw)
        return replace(self.traverses, law=FixedCauseLaw(law.law, law.extended.causes, sizes))

    def shift(self, sizes: Array) -> Array:
        """By how much other sizes of the causes change each response, (k, q) -> (S, m, k)."""
        prior, whole = self.marginal.prior, self.whole
        own = prior.centre + prior.width * self.marginal.z
        response = whole.predict(join_parameters(np.broadcast_to(own, (len(sizes), *own.shape)), sizes))
        held = self.traverses.predict(own[None])
        return self.traverses.pad((response - held).T, 0.0)

    def log_likelihood(self, sizes: Array) -> Array:
        """Of other sizes at the likeliest levels, (k, q) -> (k,); -inf where the law stalls."""
        levels = np.broadcast_to(self.mode, (len(sizes), len(self.mode)))
        return _finite_or_excluded(self.marginal.conditional(levels, self.shift(sizes)).log_likelihood)

    def sample_sessions(
        self, x: Array, sizes: Array, rng: np.random.Generator
    ) -> tuple[PosteriorDraws, Array]:
        """Draw the campaign's mean and the sessions at each x, (k, p + 1), and sizes, (k, q).

        Returns
        -------
        draws : Draws
            With the causes' parameters after the others; they do not spread between sessions.
        log_weight : array, shape (k,)
            Exact likelihood over that by which `x` was walked through.
        """
        at_a_time = max(NUMBERS_PER_CHUNK // len(self.traverses.y), 1)
        parts = [
            self._draw_back(x[first : first + at_a_time], sizes[first : first + at_a_time], rng)
            for first in range(0, len(x), at_a_time)
        ]
        draws, weights = zip(*parts, strict=True)
        both = [
            np.concatenate([getattr(part, name) for part in draws]) for name in PosteriorDraws.__annotations__
        ]
        return PosteriorDraws(*both), np.concatenate(weights)

    def _draw_back(self, x: Array, sizes: Array, rng: np.random.Generator) -> tuple[PosteriorDraws, Array]:
        prior, shift = self.marginal.prior, self.shift(sizes)
        given = self.marginal.conditional(x, np.nan_to_num(shift))
        mean = given.draw_mean(rng)
        z = (given.sessions(mean) + given.draw_departures(rng)).T
        spread, repeatability = prior.levels(x)
        values = join_parameters(prior.centre + prior.width * z, sizes)
        draws = PosteriorDraws(
            np.concatenate([prior.centre + prior.width * mean.T, sizes], axis=1),
            np.concatenate([spread, np.zeros_like(sizes)], axis=1),
            repeatability,
            values,
        )
        exact = log_importance_ratio(self.whole, self.marginal, z, values, repeatability, shift)
        walked = self.marginal.conditional(x).log_likelihood
        return draws, _finite_or_excluded(given.log_likelihood - walked + exact)


def build_proposal(
    parts: Sequence[LinearizedGroup], priors: CausePriors, start: Array, error: Array, seed: int
) -> CauseProposal:
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
    step = 1e-4
    slope = (priors.values(eta + step) - priors.values(eta - step)) / (2 * step)
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(free, np.abs(error / slope), 1.0)
    root = np.where((width > 0) & (width < 1), width, 1.0)
    initial = CauseProposal(
        priors, eta, root, free, StudentTProposal(np.zeros(free.sum()), np.eye(free.sum()))
    )

    def log_density(xi: Array) -> Array:
        points, sizes = initial.points(xi)
        found = np.sum([part.log_likelihood(sizes) for part in parts], axis=0)
        return _finite_or_excluded(found - 0.5 * np.sum(points**2, axis=1))

    mode, covariance = find_mode(log_density, np.zeros(free.sum()))
    return replace(initial, proposal=fit_proposal(log_density, mode, covariance, np.random.default_rng(seed)))


@dataclass(frozen=True, eq=False)
class CauseProposal:
    """Where draws of the causes' parameters come from.

    Attributes
    ----------
    priors : CausePriors
    centre, root : array, shape (q,)
        Origin and unit of what the guess knows, where the prior is standard normal.
    free : array of bool, shape (q,)
    proposal : Guess
        Of the free ones.
    """

    priors: CausePriors
    centre: Array
    root: Array
    free: npt.NDArray[np.bool_]
    proposal: StudentTProposal

    @property
    def middle(self) -> Array:
        """All the parameters in the middle of the guess, shape (q,)."""
        return self.points(self.proposal.centre[None])[1][0]

    def points(self, xi: Array) -> tuple[Array, Array]:
        """Where the prior is standard normal, of the free ones; and all the parameters, shape (k, q)."""
        eta = np.tile(self.centre, (len(xi), 1))
        eta[:, self.free] += self.root[self.free] * xi
        return eta[:, self.free], self.priors.values(eta)

    def draw(self, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Parameters, shape (size, q), and the log of the prior over what they were drawn from, (size,)."""
        xi = self.proposal.draw(size, rng)
        eta, values = self.points(xi)
        return values, -0.5 * np.sum(eta**2, axis=1) - self.proposal.log_density(xi)


def draw_all_groups(
    parts: Mapping[tuple[int, str], LinearizedGroup],
    levels: Mapping[tuple[int, str], Array],
    proposal: CauseProposal,
    rng: np.random.Generator,
) -> tuple[dict[tuple[int, str], PosteriorDraws], Array]:
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
        draws[group], more = part.sample_sessions(levels[group], sizes, rng)
        log_weight = log_weight + more
    return draws, log_weight


def join_parameters(own: Array, sizes: Array) -> Array:
    """Each session's own parameters and those of the causes, (k, S, p) and (k, q) -> (k, S, p + q)."""
    return np.concatenate([own, np.broadcast_to(sizes[:, None], (*own.shape[:2], sizes.shape[1]))], axis=2)


def _finite_or_excluded(log_density: Array) -> Array:
    return np.where(np.isfinite(log_density), log_density, -np.inf)


Group = tuple[int, str]

# The causes are first held where least squares has them, then in the middle of what may be.
PROPOSAL_ROUNDS = 2
DRAWS_PER_ESS = 4.0  # draws for each effective one that is asked for: uneven weights cost some
JOINT_SEED = 100_003  # the seed of what is not drawn for any one joint


def fit_jointly(
    log: Log,
    causes: Sequence[Cause],
    priors: Priors,
    *,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    on_step: Callable[[int], Any],
) -> tuple[dict[Group, PosteriorSample], Priors]:
    """Sample the posterior of every joint and direction, and of the causes' parameters; see `bayes`.

    Least squares chooses the causes' versions, and moments of sudden changes, which are held there.
    """
    start, error, laws = _least_squares_start(fit_least_squares(log, causes=causes))
    common = priors.causes or weak_cause_priors(next(iter(laws.values())), start, log.usable)
    fixed = common.values(common.at(start))
    data_by_group: dict[Group, GroupData] = {}
    backends: dict[Group, list[Any]] = {}
    for joint, direction, traverses in iterate_groups(log):
        group, law = (joint, direction), laws[joint]
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
    """Sample what belongs together.

    Parameters
    ----------
    laid_out : mapping of (int, str) to Traverses
        Under laws that hold the causes at `fixed`.
    priors : Priors
        With those of the causes.
    fixed, error : array, shape (q,)
        About where the causes' parameters are, and how well that is known; 0 where nobody knows.
    backends : mapping of (int, str) to list of Backend
    seed, target_ess, max_steps, on_step
        See `walk`.
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
    for longer in LENGTH_FACTORS:
        wanted = longer * target_ess
        chains = {
            group: run_ensembles(
                part.marginal.log_density, proposals[group], _group_seed(seed, group), backends[group],
                int(STEP_RESERVE * wanted), max_steps, on_step,
            )
            for group, part in parts.items()
        }  # fmt: skip
        levels, shape = _align_chains(chains, max(int(DRAWS_PER_ESS * wanted), MIN_DRAWS))
        rng = np.random.default_rng((seed, JOINT_SEED))
        draws, log_weight = draw_all_groups(parts, levels, proposal, rng)
        samples = _build_samples(parts, draws, log_weight, shape, common, chains, target_ess, rng)
        result = samples.values()
        enough = all(each.converged for each in result) or not all(each.weights_reliable for each in result)
        if enough or all(each.steps == max_steps for each in result):
            break
    return samples


def _least_squares_start(result: Result) -> tuple[Array, Array, dict[int, ExtendedLaw]]:
    """Sizes of the causes by least squares, how well known, and the laws with the causes' versions."""
    laws = {joint: fit.law for joint, fit in result.joints.items() if isinstance(fit.law, ExtendedLaw)}
    last = slice(-len(next(iter(laws.values())).common), None)
    fits = list(result.joints.values())
    variance = np.concatenate([np.diagonal(fit.covariance, axis1=1, axis2=2)[:, last] for fit in fits])
    sure = variance[np.argmax(np.isfinite(variance).all(axis=1))]
    return fits[0].values[0, last], np.sqrt(np.nan_to_num(sure)), laws


def _group_seed(seed: int, group: Group) -> tuple[int, ...]:
    return (seed, group[0], int(group[1] == "-"))


def _align_chains(chains: dict[Group, Chains], wanted: int) -> tuple[dict[Group, Array], tuple[int, ...]]:
    """As many draws of each part's levels, and in how many ensembles, steps and walkers."""
    ensembles, walkers = (min(each.x.shape[k] for each in chains.values()) for k in (0, 2))
    steps = -(-wanted // (ensembles * walkers))
    levels = {}
    for group, each in chains.items():
        taken = np.linspace(0, each.x.shape[1] - 1, steps).round().astype(int)
        levels[group] = each.x[:ensembles, taken, :walkers].reshape(-1, each.x.shape[-1])
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
    """Draws of equal weight, the same ones of all parts."""
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
            part.whole, part.marginal.prior, draws[group].take(taken),
            log_weight[taken], log_weight[taken], shape[0], chains[group].steps,
            pd.concat(tables, ignore_index=True), target_ess, common,
        )  # fmt: skip
    return samples


def fit_bayes(
    log: Log,
    *,
    causes: Sequence[Cause] = (),
    priors: Priors | None = None,
    seed: int = 0,
    target_ess: int = 1000,
    max_steps: int = 5000,
    backend: str | Path | None = None,
    progress: bool = True,
    command: str = "",
) -> Posterior:
    """Fit the published law of every joint to all usable traverses, each session drawn from a campaign.

    Parameters
    ----------
    log : Log
    causes : sequence of Cause, optional
        Departures from the published laws: one set of parameters for the whole campaign, which ties all
        joints and directions together.
    priors : Priors, optional
        `weak_priors` of the log without it.
    seed : int, optional
    target_ess : int, optional
        Effective draws that every parameter is to have, at R-hat below 1.01.
    max_steps : int, optional
        Steps of each ensemble after which a joint and direction is given up as not converged.
    backend : path, optional
        An HDF5 file in which the walks are kept step by step, at about a second for each joint and
        direction. After an interruption the same call carries on where it was, and ends as if nothing had
        happened.
    progress : bool, optional
        Show a progress bar.
    command : str, optional
        Kept in the result's provenance.

    Returns
    -------
    Posterior
        What has not converged is NaN and has a remark that says so.

    Raises
    ------
    InputError
        If the log has no usable traverse, the priors lack a joint or direction, or `backend` holds the
        walks of another log, law, prior or seed.

    Notes
    -----
    A session's parameters are normal about the campaign's; log(steps) is normal about the law, with the
    repeatability's variance and the rounding's. Sessions and campaign means are integrated out in closed
    form, what remains is sampled by ensembles, and the draws are weighted to the exact posterior. Causes'
    parameters are drawn beside it and weighted with it, all joints at once; see `bayes.with_causes`.
    """
    priors = weak_priors(log) if priors is None else priors
    if causes:
        with progress_bar(progress, desc="all joints", unit=" steps") as shown:
            samples, priors = fit_jointly(
                log, causes, priors, seed=seed, target_ess=target_ess, max_steps=max_steps,
                backend=backend, on_step=shown.update,
            )  # fmt: skip
    else:
        samples = _fit_separately(log, priors, seed, target_ess, max_steps, backend, progress)
    tables = [
        found.quality.assign(joint=joint, direction=direction)
        for (joint, direction), found in samples.items()
    ]
    diagnostics = pd.concat(tables, ignore_index=True)
    diagnostics = diagnostics[["joint", "direction", *diagnostics.columns.drop(["joint", "direction"])]]
    result = build_result(log, samples, seed, command)
    return Posterior(result, build_datatree(samples, np.random.default_rng(seed)), priors, diagnostics)


def _fit_separately(
    log: Log,
    priors: Priors,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    progress: bool,
) -> dict[tuple[int, str], PosteriorSample]:
    """Joints and directions that nothing ties together."""
    samples = {}
    for joint, direction, traverses in iterate_groups(log):
        prior, name = priors.prior(joint, direction), group_name(joint, direction)
        walks = memory_backends() if backend is None else file_backends(backend, name, traverses, prior, seed)
        # Most walks end long before `max_steps`, so a share of it would mislead.
        with progress_bar(progress, desc=f"joint {joint}, direction {direction}", unit=" steps") as shown:
            samples[joint, direction] = sample_posterior(
                traverses,
                prior,
                walks,
                seed=(seed, joint, int(direction == "-")),
                target_ess=target_ess,
                max_steps=max_steps,
                on_step=shown.update,
            )
    return samples
