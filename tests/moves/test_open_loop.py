from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.with_causes import FixedCauseLaw
from stickslip_fit.laws import Base, Elbow, Prismatic
from stickslip_fit.machine import load_machine
from stickslip_fit.moves import (
    DriveCommand,
    TrueLaws,
    calibrated_arm,
    dead_reckon,
    draw_random_paths,
    plan_steps,
    position_after,
    simulate_open_loop,
    step_model_from_parameters,
    straight_path,
)
from stickslip_fit.simulation import step_through
from tests.conftest import Truth as ByHand
from tests.moves.truth import step_models_from_truth

MACHINE = load_machine()
LAWS = {1: Base(MACHINE), 2: Elbow(MACHINE), 3: Prismatic()}
UNITS = {1: [1e-6, 1e-3, 1e-6, 1e-3], 2: [1e-6] * 4, 3: [1e-9, 1.0, 1e-9]}
HAND = ByHand()
PARTS = {1: HAND.base, 2: HAND.elbow, 3: HAND.prismatic}
VALUES = {(joint, way): np.array(PARTS[joint][way]) * UNITS[joint] for joint in LAWS for way in "+-"}
GROUPS = list(VALUES)
STEP = np.array([96e-6, 92e-6, 0.95e-6])
SIZES = {
    "thermal-warm-up": {"A": 0.03, "tau": 1200.0},
    "q1-gravity": {"k": 1.0},
    "psi-offset": {"delta": 0.05},
    "guide-gradient": {"k": 20.0},
    "cable-torque": {},
}


def truth(*names, sessions=("Monday",), **given):
    """Sessions under the laws of the tests' own campaign, with causes of known size."""
    causes = tuple(cause for cause in library() if cause.name in names)
    sizes = [SIZES[cause.name].get(each.name, 1e-7) for cause in causes for each in cause.parameters]
    laws = {joint: ExtendedLaw(law, causes) if causes else law for joint, law in LAWS.items()}
    values = {group: np.append(own, sizes) for group, own in VALUES.items()}
    return TrueLaws(sessions, laws, values, conditions={"session_seconds": 600.0}, **given)


def commanded(paths, true):
    return plan_steps(paths, step_models_from_truth(true), true.sessions, true.conditions)


def test_the_joints_end_where_literal_steps_take_them():
    """Against the tests' own laws in deg and mm, one step after another."""
    paths, true = draw_random_paths(MACHINE, 5, seed=8, n_segments=2), truth()
    steps = commanded(paths, true)
    found = simulate_open_loop(paths, true, steps)[0]
    scale, base = np.array([np.degrees(1), np.degrees(1), 1e3]), np.degrees([paths.theta, paths.psi]).T
    for move in range(len(paths)):
        q = paths.joint_positions[move, 0] * scale
        for part in (part for part in paths.segments if move in part.moves):
            unit = 1e-6 if part.joint == 3 else np.degrees(1e-6)
            for _ in range(int(steps[0, move, part.drive_index])):
                gamma = HAND.step_size(part.joint, part.direction, tuple(q), tuple(base[move]))
                q[part.joint - 1] += unit * gamma * (1 if part.direction == "+" else -1)
        assert np.all(np.abs(found[move] - q / scale) < 0.01 * STEP)


@pytest.mark.parametrize("name", SIZES)
def test_the_joints_end_where_the_emulated_manipulator_takes_them(name):
    """With a cause at work, step after step until the joint is where it is said to end."""
    paths, true = draw_random_paths(MACHINE, 4, seed=9), truth(name)
    steps = commanded(paths, true)
    found, q = simulate_open_loop(paths, true, steps)[0], paths.joint_positions[:, 0].copy()
    for part in paths.segments:
        stop = found[part.moves, part.joint - 1]
        rows = {f"q{joint}": q[part.moves, joint - 1] for joint in LAWS}
        rows |= {"theta": paths.theta[part.moves], "psi": paths.psi[part.moves], "stop": stop}
        rows |= {"start": q[part.moves, part.joint - 1], "session_seconds": np.full(len(stop), 600.0)}
        law, values = true.laws[part.joint], true.values[part.joint, part.direction]
        made, expected = step_through(law, rows, values), steps[0, part.moves, part.drive_index]
        assert np.all((made - expected >= 0) & (made - expected <= 1))
        q[part.moves, part.joint - 1] = stop


