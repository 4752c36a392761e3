"""The generator of steps from friction: exact where that is known, and its logs what the reader takes."""

import numpy as np
import pytest

from tests.hidden.slip import Bristles, coulomb_step, lugre_step
from tests.hidden.stage import CHANGES, RATIOS, Stage, drive_stage

FRICTION, RAMP, PULL = 43.0, 1.45e-4, 9.81


def throw(ratio):
    return ratio * FRICTION * RAMP**2


def test_a_slider_that_never_reaches_the_foot_does_not_feel_the_throw():
    near, far = (coulomb_step(FRICTION, PULL, throw(ratio), RAMP, 0.03 * RAMP) for ratio in (1.3, 3.0))
    share = PULL / FRICTION
    assert near == pytest.approx(far)
    assert near == pytest.approx(FRICTION * RAMP**2 * (1 - share) / (1 + share))


def test_without_load_a_slider_that_catches_up_goes_as_far_as_the_foot():
    assert coulomb_step(FRICTION, 0.0, throw(0.5), RAMP, 0.03 * RAMP) == pytest.approx(throw(0.5))


def test_momentum_is_what_friction_and_load_gave():
    """Solved again in small times, with friction's sign alone: slow flyback, loads of both signs."""
    for pull in (-PULL, PULL):
        lasts, place, speed = (RAMP, 2.0 * RAMP, 6 * RAMP), 0.0, 0.0
        foot = (throw(1.2) / RAMP, -throw(1.2) / (2 * RAMP), 0.0)
        dt = RAMP / 40_000
        for duration, moving in zip(lasts, foot, strict=True):
            for _ in range(round(duration / dt)):
                faster = speed + ((FRICTION if moving > speed else -FRICTION) - pull) * dt
                if (moving - speed) * (moving - faster) <= 0:
                    faster = moving
                place, speed = place + (speed + faster) / 2 * dt, faster
        assert coulomb_step(FRICTION, pull, throw(1.2), RAMP, 2.0 * RAMP) == pytest.approx(place, rel=1e-4)


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_stiff_bristles_slide_as_coulomb_says(ratio):
    loads = PULL * np.array([-1.0, 0.0, 1.0])
    exact = coulomb_step(FRICTION, loads, throw(ratio), RAMP, 0.03 * RAMP)
    off = [
        np.max(
            np.abs(lugre_step(FRICTION, loads, throw(ratio), RAMP, 0.03 * RAMP, Bristles(bend)) / exact - 1)
        )
        for bend in (3e-3, 1e-3, 3e-4)
    ]
    assert off[0] > off[1] > off[2]
    assert off[2] < 0.002


@pytest.mark.parametrize("regime", RATIOS)
@pytest.mark.parametrize("bristles", [None, pytest.param(Bristles(), marks=pytest.mark.nightly)])
def test_the_reader_takes_a_stages_log(regime, bristles, read):
    hidden = drive_stage("session", Stage(regime, bristles), seed=3)
    assert list(read(hidden)["steps"]) == list(hidden.table["steps"])


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_acts_on_what_it_is_a_change_of(change):
    """Voltage leaves no trace in friction-limited steps, friction none in unloaded steps that are not."""
    limited, reached = (
        drive_stage("many", Stage(regime), change, seed=5) for regime in ("friction", "velocity")
    )
    largest = [np.max(np.abs(hidden.effect(change))) for hidden in (limited, reached)]
    if change == "voltage":
        assert largest[0] < 1e-9
        assert largest[1] > 0.05
    else:
        assert largest[0] > 0.05
        assert largest[0] > 2 * largest[1]
