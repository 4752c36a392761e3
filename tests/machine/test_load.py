import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from stickslip_fit.machine import forward, full_load, mean_load, published_load


def base(theta, psi):
    """R = Rx(theta) Ry(psi), as scipy turns things."""
    return Rotation.from_euler("XY", np.stack([theta, psi], axis=-1))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_full_load_is_how_fast_the_joint_lifts_the_tip(arm, states, joint):
    """The height's slope over the tip's speed, so that 1 is straight up (A.111 to A.113)."""
    q, _, theta, psi = states
    step = 1e-6 * np.eye(3)[joint - 1]
    ahead, behind = forward(arm, q + step), forward(arm, q - step)
    climb = base(theta, psi).apply(ahead - behind)[:, 2]
    length = {
        1: arm.a1 - (arm.l2 + q[:, 2]) * np.sin(q[:, 1]),
        2: arm.l2 + q[:, 2],
        3: np.ones(len(q)),
    }[joint]
    assert full_load(joint, q[:, 0], q[:, 1], theta, psi) == pytest.approx(climb / (2e-6 * length), abs=1e-8)


def test_the_published_load_is_the_full_one_at_q1_0_only(states):
    """Eq. 4.5 and 6.10 with zeta = psi - q2; A.112 and A.113 give the load at any q1."""
    q, _, theta, psi = states
    q1, q2 = q[:, 0], q[:, 1]
    zeta = psi - q2
    published = {2: np.sin(zeta) * np.cos(theta), 3: np.cos(zeta) * np.cos(theta)}
    for joint, expected in published.items():
        assert published_load(joint, q1, q2, theta, psi) == pytest.approx(expected, abs=1e-15)
        assert full_load(joint, 0.0, q2, theta, psi) == pytest.approx(expected, abs=1e-15)
        assert np.max(np.abs(full_load(joint, q1, q2, theta, psi) - expected)) > 0.5


def test_joint_1_is_calibrated_by_interchanging_the_two_base_orientations():
    """psi of 90 degrees at q1 = 90 degrees loads joint 1 as theta of 90 degrees does at q1 = 0."""
    quarter = np.pi / 2
    assert published_load(1, quarter, 0.0, 0.0, quarter) == pytest.approx(1.0)
    assert published_load(1, 0.0, 0.0, quarter, 0.0) == pytest.approx(1.0)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("way", [1, -1])
def test_the_mean_load_is_the_integral_over_the_traverse(joint, way):
    rng = np.random.default_rng(5)
    start, stop = rng.uniform(-3.6, 2.0, size=(2, 12))[::way]
    q1, q2, theta, psi = rng.uniform(-np.pi, np.pi, size=(4, 12))
    given = {"q1": q1, "q2": q2} | {1: {"q1": np.nan}, 2: {"q2": np.nan}, 3: {}}[joint]
    found = mean_load(joint, start, stop, given["q1"], given["q2"], theta, psi)
    for i in range(12):

        def load(x, i=i):
            there = {1: (x, q2[i]), 2: (q1[i], x), 3: (q1[i], q2[i])}[joint]
            return float(published_load(joint, *there, theta[i], psi[i]))

        expected = quad(load, start[i], stop[i], epsabs=1e-13)[0] / (stop[i] - start[i])
        assert found[i] == pytest.approx(expected, abs=1e-12)


def test_the_mean_load_of_no_traverse_is_the_load_there():
    assert mean_load(2, -1.0, -1.0, 0.0, np.nan, 0.2, 0.3) == pytest.approx(
        published_load(2, 0, -1.0, 0.2, 0.3)
    )


@pytest.mark.parametrize("joint", [0, 4])
def test_a_joint_that_is_none(joint):
    for load in (full_load, published_load):
        with pytest.raises(ValueError, match="none of 1, 2, 3"):
            load(joint, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="none of 1, 2, 3"):
        mean_load(joint, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
