"""Every cause by its equation: counts against one quadrature per traverse, written out by hand."""

import numpy as np
import pytest

from stickslip_fit.causes import ExtendedLaw, covariates, extend, library
from stickslip_fit.laws import StepLaw
from tests.causes.by_hand import ROWS, steps
from tests.causes.table import CASES, LAWS, MACHINE, NAMED, own_values


def counted(causes, sizes, rows=ROWS):
    """Counts of all rows by the package, joint by joint."""
    counts = np.empty(len(rows))
    for joint in rows["joint"].unique():
        subset = (rows["joint"] == joint).to_numpy()
        law: StepLaw = LAWS[joint]
        for cause in causes:
            law = extend(law, cause)
        values = own_values(rows[subset])
        values = np.concatenate([values, np.tile(np.concatenate(sizes), (len(values), 1))], axis=1)
        counts[subset] = law.counts(rows[subset], values)[0]
    return counts


def by_hand(acting, rows=ROWS):
    return np.array([steps(row, acting) for row in rows.to_dict("records")])


def test_the_table_holds_every_cause_of_the_library_but_misfires():
    names = {case.cause.name for case in CASES}
    assert names == {cause.name for cause in (*library(), *covariates(ROWS))} - {"end-stop-misfire"}


@pytest.mark.parametrize(
    ("case", "values"),
    [
        pytest.param(case, values, id=f"{case.label}-{k}")
        for case in CASES
        for k, values in enumerate(case.values)
    ],
)
def test_counts_follow_the_equation(case, values):
    found = counted([case.cause], [values])
    np.testing.assert_allclose(found, by_hand([(case.effect, values)]), rtol=2e-10)
    moved = ~np.isclose(found, counted([], [np.zeros(0)]), rtol=1e-12, atol=0)
    assert set(ROWS["joint"][moved]) <= set(case.cause.joints)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.label)
def test_absent_values_are_the_published_law_exactly(case):
    baseline = np.concatenate(
        [LAWS[j].counts(ROWS[ROWS["joint"] == j], own_values(ROWS[ROWS["joint"] == j]))[0] for j in (3, 2, 1)]
    )
    np.testing.assert_allclose(counted([case.cause], [case.cause.null_values]), baseline, rtol=1e-13)


@pytest.mark.parametrize(
    "labels",
    [
        ("load-nonlinearity square", "side-load", "end-stop-latency"),
        ("q2-offset", "q1-gravity"),
        ("psi-offset", "recoil-axis"),
        ("payload-change unrecorded", "q1-gravity", "theta-offset"),
        ("recoil-shape", "recoil-axis"),
        ("cable-torque", "bearing-runout", "drift"),
        ("load-nonlinearity cube", "recoil-shape", "payload-change recorded"),
        ("worn-spot", "guide-gradient", "reversal-loss"),
        ("inertia-quadratic", "thermal-warm-up", "end-stop-latency"),
    ],
    ids=" + ".join,
)
def test_causes_act_in_the_documented_order_whatever_the_order_they_are_named_in(labels):
    cases = [NAMED[label] for label in labels]
    # By hand, in the order of the stages: what replaces a load or a recoil before what alters it.
    ordered = sorted(cases, key=lambda case: case.cause.name in ("payload-change", "recoil-shape"))
    expected = by_hand([(case.effect, case.values[0]) for case in ordered])
    for named in (cases, cases[::-1]):
        found = counted([case.cause for case in named], [case.values[0] for case in named])
        np.testing.assert_allclose(found, expected, rtol=2e-10)


@pytest.mark.parametrize(
    ("label", "column"),
    [
        ("temperature", "temperature"),
        ("temperature curved", "temperature"),
        ("humidity", "humidity"),
        ("supply-voltage", "supply"),
        ("step-rate", "step_period"),
        ("covariate:pressure", "covariate:pressure"),
    ],
)
def test_an_empty_cell_does_nothing(label, column):
    case = NAMED[label]
    empty = ROWS.assign(**{column: np.nan})
    found = counted([case.cause], [case.values[1]], empty)
    np.testing.assert_allclose(found, counted([], [np.zeros(0)]), rtol=1e-13)


