"""Readings matched to p-values and means give these back, and say what they imply."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from stickslip_fit.anova.analysis import run_factor_tests
from stickslip_fit.errors import InputError
from tests.thesis.published import value
from tests.thesis.reconstruct import LABEL, implied, implied_difference, implied_spread, reconstruct


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


READINGS = value("anova_readings_a_day")
A = value("a") * 1e-9
MEAN = A.mean()
LEVELS = len(np.arange(value("sweep_theta")[0], value("sweep_theta")[1] - 1, -value("sweep_theta")[2]))


def over_repeatability(p_value):
    """Difference of two means that has this p-value, over the standard deviation of a reading."""
    return implied_difference(1.0, p_value, READINGS)


@pytest.mark.parametrize(
    ("analysis", "joint", "direction", "p_value", "levels"),
    [
        *(("day", 3, sign, p, 2) for sign, p in zip("+-", value("p_day_prismatic"), strict=True)),
        ("direction", 3, None, value("p_direction_prismatic"), 2),
        *(
            ("normal-force", 3, sign, p, LEVELS)
            for sign, p in zip("+-", value("p_normal_force"), strict=True)
        ),
        *(("day", 2, sign, p, 2) for sign, p in zip("+-", value("p_day_rotary"), strict=True)),
        ("direction", 2, None, value("p_direction_rotary"), 2),
    ],
)
def test_every_printed_p_value_comes_back(analysis, joint, direction, p_value, levels):
    """Means are printed for none of them: any that differ imply a repeatability in proportion."""
    step = MEAN if joint == 3 else value("gamma0") * 1e-6
    for change in (0.02, 0.08):
        means = {f"level {k}": step * (1 + change * k / (levels - 1)) for k in range(levels)}
        question = reconstruct(analysis, means, p_value, joint=joint, direction=direction)
        (found,) = run_factor_tests([question]).factor_tests
        assert found.p_value == pytest.approx(p_value, rel=1e-9)
        assert found.sums.df[1:] == (levels - 1, 2 * levels)
        if levels == 2:
            repeatability = implied(list(means.values()), p_value).repeatability * (1 + change / 2)
            assert change / repeatability == pytest.approx(over_repeatability(p_value))


def test_the_printed_p_values_imply_repeatability_and_days():
    """With the a of Fig. 4.13 for the means of + and -; the thesis prints no means beside its p-values."""
    p_value = value("p_direction_prismatic")
    found = implied(A, p_value)
    assert 100 * found.repeatability == pytest.approx(value("repeatability_implied_by_p_values"), abs=0.005)
    by_day = [100 * found.repeatability * over_repeatability(p) for p in value("p_day_prismatic")]
    assert by_day == pytest.approx(value("day_to_day_change_implied_by_p_values"), abs=0.05)
    pooled = 100 * np.ptp(A) / MEAN * np.sqrt(READINGS / stats.f.isf(p_value, 1, 8))
    assert pooled == pytest.approx(value("repeatability_if_both_days_were_tested"), abs=0.005)


def test_the_rotary_p_values_imply_ratios():
    """No step of joint 2 is printed, so that a repeatability in % does not follow."""
    for joint in ("prismatic", "rotary"):
        p_values = [*value(f"p_day_{joint}"), value(f"p_direction_{joint}")]
        name = {
            "prismatic": "changes_over_repeatability_prismatic",
            "rotary": "changes_over_repeatability_rotary",
        }[joint]
        assert [over_repeatability(p) for p in p_values] == pytest.approx(value(name), abs=0.05)


def test_the_normal_force_could_hide_behind_the_days():
    """Four angles, a reading on each of three days: days that scatter as 4.2 has them hide 6 %."""
    between, within = LEVELS - 1, LEVELS * (value("days_normal_force") - 1)
    f_values = stats.f.isf(value("p_normal_force"), between, within)
    assert f_values == pytest.approx(value("normal_force_f"), abs=0.005)

    def power(difference):  # the largest of four means and the smallest apart by it, the others between
        noncentrality = value("days_normal_force") * difference**2 / 2
        return stats.ncf.sf(
            stats.f.isf(value("significance_level"), between, within), between, within, noncentrality
        )

    scatter = value("day_to_day_change_implied_by_p_values").max() / np.sqrt(2)
    shown = scatter * brentq(lambda difference: power(difference) - 0.8, 0.1, 20.0)
    assert shown == pytest.approx(value("normal_force_would_show"), abs=0.05)


@pytest.mark.parametrize(("p_value", "readings"), [(0.0, 3), (1.0, 3), (0.05, 1)])
def test_what_no_readings_can_have_is_refused(p_value, readings):
    with pytest.raises(InputError, match="give 0 < p < 1"):
        reconstruct("day", {"a": 1.0, "b": 2.0}, p_value, readings=readings)
