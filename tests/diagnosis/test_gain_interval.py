"""The interval of the gain against closed forms, and replicates by least squares in each fold."""

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.stats import norm

from stickslip_fit.diagnosis.cross_validation import Split
from stickslip_fit.diagnosis.gain_interval import (
    CAUSE_FOUND,
    NONE_FOUND,
    CompetingCauses,
    LinearizedCampaign,
    Responses,
    fit_extension,
    prepare_calibration,
    prepare_split,
    simulate_gain_intervals,
    simulate_selection,
)


def _rng():
    return np.random.default_rng(0)


def test_linear_predictions_are_those_of_least_squares_on_the_other_rows():
    rng = _rng()
    laws = np.zeros((60, 6))
    laws[:30, :3], laws[30:, 3:] = rng.standard_normal((30, 3)), rng.standard_normal((30, 3))
    slopes, responses = rng.standard_normal((60, 2)), rng.standard_normal((60, 4))
    basis = csr_array(np.linalg.qr(laws)[0] * (np.abs(np.linalg.qr(laws)[0]) > 1e-12))
    held = np.arange(0, 60, 7)
    rest = np.setdiff1d(np.arange(60), held)
    prior = np.array([0.0, 3.0])  # the second slope has a prior of standard deviation 1/3
    cases = [(np.zeros(0), laws), (np.zeros(2), np.c_[laws, slopes]), (prior, None)]
    for penalties, columns in cases:
        if columns is None:
            columns = np.c_[laws, slopes]
            ridge = columns[rest].T @ columns[rest] + np.diag(np.r_[np.zeros(6), prior**2])
            fitted = np.linalg.solve(ridge, columns[rest].T @ responses[rest])
        else:
            fitted = np.linalg.lstsq(columns[rest], responses[rest])[0]
        operators = prepare_split(basis, Split(rest, rest, held))
        training = operators.training.subtract(responses)
        campaign = a_linear_campaign(basis, slopes)
        simulated = Responses.of(campaign, responses)
        sums = operators.training.sum_training(campaign, simulated)
        np.testing.assert_allclose(sums.squares, np.sum(training**2, axis=0))
        products = operators.training.subtract(campaign.columns).T @ training
        np.testing.assert_allclose(sums.products, products, atol=1e-9)
        place = campaign.places[0][1]
        chosen = campaign.columns[:, place][:, : len(penalties)]
        added, sizes = fit_extension(operators, chosen, penalties, sums.products[place][: len(penalties)])
        found = operators.prediction.subtract_prediction(simulated) - added @ sizes
        np.testing.assert_allclose(found, responses[held] - columns[held] @ fitted, atol=1e-9)


def a_campaign(cosine, ahead=0.0, names=True, strength=8.0, threshold=0.0, n=40):
    """One cause, and one rival whose effect has a cosine with its, in units of the noise."""
    ones, own, other = np.ones(n), np.zeros(n), np.zeros(n)
    own[0], other[:2] = strength, (cosine, np.sqrt(1 - cosine**2))
    rivals = CompetingCauses(other[:, None], np.array([ahead]), np.array([names]))
    basis = csr_array((n, 1))
    return LinearizedCampaign(
        basis, ones, ones, own[:, None], (own[:, None],), (np.zeros(1),), np.array([threshold]), (rivals,)
    )


def a_linear_campaign(basis, slopes):
    """One cause with these slopes, and no rival."""
    n, q = slopes.shape
    ones, none = np.ones(n), CompetingCauses(np.zeros((n, 0)), np.zeros(0), np.zeros(0, dtype=bool))
    effect = slopes.sum(axis=1, keepdims=True)
    return LinearizedCampaign(basis, ones, ones, effect, (slopes,), (np.zeros(q),), np.zeros(1), (none,))


@pytest.mark.parametrize("cosine", [0.5, 0.9, 0.97])
def test_a_rival_is_taken_for_a_cause_as_often_as_their_cosine_says(cosine):
    """Two directions with the same evidence: the wrong one wins with Phi(-s sqrt((1 - cosine) / 2))."""
    logs, strength = 20_000, 8.0
    campaign = a_campaign(cosine, strength=strength)
    responses = campaign.effects + _rng().standard_normal((40, logs))
    training = prepare_calibration(campaign.basis, np.arange(40), np.arange(40))
    sums = training.sum_training(campaign, Responses.of(campaign, responses))
    wrong = np.mean(simulate_selection(campaign, 0, training, sums) == 1)
    expected = norm.sf(strength * np.sqrt((1 - cosine) / 2))
    assert wrong == pytest.approx(expected, abs=4 * np.sqrt(expected / logs) + 1e-4)


def test_what_has_no_name_predicts_nothing_and_what_is_weak_is_not_seen():
    responses = a_campaign(0.97).effects + _rng().standard_normal((40, 50))
    cases = [
        ({"ahead": 90.0}, 1),
        ({"ahead": 90.0, "names": False}, NONE_FOUND),
        ({"threshold": 30.0}, NONE_FOUND),
        ({"ahead": -90.0}, CAUSE_FOUND),
    ]
    for change, made in cases:
        campaign = a_campaign(0.97, **change)
        training = prepare_calibration(campaign.basis, np.arange(40), np.arange(40))
        sums = training.sum_training(campaign, Responses.of(campaign, responses))
        assert set(simulate_selection(campaign, 0, training, sums)) == {made}


