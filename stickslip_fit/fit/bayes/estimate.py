"""The hierarchical fit of a log, joint by joint and direction by direction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from stickslip_fit.causes import Cause
from stickslip_fit.fit.bayes.backend import in_file, in_memory
from stickslip_fit.fit.bayes.means import result_of
from stickslip_fit.fit.bayes.posterior import Posterior
from stickslip_fit.fit.bayes.priors import Priors, weak_priors
from stickslip_fit.fit.bayes.sample import Sample, sample
from stickslip_fit.fit.bayes.together import sample_together
from stickslip_fit.fit.bayes.traverses import each_group
from stickslip_fit.fit.bayes.tree import branch_name, plant
from stickslip_fit.fit.progress import bar
from stickslip_fit.logs import Log


def bayes(
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
        with bar(progress, desc="all joints", unit=" steps") as shown:
            samples, priors = sample_together(
                log, causes, priors, seed=seed, target_ess=target_ess, max_steps=max_steps,
                backend=backend, on_step=shown.update,
            )  # fmt: skip
    else:
        samples = _one_by_one(log, priors, seed, target_ess, max_steps, backend, progress)
    tables = [
        found.quality.assign(joint=joint, direction=direction)
        for (joint, direction), found in samples.items()
    ]
    diagnostics = pd.concat(tables, ignore_index=True)
    diagnostics = diagnostics[["joint", "direction", *diagnostics.columns.drop(["joint", "direction"])]]
    result = result_of(log, samples, seed, command)
    return Posterior(result, plant(samples, np.random.default_rng(seed)), priors, diagnostics)


def _one_by_one(
    log: Log,
    priors: Priors,
    seed: int,
    target_ess: int,
    max_steps: int,
    backend: str | Path | None,
    progress: bool,
) -> dict[tuple[int, str], Sample]:
    """Joints and directions that nothing ties together."""
    samples = {}
    for joint, direction, traverses in each_group(log):
        prior, name = priors.prior(joint, direction), branch_name(joint, direction)
        walks = in_memory() if backend is None else in_file(backend, name, traverses, prior, seed)
        # Most walks end long before `max_steps`, so a share of it would mislead.
        with bar(progress, desc=f"joint {joint}, direction {direction}", unit=" steps") as shown:
            samples[joint, direction] = sample(
                traverses,
                prior,
                walks,
                seed=(seed, joint, int(direction == "-")),
                target_ess=target_ess,
                max_steps=max_steps,
                on_step=shown.update,
            )
    return samples
