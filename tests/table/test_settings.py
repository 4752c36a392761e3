"""What columns do together: a function of two, or a value for each setting, where replicates show it."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

import stickslip_fit as ssf

LAW, ALPHA, SD = "y ~ a + b*x", 0.01, 0.05


def settings(rng, n=60):
    """Rows at random settings of two numbers and of a text, and their noise."""
    columns = {
        "x": rng.choice([1.0, 2.0, 4.0, 7.0, 10.0], n),
        "z": rng.choice([10.0, 20.0, 40.0], n),
        "who": rng.choice(["ann", "bob", "cy"], n),
    }
    return pd.DataFrame(columns), SD * rng.standard_normal(n)


def wall(seed=1):
    """A correction by the ratio of two numbers, as of a ball in a tube."""
    frame, noise = settings(np.random.default_rng(seed), 42)
    return frame.assign(y=2.0 + 0.3 * frame["x"] - 3.0 * np.log1p(2.4 * frame["x"] / frame["z"]) + noise)


def rough(seed=1):
    """A value of its own for each number and text."""
    rng = np.random.default_rng(seed)
    frame, noise = settings(rng, 90)
    kinds = frame.groupby(["x", "who"]).ngroup()
    return frame.assign(y=2.0 + 0.3 * frame["x"] + rng.standard_normal(15)[kinds] + noise)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "carrier"),
    [(wall, "x and z"), pytest.param(rough, "settings of x and who", marks=pytest.mark.nightly)],
    ids=["wall", "rough"],
)
def test_what_only_columns_together_show_is_found_and_predicted(make, carrier):
    diagnosis = ssf.diagnose_table(make(), LAW)
    (finding,) = diagnosis.findings
    assert (finding.cause, finding.carrier) == ("unknown", carrier)
    assert diagnosis.repeatability == pytest.approx(SD, rel=0.35)  # that of replicates
    assert diagnosis.gain.extended < 0.35 * diagnosis.gain.baseline


@pytest.mark.slow
def test_a_law_with_offsets_by_setting_is_saved_and_is_itself_at_other_settings(tmp_path):
    frame = rough()
    diagnosis = ssf.diagnose_table(frame, LAW, gain=False)
    assert "differs between settings of x and who" in " ".join(str(diagnosis).split())
    assert "an offset for each is proposed" in str(diagnosis)
    law = diagnosis.extended_law()
    assert np.std(law.predict(frame)["predicted"] - frame["y"]) < 1.5 * SD
    law.save(tmp_path / "law.json")
    again = ssf.load_table_fit(tmp_path / "law.json")
    new = pd.DataFrame({"x": [1.0, 2.0, 3.0], "who": ["dee", "dee", "ann"]})
    predicted = again.predict(new)["predicted"]
    np.testing.assert_allclose(predicted, law.predict(new)["predicted"])
    assert predicted[2] - predicted[1] == pytest.approx(predicted[1] - predicted[0])


@pytest.mark.slow
@pytest.mark.parametrize("number", [5, pytest.param(200, marks=pytest.mark.nightly)])
def test_replicates_of_a_right_law_raise_no_more_alarms_than_promised(number):
    alarms = 0
    for seed in range(number):
        frame, noise = settings(np.random.default_rng([5, seed]))
        frame = frame.assign(y=2.0 + 0.3 * frame["x"] + noise)
        alarms += bool(ssf.diagnose_table(frame, LAW, gain=False, alpha=ALPHA).findings)
    assert alarms <= binom.isf(1e-3, number, ALPHA)


def factorial(seed, alone, together, n=144):
    """Labels a and b, with effects of strength 12 that each has alone and that both have beyond their sum."""
    rng = np.random.default_rng([seed, n])
    a, b = (rng.permutation(np.resize(np.arange(k), n)) for k in (4, 3))
    cells = rng.standard_normal((4, 3))
    cells -= cells.mean(axis=0) + cells.mean(axis=1)[:, None] - cells.mean()
    parts = [rng.standard_normal(4)[a], rng.standard_normal(3)[b]] * alone + [cells[a, b]] * together
    effect = sum(12.0 * (one - one.mean()) / np.linalg.norm(one - one.mean()) for one in parts)
    who, what = np.array(list("abcd"))[a], np.array(list("uvw"))[b]
    return pd.DataFrame({"who": who, "what": what, "y": 3.0 + effect + rng.standard_normal(n)})


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("alone", "together", "found"),
    [
        (True, False, {"covariate:who", "covariate:what"}),
        (False, True, {"settings of who and what"}),
        (False, False, set()),
    ],
)
def test_what_two_labels_do_together_is_told_from_what_each_does_alone(seed, alone, together, found):
    diagnosis = ssf.diagnose_table(factorial(seed, alone, together), "y ~ m", gain=False)
    assert {one.carrier or one.cause for one in diagnosis.findings} == found
