"""Interrupted chains lose nothing, agreement is between ensembles, and weights say what they should."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from scipy.stats import norm

from stickslip_fit.bayes.marginal import (
    StudentTProposal,
    linearize_at_mode,
    psis_smooth,
    resample,
    sample_sessions,
)
from stickslip_fit.bayes.sampler import (
    effective_sample_sizes,
    file_backends,
    memory_backends,
    r_hat,
    run_ensembles,
    sample_posterior,
)
from stickslip_fit.errors import InputError

QUICK = {"seed": (3,), "target_ess": 400, "max_steps": 40}


@pytest.fixture(scope="module")
def traverses(traverses_of):
    truth = np.array([[970e-9, 0.30, 440e-9], [990e-9, 0.31, 430e-9], [950e-9, 0.29, 425e-9]])
    return traverses_of(truth, 0.003, np.random.default_rng(8))


@pytest.mark.slow
def test_an_interrupted_walk_ends_as_if_nothing_had_happened(traverses, tight_prior, tmp_path):
    path, made = tmp_path / "chains.h5", 0

    def interrupt(steps):
        nonlocal made
        made += steps
        if made in (9, 30, 66):
            raise KeyboardInterrupt

    def walk_on():
        chains = file_backends(path, "x", traverses, tight_prior, 3)
        return sample_posterior(traverses, tight_prior, chains, on_step=interrupt, **QUICK)

    kept = []
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            walk_on()
        with h5py.File(path) as file:
            kept.append(sum(ensemble.attrs["iteration"] for ensemble in file["x"].values()))
    resumed = walk_on()
    whole = sample_posterior(traverses, tight_prior, memory_backends(), on_step=lambda steps: None, **QUICK)
    assert kept == [9, 30, 66]
    assert np.array_equal(resumed.draws.parameters, whole.draws.parameters)
    assert resumed.quality.equals(whole.quality)


def test_chains_of_something_else_are_not_taken_up(traverses, tight_prior, tmp_path):
    path = tmp_path / "chains.h5"
    file_backends(path, "x", traverses, tight_prior, 3)
    file_backends(path, "x", traverses, tight_prior, 3)
    others = (
        (traverses, tight_prior, 4),
        (traverses, replace(tight_prior, repeatability=0.004), 3),
        (replace(traverses, y=traverses.y + 1e-6), tight_prior, 3),
    )
    for other in others:
        with pytest.raises(InputError, match="another log, law, prior or seed"):
            file_backends(path, "x", *other)
    path.write_text("no HDF5")
    with pytest.raises(InputError, match="no HDF5 file"):
        file_backends(path, "x", traverses, tight_prior, 3)


def test_files_of_others_are_neither_used_nor_written(traverses, tight_prior, tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as file:
        file["measured"] = np.arange(9.0)
    raw = path.read_bytes()
    with pytest.raises(InputError, match="something other than chains"):
        file_backends(path, "x", traverses, tight_prior, 3)
    assert path.read_bytes() == raw
    path.unlink()
    with h5py.File(path, "w") as file:
        file.attrs["schema"] = "stickslip-fit/chains/2"
    with pytest.raises(InputError, match="newer version"):
        file_backends(path, "x", traverses, tight_prior, 3)


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["nan", "no steps"])
def test_damaged_chains_are_not_continued(traverses, tight_prior, tmp_path, damage):
    path = tmp_path / "chains.h5"
    chains = file_backends(path, "x", traverses, tight_prior, 3)
    quick = QUICK | {"max_steps": 10}
    sample_posterior(traverses, tight_prior, chains, on_step=lambda steps: None, **quick)
    file_backends(path, "x", traverses, tight_prior, 3)
    with h5py.File(path, "a") as file:
        ensemble = file["x/ensemble_2"]
        if damage == "nan":
            ensemble["chain"][3, 1, 1] = np.nan
        else:
            del ensemble.attrs["iteration"]
    with pytest.raises(InputError, match=r"damaged chains|no HDF5 file that can be read") as caught:
        file_backends(path, "x", traverses, tight_prior, 3)
    assert len(caught.value.problems) == 1


def test_a_walk_finds_a_known_density_though_its_guess_is_poor():
    """Off centre by three standard deviations and half as wide: differential evolution has to do it."""
    guess = StudentTProposal(np.array([3.0, 0.0]), 0.5 * np.eye(2))
    chains = run_ensembles(
        lambda x: norm.logpdf(x).sum(axis=1), guess, (1,), memory_backends(), 1000, 4000, lambda steps: None
    )
    x = chains.x.reshape(-1, 2)
    assert x.mean(axis=0) == pytest.approx(0.0, abs=4 / np.sqrt(1000))
    assert x.std(axis=0) == pytest.approx(1.0, abs=4 / np.sqrt(2 * 1000))
    assert chains.steps < 4000


def test_effective_sizes_are_those_of_an_autoregression():
    """Walkers remember with rho = 0.8: nine draws are worth one."""
    rng, rho = np.random.default_rng(5), 0.8
    noise = rng.normal(size=(4, 400, 32))
    x = np.empty_like(noise)
    x[:, 0] = noise[:, 0]
    for step in range(1, 400):
        x[:, step] = rho * x[:, step - 1] + np.sqrt(1 - rho**2) * noise[:, step]
    assert effective_sample_sizes(x[None])[0] == pytest.approx(x.size * (1 - rho) / (1 + rho), rel=0.15)


def test_ensembles_that_sit_in_different_places_do_not_agree():
    """Though the walkers of each fill their place well."""
    x = np.random.default_rng(6).normal(size=(2, 4, 50, 32))
    x[1] += 0.3 * np.arange(4)[:, None, None]
    found = r_hat(x)
    assert found[0] < 1.01 < 1.05 < found[1]


def test_weights_turn_a_proposal_into_its_target():
    rng = np.random.default_rng(7)
    x = 1.5 * rng.normal(size=20_000)
    weight, k_hat = psis_smooth(norm.logpdf(x, 0.5) - norm.logpdf(x, 0, 1.5))
    taken = x[resample(weight, rng)]
    assert k_hat < 0.5
    assert taken.mean() == pytest.approx(0.5, abs=0.03)
    assert taken.std() == pytest.approx(1.0, abs=0.02)
    narrow = rng.normal(size=20_000)
    assert psis_smooth(norm.logpdf(narrow, 0, 5) - norm.logpdf(narrow))[1] > 0.7


def test_equal_weights_take_every_draw_once():
    weight, k_hat = psis_smooth(np.full(100, -3.0))
    assert k_hat == 0.0
    assert np.array_equal(resample(weight, np.random.default_rng(1)), np.arange(100))


def test_a_linear_law_needs_no_weights_and_a_bent_one_little(
    linear_traverses, linear_prior, traverses, tight_prior
):
    rng = np.random.default_rng(9)
    for each, prior, most in ((linear_traverses, linear_prior, 1e-9), (traverses, tight_prior, 0.05)):
        marginal, _, _ = linearize_at_mode(each, prior)
        _, log_weight = sample_sessions(each, marginal, rng.normal(size=(2000, 4)), rng)
        assert np.std(log_weight) < most


@pytest.mark.nightly
def test_what_uneven_weights_cost_is_walked_for(traverses, tight_prior, fitted, monkeypatch):
    """Weights of 1 to 3000 leave a quarter of the draws."""
    from stickslip_fit.bayes import sampler as module

    def uneven(traverses, marginal, x, rng):
        draws, log_weight = right(traverses, marginal, x, rng)
        return draws, log_weight + rng.uniform(0.0, 8.0, len(x))

    even = fitted(traverses, tight_prior, target_ess=1000, max_steps=1000)
    right = module.sample_sessions
    monkeypatch.setattr(module, "sample_sessions", uneven)
    found = fitted(traverses, tight_prior, target_ess=1000, max_steps=1000)
    assert found.converged
    assert found.steps > 2 * even.steps
    assert not fitted(traverses, tight_prior, target_ess=1000, max_steps=50).converged
