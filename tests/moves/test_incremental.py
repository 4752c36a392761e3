"""Dead reckoning of a drive step by step, against drives simulated with drawn laws and held noise."""

import numpy as np
import pytest

from stickslip_fit.causes import library
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import read_log
from stickslip_fit.moves import DriveCommand, DriveReckoning, calibrated_arm, dead_reckon
from tests.conftest import CALIBRATION

START = [0.2, -1.3, 0.004]


@pytest.fixture(scope="module")
def fit(campaign, read_table):
    return fit_least_squares(read_table(campaign(settings=CALIBRATION * 2)))


@pytest.fixture(scope="module")
def arm(fit):
    return calibrated_arm(fit, theta=-0.2, psi=0.3)


def burst(drive, joint, way, steps, each=1):
    for number in range(0, steps, each):
        drive.advance(joint, way, each, 0.01 * number)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("each", [1, 5])
def test_bursts_end_where_one_drive_ends(arm, joint, each):
    """By the closed form of the counts, to a fiftieth of a step in 2,000."""
    drive = DriveReckoning(arm, START)
    burst(drive, joint, "+", 2000, each)
    whole = dead_reckon(arm, START, [DriveCommand(joint, "+", 2000)])
    step = drive.step_size(joint, "+", 0.0)
    assert abs(drive.q[joint - 1] - whole.q[joint - 1]) < 0.2 * step
    assert drive.q_error[joint - 1] == pytest.approx(whole.q_error[joint - 1], rel=0.01)
    assert drive.pose().tip == pytest.approx(whole.tip, abs=2e-6)


def test_noise_is_held_however_the_drive_is_cut(arm):
    _, _, _, repeatability = arm.law(3, "+")
    errors = {}
    for each in (1, 10, 1000):
        drive = DriveReckoning(arm, START)
        burst(drive, 3, "+", 1000, each)
        errors[each] = drive.q_error[2]
        assert errors[each] > repeatability * (drive.q[2] - START[2])
    assert errors[1] == pytest.approx(errors[1000], rel=2e-3)
    cut = dead_reckon(arm, START, [DriveCommand(3, "+", 100)] * 10)
    assert cut.q_error[2] < 0.9 * errors[1]


def test_there_and_back_the_two_directions_add_up(arm):
    drive = DriveReckoning(arm, START)
    burst(drive, 3, "+", 1000)
    forth = drive.variance(3)
    back = DriveReckoning(arm, drive.q)
    burst(drive, 3, "-", 900)
    burst(back, 3, "-", 900)
    assert drive.variance(3) == pytest.approx(forth + back.variance(3), rel=1e-9)


def simulate(arm, rng, moves, shared, count):
    """Joints after bursts under laws drawn from the fit, and one relative error of each joint and way."""
    q, laws, cause = np.tile(START, (count, 1)), {}, None
    for joint, way in dict.fromkeys((joint, way) for joint, way, _ in moves):
        law, values, covariance, repeatability = arm.law(joint, way)
        own = len(values) - shared
        block = covariance[own:, own:]
        if cause is None:
            cause = (
                rng.multivariate_normal(np.zeros(shared), block, count) if shared else np.zeros((count, 0))
            )
        gain = covariance[:own, own:] @ np.linalg.pinv(block) if shared else np.zeros((own, 0))
        rest = covariance[:own, :own] - gain @ block @ gain.T
        drawn = cause @ gain.T + rng.multivariate_normal(np.zeros(own), rest, count, method="svd")
        factor = np.exp(-repeatability * rng.standard_normal(count))
        laws[joint, way] = law, values + np.hstack([drawn, cause]), factor
    for joint, way, steps in moves:
        law, values, factor = laws[joint, way]
        sign = 1 if way == "+" else -1
        rows = {f"q{number + 1}": q[:, number] for number in range(3)}
        rows |= {name: np.full(count, of) for name, of in {"theta": arm.theta, "psi": arm.psi}.items()}
        rows |= {name: np.full(count, of) for name, of in arm.conditions.items()}
        rows |= {"start": q[:, joint - 1], "stop": q[:, joint - 1] + sign}
        gamma = law.step_size(rows, q[:, joint - 1, None], values)[:, 0]
        q[:, joint - 1] += sign * gamma * steps * factor
    return q


