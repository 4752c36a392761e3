"""Error diffusion: whole steps follow the target, never more than a tick has room for."""

import numpy as np
import pytest

from stickslip_fit.drive.diffusion import StepDiffusion

SIZES = {"+": np.array([97e-6, 101e-6, 0.96e-6]), "-": np.array([95e-6, 88e-6, 0.88e-6])}


def size_of(joint, way):
    return float(SIZES[way][joint - 1])


def follow(displacements, slots):
    """The largest lag of each joint in steps, the bursts, and how far the target went."""
    q = [0.0, 0.0, 0.0]
    diffusion = StepDiffusion(q, size_of, slots)
    lags, bursts, wanted = np.zeros(3), [], np.zeros(3)
    for change in displacements:
        if diffusion.advance(q, list(change)):
            wanted += change
        made = 0
        for burst in diffusion.bursts(q):
            sign = 1 if burst.direction == "+" else -1
            q[burst.joint - 1] += sign * burst.steps * size_of(burst.joint, burst.direction)
            bursts.append(burst)
            made += burst.steps
        assert made <= slots
        lags = np.maximum(lags, np.abs(np.array(diffusion.target) - q) / SIZES["-"])
    assert diffusion.target == pytest.approx(wanted.tolist(), abs=1e-12)
    return lags, bursts


@pytest.mark.parametrize("slots", [1, 5])
def test_no_joint_lags_by_more_than_its_share(slots):
    """Velocities within the rate, which turn at random."""
    rng = np.random.default_rng(slots)
    ways = np.repeat(rng.uniform(-1, 1, (60, 3)), 50, axis=0)
    shares = 0.9 * slots * ways / np.abs(ways).sum(axis=1, keepdims=True)
    lags, bursts = follow(shares * SIZES["-"], slots)
    assert np.all(lags <= slots + 1.3)
    assert sum(burst.steps for burst in bursts) > 1000 * slots


def test_a_joint_alone_is_never_more_than_half_a_step_off():
    lags, bursts = follow(np.tile([0.0, 0.3 * 101e-6, 0.0], (500, 1)), 1)
    assert lags[1] <= 0.6
    assert {(burst.joint, burst.direction) for burst in bursts} == {(2, "+")}
    assert sum(burst.steps for burst in bursts) == pytest.approx(150, abs=1)


def test_rounding_alone_turns_no_joint():
    """A target that swings by two fifths of a step to either side."""
    swing = 0.4 * 97e-6 * np.sin(np.arange(2000) / 30)
    displacements = np.zeros((1999, 3))
    displacements[:, 0] = np.diff(swing)
    assert not follow(displacements, 1)[1]


def test_a_target_beyond_the_rate_waits():
    q = [0.0, 0.0, 0.0]
    diffusion = StepDiffusion(q, size_of, 1)
    assert diffusion.advance(q, [0.0, 0.0, 1.9e-6])
    assert not diffusion.advance(q, [0.0, 0.0, 1.9e-6])
    assert diffusion.target[2] == pytest.approx(1.9e-6)
    diffusion.settle(q)
    assert diffusion.target == q
