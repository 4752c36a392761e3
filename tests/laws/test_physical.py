"""The physical laws: closed forms of one step, quadrature along a traverse, derivatives, saving."""

import json

import numpy as np
import pytest

from stickslip_fit.laws import (
    FRICTION_LIMITED,
    PhysicalBase,
    PhysicalBaseAtOneReach,
    PhysicalElbow,
    PhysicalPrismatic,
    describe_law,
    restore_law,
)
from stickslip_fit.laws.physical import VELOCITY_LIMITED
from stickslip_fit.machine import load_machine
from stickslip_fit.step import step_size

MACHINE = load_machine()
G = 9.80665
N_PIECES = 5000
RATIOS = [(0.5, 0.6), (0.97, 1.05), (1.1, 0.92), (FRICTION_LIMITED, 1.3)]
LAWS = {
    "prismatic": (PhysicalPrismatic, np.array([976e-9, 0.3, 0.22])),
    "elbow": (lambda ratios: PhysicalElbow(MACHINE, ratios), np.array([1e-4, 0.06, 0.1, 0.15])),
    "base": (lambda ratios: PhysicalBase(MACHINE, ratios), np.array([9e-5, 0.05, 0.02, 0.12])),
    "base-one-reach": (
        lambda ratios: PhysicalBaseAtOneReach(MACHINE, -np.pi / 2, 0.006, ratios),
        np.array([9e-5, 0.12]),
    ),
}


def law_and_values(kind, ratios):
    """A law with its values, of which the inertia's goes where no count depends on it."""
    make, values = LAWS[kind]
    law = make(ratios)
    return law, values if len(law.parameters) == len(values) else np.delete(values, 1)


def traverses(joint, n=24, one_reach=False):
    """Configurations at random, in both directions."""
    rng = np.random.default_rng(joint)
    low, high = MACHINE.ranges[joint]
    ends = np.sort(rng.uniform(low, high, (n, 2)), axis=1)
    forward = np.arange(n) % 2 == 0
    return {
        "q1": rng.uniform(-1, 1, n),
        "q2": np.full(n, -np.pi / 2) if one_reach else rng.uniform(-3, 0.3, n),
        "q3": np.full(n, 0.006) if one_reach else rng.uniform(0, 0.012, n),
        "theta": rng.uniform(-1.5, 0.3, n),
        "psi": rng.uniform(-1, 1, n),
        "start": np.where(forward, ends[:, 0], ends[:, 1]),
        "stop": np.where(forward, ends[:, 1], ends[:, 0]),
    }


