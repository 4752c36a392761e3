"""What makes a p-value larger: heavy tails in a small log, and rows that were set aside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp, softmax
from scipy.stats import t as student_t

from stickslip_fit.diagnosis.extension import assess_residuals
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from stickslip_fit.diagnosis.misfit import (
    MAX_DETECTION_LENGTH,
    TAIL_DF,
    _tail_probabilities,
    batch_hypotheses,
    compute_misfit,
    detection_length,
)
from stickslip_fit.diagnosis.problem import problem_from_log
from tests.diagnosis.conftest import NOISE


def test_a_small_p_value_is_that_of_heavy_tails_where_noise_has_them(rows, linearize):
    """A chance coincidence of two large residuals: signs alone take it for structure four times as often."""
    windows = np.repeat(np.eye(20), 10, axis=0)
    noise = NOISE * np.random.default_rng(28).standard_t(3, len(rows))
    linearized = linearize(noise + 0.004 * windows[:, 7])
    tried = [make_hypothesis(f"{k}", None, None, linearized.project(one[:, None])) for k, one in
             enumerate(windows.T)]  # fmt: skip
    batch, rng = batch_hypotheses(tried, linearized.df), np.random.default_rng(1)

    def statistic(residuals):
        return logsumexp(batch.log_evidence(residuals), axis=0)

    simulated = statistic(linearized.project(rng.standard_t(5, (len(rows), 6000))))
    expected = np.mean(simulated >= statistic(linearized.residual[:, None]))
    assert 0.005 < expected < 0.05
    found = compute_misfit(linearized, tried, 499, rng)
    assert found.p_value == pytest.approx(expected, rel=0.4)
    assert len(found.null_log_evidence) >= 2000


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
