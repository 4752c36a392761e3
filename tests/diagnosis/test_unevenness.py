"""Noise that is many times larger somewhere is seen, whatever it follows; noise as assumed is not uneven."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.diagnosis.unevenness import Grouping, Residuals, estimate_unevenness, group_rows

N, KINDS = 480, 40
SESSION = np.arange(N) * 4 // N
KIND = np.arange(N) % KINDS
PLACE = KIND * 6 // KINDS
ONE = np.zeros(KINDS, dtype=int)
GROUPINGS = {
    "session": Grouping(SESSION, ONE[:4], 0),
    "configuration": Grouping(KIND, ONE),
    "place": Grouping(PLACE, ONE[:6]),
}
# Calibration: 60 blocks of 8 rows, 2 parameters each.
BLOCK = np.arange(N) % 60
SLOPES = np.column_stack([np.ones(N), np.random.default_rng(0).uniform(-1, 1, N)])


def draw(tails, rng):
    return rng.standard_normal(N) if tails == "gaussian" else rng.standard_t(5, N) / np.sqrt(5 / 3)


def calibrated(noise):
    """Residuals of a least-squares fit of each block."""
    left = noise.copy()
    for number in np.unique(BLOCK):
        own = number == BLOCK
        left[own] -= SLOPES[own] @ np.linalg.lstsq(SLOPES[own], noise[own], rcond=None)[0]
    return Residuals(left, np.zeros(N, dtype=int), SLOPES, BLOCK)


def noisy_in(carrier):
    return {"session": SESSION == 2, "configuration": KIND % 7 == 3, "place": (PLACE == 1) | (PLACE == 2)}[
        carrier
    ]


@pytest.mark.parametrize("tails", ["gaussian", "t5"])
@pytest.mark.parametrize("ratio", [1.0, 2.0])
def test_noise_as_assumed_is_not_uneven(tails, ratio):
    """10 logs each: even, and twice as large in a third of the configurations."""
    for seed in range(10):
        noise = draw(tails, np.random.default_rng(seed)) * np.where(KIND % 3 == 0, ratio, 1.0)
        assert estimate_unevenness(calibrated(noise), GROUPINGS).carriers == ()


@pytest.mark.nightly
@pytest.mark.parametrize("tails", ["gaussian", "t5"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
def test_noise_as_assumed_is_uneven_in_less_than_one_log_of_100(tails, share):
    found = 0
    for seed in range(1000, 1400):
        rng = np.random.default_rng(seed)
        twice = 1.0 + (rng.random(KINDS) < share)[KIND]
        found += bool(estimate_unevenness(calibrated(twice * draw(tails, rng)), GROUPINGS).carriers)
    assert found <= 6


@pytest.mark.parametrize("carrier", list(GROUPINGS))
def test_noise_five_times_as_large_somewhere_is_seen_for_what_it_is(carrier):
    noisy = noisy_in(carrier)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noise = draw("t5" if seed % 2 else "gaussian", rng) * np.where(noisy, 5.0, 1.0)
        found = estimate_unevenness(calibrated(noise), GROUPINGS)
        assert found.carriers == (carrier,)
        assert found.ratio[noisy].mean() / found.ratio[~noisy].mean() == pytest.approx(5.0, rel=0.4)


def test_few_parameters_for_few_rows_do_not_hide_noisy_places():
    """Fitted with equal weights, they carry the noise of noisy rows into quiet ones."""
    noisy = noisy_in("place")
    for seed in range(6):
        noise = np.random.default_rng(seed).standard_normal(N) * np.where(noisy, 5.0, 1.0)
        residuals = calibrated(noise)
        equal = residuals.values[noisy].std() / residuals.values[~noisy].std()
        ratio = estimate_unevenness(residuals, {"place": GROUPINGS["place"]}).ratio
        assert equal < 4.0 < ratio[noisy].mean() / ratio[~noisy].mean() < 6.0


def test_gross_errors_make_no_noise_uneven():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noise = draw("gaussian", rng)
        noise[rng.choice(N, 5, replace=False)] += 200.0
        alone = Residuals(noise, np.zeros(N, dtype=int), np.zeros((N, 1)), np.zeros(N, dtype=int))
        assert estimate_unevenness(alone, GROUPINGS).carriers == ()


def test_weighted_residuals_and_their_likelihood_are_those_of_dense_algebra():
    """Left are the residuals of generalized least squares; the density is that of all contrasts."""
    rng = np.random.default_rng(3)
    ratio = rng.uniform(0.5, 3.0, N)
    noise = ratio * rng.uniform(-2.0, 2.0, N)  # no row is so far off that it counts for less
    residuals = calibrated(noise)
    found = residuals.reweight(ratio)
    dense = np.zeros((N, 120))
    dense[np.arange(N), 2 * BLOCK], dense[np.arange(N), 2 * BLOCK + 1] = SLOPES.T
    weighted = dense / ratio[:, None]
    hat = weighted @ np.linalg.pinv(weighted)
    left = noise / ratio - hat @ (noise / ratio)
    sd = left / found.left
    assert np.ptp(sd) < 1e-9  # of the only drive
    np.testing.assert_allclose(found.free, 1 - np.diag(hat), atol=1e-9)
    np.testing.assert_allclose(np.mean(found.standardized**2), 1.0, rtol=0.05)
    covariance = np.diag((ratio * sd[0]) ** 2)
    contrasts = np.linalg.svd(dense)[0][:, 120:]
    inside = contrasts.T @ covariance @ contrasts
    values = contrasts.T @ noise
    log_density = -0.5 * (np.linalg.slogdet(inside)[1] + values @ np.linalg.solve(inside, values))
    ours = -0.5 * found.left @ found.left + found.log_volume
    # The two differ by what depends on the design alone.
    assert log_density - ours == pytest.approx(0.5 * np.linalg.slogdet(dense.T @ dense)[1], abs=1e-6)


def test_what_calibration_fitted_before_makes_no_difference():
    noise = np.random.default_rng(1).standard_normal(N)
    fitted = calibrated(noise)
    other = Residuals(noise, fitted.drive, SLOPES, BLOCK)
    ratio = np.where(KIND % 2, 3.0, 1.0)
    np.testing.assert_allclose(fitted.reweight(ratio).left, other.reweight(ratio).left, rtol=1e-6)


def test_rows_of_any_table_are_grouped_by_session_and_configuration():
    seconds = np.repeat(np.arange(30.0), 2)
    rows = pd.DataFrame({"session": ["a", "b"] * 30, "session_seconds": seconds, "x": np.arange(60.0)})
    plain = LinearizedFit(RowTable(rows), (), np.ones(60), np.zeros(60), None, ())
    nothing = np.zeros(60, dtype=int)
    alone = Residuals(np.ones(60), nothing, np.zeros((60, 1)), nothing)
    groupings = group_rows(plain, np.arange(60) % 5, alone)
    assert set(groupings) == {"session", "part of a session", "stretch of time", "configuration"}
    assert len(groupings["part of a session"].stratum) == 6
    assert "configuration" not in group_rows(plain, np.arange(60), alone)  # single rows are no groups
    untimed = replace(plain, table=RowTable(rows.assign(session_seconds=np.nan)))  # rows in any order
    assert set(group_rows(untimed, np.arange(60) % 5, alone)) == {"session", "configuration"}


def test_bursts_of_noise_are_found_by_the_neighbours_in_time():
    """40 of 200 rows in two bursts, which no column and no part of the session marks."""
    rows = pd.DataFrame({"session": "a", "session_seconds": 60.0 * np.arange(200.0)})
    plain = LinearizedFit(RowTable(rows), (), np.ones(200), np.zeros(200), None, ())
    nothing, burst = np.zeros(200, dtype=int), np.isin(np.arange(200) // 20, [3, 7])
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal(200)
        seen, even = (
            Residuals(one, nothing, np.zeros((200, 1)), nothing) for one in (noise * (1 + 4 * burst), noise)
        )
        found = estimate_unevenness(seen, group_rows(plain, np.arange(200), seen))
        assert found.carriers == ("stretch of time",)
        assert 2.0 < np.median(found.ratio[burst]) / np.median(found.ratio[~burst]) < 7.0  # 5, some mixed
        assert estimate_unevenness(even, group_rows(plain, np.arange(200), even)).carriers == ()
