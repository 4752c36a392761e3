import numpy as np
import pytest
import sympy as sp

from stickslip_fit.machine import (
    coriolis_matrix,
    gravity_forces,
    gravity_scale,
    inertia_matrix,
)

Q = sp.symbols("q1:4")
RATE = sp.symbols("w1:4")
ACCELERATION = sp.symbols("a1:4")
THETA, PSI, G = sp.symbols("theta psi g")


def denavit_hartenberg(theta, d, a, alpha):
    c, s, ca, sa = sp.cos(theta), sp.sin(theta), sp.cos(alpha), sp.sin(alpha)
    return sp.Matrix([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def rate_of(matrix):
    return sum((matrix.diff(q) * rate for q, rate in zip(Q, RATE, strict=True)), sp.zeros(*matrix.shape))


class Lagrangian:
    """D, C, G and the whole equation of motion, by differentiating T - V of three rigid bodies."""

    def __init__(self, machine):
        a1, l2 = sp.Float(machine.a1), sp.Float(machine.l2)
        upper = denavit_hartenberg(Q[0], 0, a1, sp.pi / 2)
        fore = upper * denavit_hartenberg(Q[1], 0, 0, -sp.pi / 2)
        hand = fore * denavit_hartenberg(0, l2 + Q[2], 0, 0)
        r1, r2, r3 = (link.com for link in machine.links)
        centres = [(-r1, 0, 0), (0, 0, r2), (0, 0, -r3)]
        base = sp.rot_axis1(-THETA) * sp.rot_axis2(-PSI)
        kinetic, potential = 0, 0
        for frame, centre, link in zip((upper, fore, hand), centres, machine.links, strict=True):
            place = (frame * sp.Matrix([*centre, 1]))[:3, :]
            turn = frame[:3, :3]
            spin = turn.T * rate_of(turn)
            omega = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]])
            velocity = rate_of(place)
            kinetic += link.mass * velocity.dot(velocity) / 2
            kinetic += omega.dot(sp.diag(*link.inertia) * omega) / 2
            potential += link.mass * G * (base * place)[2]
        inertia = sp.hessian(kinetic, RATE)
        momenta = sp.Matrix([kinetic.diff(rate) for rate in RATE])
        gravity = sp.Matrix([potential.diff(q) for q in Q])
        motion = momenta.jacobian(RATE) * sp.Matrix(ACCELERATION) + momenta.jacobian(Q) * sp.Matrix(RATE)
        motion += gravity - sp.Matrix([kinetic.diff(q) for q in Q])
        self.inertia = sp.lambdify([Q], inertia, cse=True)
        self.coriolis = sp.lambdify([Q, RATE], self.christoffel(inertia), cse=True)
        self.gravity = sp.lambdify([Q, THETA, PSI, G], gravity, cse=True)
        self.motion = sp.lambdify([Q, RATE, ACCELERATION, THETA, PSI, G], motion, cse=True)

    @staticmethod
    def christoffel(inertia):
        def entry(k, j):
            symbols = [
                (inertia[k, j].diff(Q[i]) + inertia[k, i].diff(Q[j]) - inertia[i, j].diff(Q[k])) / 2
                for i in range(3)
            ]
            return sum(symbol * rate for symbol, rate in zip(symbols, RATE, strict=True))

        return sp.Matrix(3, 3, entry)


@pytest.fixture(scope="module")
def lagrangian(arm):
    return Lagrangian(arm)


def close(scale):
    """What 1e-12 of the largest of these is, for the entries that are zero."""
    return 1e-12 * np.max(np.abs(scale))


def test_every_term_is_the_lagrangians(arm, states, lagrangian):
    q, qdot, theta, psi = states
    inertia, coriolis = inertia_matrix(arm, q), coriolis_matrix(arm, q, qdot)
    gravity = gravity_forces(arm, q, theta, psi, g=9.7)
    for i in range(len(q)):
        assert inertia[i] == pytest.approx(lagrangian.inertia(q[i]), rel=1e-12, abs=close(inertia[i, :2, :2]))
        assert coriolis[i] == pytest.approx(
            lagrangian.coriolis(q[i], qdot[i]), rel=1e-12, abs=close(coriolis[i])
        )
        expected = lagrangian.gravity(q[i], theta[i], psi[i], 9.7)[:, 0]
        assert gravity[i] == pytest.approx(expected, rel=1e-12, abs=close(gravity[:, 0]))


