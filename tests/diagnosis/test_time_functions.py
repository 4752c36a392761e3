"""Functions of each session's time with fine details: their evidence, and which of them is the likeliest."""

import numpy as np
import pytest

from stickslip_fit.diagnosis.evidence import WIDE_STRENGTHS
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.time_functions import ROUGH_LENGTHS, find_time_function
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden


@pytest.fixture(scope="module")
def linearized():
    return problem_from_log(read_hidden(hide("many", seed=4)))[0].linearize()


def residual_with(linearized, size, wander, *, opposite=False, seed=2):
    """Noise of variance 1 and what wanders in each session, from minutes and a generator to (n,)."""
    rng, rows = np.random.default_rng(seed), linearized.rows
    signal, session = np.zeros(len(rows)), rows["session"].to_numpy(object)
    for name in dict.fromkeys(session):
        own = np.flatnonzero(session == name)
        signal[own] = wander(rows["session_seconds"].to_numpy(float)[own] / 60.0, rng)
    signal *= linearized.direction_sign if opposite else 1.0
    return linearized.project(size * signal + rng.standard_normal(len(rows)))


def hills(minutes, rng):
    moments = rng.uniform(0.0, minutes.max(), 4)
    return np.exp(-0.5 * ((minutes[:, None] - moments) / 8.0) ** 2).sum(axis=1)


def switched(minutes, rng):
    """On or off, each for twenty minutes or so."""
    moments = np.cumsum(rng.exponential(20.0, 60))
    return np.searchsorted(moments, minutes) % 2.0


def test_the_evidence_is_that_of_a_gaussian_process_beside_the_calibration(linearized):
    residual = residual_with(linearized, 3.0, hills)
    evidence, shape = find_time_function(linearized, residual)
    term, rows = shape.version, linearized.rows
    share = np.clip(rows["session_seconds"].to_numpy(float) / term.limits[0][1], 0.0, 1.0)
    waves = np.cos(np.pi * share[:, None] * np.arange(1, len(term.sds) + 1)) * term.sds
    same = rows["session"].to_numpy(object)[:, None] == rows["session"].to_numpy(object)
    effects = linearized.project(waves @ waves.T * same / linearized.scale[:, None] / linearized.scale)
    covariance = linearized.project(effects.T)
    covariance /= np.trace(covariance)

    def log_ratio(strength):
        """Of the restricted likelihood to that of noise alone, the size of the noise unknown."""
        total = np.eye(len(residual)) + strength**2 * covariance
        left = residual @ np.linalg.solve(total, residual) / (residual @ residual)
        return -0.5 * np.linalg.slogdet(total)[1] - 0.5 * linearized.df * np.log(left)

    best = max(log_ratio(strength) for strength in WIDE_STRENGTHS)
    assert evidence == pytest.approx(best, abs=0.01)
    assert evidence > 20.0


@pytest.mark.parametrize(("wander", "is_rough"), [(hills, False), (switched, True)])
def test_what_rises_and_falls_is_smooth_and_what_is_switched_is_rough(linearized, wander, is_rough):
    _, shape = find_time_function(linearized, residual_with(linearized, 4.0, wander))
    sds = np.array(shape.version.sds)
    # Of an exponential covariance coefficients fall as one over their order, of a smooth one far faster.
    assert (sds[-1] / sds[0] > 1.0 / (1.5 * len(sds) * max(ROUGH_LENGTHS))) == is_rough
    assert (shape.version.mode, shape.version.on) == ("same", ())


def test_what_is_of_opposite_sign_in_the_two_directions_is_told(linearized):
    _, shape = find_time_function(linearized, residual_with(linearized, 4.0, hills, opposite=True))
    assert shape.version.mode == "opposite"


def test_a_function_that_is_far_smoother_than_the_finest_has_a_law():
    """Of a prior that is zero no fit knows what to do."""
    problem = problem_from_log(read_hidden(hide("session", seed=4)))[0]
    linearized = problem.linearize()
    minutes = linearized.rows["session_seconds"].to_numpy(float) / 60.0
    slow = 8.0 * np.cos(3.0 * np.pi * minutes / minutes.max())
    _, shape = find_time_function(linearized, linearized.project(slow))
    sds = np.array(shape.version.sds)
    assert len(sds) == len(shape.version.orders) < 50
    assert sds.min() > 0
    fit = problem.fit_extended([shape.version], np.zeros(len(sds)))
    assert np.isfinite(fit.covariance).all()


def test_a_log_with_few_traverses_in_each_session_has_none():
    few = problem_from_log(read_hidden(hide("many", seed=4)))[0].linearize()
    rows = few.rows.groupby(few.rows["session"].astype(object)).cumcount().to_numpy()
    short = few.select_rows(np.flatnonzero(rows < 12))
    assert find_time_function(short, short.residual) is None
