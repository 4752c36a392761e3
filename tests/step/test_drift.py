"""Heat and wear: which of them the step shows depends on the regime."""

from math import exp

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from stickslip_fit.errors import InputError
from stickslip_fit.step import Contact, Drive, Stage, StageDrift, apply_drift

LIMITED = Stage("limited", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
REACHED = Stage("reached", 5e-3, Contact(0.2, 1.25), Drive(20.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))


def relative(drift, stage, time, distance):
    return apply_drift(stage, drift, time, distance).step() / stage.step() - 1


def test_wear_is_archards_with_a_preload_spring():
    """Depth h = k N s for each stretch, and the spring, 2e4 N/m, loses that much of its deflection."""
    wear, stiffness = 1e-6, 2e4

    def rate(s, n):
        return -stiffness * wear * n

    solved = solve_ivp(rate, (0, 30.0), [1.25], rtol=1e-10, atol=1e-12).y[0, -1]
    drift = StageDrift(wear_length=1 / (stiffness * wear))
    assert apply_drift(LIMITED, drift, 0.0, 30.0).contact.preload == pytest.approx(solved, rel=1e-8)


def test_the_step_shows_friction_in_one_regime_and_travel_in_the_other():
    drift = StageDrift(
        warm_up=20.0,
        warm_up_time=600.0,
        friction_per_kelvin=-0.004,
        preload_per_kelvin=0.001,
        gain_per_kelvin=0.002,
    )
    heat = 20 * (1 - exp(-1.0))
    friction = (1 - 0.004 * heat) * (1 + 0.001 * heat) - 1
    assert relative(drift, LIMITED, 600.0, 0.0) == pytest.approx(friction, rel=1e-9)
    assert relative(drift, REACHED, 600.0, 0.0) == pytest.approx(0.002 * heat, rel=1e-9)


def test_running_in_ends_at_the_friction_that_is_given():
    drift = StageDrift(run_in=0.3, run_in_length=5.0)
    steps = [relative(drift, LIMITED, 0.0, distance) for distance in (0.0, 5.0, 1000.0)]
    np.testing.assert_allclose(steps, [0.3, 0.3 * exp(-1), 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: StageDrift(wear_length=0.0),
        lambda: StageDrift(warm_up_time=-1.0),
        lambda: StageDrift(warm_up=float("nan")),
        lambda: StageDrift(run_in=-1.0),
        lambda: StageDrift(warm_up=100.0, friction_per_kelvin=-0.05).factors(1e6, 0.0),
    ],
)
def test_what_would_leave_no_stage_is_refused(make):
    with pytest.raises(InputError):
        make()
