"""One joint and direction with known truth under each published law, and a law that is exactly linear."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.bayes import Prior
from stickslip_fit.bayes.priors import build_group_data
from stickslip_fit.bayes.sampler import memory_backends, sample_posterior
from stickslip_fit.laws import Base, Elbow, Prismatic, StepLaw, observed_count
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import expected_counts


def simulate_counts(law, rows, values, repeatability, rng):
    """Counts with noise, rounded up to the next check of the end stop."""
    steps = expected_counts(law, rows, values) * np.exp(repeatability * rng.standard_normal(len(rows)))
    return observed_count(steps, rows["check_every"])


@dataclass(frozen=True)
class Case:
    """A law, a tight prior from which truths may be drawn (no joint stalls under it), and a day's traverses.

    `to_come` is a traverse that no session makes.
    """

    law: StepLaw
    prior: Prior
    day: pd.DataFrame
    to_come: pd.DataFrame

    def traverses(self, parameters, repeatability, rng, replicates=2):
        """One direction's traverses: as many sessions as sets of parameters, counted with noise."""
        one_day = pd.concat([self.day] * replicates)
        rows = pd.concat(
            [one_day.assign(session=f"day {day + 1}") for day in range(len(parameters))], ignore_index=True
        )
        own = np.repeat(parameters, len(one_day), axis=0)
        rows["steps"] = simulate_counts(self.law, rows, own, repeatability, rng)
        return build_group_data(self.law, rows)


def table(columns, start, stop, **angles):
    """Traverses in `+`; angles in degrees, lengths in m."""
    rows = pd.DataFrame(columns | {name: np.radians(column) for name, column in angles.items()})
    return rows.assign(direction="+", start=start, stop=stop, check_every=5)


def prismatic_case():
    prior = Prior(
        names=("a", "b", "c"),
        units=("nm", "1", "nm"),
        centre=np.array([970e-9, 0.3, 430e-9]),
        width=np.array([40e-9, 0.04, 40e-9]),
        spread=np.array([15e-9, 0.01, 15e-9]),
        repeatability=0.003,
        spread_factor=1.8,
        repeatability_factor=1.5,
    )
    day = table(
        {}, 0.0, 0.012,
        q2=[-90, 0, 0, -45, -135, -60], theta=[0, -90, 0, 0, 0, -45], psi=[0, 0, 0, 0, 0, 0],
    )  # fmt: skip
    to_come = table({}, 0.0, 0.012, q2=[-20], theta=[-10], psi=[15])
    return Case(Prismatic(), prior, day, to_come)


def elbow_case():
    prior = Prior(
        names=("gamma0_q3_0", "gamma0_q3_12", "d_q3_0", "d_q3_12"),
        units=("µrad",) * 4,
        centre=np.array([95e-6, 90e-6, -15e-6, -20e-6]),
        width=np.array([4e-6, 4e-6, 4e-6, 4e-6]),
        spread=np.array([1.5e-6, 1.5e-6, 1.5e-6, 1.5e-6]),
        repeatability=0.003,
        spread_factor=1.8,
        repeatability_factor=1.5,
    )
    start, stop = np.radians([-210, -210, -210, -210, -120, -60]), np.radians([30, 30, 30, 30, -60, 0])
    day = table(
        {"q3": [0.0, 0.012, 0.0, 0.012, 0.006, 0.006]}, start, stop,
        theta=[-90, -90, 0, 0, 0, 0], psi=[0, 0, 0, 0, 0, 0],
    )  # fmt: skip
    to_come = table({"q3": [0.004]}, np.radians(-150), np.radians(-30), theta=[-20], psi=[15])
    return Case(Elbow(load_machine()), prior, day, to_come)


def base_case():
    prior = Prior(
        names=("gamma0_reach_0", "gamma0_per_mm", "d_reach_0", "d_per_mm"),
        units=("µrad", "µrad/mm", "µrad", "µrad/mm"),
        centre=np.array([97e-6, -0.05e-3, -1e-6, -0.35e-3]),
        width=np.array([4e-6, 0.1e-3, 3e-6, 0.08e-3]),
        spread=np.array([1.5e-6, 0.03e-3, 1e-6, 0.03e-3]),
        repeatability=0.003,
        spread_factor=1.8,
        repeatability_factor=1.5,
    )
    day = table(
        {"q3": [0.0, 0.012, 0.0, 0.012, 0.006, 0.006]}, np.radians(-120), np.radians(120),
        q2=[-90, -90, -90, -90, -45, -45], theta=[0, 0, -90, -90, 0, -60], psi=[0, 0, 0, 0, 0, 0],
    )  # fmt: skip
    to_come = table({"q3": [0.004]}, np.radians(-60), np.radians(30), q2=[-70], theta=[-30], psi=[15])
    return Case(Base(load_machine()), prior, day, to_come)


@pytest.fixture(scope="session")
def cases():
    return {"prismatic": prismatic_case(), "elbow": elbow_case(), "base": base_case()}


class LinearLaw(Prismatic):
    """log(steps) = 9 + x1 p1 + x2 p2 + x3 p3, with the columns q2, theta and psi for x."""

    def model(self, rows):
        design = np.stack([np.asarray(rows[name], float) for name in ("q2", "theta", "psi")], axis=-1)
        return lambda values: (9.0 + np.sum(design * values, axis=1), design)


@pytest.fixture(scope="session")
def tight_prior(cases):
    return cases["prismatic"].prior


@pytest.fixture(scope="session")
def traverses_of(cases):
    return cases["prismatic"].traverses


@pytest.fixture(scope="session")
def linear_traverses():
    """Three sessions under a law that is exactly linear, with rounding that differs from row to row."""
    rng = np.random.default_rng(1)
    sizes = (7, 4, 5)
    rows = pd.DataFrame({name: rng.normal(size=sum(sizes)) for name in ("q2", "theta", "psi")})
    rows["session"], rows["direction"] = np.repeat(["x", "y", "z"], sizes), "+"
    rows["start"], rows["stop"], rows["check_every"], rows["steps"] = 0.0, 0.012, 5, 9000
    data_by_group = build_group_data(LinearLaw(), rows)
    rounding = rng.uniform(1e-4, 4e-3, sum(sizes)) ** 2
    return replace(data_by_group, y=9.0 + rng.normal(scale=0.02, size=sum(sizes)), rounding=rounding)


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
        return sample_posterior(
            traverses, prior, memory_backends(), seed=(seed,), target_ess=target_ess, max_steps=max_steps,
            on_step=lambda steps: None,
        )  # fmt: skip

    return fit
