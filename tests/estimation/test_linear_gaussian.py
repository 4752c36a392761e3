"""Closed form, least squares and posterior mean on a case where all three are the same number."""

import numpy as np
import pytest

from stickslip_fit.bayes import Prior
from stickslip_fit.bayes.marginal import linearize
from stickslip_fit.bayes.priors import build_group_data
from stickslip_fit.estimation import fit_closed_form
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws import Parameter, Prismatic, traverse_length
from tests.conftest import CALIBRATION_3

SESSIONS = ("2012-03-05", "2012-03-06", "2012-03-07")


class LogLinear(Prismatic):
    """log(step size) = alpha + beta recoil + kappa load: in each calibration configuration the published law
    with alpha = log(a), beta = log(1 - b), kappa = log(1 - c / a), and linear everywhere."""

    parameters = tuple(Parameter(name, "1", name) for name in ("alpha", "beta", "kappa"))

    def model(self, rows):
        features = self.features(rows)
        design = -np.column_stack([np.ones(len(features)), features])
        return lambda values: (np.log(traverse_length(rows)) + np.sum(design * values, axis=1), design)

    def start_values(self, mean_step):
        none = np.zeros_like(mean_step)
        return np.stack([np.log(mean_step), none, none], axis=-1)

    def scales(self, mean_step):
        return np.ones((len(mean_step), 3))


def posterior_mean(rows, repeatability, width):
    """Of every session's parameters, (S, 3), their distribution being as wide as told and centred on 0."""
    wide = np.full(3, width)
    prior = Prior(("alpha", "beta", "kappa"), ("1",) * 3, np.zeros(3), wide, wide, repeatability)
    traverses = build_group_data(LogLinear(), rows)
    given = linearize(traverses, prior, np.zeros((len(traverses.groups), 3))).conditional(np.zeros((1, 4)))
    return width * given.sessions(given.centre)[:, :, 0].T


def generalised_least_squares(rows, repeatability, width):
    """The same mean from the covariance of everything with everything: phi C'(C phi C' + V)^-1 y."""
    y, rounding = LogLinear().response(rows)
    offset, design = LogLinear().model(rows)(np.zeros(3))
    session, sessions = rows["session"].astype(str).factorize()
    pick = np.zeros((len(rows), len(sessions), 3))
    pick[np.arange(len(rows)), session] = design
    pick = pick.reshape(len(rows), -1)
    # What sessions have in common, and what each has of its own, is equally wide here.
    phi = np.kron(np.ones((len(sessions),) * 2) + np.eye(len(sessions)), width**2 * np.eye(3))
    covariance = pick @ phi @ pick.T + np.diag(repeatability**2 + rounding)
    return (phi @ pick.T @ np.linalg.solve(covariance, y - offset)).reshape(-1, 3)


@pytest.fixture
def log(campaign, request, read_table):
    table = campaign(SESSIONS, CALIBRATION_3, ("+",), replicates=request.param)
    return read_table(table)


@pytest.mark.parametrize("log", [1], indirect=True)
def test_as_many_traverses_as_parameters_have_one_solution(log):
    """The calibration equations, the least squares and the mean under a flat prior agree."""
    solved = fit_closed_form(log).joints[3].values
    a, b, c = solved.T
    expected = np.stack([np.log(a), np.log(1 - b), np.log(1 - c / a)], axis=-1)
    rows = log.usable
    fitted, *_ = fit_joint(LogLinear(), rows, log.machine)
    assert fitted.values == pytest.approx(expected, abs=1e-10)
    assert posterior_mean(rows, 0.003, width=1e3) == pytest.approx(expected, abs=1e-10)
    published, *_ = fit_joint(Prismatic(), rows, log.machine)
    assert published.values == pytest.approx(solved, rel=1e-10)


@pytest.mark.parametrize("log", [4], indirect=True)
def test_least_squares_is_the_mean_under_a_flat_prior(log):
    """With traverses to spare, weighted alike: by the repeatability found and each count's own rounding."""
    rows = log.usable
    fitted, *_ = fit_joint(LogLinear(), rows, log.machine)
    flat = posterior_mean(rows, fitted.repeatability["+"].value, width=1e3)
    assert fitted.values == pytest.approx(flat, abs=1e-10)


@pytest.mark.parametrize("width", [0.001, 0.1, 3.0])
@pytest.mark.parametrize("log", [2], indirect=True)
def test_posterior_mean_is_generalised_least_squares(log, width):
    """Whatever the prior: from one that overrules the counts to one that they overrule."""
    found = posterior_mean(log.usable, 0.003, width)
    assert found == pytest.approx(generalised_least_squares(log.usable, 0.003, width), abs=1e-10)
