"""Readings matched to p-values and means give these back, and say what they imply."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from stickslip_fit.anova.analysis import run_factor_tests
from stickslip_fit.errors import InputError
from tests.thesis.reconstruct import LABEL, implied, implied_difference, implied_spread, reconstruct

PUBLISHED = Path(__file__).parents[2] / "data" / "published" / "published.toml"


@pytest.fixture(scope="module")
def published():
    found = {item["name"]: item["value"] for item in tomllib.loads(PUBLISHED.read_text("utf-8"))["number"]}
    return {name: np.array(value, float) for name, value in found.items() if not isinstance(value, str)}


@pytest.mark.parametrize("analysis", ["day", "direction", "normal-force"])
@pytest.mark.parametrize("p_value", [0.6, 0.031, 2e-7])
@pytest.mark.parametrize("means", [(976e-9, 951e-9), (976e-9, 951e-9, 960e-9)])
def test_the_analysis_of_reconstructed_readings_has_the_printed_p_and_means(analysis, p_value, means):
    named = {f"level {index}": mean for index, mean in enumerate(means)}
    (found,) = run_factor_tests([reconstruct(analysis, named, p_value)]).factor_tests
    assert found.p_value == pytest.approx(p_value, rel=1e-9)
    assert found.effect.means == pytest.approx(means)
    assert found.sums.df[1:] == (len(means) - 1, 2 * len(means))
    assert all(record["configuration"] == LABEL for record in run_factor_tests([found.design]).to_json())


def test_readings_of_known_scatter_are_told_from_their_p_alone():
    values = np.array([[950.0, 953.0, 954.5], [961.0, 960.0, 964.0]])
    p_value = stats.f_oneway(*values).pvalue
    spread = np.sqrt(np.mean(np.var(values, axis=1, ddof=1)))
    assert implied_spread(values.mean(axis=1), p_value, 3) == pytest.approx(spread)
    assert implied_difference(spread, p_value, 3) == pytest.approx(abs(np.diff(values.mean(axis=1))[0]))


def test_what_is_known_of_the_thesis_hangs_together(published):
    """The p-values that its 73 nm, 0.27 %, 2.6 % and 1.9 % stand for lead back to them, and to F(1, 4)."""
    readings = int(published["anova_readings_a_day"])
    forward = 12e6 / published["steps_of_a_prismatic_traverse"]
    means = np.array([forward, forward - published["a_forward_less_a_backward"]])
    noise = published["repeatability_implied_by_p_values"] / 100 * means.mean()
    by_direction = stats.f.sf(readings * np.ptp(means) ** 2 / 2 / noise**2, 1, 4)
    assert 100 * implied(means, by_direction).repeatability == pytest.approx(0.27)
    for change in published["day_to_day_change_implied_by_p_values"] / 100 * means.mean():
        by_day = stats.f.sf(readings * change**2 / 2 / noise**2, 1, 4)
        days = {"first": means.mean() * 1e-9, "second": (means.mean() + change) * 1e-9}
        (found,) = run_factor_tests([reconstruct("day", days, by_day)]).factor_tests
        assert found.sums.df[1:] == (1, 4)
        assert found.p_value == pytest.approx(by_day)
        spread = implied_spread(means, by_direction, readings)
        assert implied_difference(spread, by_day, readings) == pytest.approx(change)


@pytest.mark.parametrize(("p_value", "readings"), [(0.0, 3), (1.0, 3), (0.05, 1)])
def test_what_no_readings_can_have_is_refused(p_value, readings):
    with pytest.raises(InputError, match="give 0 < p < 1"):
        reconstruct("day", {"a": 1.0, "b": 2.0}, p_value, readings=readings)