def test_an_empty_payload_is_the_mean_one():
    cause = NAMED["payload-change recorded"].cause.bind(ROWS, MACHINE)
    mean = ROWS["payload"].mean()
    assert mean > 0
    found = counted([cause], [(10.0,)], ROWS.assign(payload=np.nan))
    np.testing.assert_allclose(found, counted([cause], [(10.0,)], ROWS.assign(payload=mean)), rtol=1e-13)


def test_a_spot_of_a_tenth_of_a_millimetre_is_not_stepped_over_wherever_it_is():
    rows = ROWS.iloc[[0]]
    law = extend(LAWS[3], NAMED["worn-spot"].cause)
    start = np.concatenate([own_values(rows)[0], [0.5, 0.0, 1e-4]])
    plain = law.counts(rows, start * np.r_[1, 1, 1, 0, 1, 1])[0]
    for x0 in np.linspace(1e-3, 11e-3, 57):
        start[4] = x0
        # The step size falls short of 1 + A e by so much that the spot costs a fixed share of its width.
        assert law.counts(rows, start)[0] / plain - 1 == pytest.approx(SPOT, rel=1e-6)


# The integral of 1 / (1 + 0.5 exp(-z^2 / 2)) - 1 over z, times 0.1 mm in 12 mm: a series in 0.5 / sqrt(n).
SPOT = sum((-0.5) ** n * np.sqrt(2 * np.pi / n) for n in range(1, 60)) * 0.1 / 12


@pytest.mark.parametrize("label", ["worn-spot", "load-nonlinearity tanh", "theta-offset", "drift"])
def test_a_stall_is_no_count(label):
    """Not a huge one, nor an error in the middle of a search."""
    case = NAMED[label]
    extreme = {"worn-spot": (-1.5, 6e-3, 1e-3), "theta-offset": (3.0,), "drift": (-1.0,)}
    values = extreme.get(label, (-3.0,) * 6)
    rows = ROWS[ROWS["joint"] == 3]
    own = own_values(rows) * np.array([1.0, 1.0, 4.0])
    law = extend(LAWS[3], case.cause)
    found = law.counts(rows, np.concatenate([own, np.tile(values, (len(own), 1))], axis=1))[0]
    assert np.isnan(found).any()
    assert not np.any(found <= 0)


def test_a_cause_shows_whatever_the_size_of_the_log():
    """The rows are worked through in pieces; the seams do not show."""
    many = ROWS[ROWS["joint"] == 2].sample(9000, replace=True, random_state=1)
    law, case = ExtendedLaw(LAWS[2], [NAMED["drift"].cause]), NAMED["drift"]
    values = np.concatenate([own_values(many), np.full((len(many), 1), case.values[0][0])], axis=1)
    once = {row: steps(ROWS.loc[row].to_dict(), [(case.effect, case.values[0])]) for row in set(many.index)}
    np.testing.assert_allclose(law.counts(many, values)[0], [once[row] for row in many.index], rtol=2e-10)


@pytest.mark.parametrize(
    ("label", "units"),
    [
        ("drift", [0.01 / 3600]),
        ("thermal-warm-up", [0.01, 60.0]),
        ("wear", [0.01, 1.0]),
        ("temperature curved", [0.01, 1.0]),
        ("humidity", [1.0]),
        ("supply-voltage", [0.01]),
        ("step-rate", [0.01]),
        ("theta-offset", [np.pi / 180]),
        ("q1-gravity", [1.0]),
        ("recoil-shape", [1.0]),
        ("load-hysteresis", [0.01]),
        ("payload-change unrecorded", [0.01, 60.0]),
        ("payload-change recorded", [0.01 / 1e-3]),
        ("inertia-quadratic", [1e-6 / 1e-6]),
        ("cable-torque", [1e-6 / (np.pi / 180)]),
        ("bearing-runout", [0.01, np.pi / 180]),
        ("guide-gradient", [0.01 / 1e-3]),
        ("worn-spot", [0.01, 1e-3, 1e-3]),
        ("end-stop-latency", [1.0]),
        ("covariate:pressure", [0.01, 0.01, 0.01]),
    ],
)
def test_one_of_a_parameters_unit_is_so_much_in_si(label, units):
    from stickslip_fit.units import to_si

    parameters = NAMED[label].cause.parameters
    assert [to_si(1.0, each.unit) for each in parameters] == pytest.approx(units)