@pytest.mark.parametrize("legs", [1, 7])
def test_a_calibration_that_is_right_leaves_half_a_step(legs):
    paths, true = draw_random_paths(MACHINE, 300, seed=3, n_segments=legs), truth("q1-gravity")
    off = np.abs(simulate_open_loop(paths, true, commanded(paths, true))[0] - paths.joint_positions[:, -1])
    largest = STEP + np.array([24e-6, 26e-6, 0.46e-6])  # with the whole load in its favour
    assert np.all(off < 0.51 * largest)
    assert np.all(off.max(axis=0) > 0.4 * STEP)


def test_a_session_factor_stretches_every_drive():
    paths = draw_random_paths(MACHINE, 20, seed=6)
    sessions = ("Monday", "Tuesday")
    factor = dict.fromkeys(GROUPS, np.array([1.0, 1.02]))
    true = truth(sessions=sessions, factor=factor)
    steps = commanded(paths, truth(sessions=sessions))
    monday, tuesday = simulate_open_loop(paths, true, steps) - paths.joint_positions[:, 0]
    assert tuesday == pytest.approx(1.02 * monday, rel=3e-3, abs=1e-9)
    assert tuesday != pytest.approx(monday, rel=3e-3, abs=1e-9)
    again = simulate_open_loop(paths, true, commanded(paths, true))
    assert np.abs(again - paths.joint_positions[:, -1]) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("lost", [30.0, -30.0])
def test_steps_lost_or_gained_at_a_reversal(lost):
    causes = tuple(cause for cause in library() if cause.name == "reversal-loss")
    laws = {joint: ExtendedLaw(law, causes) for joint, law in LAWS.items()}
    true = TrueLaws(("Monday",), laws, {group: np.append(own, lost) for group, own in VALUES.items()})
    paths, plain = draw_random_paths(MACHINE, 40, seed=7), truth()
    steps = np.full((1, 40, 3), 100.0)
    turned = np.sign(paths.joint_positions[:, -1] - paths.joint_positions[:, 0]) != paths.arrival_direction
    expected = simulate_open_loop(paths, plain, np.where(turned, steps - lost, steps))
    assert simulate_open_loop(paths, true, steps) == pytest.approx(expected, rel=1e-9)
    faster = {group: np.array([1.1]) for group in GROUPS}
    lame = simulate_open_loop(paths, replace(true, factor=faster), steps)
    assert lame == pytest.approx(
        simulate_open_loop(paths, replace(plain, factor=faster), np.where(turned, steps - lost, steps)),
        rel=1e-9,
    )
    few = simulate_open_loop(paths, true, np.full((1, 40, 3), 20.0))[0]
    assert np.array_equal(np.abs(few - paths.joint_positions[:, 0]) < 0.01 * STEP, turned & (lost > 20))


def test_a_move_hears_no_stop():
    causes = tuple(cause for cause in library() if cause.name == "end-stop-latency")
    late = {group: np.append(own, 50.0) for group, own in VALUES.items()}
    laws = {joint: ExtendedLaw(law, causes) for joint, law in LAWS.items()}
    paths, plain = draw_random_paths(MACHINE, 20, seed=7), truth()
    steps = commanded(paths, plain)
    assert simulate_open_loop(paths, TrueLaws(("Monday",), laws, late), steps) == pytest.approx(
        simulate_open_loop(paths, plain, steps)
    )
    for calibration in (
        {group: step_model_from_parameters(laws[group[0]], late[group]) for group in GROUPS},
        {
            g: step_model_from_parameters(FixedCauseLaw(LAWS[g[0]], causes, np.array([50.0])), VALUES[g])
            for g in GROUPS
        },
    ):
        assert np.array_equal(plan_steps(paths, calibration, ("Monday",), {}), steps)


def test_a_joint_stops_at_its_stop():
    path = straight_path(MACHINE, [0.0, -1.2, 0.0105], [0.0, 0.0, 1.0], 1e-3)
    reached = simulate_open_loop(path, truth(), np.full((1, 1, 3), 50_000.0))
    moved = path.joint_positions[0, -1] > path.joint_positions[0, 0]
    ends = [MACHINE.ranges[joint][1] for joint in LAWS]
    assert reached[0, 0, moved].tolist() == [end for end, way in zip(ends, moved, strict=True) if way]


