"""Steps over a traverse: formulas against literal stepping, quadrature and numerical derivatives."""

from itertools import product

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.laws import Base, BaseAtOneReach, ConstantStep, Elbow, Prismatic, StepLaw, observed_count
from stickslip_fit.laws.integration import integrate
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import step_through

MACHINE = load_machine()
LAWS = {
    "constant": ConstantStep(2, Elbow(MACHINE).calibration()[0]),
    "prismatic": Prismatic(),
    "elbow": Elbow(MACHINE),
    "base": Base(MACHINE),
    "one reach": BaseAtOneReach(MACHINE, q2=np.radians(-90), q3=0.0),
}
VALUES = {
    "constant": {"+": [94e-6], "-": [95e-6]},
    "prismatic": {"+": [976e-9, 0.30, 438e-9], "-": [903e-9, 0.30, -405e-9]},
    "elbow": {"+": [95e-6, 90e-6, -15e-6, -19.85e-6], "-": [95e-6, 90e-6, 19.6e-6, 25.91e-6]},
    "base": {"+": [97e-6, -0.05e-3, -1e-6, -0.35e-3], "-": [97e-6, -0.05e-3, 1.2e-6, 0.45e-3]},
    "one reach": {"+": [95e-6, -14e-6], "-": [95e-6, 18e-6]},
}
STRETCHES = {
    1: [(-120.0, 120.0), (-35.0, 10.0)],
    2: [(-210.0, 30.0), (-90.0, -60.0), (-200.0, -40.0)],
    3: [(0.0, 12.0), (3.3, 4.5)],
}


def traverses(law, direction):
    """Traverses of a law's joint in one direction: full and partial, base and arm in several positions."""
    unit = 1e-3 if law.joint == 3 else np.pi / 180
    grid = product(STRETCHES[law.joint], (-90.0, -20.0, 0.0), (0.0, -35.0, -90.0), (0.0, 60.0), (0.0, 12.0))
    ends, q2, theta, psi, q3 = (np.array(column) for column in zip(*grid, strict=True))
    start, stop = ends.T * unit if direction == "+" else ends.T[::-1] * unit
    return {
        "q2": np.radians(q2),
        "q3": q3 * 1e-3,
        "theta": np.radians(theta),
        "psi": np.radians(psi),
        "start": start,
        "stop": stop,
    }


