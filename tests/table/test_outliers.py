"""Outlying values of a table: whose p-value counts, what the others leave, and how rare such a value is."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import stickslip_fit as ssf
from stickslip_fit.diagnosis.extension import OUTLIER_ALPHA_SHARE
from stickslip_fit.diagnosis.selection import select_causes
from stickslip_fit.diagnosis.table import problem_from_table

OFF = [7, 31]


@pytest.fixture(scope="module")
def line():
    """A line with two values so far off the others that the law leaves mostly them."""
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 10.0, 60)
    y = 1.0 + 0.5 * x + 0.2 * rng.standard_normal(60)
    y[OFF] += 3.0
    return pd.DataFrame({"x": x, "y": y})


@pytest.mark.slow
def test_rows_that_are_trusted_are_no_evidence_against_the_law(line):
    """Else nothing is wrong, and p is below the false-alarm rate."""
    problem, _ = problem_from_table(line, "y ~ a + b*x")
    rng = np.random.default_rng(0)
    doubted = select_causes(problem, 0.01, 3000, rng)
    assert set(OFF) <= set(doubted.outliers.tolist())
    assert doubted.p_value < 0.01
    trusted = select_causes(problem, 0.01, 3000, rng, trusted=doubted.outliers)
    assert not trusted.selected
    assert trusted.p_value == pytest.approx(
        min(1.0, trusted.first_misfit.p_value / (1.0 - OUTLIER_ALPHA_SHARE))
    )


@pytest.mark.slow
def test_what_the_law_leaves_is_that_of_all_other_rows(line):
    found = ssf.diagnose_table(line, "y ~ a + b*x", gain=False)
    assert [one.cause for one in found.findings] == ["outliers"]
    others = line.drop(index=OFF)
    left = others["y"] - np.polyval(np.polyfit(others["x"], others["y"], 1), others["x"])
    assert found.misfit == pytest.approx(np.sqrt(np.mean(left**2)))
    assert f"of all others the law leaves {found.misfit:.3f} rms" in found.summary().headline[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "rare"), [pytest.param((-50.0, -2.0), True, marks=pytest.mark.nightly), ((-2.0, 30.0), False)]
)
def test_how_rare_a_value_far_off_is_is_told(off, rare):
    """Against draws of Student's t: of 66 values in units of their median, the largest."""
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"x": rng.normal(27.0, 5.0, 66).round()})
    frame.loc[[1, 53], "x"] = off
    found = ssf.diagnose_table(frame, "x ~ a", time="order", alpha=0.001, gain=False)
    assert found.verdict == "nothing wrong"
    text = " ".join(found.summary().headline)
    left = np.abs(frame["x"] - frame["x"].mean())
    draws = np.abs(rng.standard_t(5, (20_000, 66)))
    largest = np.max(draws, axis=1) / np.median(draws, axis=1)
    share = np.mean(largest > left.max() / np.median(left))
    assert (share < 2e-3) == rare
    assert ("now and then" in text) != rare
    assert ("in only 1 of" in text) == rare


@pytest.mark.slow
def test_a_run_at_the_end_of_a_column_is_a_curve_and_scattered_values_are_outliers():
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 60.0, 61)
    y = 1.0 + 0.02 * x + 0.01 * rng.standard_normal(61)
    steep = pd.DataFrame({"x": x, "y": y + 0.03 * np.maximum(x - 53.0, 0.0) ** 3}).sample(
        frac=1, random_state=1
    )
    scattered = pd.DataFrame({"x": x, "y": y}).sample(frac=1, random_state=1)
    scattered.loc[[4, 20, 45], "y"] += 0.5
    found = [ssf.diagnose_table(frame, "y ~ a + b*x", gain=False) for frame in (steep, scattered)]
    assert [[(one.cause, one.carrier) for one in diagnosis.findings] for diagnosis in found] == [
        [("unknown", "x")],
        [("outliers", "")],
    ]
    assert len(found[1].findings[0].traverses) == 3


