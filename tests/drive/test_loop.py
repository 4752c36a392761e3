"""The loop, on joints that step as they are told."""

import json
from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.capture.protocols import VirtualClock
from stickslip_fit.drive.loop import DriveLoop, StepTiming
from stickslip_fit.drive.record import BurstRecord
from stickslip_fit.drive.state import VelocityInput
from stickslip_fit.drive.velocity import joint_velocity
from stickslip_fit.machine import forward
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.units import Z_95
from tests.drive.rig import Hand, Shown, Steps, joint, tip

START = [0.2, -1.3, 0.006]


def drive_of(arm, wishes, start=START, tolerance=1.0, period=0.01, **options):
    clock = VirtualClock()
    controller, shown = Steps(clock, period), Shown()
    reckoning = DriveReckoning(arm, start)
    inputs = (Hand(wishes), shown, BurstRecord(), tolerance)
    return DriveLoop(reckoning, controller, clock, *inputs, **options), controller, shown


def test_the_tip_goes_where_it_is_sent(arm):
    loop, controller, _ = drive_of(arm, [(10.0, tip(20, -10, 15)), (15.0, tip(0, 30, 0))])
    state = loop.run()
    wanted = forward(arm.machine, START) + np.array([200, 50, 150]) * 1e-6
    steps_long = np.array([60e-3 * 97e-6, 50e-3 * 100e-6, 1e-6])
    assert np.linalg.norm(state.tip - wanted) < np.linalg.norm(steps_long)
    assert np.allclose(loop.commanded_tip, wanted, atol=0.3e-6)
    assert state.steps == tuple(controller.total(number) for number in (1, 2, 3))
    assert state.time == pytest.approx(15.0, abs=0.03)


def test_a_slow_velocity_is_followed_by_single_steps_without_dithering(arm):
    """12 µm along y in 8 s are two and a half steps of joint 1; the others hardly move."""
    loop, controller, _ = drive_of(arm, [(8.0, tip(0, 1.5, 0))])
    loop.run()
    signs = {
        number: {np.sign(steps) for _, moved, steps in controller.made if moved == number}
        for number in (1, 2, 3)
    }
    assert all(len(own) <= 1 for own in signs.values())
    assert 2 <= controller.total(1) <= 3


def test_a_reversal_waits_for_a_whole_step(arm):
    """Half a micrometre to and fro is less than a step of joint 1: it never moves back and forth."""
    to_and_fro = [(0.5 * number, tip(0, 4.0 * (-1) ** number, 0)) for number in range(1, 41)]
    loop, controller, _ = drive_of(arm, to_and_fro)
    loop.run()
    assert len([made for made in controller.made if made[1] == 1]) <= 1


def test_no_more_steps_than_the_controller_makes_and_the_direction_is_kept(arm):
    """One joint's step after the other's: 100 a second of all joints together."""
    loop, controller, shown = drive_of(arm, [(4.0, tip(150, 150, 150))])
    start = np.array(loop.commanded_tip)
    state = loop.run()
    assert sum(abs(steps) for _, _, steps in controller.made) <= 401
    way = np.array(loop.commanded_tip) - start
    assert way / np.linalg.norm(way) == pytest.approx(np.ones(3) / np.sqrt(3), abs=2e-3)
    assert np.linalg.norm(state.tip - loop.commanded_tip) < 8e-6
    assert "slowed down to" in shown.states[5].limits[0]


@pytest.mark.parametrize(
    ("period", "command", "rate"), [(0.010, 0.010, 50), (0.025, 0.0, 40), (0.002, 0.0, 500)]
)
def test_the_rate_is_that_of_the_controller(arm, period, command, rate):
    timing = StepTiming(period, command)
    wishes = [(4.0, joint(3, 2e-3))]
    loop, controller, _ = drive_of(arm, wishes, period=period + command, timing=timing)
    loop.run()
    assert controller.total(3) == pytest.approx(4.0 * rate, rel=0.05)


