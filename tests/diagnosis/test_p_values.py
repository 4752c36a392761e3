"""What makes a p-value larger: heavy tails in a small log, and rows that were set aside."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from scipy.stats import t as student_t

from stickslip_fit.diagnosis.alternatives import _cosines_and_sines
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.extension import assess_residuals
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from stickslip_fit.diagnosis.misfit import (
    MAX_DETECTION_LENGTH,
    TAIL_DF,
    _tail_probabilities,
    compute_p_value,
    detection_length,
    weigh_evidence,
    winsorize,
)
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import MAX_EXCEEDANCES, allocate_alpha
from tests.diagnosis.conftest import NOISE


@pytest.mark.slow
def test_a_small_p_value_is_that_of_heavy_tails_where_noise_has_them(rows, linearize):
    """A chance coincidence of two large residuals: signs alone take it for structure five times as often."""
    windows = np.repeat(np.eye(20), 10, axis=0)
    noise = NOISE * np.random.default_rng(47).standard_t(3, len(rows))
    linearized = linearize(noise + 0.004 * windows[:, 7])
    tried = [make_hypothesis(f"{k}", None, None, linearized.project(one[:, None])) for k, one in
             enumerate(windows.T)]  # fmt: skip
    batch, rng = batch_hypotheses(tried, linearized.df), np.random.default_rng(1)

    def statistic(residuals):
        return logsumexp(batch.log_evidence(residuals), axis=0)

    df = rng.choice(TAIL_DF, 12_000, p=_tail_probabilities(linearized.residual))
    simulated = statistic(linearized.project(winsorize(rng.standard_t(df, (len(rows), len(df))), 2.5)))
    expected = np.mean(
        simulated >= statistic(linearized.project(winsorize(linearized.residual, 2.5))[:, None])
    )
    assert 0.003 < expected < 0.05
    found = [compute_p_value(weigh_evidence(linearized, tried), linearized, 499, rng) for _ in range(8)]
    # Of 8 x 2000 samples some 80 lie above: four standard errors of their number, and of that of `simulated`.
    assert np.mean([one.p_value for one in found]) == pytest.approx(expected, rel=0.65)
    assert all(len(one.null_log_evidence) >= 2000 for one in found)


def test_one_row_far_out_does_not_hide_an_effect_that_many_rows_share(rows, linearize):
    """Nine standard deviations in one of the four rows of a shape: they are there in every sample."""
    rng, half = np.random.default_rng(5), np.arange(len(rows)) % 20 < 10
    windows = np.repeat(np.eye(len(rows) // 4), 4, axis=0)
    noise = rng.standard_normal(len(rows))
    noise[33] = 9.0
    linearized = linearize(NOISE * (noise + 0.6 * half))
    shapes = {"half": half[:, None], **{f"{k}": one[:, None] for k, one in enumerate(windows.T)}}
    tried = [make_hypothesis(name, None, None, linearized.project(1.0 * one)) for name, one in shapes.items()]
    found = compute_p_value(weigh_evidence(linearized, tried), linearized, 1999, rng)
    assert max(found.log_evidence_by_cause, key=found.log_evidence_by_cause.__getitem__) == "half"
    assert found.p_value < 0.005


def test_residuals_are_cut_off_at_multiples_of_their_own_rms():
    columns = np.random.default_rng(1).standard_normal((4000, 2)) * [1.0, 1e-6]
    columns[7] = [50.0, -1e-6]
    within = winsorize(columns, 2.5)
    rms = np.sqrt(np.mean(columns**2, axis=0))
    assert within[7] == pytest.approx([2.5 * rms[0], -1e-6])
    assert np.array_equal(within != columns, np.abs(columns) > 2.5 * rms)
    assert winsorize(columns[:, 0], 2.5) == pytest.approx(within[:, 0], rel=1e-12)


@pytest.mark.parametrize("size", [0.0, 1.0, 3.3, 6.0])
def test_a_bootstrap_that_ends_early_decides_as_the_whole_one(rows, linearize, size):
    """It ends where so many samples lie above that no level can be reached, or where all are far below.

    A few samples count then as those that are clearly enough.
    """
    windows, noise = np.repeat(np.eye(20), 10, axis=0), np.random.default_rng(3)
    for seed in range(8):
        linearized = linearize(NOISE * (noise.standard_normal(len(rows)) + size * windows[:, 3]))
        tried = [
            make_hypothesis(f"{k}", None, None, linearized.project(one[:, None]))
            for k, one in enumerate(windows.T)
        ]
        misfit = weigh_evidence(linearized, tried)
        whole, early = (
            compute_p_value(misfit, linearized, 3000, np.random.default_rng(seed), most)
            for most in (None, MAX_EXCEEDANCES)
        )
        level = allocate_alpha(0.01)
        assert (early.p_value < level) == (whole.p_value < level)
        if size >= 3.3:
            assert early.p_value == 1 / 2001  # 20 for each expected false alarm at 1 %
            assert len(early.null_log_evidence) == 500
            assert whole.p_value == 1 / 3001
        elif whole.p_value < level:
            assert early.p_value == whole.p_value
        else:
            spread = np.sqrt(whole.p_value * (1.0 - whole.p_value) / len(early.null_log_evidence))
            assert abs(early.p_value - whole.p_value) < 4.0 * spread
        assert whole.p_value < 0.15 or len(early.null_log_evidence) < 1000


@pytest.mark.parametrize("number", [2, 37, 250])
def test_periods_are_cosines_and_sines(number):
    clock, frequencies = np.random.default_rng(2).uniform(0, 3e4, 50), np.linspace(1e-4, 1e-2, number)
    angles = 2 * np.pi * clock[:, None] * frequencies
    expected = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    np.testing.assert_allclose(_cosines_and_sines(clock, frequencies), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("df", [4.0, 8.0, 15.0, 1e6])
@pytest.mark.parametrize("number", [60, 5000])
def test_the_tails_of_residuals_have_the_probabilities_of_their_likelihoods(df, number):
    """By scipy's density of Student t noise of the residuals' own variance."""
    residual = 0.02 * np.random.default_rng(3).standard_t(df, number)
    sd = np.sqrt(np.mean(residual**2))
    likelihoods = [
        student_t.logpdf(residual, tail, scale=sd * np.sqrt((tail - 2) / tail)).sum() for tail in TAIL_DF
    ]
    probability = _tail_probabilities(residual)
    assert probability == pytest.approx(softmax(likelihoods), abs=1e-9)
    if number == 5000:
        assert TAIL_DF[np.argmax(probability)] == (5.0 if df < 5 else min(df, 200.0))


@pytest.mark.slow
def test_a_log_from_which_rows_were_set_aside_needs_twice_the_evidence(drifting):
    """The same residuals; the share of bootstrap samples counts twice, of twice as many."""
    whole, _ = problem_from_log(drifting)
    whole = replace(whole, causes=whole.causes[:1], noise_ratio=np.ones(len(whole)))
    linearized = whole.linearize()
    samples = 300
    found = {
        trimmed: assess_residuals(
            linearized, replace(whole, trimmed=trimmed), samples, np.random.default_rng(0)
        )
        for trimmed in (False, True)
    }
    assert np.array_equal(found[True].log_evidence, found[False].log_evidence)
    for trimmed, factor in ((False, 1), (True, 2)):
        misfit = found[trimmed]
        statistic = logsumexp(list(misfit.log_evidence_by_cause.values()))
        null = misfit.null_log_evidence
        share = (1 + np.sum(null >= statistic)) / (1 + len(null))
        assert misfit.p_value == pytest.approx(min(factor * share, 1))
        # An alarm at 2 % where nothing was set aside is one at 1 % where something was.
        assert misfit.critical_value(0.02) == pytest.approx(np.quantile(null, 1 - 0.02 / factor))
    assert len(found[True].null_log_evidence) == 2 * len(found[False].null_log_evidence) == 2 * samples


def test_where_no_effect_could_be_detected_the_length_is_the_longest():
    assert detection_length(500.0, 1, 5) == MAX_DETECTION_LENGTH
    assert detection_length(10.0, 1, 500) < 8.0
