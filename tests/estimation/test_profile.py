from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.stats import t as student_t

from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_closed_form, fit_least_squares
from stickslip_fit.estimation.least_squares import profile_intervals
from stickslip_fit.logs import read_log

FEW = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -75.0},
    {"joint": 3, "q2_deg": -30.0, "theta_deg": -20.0},
    {"joint": 3, "q2_deg": -150.0, "psi_deg": -60.0},
)


@pytest.fixture(scope="module")
def log(campaign, tmp_path_factory):
    path = tmp_path_factory.mktemp("profile") / "log.csv"
    campaign(settings=FEW, repeatability=0.15, seed=11).to_csv(path, index=False)
    return read_log(path)


def test_ends_are_where_the_best_of_the_others_costs_t_squared(log):
    """One group's profile by scipy's general minimiser."""
    result = fit_least_squares(log)
    table = profile_intervals(log, result)
    subset = log.usable[(log.usable["session"] == "2012-03-05") & (log.usable["direction"] == "+")]
    found = result.joints[3].repeatability["+"]
    counts = subset["steps"].to_numpy() - 2.5
    sigma = np.hypot(found.value, 5 / np.sqrt(12) / counts)
    recoil, load = (
        np.abs(np.cos(subset["q2"])),
        np.cos(subset["psi"] - subset["q2"]) * np.cos(subset["theta"]),
    )

    def cost(a, b, c):
        gamma = ((1 - b * recoil) * (a - c * load) * 1e-6).to_numpy()
        if np.min(gamma) <= 0:
            return np.inf
        return np.sum(((np.log(counts) - np.log(0.012 / gamma)) / sigma) ** 2)

    whole = table[(table["session"] == "2012-03-05") & (table["direction"] == "+")].set_index("name")
    a, b, c = whole["estimate"] * [1e6, 1.0, 1e6]
    reach = student_t.ppf(0.975, found.df)

    def excess(value):
        best = minimize(
            lambda p: cost(p[0], value, p[1]),
            [a, c],
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-9},
        )
        return best.fun - cost(a, b, c) - reach**2

    width = whole.loc["b", "high"] - b
    assert whole.loc["b", "profile_high"] == pytest.approx(brentq(excess, b, b + 2 * width), rel=1e-3)
    assert whole.loc["b", "profile_low"] == pytest.approx(brentq(excess, b - 2 * width, b), rel=1e-3)


def test_large_noise_bends_the_intervals_and_small_noise_does_not(campaign, log, tmp_path):
    assert profile_intervals(log, fit_least_squares(log))["differs"].any()
    campaign(settings=FEW, seed=11).to_csv(tmp_path / "log.csv", index=False)
    quiet = read_log(tmp_path / "log.csv")
    table = profile_intervals(quiet, fit_least_squares(quiet))
    assert not table["differs"].any()
    assert table["profile_low"].to_numpy() == pytest.approx(table["low"].to_numpy(), rel=0.01)


def test_what_is_not_known_has_no_profile(campaign, tmp_path):
    campaign(settings=FEW[:1], seed=11).to_csv(tmp_path / "log.csv", index=False)
    poor = read_log(tmp_path / "log.csv")
    table = profile_intervals(poor, fit_least_squares(poor)).set_index("name")
    assert table.loc["a", "profile_low"].notna().all()
    assert table.loc[["b", "c"], "profile_low"].isna().all()
    assert not table["differs"].any()


def test_only_the_fit_of_this_log_will_do(log):
    with pytest.raises(InputError, match="least-squares fit of this very log"):
        profile_intervals(log, fit_closed_form(log))