each_law = pytest.mark.parametrize("name", LAWS)
each_direction = pytest.mark.parametrize("direction", ["+", "-"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("every", "step"), [(5, 8.0), pytest.param(1, 1.0, marks=pytest.mark.nightly)], ids=["few", "all"]
)
@pytest.mark.parametrize(
    ("name", "direction"),
    [
        *(("prismatic", "+"), ("prismatic", "-"), ("elbow", "+"), ("base", "-")),
        *(pytest.param(*one, marks=pytest.mark.nightly) for one in (("elbow", "-"), ("base", "+"))),
    ],
)
def test_counts_are_those_of_literally_stepping_the_joint(name, direction, every, step):
    """No side of the grid is a multiple of five, so that every fifth traverse has all values of each.

    Steps are eight times as long as real ones, which takes an eighth of the time.
    """
    law = LAWS[name]
    lengths = np.array([parameter.unit != "1" for parameter in law.parameters])
    values = np.where(lengths, step, 1.0) * VALUES[name][direction]
    rows = {name: column[2 % every :: every] for name, column in traverses(law, direction).items()}
    stepped = step_through(law, rows, values)
    counts, _ = law.counts(rows, values)
    assert stepped.max() > (44_000 if law.joint != 3 else 20_000) / step
    assert np.abs(stepped - np.ceil(counts)).max() <= 1


@each_law
@each_direction
def test_closed_forms_are_the_quadrature_with_its_slopes(name, direction):
    law, values = LAWS[name], np.array(VALUES[name][direction])
    rows = traverses(law, direction)
    counts, slopes = law.counts(rows, values)
    integrals, integrated_slopes = StepLaw.counter(law, rows)(values)
    np.testing.assert_allclose(counts, integrals, rtol=1e-9)
    size = counts[:, None] / law.scales(np.array([values[0]]))  # of a slope that matters
    assert np.abs((slopes - integrated_slopes) / size).max() < 1e-9


@each_law
@each_direction
def test_slopes_are_the_derivatives_of_the_counts(name, direction):
    law, values = LAWS[name], np.array(VALUES[name][direction])
    rows = traverses(law, direction)
    counts, slopes = law.counts(rows, values)
    for number, scale in enumerate(law.scales(np.array([values[0]]))[0]):
        h = 1e-4 * scale

        def at(shift, number=number):
            return law.counts(rows, values + shift * np.eye(len(values))[number])[0]

        # Fourth order, so that rounding and truncation both stay below 1e-9.
        slope = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        assert np.abs((slopes[:, number] - slope) * scale / counts).max() < 1e-8


def test_the_quadrature_sees_a_narrow_feature_beside_a_slope_in_another_unit():
    def integrand(owner, x):
        return np.stack([1 + np.exp(-(((x - 0.47) / 0.01) ** 2)), np.full_like(x, 1e6)], axis=-1)

    found = integrate(integrand, [0.0], [1.0])
    np.testing.assert_allclose(found, [[1 + 0.01 * np.sqrt(np.pi), 1e6]], rtol=1e-10)


def test_the_quadrature_is_not_held_up_by_rounding_noise():
    noise = np.random.default_rng(1)

    def integrand(owner, x):
        return np.stack([1 + x**2, 1e-17 * noise.standard_normal(x.shape)], axis=-1)

    np.testing.assert_allclose(integrate(integrand, [0.0], [3.0]), [[12.0, 0.0]], rtol=1e-10, atol=1e-15)


def test_the_quadrature_gives_up_on_what_is_no_smooth_function():
    noise = np.random.default_rng(1)
    with pytest.raises(InputError, match="varies too sharply"):
        integrate(lambda owner, x: noise.random(x.shape), [0.0, 1.0], [1.0, 3.0])


def test_step_sizes_are_the_published_formulas():
    rng = np.random.default_rng(4)
    q1, q2, theta, psi = rng.uniform(-np.pi, np.pi, (4, 50))
    q3 = rng.uniform(0, 0.012, 50)
    rows = {"q1": q1, "q2": q2, "q3": q3, "theta": theta, "psi": psi}

    a, b, c = VALUES["prismatic"]["+"]
    wanted = (1 - b * abs(np.cos(q2))) * (a - c * np.cos(psi - q2) * np.cos(theta))
    found = Prismatic().step_size(rows, q3[:, None], np.array([a, b, c]))[:, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)

    near, far, d_near, d_far = VALUES["elbow"]["-"]
    share = q3 / 0.012
    d = d_near + (d_far - d_near) * share
    wanted = near + (far - near) * share + d * np.sin(psi - q2) * np.cos(theta)
    found = LAWS["elbow"].step_size(rows, q2[:, None], np.array(VALUES["elbow"]["-"]))[:, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)

    zero, per_metre, d_zero, d_per_metre = VALUES["base"]["-"]
    reach = -(0.0375 + q3) * np.sin(q2)
    load = np.cos(theta) * np.sin(psi) * np.sin(q1) + np.sin(theta) * np.cos(q1)
    wanted = zero + per_metre * reach + (d_zero + d_per_metre * reach) * load
    found = LAWS["base"].step_size(rows, q1[:, None], np.array(VALUES["base"]["-"]))[:, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_a_row_may_have_parameters_of_its_own():
    law, rows = LAWS["elbow"], traverses(LAWS["elbow"], "+")
    own = np.array(VALUES["elbow"]["+"]) * np.linspace(0.9, 1.1, len(rows["q2"]))[:, None]
    one_by_one = [
        law.counts({name: column[[k]] for name, column in rows.items()}, own[k])[0][0]
        for k in range(len(own))
    ]
    np.testing.assert_array_equal(law.counts(rows, own)[0], one_by_one)
    np.testing.assert_allclose(StepLaw.counter(law, rows)(own)[0], one_by_one, rtol=1e-9)


HALTS = {
    "prismatic": ([4e-7, 0.0, 5e-7], {"q2": [0.0], "theta": [0.0], "start": [0.0], "stop": [0.01]}),
    "elbow": ([1e-2, 1e-2, 4e-2, 4e-2], {"q2": [0.0], "theta": [0.0], "start": [-1.0], "stop": [0.5]}),
    "base": ([1e-5, 0.0, 2e-5, 0.0], {"q2": [-1.0], "theta": [-1.5], "start": [0.5], "stop": [-0.5]}),
}


@pytest.mark.parametrize("name", HALTS)
def test_a_joint_that_comes_to_a_halt_has_no_count_and_cannot_be_stepped(name):
    law, (values, rows) = LAWS[name], HALTS[name]
    values, rows = np.array(values), rows | {"q3": [0.006], "psi": [0.0]}
    assert np.isnan(law.counts(rows, values)[0]).all()
    counts, slopes = StepLaw.counter(law, rows)(values)
    assert np.isnan(counts).all()
    assert np.isnan(slopes).all()
    with pytest.raises(InputError, match="comes to a halt"):
        step_through(law, rows, values)


def test_the_stop_is_noticed_at_the_first_check_after_it():
    stepped = np.array([12_295, 12_296, 12_300, 12_301, 3])
    assert list(observed_count(stepped, 5)) == [12_295, 12_300, 12_300, 12_305, 5]
    assert list(observed_count(stepped, 1)) == list(stepped)
