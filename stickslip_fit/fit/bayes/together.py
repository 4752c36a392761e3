"""The posterior of a log whose laws have causes in them: all joints and directions at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.fit.bayes.backend import in_file, in_memory
from stickslip_fit.fit.bayes.cause_priors import CausePriors, weak_cause_priors
from stickslip_fit.fit.bayes.ensembles import Chains, walk
from stickslip_fit.fit.bayes.exact import Draws, resample, smooth
from stickslip_fit.fit.bayes.expansion import expand
from stickslip_fit.fit.bayes.laplace import fit_guess
from stickslip_fit.fit.bayes.priors import Priors
from stickslip_fit.fit.bayes.sample import FEWEST, LONGER, RESERVE, Sample, quality, quality_of
from stickslip_fit.fit.bayes.traverses import Traverses, each_group, lay_out
from stickslip_fit.fit.bayes.tree import branch_name
from stickslip_fit.fit.bayes.with_causes import Part, draw_together, propose
from stickslip_fit.fit.known_causes import HeldLaw
from stickslip_fit.fit.least_squares import least_squares
from stickslip_fit.fit.result import Result
from stickslip_fit.logs import Log

Array = npt.NDArray[np.float64]
Group = tuple[int, str]

# The causes are first held where least squares has them, then in the middle of what may be.
ROUNDS = 2
KEPT = 4.0  # draws for each effective one that is asked for: uneven weights cost some
FITTED_APART = 100_003  # the seed of what is not drawn for any one joint


def sample_together(
    log: Log,
    causes: Sequence[Cause],
    priors: Priors,
    *,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    on_step: Callable[[int], Any],
) -> tuple[dict[Group, Sample], Priors]:
    """Sample the posterior of every joint and direction, and of the causes' parameters; see `bayes`.

    Least squares chooses the causes' versions, and moments of sudden changes, which are held there.
    """
    start, error, laws = _begun(least_squares(log, causes=causes))
    common = priors.causes or weak_cause_priors(next(iter(laws.values())), start, log.usable)
    held = common.values(common.at(start))
    laid_out: dict[Group, Traverses] = {}
    walks: dict[Group, list[Any]] = {}
    for joint, direction, traverses in each_group(log):
        group, law = (joint, direction), laws[joint]
        laid_out[group] = lay_out(HeldLaw(law.law, law.causes, held), traverses.rows)
        walks[group] = in_memory()
        if backend is not None:
            prior, name = priors.prior(*group), branch_name(*group)
            walks[group] = in_file(backend, name, laid_out[group], prior, seed)
    priors = replace(priors, causes=common)
    samples = sample_parts(
        laid_out, priors, held, error, walks,
        seed=seed, target_ess=target_ess, max_steps=max_steps, on_step=on_step,
    )  # fmt: skip
    return samples, priors


def sample_parts(
    laid_out: Mapping[Group, Traverses],
    priors: Priors,
    held: Array,
    error: Array,
    walks: Mapping[Group, list[Any]],
    *,
    seed: int,
    target_ess: int,
    max_steps: int,
    on_step: Callable[[int], Any],
) -> dict[Group, Sample]:
    """Sample what belongs together.

    Parameters
    ----------
    laid_out : mapping of (int, str) to Traverses
        Under laws that hold the causes at `held`.
    priors : Priors
        With those of the causes.
    held, error : array, shape (q,)
        About where the causes' parameters are, and how well that is known; 0 where nobody knows.
    walks : mapping of (int, str) to list of Backend
    seed, target_ess, max_steps, on_step
        See `walk`.
    """
    common = priors.causes
    assert common is not None
    for _ in range(ROUNDS):
        parts = {
            group: Part(traverses, *expand(traverses, priors.prior(*group)))
            for group, traverses in laid_out.items()
        }
        proposal = propose(list(parts.values()), common, held, error, seed)
        held = proposal.middle
        laid_out = {group: part.holding(held) for group, part in parts.items()}
    guesses = {
        group: fit_guess(
            part.marginal.log_density, part.mode, part.covariance, np.random.default_rng(_seed(seed, group))
        )
        for group, part in parts.items()
    }
    for longer in LONGER:
        wanted = longer * target_ess
        chains = {
            group: walk(
                part.marginal.log_density, guesses[group], _seed(seed, group), walks[group],
                int(RESERVE * wanted), max_steps, on_step,
            )
            for group, part in parts.items()
        }  # fmt: skip
        levels, shape = _side_by_side(chains, max(int(KEPT * wanted), FEWEST))
        rng = np.random.default_rng((seed, FITTED_APART))
        draws, log_weight = draw_together(parts, levels, proposal, rng)
        samples = _samples(parts, draws, log_weight, shape, common, chains, target_ess, rng)
        found = samples.values()
        enough = all(each.converged for each in found) or not all(each.trusted for each in found)
        if enough or all(each.steps == max_steps for each in found):
            break
    return samples


def _begun(found: Result) -> tuple[Array, Array, dict[int, ExtendedLaw]]:
    """Sizes of the causes by least squares, how well known, and the laws with the causes' versions."""
    laws = {joint: fit.law for joint, fit in found.joints.items() if isinstance(fit.law, ExtendedLaw)}
    last = slice(-len(next(iter(laws.values())).common), None)
    fits = list(found.joints.values())
    variance = np.concatenate([np.diagonal(fit.covariance, axis1=1, axis2=2)[:, last] for fit in fits])
    sure = variance[np.argmax(np.isfinite(variance).all(axis=1))]
    return fits[0].values[0, last], np.sqrt(np.nan_to_num(sure)), laws


def _seed(seed: int, group: Group) -> tuple[int, ...]:
    return (seed, group[0], int(group[1] == "-"))


def _side_by_side(chains: dict[Group, Chains], wanted: int) -> tuple[dict[Group, Array], tuple[int, ...]]:
    """As many draws of each part's levels, and in how many ensembles, steps and walkers."""
    ensembles, walkers = (min(each.x.shape[k] for each in chains.values()) for k in (0, 2))
    steps = -(-wanted // (ensembles * walkers))
    levels = {}
    for group, each in chains.items():
        taken = np.linspace(0, each.x.shape[1] - 1, steps).round().astype(int)
        levels[group] = each.x[:ensembles, taken, :walkers].reshape(-1, each.x.shape[-1])
    return levels, (ensembles, steps, walkers)


def _samples(
    parts: dict[Group, Part],
    draws: dict[Group, Draws],
    log_weight: Array,
    shape: tuple[int, ...],
    common: CausePriors,
    chains: dict[Group, Chains],
    target_ess: int,
    rng: np.random.Generator,
) -> dict[Group, Sample]:
    """Draws of equal weight, the same ones of all parts."""
    weight, k_hat = smooth(log_weight)
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
            quality(draws[group].of_law(own), part.traverses, part.marginal.prior, shape, weight, k_hat),
            quality_of(labels, sizes, shape, weight, k_hat),
        ]
        samples[group] = Sample(
            part.whole, part.marginal.prior, draws[group].take(taken),
            log_weight[taken], log_weight[taken], shape[0], chains[group].steps,
            pd.concat(tables, ignore_index=True), target_ess, common,
        )  # fmt: skip
    return samples
