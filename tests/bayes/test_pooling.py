"""Sessions drawn together, beside the best linear prediction by one who knows what differs between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.bayes.pooling import pool_sessions
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws.physical import FRICTION_LIMITED, physical_law_with
from tests.hidden.stage import Stage, drive_stage

ANYTHING = 0.5  # standard deviation of the logarithm of a parameter of which nothing is known
SEEDS = range(200, 206)


def guide(seed, folder):
    """Joint 3 of a log whose friction is another each day; the traverses, and where they are."""
    hidden = drive_stage("many", Stage("friction"), seed=seed)
    hidden.write(folder / "log.csv")
    log = ssf.read_log(folder / "log.csv")
    (place,) = (one for one in hidden.campaign.places if one.joint == 3)
    return log, log.usable[log.usable["joint"] == 3], place, hidden.campaign


def best_linear_error(campaign, place, direction):
    """Expected rms error of log counts where only the friction of each day is unknown beside the stage."""

    def log_counts(name, share):
        moved = replace(place, values={**place.values, name: place.values[name] * (1 + share)})
        return np.log(moved.counts(moved.step_size()))

    own = (place.forward.ravel() > 0) == (direction == "+")
    slopes = {name: (log_counts(name, 1e-4) - log_counts(name, -1e-4))[own] / 2e-4 for name in place.values}
    day = campaign.plan.session[place.rows][own]
    by_day = slopes["friction"][:, None] * (day[:, None] == np.unique(day))
    columns = np.column_stack([*slopes.values(), by_day])
    sd = np.r_[np.full(len(slopes), ANYTHING), np.full(by_day.shape[1], Stage().day_to_day)]
    noise = campaign.repeatability[place.rows][own]
    information = columns.T @ (columns / noise[:, None] ** 2) + np.diag(1 / sd**2)
    return np.sqrt(np.mean(np.sum(columns * np.linalg.solve(information, columns.T).T, axis=1)))


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """Rms errors of log counts: drawn together, each session alone, and best; shape (logs, 3)."""
    found = []
    for seed in SEEDS:
        log, rows, place, campaign = guide(seed, tmp_path_factory.mktemp("log"))
        law = physical_law_with(3, rows, log.machine, (FRICTION_LIMITED, FRICTION_LIMITED))
        fit = fit_joint(law, rows, log.machine)[0]
        true = np.log(campaign.counts[place.rows])
        alone = law.predict(rows, fit.values[fit.group_index(rows)]) - true
        for direction in "+-":
            own = (rows["direction"] == direction).to_numpy()
            pooled = pool_sessions(law, rows[own]).loc[rows["session"][own]].to_numpy()
            together = law.predict(rows[own], pooled) - true[own]
            rms = [np.sqrt(np.mean(error**2)) for error in (together, alone[own])]
            found.append([*rms, best_linear_error(campaign, place, direction)])
    return np.sqrt(np.mean(np.square(found), axis=0))


def test_sessions_drawn_together_err_little_more_than_at_best(errors):
    together, alone, best = errors
    # Drawn together by variances without covariances, 1.36 times.
    assert together < 1.25 * best
    assert alone > 1.5 * best


def test_a_log_without_noise_is_met(tmp_path):
    log, rows, *_ = guide(210, tmp_path)
    law = physical_law_with(3, rows, log.machine, (FRICTION_LIMITED, FRICTION_LIMITED))
    values = np.array([950e-9, 0.3, 0.2])
    rows = rows[rows["direction"] == "+"]
    exact = rows.assign(steps=np.exp(law.predict(rows, values)) + rows["check_every"] / 2)
    every = np.tile(values, (exact["session"].nunique(), 1))
    assert pool_sessions(law, exact).to_numpy() == pytest.approx(every)
