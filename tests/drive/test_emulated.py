"""Dead reckoning of a drive beside the emulated manipulator, burst by burst."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.capture.emulator.manipulator import HiddenLaws, Manipulator
from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.drive.emulated import draw_laws
from stickslip_fit.logs.plan import Noise
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.simulation import LawValues

START = [0.3, -1.2, 0.006]
GROUPS = [(joint, way) for joint in (1, 2, 3) for way in "+-"]
SIZES = {
    "thermal-warm-up": [0.05, 300.0],
    "drift": [0.5 / 3600],
    "wear": [0.05, 300.0],
    "reversal-loss": [7.0],
    "load-hysteresis": [0.05],
}


def extended(arm, name):
    """The arm, and its laws as a truth, with a cause of known size in both."""
    causes = [cause for cause in library() if cause.name == name]
    conditions = {"session_seconds": 0.0, "steps_before": 0} if causes else {}
    joints, values = {}, {}
    for joint, fit in arm.result.joints.items():
        law = ExtendedLaw(fit.law, tuple(causes)) if causes else fit.law
        sizes = SIZES[name] if causes else []
        sizes = (sizes * 9)[: len(law.parameters) - fit.values.shape[1]]
        whole = np.column_stack([fit.values, np.tile(sizes, (len(fit.values), 1))])
        covariance = np.zeros((len(whole), whole.shape[1], whole.shape[1]))
        covariance[:, : fit.values.shape[1], : fit.values.shape[1]] = fit.covariance
        known = np.ones(whole.shape, bool)
        joints[joint] = replace(fit, law=law, values=whole, covariance=covariance, known=known)
    arm = replace(arm, result=replace(arm.result, joints=joints), conditions=conditions)
    for joint, way in GROUPS:
        values[joint, way, None] = arm.law(joint, way)[1]
    return arm, LawValues({joint: fit.law for joint, fit in joints.items()}, values)


def drive_both(drive, manipulator, seed, bursts=100):
    rng, moment = np.random.default_rng(seed), 0.0
    for _ in range(bursts):
        joint, steps = int(rng.integers(1, 4)), int(rng.choice([-9, -3, 4, 12]))
        manipulator.step(joint, steps, moment, 0.01)
        drive.advance(joint, "+" if steps > 0 else "-", abs(steps), moment)
        moment += 0.01 * abs(steps) + float(rng.choice([0.0, 0.5, 3.0]))
    return np.array([manipulator.position(joint) for joint in (1, 2, 3)])


@pytest.mark.parametrize(
    "name",
    [
        "thermal-warm-up",
        pytest.param("reversal-loss", marks=pytest.mark.slow),
        *(
            pytest.param(name, marks=pytest.mark.nightly)
            for name in ("nothing", "drift", "wear", "load-hysteresis")
        ),
    ],
)
def test_it_is_where_the_manipulator_is(arm, name):
    arm, laws = extended(arm, name)
    manipulator = Manipulator(HiddenLaws(laws, arm.machine), arm.session)
    manipulator.set(**{f"q{number + 1}": START[number] for number in range(3)})
    drive = DriveReckoning(arm, START)
    true = drive_both(drive, manipulator, seed=2)
    step = np.array([drive.step_size(joint, "+", 0.0) for joint in (1, 2, 3)])
    assert np.all(np.abs(true - drive.q) < 0.4 * step)


@pytest.mark.slow
def test_a_drive_has_one_relative_error_until_a_stop(arm):
    _, laws = extended(arm, "nothing")
    truth = HiddenLaws(laws, arm.machine, Noise(dict.fromkeys(GROUPS, 0.01)), seed=6)

    def displacements(held):
        manipulator = Manipulator(truth, arm.session)
        manipulator.set(**{f"q{number + 1}": START[number] for number in range(3)})
        if held:
            manipulator.begin_drive()
        moved, moment = [], 0.0
        for _ in range(20):
            for joint in (3, 1):
                before = manipulator.position(joint)
                manipulator.step(joint, 100, moment, 0.01)
                moment += 10.0
                moved += [manipulator.position(joint) - before] if joint == 3 else []
        return np.array(moved), manipulator, moment

    held, manipulator, moment = displacements(held=True)
    assert np.std(held) < 1e-4 * np.mean(held)
    single, _, _ = displacements(held=False)
    assert 0.004 < np.std(single) / np.mean(single) < 0.02
    manipulator.step(3, -20_000, moment, 0.01)
    assert manipulator.position(3) == 0.0
    before = manipulator.position(3)
    manipulator.step(3, 100, moment + 300, 0.01)
    assert manipulator.position(3) - before != pytest.approx(np.mean(held), rel=1e-3)


def test_true_laws_are_drawn_as_the_calibration_says(arm):
    rng = np.random.default_rng(3)
    drawn = [draw_laws(arm, rng) for _ in range(100)]
    for group in GROUPS:
        _, values, covariance, _ = arm.law(*group)
        errors = np.array([laws.values[*group, None] for laws in drawn]) - values
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), errors.T)
        assert np.abs(whitened.mean(axis=1)) == pytest.approx(0.0, abs=4 / np.sqrt(100))
        assert whitened.std(axis=1) == pytest.approx(1.0, abs=4 / np.sqrt(200))