def test_nothing_moves_once_the_input_is_no_longer_valid(arm):
    class Once:
        def read(self, now):
            return VelocityInput(**tip(0, 0, 60), valid_until=0.5, ends=now > 2)

    loop, controller, shown = drive_of(arm, [])
    loop.device = Once()
    loop.run()
    assert 0.47 < controller.made[-1][0] < 0.5
    assert shown.states[-2].status == "idle"


def test_time_that_a_stalled_program_has_missed_is_not_made_up_for(arm):
    loop, controller, _ = drive_of(arm, [(10.0, tip(0, 0, 60))])
    for _ in range(100):
        loop.tick()
        loop.clock.sleep(0.001)
    before = len(controller.made)
    loop.clock.sleep(5.0)
    loop.tick()
    assert len(controller.made) - before <= 1
    for _ in range(10):
        loop.tick()
    assert len(controller.made) - before <= 12


def test_a_pulled_plug_ends_the_drive_and_leaves_the_last_burst_in_doubt(arm):
    loop, controller, _ = drive_of(arm, [(10.0, tip(0, 0, 60))])
    controller.fails_after = 40
    state = loop.run()
    assert state.status == "stopped"
    assert "the plug is out" in state.message
    true = DriveReckoning(arm, START)
    for moment, moved, steps in controller.made:
        true.advance(moved, "+" if steps > 0 else "-", abs(steps), moment)
    assert np.any(loop.drive.q != np.array(true.q))
    assert np.all(np.abs(np.array(true.q) - loop.drive.q) <= Z_95 * loop.drive.q_error)


def test_a_frozen_screen_stops_the_joints_and_they_go_on_when_it_is_back(arm):
    frozen = {"age": 0.0}
    loop, controller, shown = drive_of(arm, [(3.0, tip(0, 0, 60))], screen_age=lambda: frozen["age"])
    while loop.tick():
        loop.clock.sleep(0.001)
        frozen["age"] = 5.0 if 1.0 < loop.clock.now() < 2.0 else 0.0
    moments = np.array([moment for moment, _, _ in controller.made])
    assert not np.any((moments > 1.03) & (moments < 1.99))
    assert np.any(moments > 2.0)
    assert any("frozen" in state.message for state in shown.states)


@pytest.mark.parametrize(("number", "rate"), [(3, 70e-6), (2, 5e-3), (1, -5e-3)])
def test_a_joint_stops_before_where_it_may_stand_at_its_stop(arm, number, rate):
    """Its end less 1.96 standard deviations, which a start that is known badly shows."""
    start, error = list(START), [0.0, 0.0, 0.0]
    end = arm.machine.ranges[number][rate > 0]
    start[number - 1] = end - 30 * rate
    error[number - 1] = 5 * abs(rate)
    loop, _, _ = drive_of(arm, [(40.0, joint(number, rate))])
    loop.drive = DriveReckoning(arm, start, error)
    loop.diffusion.target = list(start)
    state = loop.run()
    edge = end - np.sign(rate) * Z_95 * np.sqrt(loop.drive.variance(number))
    step = loop.drive.step_size(number, "+" if rate > 0 else "-", 0.0)
    assert 0 <= (edge - state.q[number - 1]) * np.sign(rate) <= 2.5 * step
    assert state.limits == (f"joint {number} is at its soft limit",)
    assert state.status == "stopped"


def test_a_limit_holds_the_whole_tip_back_and_lets_it_go_the_other_way(arm):
    """Half a limit would send the tip elsewhere than wanted."""
    start = [0.0, -1.3, 0.0119]
    wishes = [(6.0, joint(3, 0.1e-3)), (8.0, joint(3, -0.1e-3))]
    loop, controller, shown = drive_of(arm, wishes, start)
    loop.run()
    turned = [moment for moment, _, steps in controller.made if steps < 0]
    assert 6.0 <= turned[0] + 1e-9 < 6.1
    assert {state.status for state in shown.states if 3.0 < state.time < 6.0} == {"stopped"}
    assert shown.states[-3].message == ""


