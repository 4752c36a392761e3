"""Held-out errors of two laws of one joint, one configuration or, of many, a fiftieth left out at a time.

Each law is fitted to all other configurations and predicts the one left out. Where there are several
sessions, each is drawn to their mean by as much as they differ (`bayes.pooling`), since the configurations
of one leave much of its parameters open. Lambda of the physical law is chosen anew each time where
configurations are few. Configurations, not traverses, are resampled for the intervals, for what a law gets
wrong in one it gets wrong in every replicate (B. Efron and R. Tibshirani, An Introduction to the Bootstrap,
Chapman & Hall, 1993).
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.bayes.pooling import pool_sessions
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._problem import DEFAULT_OPTIONS, single_problem
from stickslip_fit.estimation.drive_ratio import RatioProfile, likeliest_law, profile_ratio
from stickslip_fit.estimation.identifiability import identifiable_parameters
from stickslip_fit.laws import FRICTION_LIMITED, StepLaw, published_law
from stickslip_fit.logs.log import number_configurations
from stickslip_fit.machine import Machine

MIN_CONFIGURATIONS = 5  # of which fewer say nothing of the error in another
MAX_SPREAD = 2.0  # variance of a prediction over that of the noise; beyond, it is no test of a law
MANY = 20  # configurations; one of more has no say in lambda, which then is that of all
MAX_PARTS = 50  # more configurations are left out several at a time
LIKELY = 0.05
RESAMPLES = 2000


@dataclass(frozen=True)
class ErrorEstimate:
    """Rms of held-out errors of log(steps), and its interval of 95 %."""

    rms: float
    low: float
    high: float


@dataclass(frozen=True)
class HeldOutComparison:
    """Errors of both laws on the same held-out traverses.

    Attributes
    ----------
    configurations, traverses : int
        Held out and predicted by both laws.
    published, physical : ErrorEstimate
    log_ratio : tuple of float
        Interval of 95 % of the logarithm of the published law's rms error over the physical law's.
    """

    configurations: int
    traverses: int
    published: ErrorEstimate
    physical: ErrorEstimate
    log_ratio: tuple[float, float]

    @property
    def better(self) -> str:
        """``published``, ``physical``, or empty where the log cannot tell."""
        if self.configurations < MIN_CONFIGURATIONS:
            return ""
        low, high = self.log_ratio
        return "physical" if low > 0 else "published" if high < 0 else ""


def compare_held_out(
    joint: int, rows: pd.DataFrame, machine: Machine, profiles: Mapping[str, RatioProfile]
) -> HeldOutComparison:
    """Errors of the published and the physical law.

    Parameters
    ----------
    rows : DataFrame
        Usable traverses of the joint.
    profiles : mapping of str to RatioProfile
        By direction, of all traverses: without a configuration, lambda is looked for where it is likely here.
    """
    published = published_law(joint, rows, machine)
    configuration = number_configurations(rows, published.features(rows))
    candidates = _candidates(profiles)
    errors = np.full((2, len(rows)), np.nan)
    number = int(configuration.max()) + 1
    part_of = np.random.default_rng(0).permutation(number) % MAX_PARTS
    for part in range(min(number, MAX_PARTS)):
        out = part_of[configuration] == part
        training, test = rows[~out], rows[out]
        if training.empty:
            continue
        found = profiles
        if configuration.max() < MANY:
            found = profile_ratio(joint, training, machine, candidates, 0)
        physical = likeliest_law(joint, rows, machine, found)
        for k, law in enumerate((published, physical)):
            errors[k, out] = predict_held_out(law, training, test)
    usable = np.all(np.isfinite(errors), axis=0)
    return _summarize(errors[:, usable], configuration[usable])


def predict_held_out(law: StepLaw, training: pd.DataFrame, test: pd.DataFrame) -> Array:
    """Errors of log(steps), shape (n,); NaN where the training cannot predict."""
    problem = single_problem(law, training, DEFAULT_OPTIONS)
    minimum = problem.minimize(np.ones(len(training)), problem.start)
    _, rank, covariance = identifiable_parameters(minimum.curvature, problem.scales)
    table = problem.groups.table
    index = {key: k for k, key in enumerate(zip(table["session"], table["direction"], strict=True))}
    keys = zip(test["session"].astype(object), test["direction"].astype(object), strict=True)
    group = np.array([index.get(key, -1) for key in keys])
    response, slopes = law.model(test)(_draw_together(minimum.values, table, law, training)[group])
    spread = np.einsum("ni,nij,nj->n", slopes, covariance[group], slopes)
    known = (group >= 0) & (rank[group] == len(law.parameters)) & (spread < MAX_SPREAD)
    return np.where(known, law.response(test)[0] - response, np.nan)


def _draw_together(values: Array, table: pd.DataFrame, law: StepLaw, rows: pd.DataFrame) -> Array:
    """Parameters of each session and direction of a table, those of several sessions drawn together."""
    values = values.copy()
    for direction, own in rows.groupby("direction", observed=True):
        if own["session"].nunique() > 1:
            place = (table["direction"] == direction).to_numpy()
            with suppress(InputError):
                values[place] = pool_sessions(law, own).loc[table["session"][place]]
    return values


def _candidates(profiles: Mapping[str, RatioProfile]) -> list[float]:
    """The likeliest lambda in either direction, and the ends of what is likely."""
    chosen: set[float] = set()
    for profile in profiles.values():
        likely = profile.ratios[(profile.likelihood > LIKELY) & (profile.ratios < FRICTION_LIMITED)]
        chosen |= {float(ratio) for ratio in likely[[0, -1]]} if len(likely) else set()
        chosen.add(profile.best)
    return sorted(chosen)


def _summarize(errors: Array, configuration: IntArray) -> HeldOutComparison:
    kinds, of_row = np.unique(configuration, return_inverse=True)
    if not len(kinds):
        nothing = ErrorEstimate(np.nan, np.nan, np.nan)
        return HeldOutComparison(0, 0, nothing, nothing, (-np.inf, np.inf))
    squares = np.array([np.bincount(of_row, error**2) for error in errors])
    sizes = np.bincount(of_row)
    drawn = np.random.default_rng(0).multinomial(len(kinds), np.full(len(kinds), 1 / len(kinds)), RESAMPLES)
    mean = squares @ drawn.T / (drawn @ sizes)
    ends = np.sqrt(np.quantile(mean, [0.025, 0.975], axis=1))
    rms = np.sqrt(squares.sum(axis=1) / sizes.sum())
    published, physical = (ErrorEstimate(float(rms[k]), *map(float, ends[:, k])) for k in (0, 1))
    low, high = np.quantile(np.log(mean[0] / mean[1]) / 2, [0.025, 0.975])
    return HeldOutComparison(len(kinds), int(sizes.sum()), published, physical, (float(low), float(high)))