@pytest.mark.slow
def test_the_two_outliers_of_newcombs_times_of_light_are_named_and_one_in_few_rows_is():
    """66 times, two of them far off (S. M. Stigler, Ann. Stat. 5:1055, 1977); of 25 rows one, by 10 sigma."""
    rng = np.random.default_rng(0)
    times = pd.DataFrame({"x": rng.normal(27.0, 5.0, 66).round()})
    times.loc[[1, 53], "x"] = -44.0, -2.0
    line = pd.DataFrame({"x": np.linspace(0.0, 10.0, 25)})
    line["y"] = 1.0 + 2.0 * line["x"] + 0.2 * np.random.default_rng(9).standard_normal(25)
    line.loc[17, "y"] += 2.0
    for frame, law, rows in ((times, "x ~ a", [1, 53]), (line, "y ~ a + b*x", [17])):
        found = ssf.diagnose_table(frame, law, time="order", gain=False)
        assert [one.cause for one in found.findings] == ["outliers"]
        assert found.selection.outliers.tolist() == rows


@pytest.mark.nightly
def test_in_noise_that_persists_an_outlier_is_told_from_a_change_that_lasts():
    """The rows after an outlier, less what it foretells, are as far off as those after such a change."""
    noise = lfilter([1.0], [1.0, -0.9], 0.1 * np.random.default_rng(11).standard_normal(400))[100:]
    seconds = np.arange(300.0)
    y = 20.0 + noise + (seconds >= 180.0) + 2.0 * (seconds == 60.0)
    found = ssf.diagnose_table(pd.DataFrame({"t": seconds, "y": y}), "y ~ mean", time="t", gain=False)
    (change,) = (one for one in found.findings if one.cause != "outliers")
    sizes = {one.name: one.size for one in change.parameters}
    assert change.cause == "sudden-change"
    assert sizes["A"].low < 1.0 < sizes["A"].high
    assert sizes["moment"].low <= 179.5 <= sizes["moment"].high
    assert found.selection.outliers.tolist() == [60]


@pytest.mark.slow
@pytest.mark.parametrize(
    "errors",
    [(-20.0, 200.0), *(pytest.param(one, marks=pytest.mark.nightly) for one in ((20.0, 200.0), (-0.5, 5.0)))],
)
def test_an_error_many_times_as_large_hides_no_other_nor_a_jump(errors):
    """Until both are set aside, a jump of four standard deviations is lost in what the smaller one leaves."""
    rng, off = np.random.default_rng(104), [40, 160]
    mass = rng.choice([10.0, 20.0, 50.0, 100.0, 200.0], 200)
    y = 1.0003 * mass + 0.002 + 0.012 * (np.arange(200) >= 130) + 0.003 * rng.standard_normal(200)
    y[off] += errors
    found = ssf.diagnose_table(
        pd.DataFrame({"mass": mass, "y": y.round(3)}), "y ~ k*mass + zero", time="order", gain=False
    )
    assert {one.cause for one in found.findings} == {"outliers", "sudden-change"}
    assert set(found.selection.outliers.tolist()) == set(off)


def test_a_slip_of_the_pen_in_few_rows_is_told():
    """The line turns about it, so that beside the median of what is left it is small."""
    mass = np.array([0.0, 24.0, 56.0, 76.0, 91.0, 106.0, 116.0, 126.0, 146.0, 168.0])
    noise = 0.05 * np.random.default_rng(2).standard_normal(10)
    frame = pd.DataFrame({"mass": mass, "length": 25.8 + 0.036 * mass + noise})
    frame.loc[4, "mass"] = 61.0
    found = ssf.diagnose_table(frame, "length ~ a + b*mass", gain=False)
    assert re.search(
        r"Check row 5 \(\+\d\.\d+\): [1-9][\d.]* standard deviations off", " ".join(found.summary().headline)
    )
