"""Held-out errors at best: of one who knows the true law, in logs that a stage drives friction-limited.

Each configuration is left out in turn. Linearized about the truth, with the noise known, errors are expected
of three: each session and direction calibrated anew by weighted least squares; sessions drawn together by
what differs between them in truth; and the same by one who also knows from which range each quantity of the
stage was drawn, beyond which no estimate can be better.

``python -m tests.hidden.law_optimum --logs 10 --first 40000`` prints them over the noise;
benchmarks/README.md quotes them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tests.hidden.campaign import Campaign, make_campaign
from tests.hidden.physics import Array, Place
from tests.hidden.stage import Stage

DESIGNS = ("session", "thesis", "many")
ESTIMATES = ("each session alone", "sessions drawn together", "ranges of the stage known")
STEP, RANK = 1e-4, 1e-6
DRAWS, ANYTHING = 4000, 10.0  # of a stage; standard deviation of the logarithm of what is not known
MAX_SPREAD = 2.0  # variance of a prediction over that of the noise, beyond which nothing is predicted
DAILY = ("friction", "throw")
GIVEN = "lever"  # by the machine


def optimum(campaign: Campaign, place: Place, stage: Stage) -> Array:
    """Expected rms errors over the noise of one joint, as `ESTIMATES`, shape (3,)."""
    session, configuration = campaign.plan.session[place.rows], campaign.plan.configuration()[place.rows]
    sd, forward = campaign.repeatability[place.rows], place.forward.ravel() > 0
    names = [name for name in place.values if name != GIVEN]
    slopes, spread = _slopes(place, names), np.full((3, len(sd)), np.nan)
    for way in (True, False):
        own = np.flatnonzero(forward == way)
        known = _covariance(stage, place.joint, 1 if way else -1, names)
        daily = [
            slopes[own, names.index(name), None] * (session[own, None] == np.unique(session))
            for name in DAILY
        ]
        columns = np.concatenate([slopes[own], *daily], axis=1) / sd[own, None]
        changes = np.full(columns.shape[1] - len(names), stage.day_to_day**2)
        nothing = np.full(len(names), ANYTHING**2)
        priors = [np.diag(np.r_[nothing, changes]), np.diag(np.r_[nothing, changes])]
        priors[1][: len(names), : len(names)] = known
        for each in np.unique(configuration[own]):
            out = configuration[own] == each
            for k, prior in enumerate(priors, start=1):
                spread[k, own[out]] = _variance(columns[~out], columns[out], prior)
            for day in np.unique(session[own][out]):
                today = session[own] == day
                training, test = own[~out & today], own[out & today]
                spread[0, test] = _least_squares(
                    slopes[training] / sd[training, None], slopes[test], slopes[own]
                )
                spread[0, test] /= sd[test] ** 2
    predicted = spread[0] < MAX_SPREAD
    noise = np.mean(sd[predicted] ** 2)
    return np.sqrt(np.mean((sd**2 * (1 + spread))[:, predicted], axis=1) / noise)


def _slopes(place: Place, names: Sequence[str]) -> Array:
    """Change of each log count with the logarithm of each quantity, by central differences."""

    def log_counts(name: str, share: float) -> Array:
        moved = replace(place, values={**place.values, name: place.values[name] * (1 + share)})
        return np.log(moved.counts(moved.step_size()))

    slopes = [(log_counts(name, STEP) - log_counts(name, -STEP)) / (2 * STEP) for name in names]
    return np.stack(slopes, axis=1)


def _covariance(stage: Stage, joint: int, way: int, names: Sequence[str]) -> Array:
    """Of the logarithms of a drive's quantities, over stages."""
    rng = np.random.default_rng(1)
    drawn = [stage.usual(joint, way, rng) for _ in range(DRAWS)]
    return np.cov(np.log([[one[name] for name in names] for one in drawn]).T)


def _variance(training: Array, test: Array, prior: Array) -> Array:
    """Variance of predictions over that of the noise, of whitened rows."""
    gain = prior @ training.T
    left = prior - gain @ np.linalg.solve(np.eye(len(training)) + training @ gain, gain.T)
    return np.einsum("ni,ij,nj->n", test, left, test)


def _least_squares(training: Array, test: Array, every: Array) -> Array:
    """Variance of predictions; infinite unless the training determines all that any row depends on."""
    _, size, right = np.linalg.svd(every, full_matrices=False)
    basis = right[size > RANK * size[0]].T
    inside = training @ basis
    if np.linalg.matrix_rank(inside, RANK * np.linalg.norm(inside)) < basis.shape[1]:
        return np.full(len(test), np.inf)
    return np.sum(np.linalg.lstsq(inside.T, (test @ basis).T, rcond=None)[0] ** 2, axis=0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    stage = Stage("friction")
    for design in DESIGNS:
        found: dict[int, list[Array]] = {1: [], 2: [], 3: []}
        for seed in range(arguments.first, arguments.first + arguments.logs):
            campaign = make_campaign(design, "gaussian", seed, nature=stage)
            for place in campaign.places:
                found[place.joint].append(optimum(campaign, place, stage))
        for joint, errors in found.items():
            text = ", ".join(
                f"{name} {x:.3f}" for name, x in zip(ESTIMATES, np.mean(errors, axis=0), strict=True)
            )
            print(f"{design}, joint {joint}: {text}", flush=True)
