"""From posterior draws to a Result (means, covariances, quantiles, flags) and to an ArviZ DataTree."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.bayes.marginal import PosteriorDraws
from stickslip_fit.bayes.sampler import K_HAT_LIMIT, PosteriorSample
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.estimation import Flag, JointFit, NoiseLevel, Result
from stickslip_fit.estimation._groups import group_rows
from stickslip_fit.estimation.identifiability import (
    configuration_rows,
    describe_configuration,
    identifiable_parameters,
)
from stickslip_fit.estimation.noise import COVERAGE
from stickslip_fit.estimation.result import ALL_JOINTS, build_provenance
from stickslip_fit.estimation.reweighting import flag_outliers
from stickslip_fit.estimation.travel import driven_stretches
from stickslip_fit.laws import observed_count
from stickslip_fit.logs import Log
from stickslip_fit.machine import Machine

if TYPE_CHECKING:
    from xarray import Dataset, DataTree

# Of arrays with a number for each traverse and draw, these many are kept.
MAX_POINTWISE_DRAWS, MAX_POINTWISE_NUMBERS = 500, 10_000_000


def group_name(joint: int, direction: str) -> str:
    """Name of a joint and direction in the tree.

    Examples
    --------
    >>> group_name(3, "-")
    'joint_3_minus'
    """
    return f"joint_{joint}_{'plus' if direction == '+' else 'minus'}"


def build_datatree(samples: Mapping[tuple[int, str], PosteriorSample], rng: np.random.Generator) -> DataTree:
    """The tree of all joints and directions."""
    from xarray import DataTree

    leaves = {
        f"/{group_name(joint, direction)}/{group}": dataset
        for (joint, direction), sample in samples.items()
        for group, dataset in _group_datasets(sample, rng).items()
    }
    return DataTree.from_dict(leaves)


def _group_datasets(sample: PosteriorSample, rng: np.random.Generator) -> dict[str, Dataset]:
    """The groups of one joint and direction; all in SI.

    posterior and prior (mean and spread of the campaign, repeatability, and each session's parameters),
    sample_stats, log_likelihood, observed_data, posterior_predictive and prior_predictive: counts, log
    steps by the law without noise, and the repeatability; NaN where the joint stalls.
    """
    from xarray import Dataset

    draws, chains, traverses = sample.draws, sample.ensembles, sample.traverses
    per_chain = len(draws) // chains
    every = max(
        per_chain * chains // MAX_POINTWISE_DRAWS,
        int(np.ceil(len(draws) * len(sample.traverses.y) / MAX_POINTWISE_NUMBERS)),
        1,
    )
    kept = np.arange(per_chain)[::every]
    some = draws.select((np.arange(chains)[:, None] * per_chain + kept).ravel())
    expected = sample.traverses.predict(some.parameters)
    posterior = {name: getattr(draws, name) for name in PosteriorDraws.__annotations__}
    stats = {"lp": sample.log_density, "log_weight": sample.log_weight}
    variance = some.repeatability[:, None] ** 2 + sample.traverses.rounding
    squares = (sample.traverses.y - expected) ** 2 / variance
    pointwise = -0.5 * (squares + np.log(2 * np.pi * variance))
    predictive = _predictive_draws(sample, expected, some.repeatability, rng)
    return {
        "posterior": _build_dataset(sample, posterior, chains),
        "sample_stats": _build_dataset(sample, stats, chains),
        "log_likelihood": _build_dataset(sample, {"log_steps": pointwise}, chains, kept),
        "posterior_predictive": _build_dataset(sample, predictive, chains, kept),
        **_prior_draws(sample, len(some), rng),
        "observed_data": Dataset(
            {
                "log_steps": ("traverse", traverses.y),
                "steps": ("traverse", traverses.rows["steps"].to_numpy()),
            },
            coords={"traverse": traverses.rows.index.to_numpy()},
        ),
    }


def _predictive_draws(
    sample: PosteriorSample, expected: Array, repeatability: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Counts as observed, log steps by the law without noise, and the noise's standard deviation."""
    steps = np.exp(expected + repeatability[:, None] * rng.standard_normal(expected.shape))
    stalled = ~np.isfinite(steps)
    counts = observed_count(np.where(stalled, 1.0, steps), sample.traverses.rows["check_every"])
    return {"steps": np.where(stalled, np.nan, counts), "law": expected, "repeatability": repeatability}


def _prior_draws(sample: PosteriorSample, size: int, rng: np.random.Generator) -> dict[str, Dataset]:
    mean, spread, repeatability = sample.draw_prior(size, rng)
    sessions = len(sample.traverses.groups)
    noise = rng.standard_normal((size, sessions, mean.shape[1]))
    parameters = mean[:, None] + spread[:, None] * noise
    predictive = _predictive_draws(sample, sample.traverses.predict(parameters), repeatability, rng)
    prior = {"mean": mean, "spread": spread, "repeatability": repeatability, "parameters": parameters}
    return {
        "prior": _build_dataset(sample, prior, 1),
        "prior_predictive": _build_dataset(sample, predictive, 1),
    }


def _build_dataset(
    sample: PosteriorSample, columns: dict[str, Array], chains: int, draws: npt.NDArray[np.intp] | None = None
) -> Dataset:
    from xarray import Dataset

    dimensions: dict[str, tuple[str, ...]] = dict.fromkeys(("log_steps", "steps", "law"), ("traverse",))
    dimensions |= {"mean": ("parameter",), "spread": ("parameter",), "parameters": ("session", "parameter")}
    coordinates = {
        "parameter": list(sample.names),
        "session": [str(session) for session in sample.traverses.groups.table["session"]],
        "traverse": sample.traverses.rows.index.to_numpy(),
    }
    used = {name for column in columns for name in dimensions.get(column, ())}
    per_chain = len(next(iter(columns.values()))) // chains
    return Dataset(
        {
            name: (
                ("chain", "draw", *dimensions.get(name, ())),
                column.reshape(chains, -1, *column.shape[1:]),
            )
            for name, column in columns.items()
        },
        coords={"chain": np.arange(chains), "draw": np.arange(per_chain) if draws is None else draws}
        | {name: coordinates[name] for name in coordinates if name in used},
    )


FEW_REPLICATES = (
    "no traverse is repeated to show how much one scatters, so the repeatability, and with it every "
    "interval, leans on the prior; make each calibration traverse twice"
)
MAX_POSTERIOR_SD = 0.8  # standard deviations of the prior; wider, the data tell nothing


def flag_sample(
    sample: PosteriorSample, machine: Machine, direction: str, values: Array
) -> tuple[list[Flag], BoolArray]:
    """Flags of one joint and direction, and which parameters its log determines, shape (p,).

    `values`, shape (S, p), are the posterior means.
    """
    slopes = sample.traverses.law.jacobian(sample.traverses.rows, values[sample.traverses.groups.of_row])
    known, *_ = identifiable_parameters((slopes.T @ slopes)[None], sample.prior.width[None])
    flags = _flag_not_converged(sample, direction)
    if not known.all():
        flags.append(_flag_not_identified(sample, machine, direction, slopes, known[0]))
    # The sum of the ranks of the sessions, each by itself.
    padded = sample.traverses.pad(slopes * sample.prior.width, 0.0)
    if len(slopes) <= int(np.linalg.matrix_rank(padded, tol=1e-4).sum()):
        flags.append(_build_flag("few_replicates", sample, direction, FEW_REPLICATES))
    return flags, known[0]


def identifiable_causes(sample: PosteriorSample) -> BoolArray:
    """Which parameters of causes the log knows better than the prior, or are fixed; shape (q,)."""
    if sample.causes is None:
        return np.zeros(0, dtype=bool)
    eta = sample.causes.standardize(sample.draws.mean[:, len(sample.prior.names) :])
    return eta.std(axis=0) < MAX_POSTERIOR_SD


def flag_cause_parameters(sample: PosteriorSample) -> list[Flag]:
    """Flags of the causes' parameters, once for all joints."""
    if sample.causes is None or not sample.converged:
        return []
    law, flags = sample.traverses.law, []
    assert isinstance(law, ExtendedLaw)
    causes = [cause for cause in law.causes for _ in cause.parameters]
    free, known = sample.causes.free, identifiable_causes(sample)
    for k, (name, prior) in enumerate(sample.causes.describe()):
        if not free[k]:
            text = f"{name} is {prior}, where least squares chose it; it has no error bar"
            flags.append(Flag("chosen", ALL_JOINTS, "", "", (name,), text))
        elif not known[k]:
            text = f"{name} would be what the prior says, {prior}; what would show it: {causes[k].shows_best}"
            flags.append(Flag("not_identified", ALL_JOINTS, "", "", (name,), text))
    return flags


def _flag_not_converged(sample: PosteriorSample, direction: str) -> list[Flag]:
    if sample.converged:
        return []
    worst = sample.quality
    k_hat, largest_r_hat, size = worst["k_hat"].max(), worst["r_hat"].max(), worst["ess_bulk"].min()
    if sample.weights_reliable:
        what = (
            f"the ensembles have too few effective draws after {sample.steps} steps each (R-hat "
            f"{largest_r_hat:.3f}, {size:.0f} effective draws of {sample.target_ess}); allow more steps, and "
            "where that does not help use tighter priors or log more traverses"
        )
    else:
        what = (
            f"the importance weights are unreliable (k-hat {k_hat:.2f}, above {K_HAT_LIMIT}): the law is too "
            "nonlinear over the posterior; use tighter priors or log more traverses"
        )
    return [_build_flag("not_converged", sample, direction, f"{what}. No numbers are given")]


def _flag_not_identified(
    sample: PosteriorSample, machine: Machine, direction: str, slopes: Array, known: BoolArray
) -> Flag:
    """Names the calibration traverses that would show what no traverse of the log does."""
    law, prior = sample.traverses.law, sample.prior
    _, singular, right = np.linalg.svd(slopes * prior.width, full_matrices=True)
    singular = np.append(singular, np.zeros(len(right) - len(singular)))
    unseen = right[singular < 1e-4 * singular[0]]
    unknown = tuple(name for name, is_known in zip(prior.names, known, strict=True) if not is_known)
    what = f"{', '.join(unknown)} would be what the prior says, for no session has a traverse that tells"
    if not law.calibration():
        return _build_flag("not_identified", sample, direction, what, parameters=unknown)
    rows = configuration_rows(law.calibration(), law.joint, direction, machine)
    shown = np.abs(law.jacobian(rows, prior.centre) * prior.width @ unseen.T).max(axis=1) > 0.01
    wanted = [candidate for candidate, shows in zip(law.calibration(), shown, strict=True) if shows]
    missing = " or ".join(describe_configuration(configuration) for configuration in wanted)
    return _build_flag("not_identified", sample, direction, f"{what}; missing: {missing}", parameters=unknown)


def _build_flag(
    flag: str, sample: PosteriorSample, direction: str, what: str, parameters: tuple[str, ...] | None = None
) -> Flag:
    return Flag.at(flag, sample.traverses.law.joint, direction, "", parameters or sample.prior.names, what)


INTERVAL_QUANTILES = (0.5 - COVERAGE / 2, 0.5 + COVERAGE / 2)


def build_result(
    log: Log, samples: Mapping[tuple[int, str], PosteriorSample], seed: int, command: str
) -> Result:
    """The result of all joints and directions."""
    joints, residuals, flags = {}, [], []
    for joint in dict.fromkeys(joint for joint, _ in samples):
        both = {direction: sample for (other, direction), sample in samples.items() if other == joint}
        joints[joint], residual, joint_flags = _fit_joint(joint, both, log.machine)
        residuals.append(residual)
        flags += joint_flags
    flags += flag_cause_parameters(next(iter(samples.values())))
    result = Result(
        method="bayes",
        machine=log.machine,
        joints=joints,
        residuals=pd.concat(residuals).sort_index(),
        flags=tuple(flags),
        provenance=replace(build_provenance(log, command), seed=seed),
    )
    return flag_outliers(result, log)


def _fit_joint(
    joint: int, samples: Mapping[str, PosteriorSample], machine: Machine
) -> tuple[JointFit, pd.DataFrame, list[Flag]]:
    """One joint's fit from its directions' samples; also its residuals and flags."""
    law = next(iter(samples.values())).traverses.law
    rows = pd.concat([sample.traverses.rows[["session", "direction"]] for sample in samples.values()])
    table = group_rows(rows.sort_index()).table
    g, p = len(table), len(law.parameters)
    values, known = np.full((g, p), np.nan), np.zeros((g, p), dtype=bool)
    covariance, interval = np.full((g, p, p), np.nan), np.full((g, p, 2), np.nan)
    repeatability = {direction: NoiseLevel(np.nan, 0, "posterior") for direction in ("+", "-")}
    residuals, flags = [], []
    for direction, sample in samples.items():
        mean = sample.draws.parameters.mean(axis=0)
        predicted = law.predict(sample.traverses.rows, mean[sample.traverses.groups.of_row])
        residual = sample.traverses.y - predicted
        own_mean = mean[:, : len(sample.prior.names)]
        new_flags, identified = flag_sample(sample.without_causes(), machine, direction, own_mean)
        flags += new_flags
        if sample.converged:
            own = np.flatnonzero(table["direction"] == direction)
            values[own], known[own] = mean, np.append(identified, identifiable_causes(sample))
            departure = sample.draws.parameters - mean
            covariance[own] = np.einsum("dsi,dsj->sij", departure, departure) / (len(departure) - 1)
            quantiles = np.quantile(sample.draws.parameters, INTERVAL_QUANTILES, axis=0)
            interval[own] = np.moveaxis(quantiles, 0, -1)
            noise = sample.draws.repeatability
            df = 1.0 / (2.0 * float(np.var(np.log(noise))))  # of as wide a chi-square
            repeatability[direction] = NoiseLevel(float(noise.mean()), max(round(df), 1), "posterior")
        else:
            residual = np.full_like(residual, np.nan)
        columns = {"joint": joint, "residual": residual, "used": True}
        residuals.append(pd.DataFrame(columns, index=sample.traverses.rows.index))
    travel = driven_stretches(pd.concat([sample.traverses.rows for sample in samples.values()]))
    fit = JointFit(law, table, values, known, covariance, interval, repeatability, travel=travel)
    return fit, pd.concat(residuals), flags