def test_what_a_calibration_does_not_know_stays_unknown():
    paths, true = draw_random_paths(MACHINE, 30, seed=1), truth()
    right = step_models_from_truth(true)
    gone = right | {(3, "+"): lambda rows: np.full(len(rows), np.nan)}
    found = simulate_open_loop(paths, true, plan_steps(paths, gone, true.sessions, {}))[0]
    forth = paths.joint_positions[:, -1, 2] > paths.joint_positions[:, 0, 2]
    assert np.array_equal(np.isnan(found).any(axis=1), forth)
    with pytest.raises(InputError, match="joint 3 has no calibration in direction -"):
        plan_steps(paths, {g: of for g, of in right.items() if g != (3, "-")}, true.sessions, {})


def test_a_joint_that_would_come_to_a_halt_is_named():
    paths, true = draw_random_paths(MACHINE, 30, seed=1), truth()
    stalled = TrueLaws(true.sessions, true.laws, true.values | {(3, "+"): np.array([1e-7, 0.0, 9e-7])})
    with pytest.raises(InputError, match="joint 3 comes to a halt"):
        simulate_open_loop(paths, stalled, commanded(paths, true))


def test_noise_goes_with_the_way():
    paths, noise = (
        draw_random_paths(MACHINE, 25, seed=2),
        np.random.default_rng(1).standard_normal((1, 25, 3)),
    )
    true = truth(repeatability=dict.fromkeys(GROUPS, 0.01))
    steps = commanded(paths, true)
    still, shaken = simulate_open_loop(paths, true, steps), simulate_open_loop(paths, true, steps, noise)
    gone = still - paths.joint_positions[:, 0]
    assert shaken - still == pytest.approx(-0.01 * noise * gone, abs=4e-4 * np.abs(gone).max())


@pytest.fixture(scope="module")
def arm(campaign, read_table):
    return calibrated_arm(fit_least_squares(read_table(campaign())), theta=-0.3, psi=0.2)


def test_a_users_drives_and_those_of_many_moves_agree(arm):
    path = straight_path(
        arm.machine, [0.3, -1.4, 0.004], [0.0, 0.6, -0.8], 2e-3, n_segments=4, theta=-0.3, psi=0.2
    )
    laws = {joint: fit.law for joint, fit in arm.result.joints.items()}
    true = TrueLaws((arm.session,), laws, {group: arm.law(*group)[1] for group in GROUPS})
    steps = commanded(path, true)
    numbers = steps[steps > 0].astype(int).tolist()
    drives = [
        DriveCommand(segment.joint, segment.direction, number)
        for segment, number in zip(path.segments, numbers, strict=True)
    ]
    found = dead_reckon(arm, path.joint_positions[0, 0], drives)
    assert found.q == pytest.approx(simulate_open_loop(path, true, steps)[0, 0], abs=1e-10)
    assert np.abs(found.q - path.joint_positions[0, -1]) == pytest.approx(0.0, abs=6e-5)


def test_positions_of_many_rows_are_those_of_each():
    rng, law = np.random.default_rng(4), LAWS[1]
    rows = {"q2": rng.uniform(-2, 0, 50), "q3": rng.uniform(0, 0.012, 50)}
    rows |= {"theta": rng.uniform(-1, 0, 50), "psi": rng.uniform(-1, 1, 50)}
    rows |= {"start": rng.uniform(-2, 2, 50), "stop": np.where(np.arange(50) % 2, 2.0, -2.0)}
    steps = rng.uniform(0, 60_000, 50)
    steps[:3] = 0.0
    reached = position_after(law, rows, VALUES[1, "+"], steps)
    full = law.counts(rows, VALUES[1, "+"])[0]
    assert np.all((reached == rows["stop"]) == (steps >= full))
    assert np.all(reached[:3] == rows["start"][:3])
    short = steps < full
    assert law.counts(rows | {"stop": reached}, VALUES[1, "+"])[0][short] == pytest.approx(
        steps[short], abs=1e-6
    )