MOVES = [(joint, way, 30) for _ in range(4) for joint, way in ((1, "+"), (3, "-"), (2, "+"), (1, "-"))]


@pytest.mark.parametrize("warm", [False, True])
def test_the_covariance_is_that_of_drawn_laws(arm, campaign, tmp_path, warm):
    """Joints are correlated by the cause that they share, and by nothing else."""
    shared = 0
    if warm:
        campaign(settings=CALIBRATION).to_csv(tmp_path / "log.csv", index=False)
        cause = [one for one in library() if one.name == "drift"]
        arm = calibrated_arm(
            fit_least_squares(read_log(tmp_path / "log.csv"), causes=cause),
            conditions={"session_seconds": 2e5},
        )
        shared = 1
    drive = DriveReckoning(arm, START)
    for joint, way, steps in MOVES:
        burst(drive, joint, way, steps, 30)
    rng, count = np.random.default_rng(8), 2000
    drawn = simulate(arm, rng, MOVES, shared, count)
    error = np.std(drawn, axis=0)
    assert np.all(np.abs(drawn.mean(axis=0) - drive.q) < 4 * error / np.sqrt(count))
    assert drive.q_error == pytest.approx(error, rel=4 / np.sqrt(2 * count))
    covariance = drive.joint_covariance()
    correlation = covariance / np.outer(drive.q_error, drive.q_error)
    assert correlation == pytest.approx(np.corrcoef(drawn.T), abs=4 / np.sqrt(count))
    assert (abs(correlation[1, 2]) > 0.3) == warm


def test_a_stop_ends_the_errors_of_its_joint(arm):
    drive = DriveReckoning(arm, START)
    burst(drive, 3, "-", 500)
    burst(drive, 1, "+", 100)
    drive.place(3, 0.0)
    assert drive.variance(3) == 0.0
    assert drive.variance(1) > 0.0
    assert drive.pose().at_stop == (3,)
    again = DriveReckoning(arm, [drive.q[0], START[1], 0.0])
    burst(drive, 3, "+", 100)
    burst(again, 3, "+", 100)
    assert drive.variance(3) == pytest.approx(again.variance(3), rel=1e-6)


def test_a_doubtful_burst_is_halfway_between_made_and_not_made(arm):
    drive = DriveReckoning(arm, START)
    moved = drive.advance(1, "+", 4, 0.0)
    drive.doubt(1, moved)
    assert drive.q[0] == pytest.approx(START[0] + moved / 2)
    assert 1.96 * drive.q_error[0] > moved / 2
    for _ in range(9):
        drive.doubt(1, drive.advance(1, "+", 4, 0.0))
    assert 1.96 * drive.q_error[0] > 10 * moved / 2, "all may have been made, or none"


def test_steps_lost_at_a_reversal(fit, campaign, read_table):
    from dataclasses import replace

    causes = [cause for cause in library() if cause.name == "reversal-loss"]
    result = fit_least_squares(read_table(campaign(settings=CALIBRATION + CALIBRATION[::-1])), causes=causes)
    joints = {
        joint: replace(own, values=np.column_stack([own.values[:, :-1], np.full(len(own.values), 30.0)]))
        for joint, own in result.joints.items()
    }
    drive = DriveReckoning(replace(result, joints=joints), START)
    burst(drive, 3, "+", 100)
    there = drive.q[2]
    burst(drive, 3, "-", 30)
    assert drive.q[2] == pytest.approx(there, abs=1e-12)
    burst(drive, 3, "-", 10)
    assert drive.q[2] == pytest.approx(there - 10 * drive.step_size(3, "-", 0.0), rel=1e-4)


def test_a_joint_without_calibration_is_refused(arm):
    from dataclasses import replace

    alone = replace(arm, result=replace(arm.result, joints={3: arm.result.joints[3]}))
    with pytest.raises(InputError, match="joint 1 has no calibration"):
        DriveReckoning(alone, START).advance(1, "+", 1, 0.0)
