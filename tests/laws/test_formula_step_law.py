"""Step sizes by formula: against the published laws, and one message for what cannot be used."""

import json

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit import InputError, Law
from stickslip_fit.laws import Elbow, Prismatic, describe_law, restore_law
from tests.docs.commands import ROOT

PRISMATIC = Law("gamma ~ (1 - b*recoil)*(a - c*load)", units={"a": "nm", "b": "1", "c": "nm"})
ELBOW = Law(
    "gamma ~ (g0 + d0*load)*(1 - q3/0.012) + (g1 + d1*load)*q3/0.012",
    units={"g0": "µrad", "g1": "µrad", "d0": "µrad", "d1": "µrad"},
    bounds={"g0": (0, 500)},
)


def prismatic(recoil, load, a, b, c):
    return (1 - b * recoil) * (a - c * load)


@pytest.fixture(scope="module")
def log():
    return ssf.read_log(ROOT / "data/reference")


@pytest.mark.parametrize(
    ("law", "own", "base"),
    [
        (PRISMATIC, lambda machine: Prismatic(), {"a": 1e-6, "b": 0.3, "c": 4e-8}),
        (
            Law(prismatic, bounds={"b": (-1, 1)}),
            lambda machine: Prismatic(),
            {"a": 1e-6, "b": 0.3, "c": 4e-8},
        ),
        (ELBOW, Elbow, {"g0": 1e-4, "d0": 2e-6, "g1": 1e-4, "d1": 3e-5}),
    ],
    ids=["prismatic", "function", "elbow"],
)
def test_a_formula_is_the_published_law(log, law, own, base):
    published = own(log.machine)
    rows = log.rows[log.rows.joint == published.joint].iloc[:60]
    step_law = law.step_law(published.joint, rows, log.machine)
    values = np.array([base[name] for name in step_law.parameter_names])
    order = {"a": 0, "b": 1, "c": 2, "g0": 0, "g1": 1, "d0": 2, "d1": 3}
    place = [order[name] for name in step_law.parameter_names]
    own_values = np.empty(len(values))
    own_values[place] = values
    counts, slopes = step_law.counts(rows, values)
    own_counts, own_slopes = published.counts(rows, own_values)
    np.testing.assert_allclose(counts, own_counts, rtol=1e-9)
    np.testing.assert_allclose(slopes, own_slopes[:, place], rtol=1e-6, atol=1e-6 * np.abs(own_slopes).max())
    assert step_law.prismatic == published.prismatic
    assert step_law.features(rows).shape[0] == len(rows)


def test_a_fit_with_a_formula_is_that_with_the_published_law(log):
    formula = ssf.fit(log, laws={3: PRISMATIC}).joints[3]
    published = ssf.fit(log).joints[3]
    place = ["abc".index(parameter.name) for parameter in formula.law.parameters]
    np.testing.assert_allclose(formula.values, published.values[:, place], rtol=1e-8)


def test_start_values_and_scales_follow_the_step_size(log):
    law = PRISMATIC.step_law(3, log.rows[log.rows.joint == 3], log.machine)
    once, twice = (law.start_values(np.array([step]))[0] for step in (1e-6, 2e-6))
    names = law.parameter_names
    assert twice[names.index("a")] == pytest.approx(2 * once[names.index("a")])
    assert twice[names.index("b")] == pytest.approx(once[names.index("b")])
    assert law.scales(np.array([1e-6]))[0][names.index("a")] == pytest.approx(1.2e-6, rel=0.5)


def test_a_law_of_the_position_is_integrated(log):
    law = Law("gamma ~ a*(1 + s*q/0.012)", units={"a": "nm"}, start={"s": 0.1})
    rows = log.rows[log.rows.joint == 3].iloc[:4]
    with pytest.raises(InputError, match="s, which is no column of the log"):
        Law("gamma ~ a*(1 + s*q/0.012)", units={"a": "nm"}).step_law(3, rows, log.machine)
    step_law = law.step_law(3, rows, log.machine)
    counts, slopes = step_law.counts(rows, np.array([1e-6, 0.2]))
    np.testing.assert_allclose(counts, 12_000 * np.log(1.2) / 0.2, rtol=1e-12)
    numerical = 12_000 * (np.log(1.2 + 1e-6) / (0.2 + 1e-6) - np.log(1.2 - 1e-6) / (0.2 - 1e-6)) / 2e-6
    np.testing.assert_allclose(slopes[:, 1], numerical, rtol=1e-7)


def test_laws_of_logs_are_described_and_restored(log):
    rows = log.rows[log.rows.joint == 2].iloc[:60]
    law = ELBOW.step_law(2, rows, log.machine)
    again = restore_law(json.loads(json.dumps(describe_law(law))), log.machine)
    values = law.start_values(np.array([1e-4]))[0]
    np.testing.assert_array_equal(again.start_values(np.array([1e-4]))[0], values)
    np.testing.assert_array_equal(again.predict(rows, values), law.predict(rows, values))
    assert [one.upper for one in again.parameters] == [one.upper for one in law.parameters]


BAD = {
    "gamma ~ a*b": "occur only as a product",
    "step ~ a": "write 'gamma ~ ...' in place of 'step ~ a'",
    "gamma ~ a + k*steps": "steps is what the law .* is to predict",
    "gamma ~ gamma*a": "gamma stands on both sides",
    "gamma ~ 1e-6*cos(q2)": "has no parameters",
    "gamma ~ a + b*zeta**2*0": "b cancels out",
}


@pytest.mark.parametrize("formula", BAD)
def test_a_formula_that_is_no_law_of_a_log_gets_one_message(log, formula):
    with pytest.raises(InputError, match=BAD[formula]):
        Law(formula).step_law(3, log.rows[log.rows.joint == 3], log.machine)


def test_units_of_a_log_are_known_ones(log):
    with pytest.raises(InputError, match="the unit 'nmm' of a is not known for a log; did you mean nm"):
        Law("gamma ~ a", units={"a": "nmm"}).step_law(3, log.rows, log.machine)
    law = Law("gamma ~ a", units={"a": "nm"}, bounds={"a": (900, 1200)}).step_law(3, log.rows, log.machine)
    assert law.parameters[0].lower == pytest.approx(9e-7)
