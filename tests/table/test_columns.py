"""Columns that the law lacks, several at once: each has its name, and its size by statsmodels."""

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf

import stickslip_fit as ssf

LAW = "y ~ a + b*x"


def table(seed, effect, number=6, n=200):
    """A line in x, columns c0, c1, ... and an effect of them, with noise of 0.05."""
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame({f"c{k}": rng.standard_normal(n) for k in range(number)})
    frame["x"] = rng.uniform(0.0, 1.0, n)
    frame["y"] = 1.0 + 2.0 * frame["x"] + effect(frame) + 0.05 * rng.standard_normal(n)
    return frame


def sum_of_columns(number):
    return lambda frame: sum((0.3 - 0.03 * k) * frame[f"c{k}"] for k in range(number))


@pytest.mark.parametrize(
    ("number", "seed"),
    [
        (2, 1),
        (3, 0),
        *(pytest.param(k, seed, marks=pytest.mark.slow) for k, seed in ((4, 13), (6, 0), (6, 1))),
    ],
)
def test_every_column_that_acts_is_named_with_its_size(number, seed):
    """Of more than one each is hidden by all others: alone it explains less than any function of two."""
    frame = table(seed, sum_of_columns(number))
    names = [f"c{k}" for k in range(number)]
    diagnosis = ssf.diagnose_table(frame, LAW, gain=False)
    assert {one.cause for one in diagnosis.findings} == {f"covariate:{name}" for name in names}
    assert not any(one.equivalent for one in diagnosis.findings)
    fit = smf.ols(f"y ~ x + {' + '.join(names)}", frame).fit()
    for finding in diagnosis.findings:
        name = finding.cause.removeprefix("covariate:")
        own = frame[name] - smf.ols(f"{name} ~ x", frame).fit().fittedvalues
        size = abs(fit.params[name]) * np.sqrt(np.mean(own**2))
        assert finding.effect.low < size < finding.effect.high
        assert finding.effect.estimate == pytest.approx(size, rel=0.03)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_product_of_two_columns_is_no_sum_of_causes(seed):
    (finding,) = ssf.diagnose_table(
        table(seed, lambda frame: 0.2 * frame["c0"] * frame["c1"]), LAW, gain=False
    ).findings
    assert (finding.cause, finding.carrier) == ("unknown", "c0 and c1")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_columns_that_act_by_themselves_and_by_a_product_are_both(seed):
    frame = table(seed, lambda frame: 0.3 * frame["c0"] + 0.2 * frame["c0"] * frame["c1"] + 0.2 * frame["c2"])
    found = ssf.diagnose_table(frame, LAW, gain=False).findings
    assert {one.cause for one in found} == {"covariate:c0", "covariate:c2", "unknown"}
    assert [one.carrier for one in found if one.cause == "unknown"] == ["c0 and c1"]


@pytest.mark.slow
def test_columns_beyond_the_end_of_the_search_are_told():
    diagnosis = ssf.diagnose_table(
        table(3, lambda frame: 0.2 * frame[[f"c{k}" for k in range(8)]].sum(axis=1), 8), LAW, gain=False
    )
    named = {one.cause for one in diagnosis.findings}
    assert len(named) == 6
    text = " ".join(str(diagnosis).split())
    assert "There is more" in text
    assert "the search ends after 6 findings" in text


@pytest.mark.parametrize(
    ("apart", "cancel"), [(0.05, True), pytest.param(1.0, False, marks=pytest.mark.slow)]
)
def test_columns_whose_effects_cancel_are_told(apart, cancel):
    """The second column is the first one but for a small part, and acts the other way."""
    frame = table(0, lambda frame: 0.1 * frame["c0"] - 3.0 * apart * frame["c1"], 2)
    frame["c1"] = frame["c0"] + apart * frame["c1"]
    diagnosis = ssf.diagnose_table(frame, LAW, gain=False)
    assert {one.cause for one in diagnosis.findings[:2]} == {"covariate:c0", "covariate:c1"}
    assert ("nearly cancel: together they are" in " ".join(str(diagnosis).split())) == cancel


def test_a_long_search_says_how_much_was_found():
    told = []
    ssf.diagnose_table(
        table(10, sum_of_columns(2)), LAW, gain=False, progress=lambda step, done: told.append((step, done))
    )
    assert [step for step, _ in told if "found" in step] == [
        "searching for causes, 1 found",
        "searching for causes, 2 found",
    ]
    assert [done for _, done in told] == sorted(done for _, done in told)
