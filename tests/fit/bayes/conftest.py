"""One joint and direction with known truth, and a law that is exactly linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.fit.bayes.backend import in_memory
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.sample import sample
from stickslip_fit.fit.bayes.traverses import lay_out
from stickslip_fit.laws import Prismatic
from stickslip_fit.simulate.counts import simulate_counts

Q2, THETA = (
    np.radians([-90.0, 0.0, 0.0, -45.0, -135.0, -60.0]),
    np.radians([0.0, -90.0, 0.0, 0.0, 0.0, -45.0]),
)


class LinearLaw(Prismatic):
    """log(steps) = 9 + x1 p1 + x2 p2 + x3 p3, with the columns q2, theta and psi for x."""

    def model(self, rows):
        design = np.stack([np.asarray(rows[name], float) for name in ("q2", "theta", "psi")], axis=-1)
        return lambda values: (9.0 + np.sum(design * values, axis=1), design)


@pytest.fixture(scope="session")
def tight_prior():
    """A prior of the prismatic joint from which truths may be drawn: no joint stalls under it."""
    return Prior(
        names=("a", "b", "c"),
        units=("nm", "1", "nm"),
        centre=np.array([970e-9, 0.3, 430e-9]),
        width=np.array([40e-9, 0.04, 40e-9]),
        spread=np.array([15e-9, 0.01, 15e-9]),
        repeatability=0.003,
        spread_factor=1.8,
        repeatability_factor=1.5,
    )


@pytest.fixture(scope="session")
def traverses_of():
    """A maker of one direction's traverses: as many sessions as sets of parameters, counted with noise."""

    def make(parameters, repeatability, rng, replicates=2):
        sessions = np.repeat(np.arange(len(parameters)), replicates * len(Q2))
        rows = pd.DataFrame(
            {
                "session": [f"day {day + 1}" for day in sessions],
                "direction": "+",
                "q2": np.tile(Q2, replicates * len(parameters)),
                "theta": np.tile(THETA, replicates * len(parameters)),
                "psi": 0.0,
                "start": 0.0,
                "stop": 0.012,
                "check_every": 5,
            }
        )
        rows["steps"] = simulate_counts(Prismatic(), rows, parameters[sessions], repeatability, rng)
        return lay_out(Prismatic(), rows)

    return make


@pytest.fixture(scope="session")
def linear_traverses():
    """Three sessions under a law that is exactly linear, with rounding that differs from row to row."""
    rng = np.random.default_rng(1)
    sizes = (7, 4, 5)
    rows = pd.DataFrame({name: rng.normal(size=sum(sizes)) for name in ("q2", "theta", "psi")})
    rows["session"], rows["direction"] = np.repeat(["x", "y", "z"], sizes), "+"
    rows["start"], rows["stop"], rows["check_every"], rows["steps"] = 0.0, 0.012, 5, 9000
    laid_out = lay_out(LinearLaw(), rows)
    rounding = rng.uniform(1e-4, 4e-3, sum(sizes)) ** 2
    return replace(laid_out, y=9.0 + rng.normal(scale=0.02, size=sum(sizes)), rounding=rounding)


@pytest.fixture(scope="session")
def linear_prior():
    return Prior(
        names=("p", "q", "r"),
        units=("1", "1", "1"),
        centre=np.array([0.01, -0.02, 0.0]),
        width=np.array([0.03, 0.05, 0.02]),
        spread=np.array([0.01, 0.02, 0.03]),
        repeatability=0.01,
    )


@pytest.fixture(scope="session")
def fitted():
    """A quick fit of one joint and direction."""

    def fit(traverses, prior, seed=0, target_ess=400, max_steps=150):
        return sample(
            traverses, prior, in_memory(), seed=(seed,), target_ess=target_ess, max_steps=max_steps,
            on_step=lambda steps: None,
        )  # fmt: skip

    return fit