@pytest.mark.slow
def test_the_advice_counts_down_to_the_tolerance(arm):
    loop, _, shown = drive_of(arm, [(60.0, joint(3, -60e-6))], tolerance=3e-6)
    loop.run()
    advised = [state for state in shown.states if state.advice is not None]
    first = advised[0]
    assert first.tip_radius == pytest.approx(0.75 * 3e-6, rel=0.05)
    assert (first.advice.joint, first.advice.direction) == (3, "-")
    expected = first.q[2] / loop.drive.step_size(3, "-", 0.0)
    assert first.advice.steps_to_stop == pytest.approx(expected, rel=0.01)
    exceeds = next(state for state in advised if state.tip_radius >= 3e-6)
    made = abs(exceeds.steps[2] - first.steps[2])
    assert first.advice.steps_left == pytest.approx(made, rel=0.05, abs=15)
    assert exceeds.advice.steps_left == 0


def test_at_rest_the_advice_counts_the_steps_home(arm):
    loop, _, _ = drive_of(arm, [(8.0, joint(3, -60e-6)), (9.0, {})], tolerance=3e-6)
    state = loop.run()
    assert state.tip_radius < 3e-6
    steps = state.advice.steps_left
    assert steps > 50
    for _ in range(steps):
        loop.drive.advance(3, "-", 1, 20.0)
    radius = loop.state().tip_radius
    assert radius == pytest.approx(3e-6, rel=0.01)


def test_single_joints_go_at_the_rate_wanted(arm):
    loop, controller, _ = drive_of(arm, [(5.0, joint(2, 2e-3))])
    state = loop.run()
    assert state.q[1] - START[1] == pytest.approx(10e-3, abs=1.2e-4)
    assert controller.total(1) == controller.total(3) == 0


def test_near_the_axis_the_person_is_told(arm):
    loop, _, shown = drive_of(arm, [(1.0, tip(0, 20, 0))], [0.0, np.arcsin(0.0125 / 0.0435), 0.006])
    loop.run()
    assert "near the axis of joint 1" in shown.states[3].limits[0]
    far = shown.states[3]
    assert np.linalg.norm(far.tip_velocity) < 0.5 * np.linalg.norm(far.wanted_velocity)


def test_the_state_goes_out_in_plain_numbers(arm):
    loop, _, _ = drive_of(arm, [(2.0, tip(0, 20, 0))], tolerance=1e-7)
    content = json.loads(json.dumps(loop.run().to_json()))
    assert content["advice"]["joint"] == 1
    assert content["status"] == "idle"
    rates = joint_velocity(arm.machine, START, (0, 20e-6, 0))
    assert content["q"][0] == pytest.approx(START[0] + 2 * rates[0], abs=1e-4)


def test_a_joint_without_calibration_stays_where_it_is_and_the_others_go(arm):
    joints = {number: arm.result.joints[number] for number in (2, 3)}
    partial = replace(arm, result=replace(arm.result, joints=joints))
    wishes = [(1.0, tip(20, 0, 10)), (2.0, tip(0, 20, 0))]
    loop, controller, shown = drive_of(partial, wishes, [0.0, -1.3, 0.006])
    loop.run()
    assert controller.made
    assert {moved for _, moved, _ in controller.made} <= {2, 3}
    assert all(moment < 1.0 for moment, _, _ in controller.made)
    assert shown.states[-2].status == "stopped"
    assert "joint 1 has no calibration" in shown.states[-2].message


def test_a_law_without_error_bars_drives_nothing(arm):
    """Nobody could say how surely the tip is where it is said to be, nor where a soft limit lies."""
    fits = {
        number: replace(fit, covariance=np.full_like(fit.covariance, np.nan))
        for number, fit in arm.result.joints.items()
    }
    unsure = replace(arm, result=replace(arm.result, joints=fits))
    loop, controller, _ = drive_of(unsure, [(0.5, tip(0, 0, 20))])
    state = loop.run()
    assert not controller.made
    assert "no error bars" in state.message