@pytest.mark.parametrize("ratio", [0.3, 0.9, 1.0, 1.1, 2.5])
@pytest.mark.parametrize("load", [-0.9, -0.3, 0.0, 0.4, 1.0])
def test_the_guides_step_is_that_of_a_slider_that_carries_its_weight(ratio, load):
    """a, r and lambda stand for a_f, T1 and D."""
    friction, ramp = 43.0, 1.45e-4
    throw = ratio * friction * ramp**2
    values = np.array([min(throw, friction * ramp**2), 0.3, G / friction])
    angle = np.arccos(load)
    row = {"q2": [0.0], "theta": [angle], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    counts, _ = PhysicalPrismatic((ratio, ratio)).counts(row, values)
    expected = (1 - 0.3) * step_size(friction, ramp, throw, G * load)
    assert 0.012 / counts[0] == pytest.approx(float(expected), rel=1e-12)


def test_the_load_hinders_one_direction_and_helps_the_other():
    upright = {"q2": [0.0, 0.0], "theta": [0.0, 0.0], "psi": [0.0, 0.0]}
    both = {**upright, "start": [0.0, 0.012], "stop": [0.012, 0.0]}
    up, down = 0.012 / PhysicalPrismatic().counts(both, np.array([1e-6, 0.0, 0.2]))[0]
    assert up == pytest.approx(1e-6 * 0.8 / 1.2)
    assert down == pytest.approx(1e-6 * 1.2 / 0.8)


@pytest.mark.parametrize("kind", LAWS)
@pytest.mark.parametrize("ratios", RATIOS)
def test_derivatives_are_those_of_the_counts(kind, ratios):
    law, values = law_and_values(kind, ratios)
    rows = traverses(law.joint, one_reach=kind == "base-one-reach")
    counts, slopes = law.counts(rows, values)
    for k in range(len(values)):
        shift = np.zeros(len(values))
        shift[k] = 1e-6 * values[k]
        change = law.counts(rows, values + shift)[0] - law.counts(rows, values - shift)[0]
        np.testing.assert_allclose(
            slopes[:, k] * values[k] / counts, change / 2e-6 / counts, rtol=1e-5, atol=1e-8
        )


@pytest.mark.parametrize("kind", ["elbow", "base", "base-one-reach"])
@pytest.mark.parametrize("ratios", RATIOS)
def test_counts_are_the_integral_of_one_over_the_step_size(kind, ratios):
    law, values = law_and_values(kind, ratios)
    rows = traverses(law.joint, 8, one_reach=kind == "base-one-reach")
    counts, _ = law.counts(rows, values)
    for k, count in enumerate(counts):
        row = {name: column[k : k + 1] for name, column in rows.items()}
        low, high = sorted((row["start"][0], row["stop"][0]))
        # Many pieces, for the regime may change anywhere.
        width = (high - low) / N_PIECES
        middles = low + width * (np.arange(N_PIECES) + 0.5)
        places, weights = np.polynomial.legendre.leggauss(4)
        angles = (middles[:, None] + width / 2 * places).reshape(1, -1)
        rate = 1 / law.step_size(row, angles, values).reshape(N_PIECES, -1)
        expected = np.sum(rate @ weights) * width / 2
        assert count == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("kind", LAWS)
def test_traverses_are_counted_under_many_laws_at_once_as_under_each(kind):
    law, values = law_and_values(kind, (1.1, 1.1))
    rows = traverses(law.joint, one_reach=kind == "base-one-reach")
    each, ratios, n = np.outer([0.9, 1.0, 1.1], values), (0.8, 1.0, FRICTION_LIMITED), len(rows["start"])
    stacked = np.repeat(each[:, None], n, axis=1), np.repeat(np.array(ratios)[:, None], n, axis=1)
    at_once = law.ratio_counter(rows)(*stacked)
    for counts, slopes, own, ratio in zip(*at_once, each, ratios, strict=True):
        expected = law_and_values(kind, (ratio, ratio))[0].counts(rows, own)
        np.testing.assert_allclose(counts, expected[0], rtol=1e-9)
        np.testing.assert_allclose(slopes, expected[1], rtol=1e-7, atol=1e-12 * np.abs(expected[1]).max())


def test_a_rotary_step_falls_as_inertia_grows_only_where_friction_limits_it():
    out = {
        "q3": [0.0, 0.012],
        "theta": [-np.pi / 2] * 2,
        "psi": [0.0] * 2,
        "start": [0.0] * 2,
        "stop": [-1.0] * 2,
    }
    laws = [law_and_values("elbow", (ratio, ratio)) for ratio in (1.5, 0.5)]
    limited, reached = (1 / law.counts(out, values)[0] for law, values in laws)
    assert limited[1] / limited[0] == pytest.approx(1 / 1.06)
    assert reached[1] == pytest.approx(reached[0])
    assert VELOCITY_LIMITED < 1


def test_where_friction_does_not_hold_the_load_there_is_no_count():
    row = {"q2": [0.0], "theta": [0.0], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    assert np.isnan(PhysicalPrismatic().counts(row, np.array([1e-6, 0.3, 1.01]))[0][0])


@pytest.mark.parametrize("kind", LAWS)
def test_a_saved_law_counts_as_before(kind):
    make, values = LAWS[kind]
    law = make((FRICTION_LIMITED, 0.62))
    again = restore_law(json.loads(json.dumps(describe_law(law))), MACHINE)
    rows = traverses(law.joint, one_reach=kind == "base-one-reach")
    np.testing.assert_array_equal(again.counts(rows, values)[0], law.counts(rows, values)[0])
    assert again.parameters == law.parameters
