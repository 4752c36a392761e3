import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.machine import forward, load_machine
from stickslip_fit.moves import (
    DriveCommand,
    calibrated_arm,
    dead_reckon,
    plan_move,
    steps_before_recalibration,
)

N_MOVES = 120


@pytest.fixture(scope="module")
def arm(campaign, read_table):
    return calibrated_arm(fit_least_squares(read_table(campaign())))


def stepped(arm, q, joint, way, steps):
    """Where a joint ends that literally makes its steps one by one."""
    law, values, _, _ = arm.law(joint, way)
    q = np.array(q, float)
    row = arm.drive_row(q, joint, arm.machine.ranges[joint][way == "+"])
    for _ in range(steps):
        gamma = law.step_size(row, np.array([[q[joint - 1]]]), values)[0, 0]
        q[joint - 1] += gamma if way == "+" else -gamma
    return q[joint - 1]


def test_the_latest_session_is_taken_unless_another_is_named(arm):
    assert arm.session == "2012-03-06"
    assert calibrated_arm(arm.result, "2012-03-05").session == "2012-03-05"
    with pytest.raises(InputError, match="'1999' is not in this result; it has 2012-03-05, 2012-03-06"):
        calibrated_arm(arm.result, "1999")


def test_a_drive_that_no_controller_can_make_is_refused():
    for way, steps, told in (
        ("x", 500, "'x'"),
        ("+", -500, "steps .* not -500"),
        ("-", 0.5, "steps .* not 0.5"),
    ):
        with pytest.raises(InputError, match=told):
            DriveCommand(3, way, steps)


@pytest.mark.parametrize(
    ("q", "joint", "way", "steps"),
    [((0.0, 0.3, 0.004), 2, "-", 900), ((0.2, -1.5, 0.0), 3, "+", 800), ((1.0, -1.5, 0.006), 1, "+", 700)],
)
def test_where_agrees_with_literal_steps(arm, q, joint, way, steps):
    found = dead_reckon(arm, np.array(q), [DriveCommand(joint, way, steps)])
    step = abs(stepped(arm, q, joint, way, 1) - q[joint - 1])
    assert found.q[joint - 1] == pytest.approx(stepped(arm, q, joint, way, steps), abs=step)
    assert found.tip == pytest.approx(forward(load_machine(), found.q))


def test_a_move_there_and_where_it_ends_agree(arm):
    start, target = np.array([-0.4, -2.2, 0.001]), np.array([0.5, -1.0, 0.009])
    move = plan_move(arm, start, target, order=(3, 1, 2))
    assert [leg.joint for leg in move.segments] == [3, 1, 2]
    found = dead_reckon(
        arm, start, [DriveCommand(leg.joint, leg.direction, leg.steps) for leg in move.segments]
    )
    one_step = np.array([1e-4, 1.3e-4, 1.1e-6])
    assert np.all(np.abs(found.q - target) < one_step)
    assert move.tip == pytest.approx(forward(load_machine(), target))


@pytest.mark.slow
def test_the_tip_radius_holds_95_percent_of_many_moves(arm):
    """Draw laws from the fit's own uncertainty and repeatability, make the move, look at the tips."""
    rng = np.random.default_rng(3)
    start, target = np.array([0.0, -2.0, 0.0]), np.array([0.3, -1.2, 0.008])
    move = plan_move(arm, start, target)
    tips = []
    for _ in range(N_MOVES):
        q = start.copy()
        for leg in move.segments:
            law, values, covariance, repeatability = arm.law(leg.joint, leg.direction)
            drawn = rng.multivariate_normal(values, covariance, method="svd")
            there = np.array(q)
            there[leg.joint - 1] = leg.stop
            counts = law.counts(arm.drive_row(q, leg.joint, leg.stop), drawn)[0][0]
            share = leg.steps / (counts * np.exp(repeatability * rng.standard_normal()))
            q[leg.joint - 1] += share * (leg.stop - leg.start)
        tips.append(forward(arm.machine, q))
    inside = np.linalg.norm(np.array(tips) - move.tip, axis=1) < move.tip_radius
    assert np.mean(inside) == pytest.approx(0.95, abs=3 * np.sqrt(0.05 * 0.95 / N_MOVES))


def test_errors_of_a_law_add_up_over_drives_and_noise_does_not(arm):
    start = np.array([0.0, -1.5, 0.0])
    one = dead_reckon(arm, start, [DriveCommand(3, "+", 8000)])
    many = dead_reckon(arm, start, [DriveCommand(3, "+", 1000)] * 8)
    assert many.q[2] == pytest.approx(one.q[2], abs=1e-10)
    _, _, _, repeatability = arm.law(3, "+")
    gone = one.q[2]
    from_law = one.q_error[2] ** 2 - (repeatability * gone) ** 2
    assert many.q_error[2] ** 2 == pytest.approx(from_law + (repeatability * gone) ** 2 / 8, rel=1e-6)


def test_a_stop_makes_the_position_known_again(arm):
    start = np.array([0.0, -1.5, 0.0])
    found = dead_reckon(
        arm, start, [DriveCommand(3, "+", 5000), DriveCommand(3, "-", 20000), DriveCommand(3, "+", 1000)]
    )
    direct = dead_reckon(arm, start, [DriveCommand(3, "+", 1000)])
    assert found.q == pytest.approx(direct.q)
    assert found.q_error == pytest.approx(direct.q_error)
    assert 3 not in found.at_stop


def test_a_drive_that_may_or_may_not_reach_the_stop_is_refused(arm):
    start = np.array([0.0, -np.pi / 2, 0.0])
    with pytest.raises(InputError, match="may or may not reach its stop"):
        dead_reckon(arm, start, [DriveCommand(3, "+", 12295)])


def test_when_to_go_back_to_a_stop(arm):
    at = dead_reckon(arm, np.array([0.0, -1.5, 0.0]), [DriveCommand(3, "+", 3000)])
    tolerance = 1.5 * at.tip_radius
    further = steps_before_recalibration(arm, at, 3, "+", tolerance)
    assert further is not None
    before, after = (
        dead_reckon(
            arm,
            np.array([0.0, -1.5, 0.0]),
            [DriveCommand(3, "+", 3000), DriveCommand(3, "+", further + extra)],
        )
        for extra in (-400, 400)
    )
    assert before.tip_radius < tolerance * 1.05
    assert after.tip_radius > tolerance * 0.8
    assert steps_before_recalibration(arm, at, 3, "+", 0.5 * at.tip_radius) == 0
    assert steps_before_recalibration(arm, at, 3, "+", 1.0) is None


def test_positions_outside_the_range_are_refused(arm):
    with pytest.raises(InputError, match=r"target q3 = 15.00 mm is outside its range, 0.00 mm to 12.00 mm"):
        plan_move(arm, np.array([0.0, -1.0, 0.0]), np.array([0.0, -1.0, 0.015]))


def test_a_law_that_is_not_known_is_not_used(campaign, read_table):
    table = campaign(settings=({"joint": 3, "q2_deg": -90.0},))
    arm = calibrated_arm(fit_least_squares(read_table(table)))
    with pytest.raises(InputError, match="b and c cannot be known"):
        plan_move(arm, np.array([0.0, -1.0, 0.0]), np.array([0.0, -1.0, 0.006]))
    with pytest.raises(InputError, match="joint 2 has no calibration"):
        plan_move(arm, np.array([0.0, -1.0, 0.0]), np.array([0.0, -0.5, 0.0]))