def test_the_equation_of_motion_is_euler_and_lagranges(arm, states, lagrangian):
    q, qdot, theta, psi = states
    qddot = np.random.default_rng(3).normal(size=q.shape) * [900.0, 900.0, 30.0]
    forces = np.einsum("nij,nj->ni", inertia_matrix(arm, q), qddot)
    forces += np.einsum("nij,nj->ni", coriolis_matrix(arm, q, qdot), qdot)
    forces += gravity_forces(arm, q, theta, psi)
    for i in range(len(q)):
        expected = lagrangian.motion(q[i], qdot[i], qddot[i], theta[i], psi[i], 9.80665)[:, 0]
        assert forces[i] == pytest.approx(expected, rel=1e-11, abs=close(expected))


def test_every_term_is_the_engines(arm, engine, states):
    q, qdot, theta, psi = states
    inertia, gravity = inertia_matrix(arm, q), gravity_forces(arm, q, theta, psi)
    bias = np.einsum("nij,nj->ni", coriolis_matrix(arm, q, qdot), qdot) + gravity
    for i in range(len(q)):
        engine.put(q[i], np.zeros(3), theta[i], psi[i])
        assert gravity[i] == pytest.approx(engine.bias(), rel=1e-9, abs=1e-14)
        engine.put(q[i], qdot[i], theta[i], psi[i])
        assert inertia[i] == pytest.approx(engine.inertia(), rel=1e-9, abs=1e-16)
        assert bias[i] == pytest.approx(engine.bias(), rel=1e-9, abs=1e-14)


def skew_defect(arm, q, qdot, coriolis):
    """How far dD/dt - 2 C is from skew-symmetry, as a share of dD/dt."""
    h = 1e-6
    rate = (inertia_matrix(arm, q + h * qdot) - inertia_matrix(arm, q - h * qdot)) / (2 * h)
    defect = rate - 2 * coriolis
    return np.max(np.abs(defect + np.swapaxes(defect, -1, -2))) / np.max(np.abs(rate))


def test_motion_makes_no_energy(arm, states):
    q, qdot = states[0], states[1] / 30.0
    assert skew_defect(arm, q, qdot, coriolis_matrix(arm, q, qdot)) < 1e-8


def test_the_printed_c322_makes_energy(arm, states, lagrangian):
    """A.95, and with it C32 in A.108, has the wrong sign: it is -m3 (l2 + q3 - r3)."""
    q, qdot = states[0], states[1] / 30.0
    printed = coriolis_matrix(arm, q, qdot)
    printed[:, 2, 1] = 0.007 * (0.041 + q[:, 2] - 0.016) * qdot[:, 1]
    assert skew_defect(arm, q, qdot, printed) > 0.1
    right = np.array([lagrangian.coriolis(*state) for state in zip(q, qdot, strict=True)])[:, 2, 1]
    assert right == pytest.approx(-printed[:, 2, 1], rel=1e-12)


def test_gravity_is_the_full_load_times_its_scale(arm, states):
    """Turned for u = 1 of each joint in turn, the arm bears the whole scale, which is all there can be."""
    q = states[0]
    angles = np.linspace(-np.pi, np.pi, 73)
    theta, psi = (angle.ravel() for angle in np.meshgrid(angles, angles))
    for row in q[:5]:
        worst = np.max(np.abs(gravity_forces(arm, row[None, :], theta, psi)), axis=0)
        assert np.all(worst <= np.abs(gravity_scale(arm, row)) * (1 + 1e-12))
        assert worst == pytest.approx(np.abs(gravity_scale(arm, row)), rel=2e-3)


def test_many_states_at_once(arm, states):
    q, qdot, theta, psi = (part[:6].reshape(2, 3, *part.shape[1:]) for part in states)
    for all_at_once, one in (
        (inertia_matrix(arm, q), inertia_matrix(arm, q[1, 2])),
        (coriolis_matrix(arm, q, qdot), coriolis_matrix(arm, q[1, 2], qdot[1, 2])),
        (gravity_forces(arm, q, theta, psi), gravity_forces(arm, q[1, 2], theta[1, 2], psi[1, 2])),
    ):
        assert all_at_once[1, 2] == pytest.approx(one, rel=1e-15)
    assert coriolis_matrix(arm, q, qdot[0, 0]).shape == (2, 3, 3, 3)
