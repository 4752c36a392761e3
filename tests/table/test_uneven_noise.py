"""Noise of a table that is larger in some labels, or at some values of a column: no outlier and no cause."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

import stickslip_fit as ssf

SD, RATIO = 0.05, 5.0


def in_label(frame):
    return frame["lot"] == "B"


def at_values(frame):
    return frame["load"] > 0.7


def at_values_of_the_law(frame):
    return frame["x"] > 0.7


def make(seed, where, effect=0.0, n=250):
    rng = np.random.default_rng([seed, n])
    frame = pd.DataFrame(
        {
            "x": rng.uniform(0.0, 1.0, n),
            "load": rng.standard_normal(n),
            "room": rng.standard_normal(n),
            "lot": rng.choice(list("ABCDE"), n),
        }
    )
    sd = SD * np.where(where(frame), RATIO, 1.0)
    frame["y"] = 1.0 + 2.0 * frame["x"] + effect * frame["room"] + sd * rng.standard_normal(n)
    return frame


def diagnose(*case, **options):
    return ssf.diagnose_table(make(*case, **options), "y ~ a + b*x", gain=False)


@pytest.mark.parametrize(
    ("where", "told"),
    [
        (in_label, "times as large in lot B as in others"),
        (at_values, "of load as at others"),
        (at_values_of_the_law, "of x as at others"),
    ],
)
def test_larger_noise_somewhere_is_nothing_wrong_and_is_told(where, told):
    found = diagnose(0, where)
    assert found.verdict == "nothing wrong"
    assert found.noise_properties == ("uneven",)
    assert told in str(found.summary()).replace("\n", " ")
    noise, frame = found.selection.problem.noise_sd, make(0, where)
    rows, left = where(frame).to_numpy(), frame["y"] - 1.0 - 2.0 * frame["x"]
    ratio = np.std(left[rows]) / np.std(left[~rows])
    assert np.median(noise[rows]) / np.median(noise[~rows]) == pytest.approx(ratio, rel=0.2)


def test_a_cause_beside_noise_that_is_larger_in_a_label_is_as_precise_as_weights_make_it():
    """By least squares with the true weights; without weights the standard error is 1.6 times as large."""
    frame = make(1, in_label, 0.02)
    (one,) = ssf.diagnose_table(frame, "y ~ a + b*x", gain=False).findings
    assert one.cause == "covariate:room"
    weight = 1.0 / np.where(in_label(frame), RATIO * SD, SD)
    design = np.column_stack([np.ones(len(frame)), frame["x"], frame["room"]]) * weight[:, None]
    expected = np.linalg.lstsq(design, frame["y"] * weight, rcond=None)[0][2]
    error = np.sqrt(np.linalg.inv(design.T @ design)[2, 2])
    rms = np.std(frame["room"])
    assert one.effect.estimate == pytest.approx(expected * rms, rel=0.05)
    assert one.effect.high - one.effect.low == pytest.approx(2 * 1.96 * error * rms, rel=0.15)


def test_what_steepens_at_the_end_of_a_column_is_no_noise_there():
    """Seven rows of 61, up to a thousand times the noise: as likely a range in which the noise is large."""
    x = np.linspace(0.0, 60.0, 61)
    noise = 0.01 * np.random.default_rng(3).standard_normal(61)
    frame = pd.DataFrame({"x": x, "y": 1.0 + 0.02 * x + 0.03 * np.maximum(x - 53.0, 0.0) ** 3 + noise})
    (finding,) = ssf.diagnose_table(frame, "y ~ a + b*x", gain=False).findings
    assert (finding.cause, finding.carrier) == ("unknown", "x")


def test_a_group_named_by_its_role_is_told_by_the_columns_name():
    frame = make(0, in_label)
    found = ssf.diagnose_table(frame, "y ~ a + b*x", group="lot", gain=False)
    assert "in lot B as in others" in str(found.summary()).replace("\n", " ")


@pytest.mark.nightly
@pytest.mark.parametrize("where", [in_label, at_values, at_values_of_the_law])
def test_large_noise_somewhere_is_rarely_taken_for_anything_else(where):
    """Of 200 tables; where few rows show that the noise differs, the largest may count as outliers."""
    runs = [diagnose(seed, where, n=n) for seed in range(100) for n in (60, 200)]
    found = [{one.cause for one in run.findings} for run in runs]
    assert sum(bool(one - {"outliers"}) for one in found) <= binom(len(runs), 0.02).ppf(0.999)
    assert sum("outliers" in one for one in found) <= binom(len(runs), 0.06).ppf(0.999)


@pytest.mark.slow
@pytest.mark.parametrize("where", [in_label, at_values])
def test_no_rows_are_set_aside(where):
    runs = map(partial(diagnose, where=where), range(10, 22))
    assert sum(one.verdict != "nothing wrong" for one in runs) <= 1
