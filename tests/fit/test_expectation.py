from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.fit import least_squares
from stickslip_fit.fit.expectation import expectation, expectation_text
from stickslip_fit.logs import read_log

CALIBRATION = (
    {"joint": 3, "q2_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
    {"joint": 3, "q2_deg": 0.0},
)


def fitted(table: pd.DataFrame, folder):
    table.to_csv(folder / "log.csv", index=False)
    return least_squares(read_log(folder / "log.csv"))


@pytest.fixture
def drifting(campaign):
    """Ten sessions whose step sizes change by 2 % from one to the next, and how the last one is off."""

    def make(last: float, seed: int = 1) -> pd.DataFrame:
        days = tuple(f"2012-03-{day:02d}" for day in range(1, 11))
        table = campaign(sessions=days, settings=CALIBRATION)
        factor = np.exp(0.02 * np.random.default_rng(seed).standard_normal(10))
        factor[-1] *= last
        table["steps"] = (
            table["steps"] / table["session"].map(dict(zip(days, factor, strict=True))) // 5 * 5
        ).astype(int)
        return table

    return make


def test_a_usual_day_is_as_expected(drifting, tmp_path):
    found = expectation(fitted(drifting(1.0), tmp_path))
    assert len(found) == 6
    assert not found["surprising"].any()
    assert (
        expectation_text(found) == "session 2012-03-10 lies where the sessions before it lead one to expect"
    )


def test_a_drive_that_lost_a_quarter_of_its_step_is_told(drifting, tmp_path):
    found = expectation(fitted(drifting(0.75), tmp_path))
    told = expectation_text(found)
    assert set(found.loc[found["surprising"], "name"]) == {"a", "c"}
    assert "joint 3 + a: " in told
    assert "nm" in told


def test_the_stated_rate_of_surprises_holds(drifting, tmp_path):
    """Usual days only: a surprise anywhere in about 1 of 100; parameters move together, so fewer."""
    surprised = [expectation(fitted(drifting(1.0, seed), tmp_path))["surprising"].any() for seed in range(60)]
    assert sum(surprised) <= 4


def test_three_sessions_are_too_few(campaign, tmp_path):
    days = ("2012-03-01", "2012-03-02", "2012-03-03")
    found = expectation(fitted(campaign(sessions=days, settings=CALIBRATION), tmp_path))
    assert found.empty
    assert "too few to say" in expectation_text(found)
