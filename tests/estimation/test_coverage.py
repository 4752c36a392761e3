"""Intervals cover what they say: many campaigns that differ in nothing but their noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student_t

from stickslip_fit.estimation import fit_closed_form, fit_least_squares

REPEATABILITY = 0.0027
TRUTH = {
    (3, "+"): [976e-9, 0.30, 438e-9],
    (3, "-"): [903e-9, 0.27, -405e-9],
    (2, "+"): [95e-6, 90e-6, -15e-6, -19.85e-6],
    (2, "-"): [94e-6, 91e-6, 19.6e-6, 25.91e-6],
    (1, "+"): [97e-6, -0.05e-3, -1e-6, -0.35e-3],
    (1, "-"): [96e-6, -0.04e-3, 1.2e-6, 0.45e-3],
}


def noisy(log, expected, rng):
    """The campaign again, its counts drawn anew and seen at every fifth step."""
    steps = expected * np.exp(REPEATABILITY * rng.standard_normal(len(expected)))
    return replace(log, rows=log.rows.assign(steps=(np.ceil(steps / 5) * 5).astype(np.int64)))


def levels(result, fresh, expected):
    """The level at which each interval, of a parameter or of a predicted count, just reaches the truth."""
    parts, predictions = [], result.si.predict(fresh)
    off = np.abs(np.log(predictions["steps"] / expected) / predictions["relative_error"])
    predicted = np.empty(len(fresh))
    for joint, fit in result.joints.items():
        truth = np.array([TRUTH[joint, way] for way in fit.groups["direction"]])
        error = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
        df = np.array([fit.repeatability[way].df for way in fit.groups["direction"]])
        parts.append(level(np.abs(fit.values - truth) / error, df[:, None]).ravel())
        subset = (fresh["joint"] == joint).to_numpy()
        predicted[subset] = level(off[subset], df[fit.group_index(fresh[subset])])
    return np.concatenate(parts), predicted


def level(off, df):
    return 2 * student_t.cdf(off, df) - 1


def study(estimator, campaign, read_table, sessions, campaigns, seed):
    days = tuple(str(np.datetime64("2012-03-05") + np.timedelta64(index, "D")) for index in range(sessions))
    table = campaign(sessions=days, repeatability=0.0, check_every=1)
    expected = table["steps"].to_numpy(float)
    table["steps"], table["check_every"] = 5 * np.ceil(expected / 5).astype(int), 5
    log, rng = read_table(table), np.random.default_rng(seed)
    found = [levels(estimator(noisy(log, expected, rng)), log.usable, expected) for _ in range(campaigns)]
    return np.array([part for part, _ in found]), np.array([part for _, part in found])


@pytest.mark.slow
@pytest.mark.parametrize("estimator", [fit_closed_form, fit_least_squares])
@pytest.mark.parametrize(
    ("sessions", "campaigns", "seed"),
    [(3, 10, 1), *(pytest.param(sessions, 1000, 2, marks=pytest.mark.nightly) for sessions in (1, 3, 20))],
)
def test_intervals_cover(campaign, read_table, estimator, sessions, campaigns, seed):
    """Each parameter within the binomial error of the largest of so many; in the mean, also predictions.

    A campaign's intervals share its noise, so that the mean's error is the scatter from campaign to campaign.
    """
    parameters, predicted = study(estimator, campaign, read_table, sessions, campaigns, seed)
    for nominal in (0.95, 0.68):
        share = np.mean(parameters < nominal, axis=0)
        spread = np.sqrt(nominal * (1 - nominal) / campaigns)
        assert np.abs(share - nominal).max() < norm.ppf(1 - 0.0005 / parameters.shape[1]) * spread
        for levels in (parameters, predicted):
            inside = np.mean(levels < nominal, axis=1)
            assert np.mean(inside) == pytest.approx(nominal, abs=4 * np.std(inside) / np.sqrt(campaigns))