@pytest.mark.parametrize(("ahead", "reaches"), [(0.0, True), (-40.0, False)])
def test_a_replicate_may_gain_nothing_where_a_rival_is_as_likely(ahead, reaches):
    """What favours unknown structure in one fold of a campaign does so in all: gains do not average."""
    n, strength = 400, 12.0
    effect, ones = np.full((n, 1), strength / np.sqrt(n)), np.ones(n)
    rivals = CompetingCauses(effect, np.array([ahead]), np.array([False]))
    campaign = LinearizedCampaign(
        csr_array((n, 1)), ones, ones, effect, (effect,), (np.zeros(1),), np.zeros(1), (rivals,)
    )
    before = np.sqrt(1.0 + strength**2 / n)
    errors = np.array([[before, 1.0]])
    low, high = simulate_gain_intervals(campaign, [folds_of(n)], errors, _rng(), 600)[0, :, -1]
    assert low < before - 1.0 < high
    assert (low < 0.1 * (before - 1.0)) == reaches


def folds_of(n, number=10):
    folds = [np.arange(k, n, number) for k in range(number)]
    return [Split(*[np.setdiff1d(np.arange(n), fold)] * 2, fold) for fold in folds]


def errors_of_replicates(effects, signal, splits, logs=1000):
    """Held-out rms error of nothing and of all effects, by least squares in each fold; shape (2, logs)."""
    responses = signal[:, None] + np.random.default_rng(5).standard_normal((len(signal), logs))
    after = np.empty_like(responses)
    for one in splits:
        sizes = np.linalg.lstsq(effects[one.train], responses[one.train], rcond=None)[0]
        after[one.held_out] = responses[one.held_out] - effects[one.held_out] @ sizes
    return np.sqrt(np.mean([responses**2, after**2], axis=1))


def uncontested(effects):
    """As many causes as effects, without rivals or calibration."""
    n, k = effects.shape
    none = CompetingCauses(np.zeros((n, 0)), np.zeros(0), np.zeros(0, dtype=bool))
    return LinearizedCampaign(
        csr_array((n, 1)),
        np.ones(n),
        np.ones(n),
        effects,
        tuple(effects.T[:, :, None]),
        (np.zeros(1),) * k,
        np.zeros(k),
        (none,) * k,
    )


def share_covered(effects, observed, replicates, splits):
    """How many replicates gain what the interval claims; errors of shapes (2,) and (2, logs)."""
    middle = np.full(effects.shape[1] - 1, np.mean(observed))
    errors = np.array([[observed[0], *middle, observed[1]]])
    low, high = simulate_gain_intervals(uncontested(effects), [splits], errors, _rng())[0, :, -1]
    gains = replicates[0] - replicates[1]
    return np.mean((gains > low) & (gains < high))


def test_the_interval_of_causes_that_partly_cancel_is_that_of_their_sum():
    """What a log shows of each is the sum's length along it, 1.8 where their own are 60."""
    n, splits = 400, folds_of(400)
    rng = np.random.default_rng(1)
    first, other = np.linalg.qr(rng.standard_normal((n, 2)))[0].T
    effects = 60.0 * np.stack([first, -(0.97 * first + np.sqrt(1 - 0.97**2) * other)], axis=1)
    replicates = errors_of_replicates(effects, effects.sum(axis=1), splits)
    assert share_covered(effects, replicates.mean(axis=1), replicates, splits) > 0.93


def test_the_interval_holds_where_the_log_gained_little_by_chance():
    """Its effect's length says more of what a replicate gains than its own held-out error does."""
    n, splits = 400, folds_of(400)
    effects = np.full((n, 1), 12.0 / np.sqrt(n))
    replicates = errors_of_replicates(effects, effects[:, 0], splits)
    gains = replicates[0] - replicates[1]
    unlucky = replicates.mean(axis=1) + np.array([0.0, 2.5 * gains.std()])
    assert share_covered(effects, unlucky, replicates, splits) > 0.9


def test_the_interval_holds_where_the_law_has_not_the_form_of_the_effect():
    """The log's held-out error is a fourth larger than one of the law's form, and so is a replicate's."""
    n, splits = 400, folds_of(400)
    effects = np.full((n, 1), 12.0 / np.sqrt(n))
    replicates = errors_of_replicates(effects, effects[:, 0], splits) * np.array([[1.0], [1.25]])
    assert share_covered(effects, replicates.mean(axis=1), replicates, splits) > 0.9


def test_the_gain_of_the_log_is_no_end_of_its_interval_where_none_simulated_is_as_large():
    """Replicates gain about what it did, some more; a fold's bad calibration that no draw has helped it."""
    n, splits = 400, folds_of(400)
    effects = np.full((n, 1), 12.0 / np.sqrt(n))
    replicates = errors_of_replicates(effects, effects[:, 0], splits)
    gains = replicates[0] - replicates[1]
    observed = replicates.mean(axis=1) + np.array([10.0 * gains.std(), 0.0])
    low, high = simulate_gain_intervals(uncontested(effects), [splits], observed[None], _rng())[0, :, -1]
    value = observed[0] - observed[1]
    assert low < value - 1.5 * gains.std()
    assert high > value + 1.5 * gains.std()
