"""A sample as an ArviZ DataTree, so that everything that speaks ArviZ can look at it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.bayes.sample import Sample
from stickslip_fit.laws import seen_count

if TYPE_CHECKING:
    from xarray import Dataset, DataTree

Array = npt.NDArray[np.float64]

# What has a number for each traverse and draw is kept for some of the draws.
POINTWISE_DRAWS, POINTWISE_NUMBERS = 500, 10_000_000


def branch_name(joint: int, direction: str) -> str:
    """Where a joint and direction stands in the tree.

    Examples
    --------
    >>> branch_name(3, "-")
    'joint_3_minus'
    """
    return f"joint_{joint}_{'plus' if direction == '+' else 'minus'}"


def plant(samples: Mapping[tuple[int, str], Sample], rng: np.random.Generator) -> DataTree:
    """The tree of all joints and directions."""
    from xarray import DataTree

    leaves = {
        f"/{branch_name(joint, direction)}/{group}": dataset
        for (joint, direction), sample in samples.items()
        for group, dataset in _branch(sample, rng).items()
    }
    return DataTree.from_dict(leaves)


def _branch(sample: Sample, rng: np.random.Generator) -> dict[str, Dataset]:
    """The groups of one joint and direction; all in SI.

    posterior and prior (mean and spread of the campaign, repeatability, and each session's parameters),
    sample_stats, log_likelihood, observed_data, posterior_predictive and prior_predictive: counts, log
    steps by the law without noise, and the repeatability; NaN where the joint stalls.
    """
    draws, chains = sample.draws, sample.ensembles
    per_chain = len(draws) // chains
    every = max(
        per_chain * chains // POINTWISE_DRAWS,
        int(np.ceil(len(draws) * len(sample.traverses.y) / POINTWISE_NUMBERS)),
        1,
    )
    kept = np.arange(per_chain)[::every]
    some = draws.take((np.arange(chains)[:, None] * per_chain + kept).ravel())
    expected = sample.traverses.predict(some.parameters)
    posterior = {
        "mean": draws.mean, "spread": draws.spread,
        "repeatability": draws.repeatability, "parameters": draws.parameters,
    }  # fmt: skip
    stats = {"lp": sample.log_density, "log_weight": sample.log_weight}
    pointwise = _log_likelihood(sample, expected, some.repeatability)
    predictive = _predictive(sample, expected, some.repeatability, rng)
    return {
        "posterior": _dataset(sample, posterior, chains),
        "sample_stats": _dataset(sample, stats, chains),
        "log_likelihood": _dataset(sample, {"log_steps": pointwise}, chains, kept),
        "posterior_predictive": _dataset(sample, predictive, chains, kept),
        **_prior(sample, len(some), rng),
        "observed_data": _observed(sample),
    }


def _log_likelihood(sample: Sample, expected: Array, repeatability: Array) -> Array:
    variance = repeatability[:, None] ** 2 + sample.traverses.rounding
    return -0.5 * ((sample.traverses.y - expected) ** 2 / variance + np.log(2 * np.pi * variance))


def _predictive(
    sample: Sample, expected: Array, repeatability: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Counts as a lab would have seen them, log steps by the law alone, and the noise between the two."""
    steps = np.exp(expected + repeatability[:, None] * rng.standard_normal(expected.shape))
    stalled = ~np.isfinite(steps)
    seen = seen_count(np.where(stalled, 1.0, steps), sample.traverses.rows["check_every"])
    return {"steps": np.where(stalled, np.nan, seen), "law": expected, "repeatability": repeatability}


def _prior(sample: Sample, size: int, rng: np.random.Generator) -> dict[str, Dataset]:
    mean, spread, repeatability = sample.from_prior(size, rng)
    sessions = len(sample.traverses.groups)
    noise = rng.standard_normal((size, sessions, mean.shape[1]))
    parameters = mean[:, None] + spread[:, None] * noise
    predictive = _predictive(sample, sample.traverses.predict(parameters), repeatability, rng)
    prior = {"mean": mean, "spread": spread, "repeatability": repeatability, "parameters": parameters}
    return {
        "prior": _dataset(sample, prior, 1),
        "prior_predictive": _dataset(sample, predictive, 1),
    }


def _observed(sample: Sample) -> Dataset:
    from xarray import Dataset

    traverses = sample.traverses
    return Dataset(
        {"log_steps": ("traverse", traverses.y), "steps": ("traverse", traverses.rows["steps"].to_numpy())},
        coords={"traverse": traverses.rows.index.to_numpy()},
    )


def _dataset(
    sample: Sample, columns: dict[str, Array], chains: int, draws: npt.NDArray[np.intp] | None = None
) -> Dataset:
    from xarray import Dataset

    beyond = {
        "mean": ("parameter",), "spread": ("parameter",), "parameters": ("session", "parameter"),
        "log_steps": ("traverse",), "steps": ("traverse",),
        "law": ("traverse",),
    }  # fmt: skip
    coordinates = {
        "parameter": list(sample.names),
        "session": [str(session) for session in sample.traverses.groups.table["session"]],
        "traverse": sample.traverses.rows.index.to_numpy(),
    }
    used = {name for column in columns for name in beyond.get(column, ())}
    per_chain = len(next(iter(columns.values()))) // chains
    return Dataset(
        {
            name: (("chain", "draw", *beyond.get(name, ())), column.reshape(chains, -1, *column.shape[1:]))
            for name, column in columns.items()
        },
        coords={"chain": np.arange(chains), "draw": np.arange(per_chain) if draws is None else draws}
        | {name: coordinates[name] for name in coordinates if name in used},
    )
