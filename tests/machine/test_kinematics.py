from itertools import product

import numpy as np
import pytest
from scipy.optimize import root

from stickslip_fit.errors import InputError
from stickslip_fit.machine import forward, inverse, jacobian, nearest_solution, reach


def grid(machine, sizes=(9, 13, 5)):
    """Joint positions over the whole workspace, the ends of every range included."""
    axes = [np.linspace(*machine.ranges[joint], size) for joint, size in zip((1, 2, 3), sizes, strict=True)]
    return np.array(list(product(*axes)))


def in_range(machine, q):
    return all(machine.ranges[joint][0] <= q[joint - 1] <= machine.ranges[joint][1] for joint in (1, 2, 3))


def test_tip_and_jacobian_are_the_engines(arm, engine, states):
    q = states[0]
    for row, tip, slopes in zip(q, forward(arm, q), jacobian(arm, q), strict=True):
        engine.put(row)
        assert tip == pytest.approx(engine.tip(), abs=1e-14)
        assert slopes == pytest.approx(engine.jacobian(), abs=1e-14)


def test_jacobian_is_the_slope_of_forward(arm, states):
    q, h = states[0], 1e-6
    slopes = [(forward(arm, q + h * step) - forward(arm, q - h * step)) / (2 * h) for step in np.eye(3)]
    assert jacobian(arm, q) == pytest.approx(np.stack(slopes, axis=-1), abs=1e-9)


def test_reach_is_the_tip_beyond_joint_2(arm, states):
    q = states[0] * [0.0, 1.0, 1.0]
    assert reach(arm, q[:, 1], q[:, 2]) == pytest.approx(forward(arm, q)[:, 0] - 0.017, abs=1e-15)


def test_many_positions_at_once(arm, states):
    q = states[0].reshape(2, 20, 3)
    assert forward(arm, q)[1, 3] == pytest.approx(forward(arm, q[1, 3]), rel=1e-15)
    assert jacobian(arm, q)[1, 3] == pytest.approx(jacobian(arm, q[1, 3]), rel=1e-15)


@pytest.mark.parametrize("which", ["nominal", "arm"])
def test_round_trip_over_the_whole_workspace(which, request):
    machine = request.getfixturevalue(which)
    folded_back = 0
    for q in grid(machine):
        target = forward(machine, q)
        found = inverse(machine, target)
        assert min(np.max(np.abs(q - solution)) for solution in found) < 1e-12
        for solution in found:
            assert in_range(machine, solution)
            assert forward(machine, solution) == pytest.approx(target, abs=1e-15)
        folded_back += machine.a1 < (machine.l2 + q[2]) * np.sin(q[1])
    assert folded_back > 50


def test_no_solution_is_missed(arm):
    """Newton's method from all over the workspace finds no stand that inverse does not know."""
    rng = np.random.default_rng(2)
    starts, counts = grid(arm, (6, 7, 1)), []
    low, high = np.array([arm.ranges[joint] for joint in (1, 2, 3)]).T
    for _ in range(6):
        # Upright, where joint 1 can be turned either way.
        q = rng.uniform([low[0], 0.0, low[2]], high)
        target, solutions = forward(arm, q), inverse(arm, forward(arm, q))
        found = [
            root(lambda q, goal=target: 1e3 * (forward(arm, q) - goal), x0=start, tol=1e-13)
            for start in starts
        ]
        stands = {tuple(np.round(f.x, 7)) for f in found if f.success and in_range(arm, f.x)}
        for stand in stands:
            assert min(np.max(np.abs(np.array(stand) - solution)) for solution in solutions) < 1e-6
        assert len(stands) == len(solutions)
        counts.append(len(stands))
    assert set(counts) == {1, 2}


def test_a_wide_range_gives_a_solution_for_every_turn(machine_of):
    machine = machine_of(
        "[geometry]\na1_mm = 10\nl2_mm = 30\n"
        "[range]\nq1_deg = [-200, 200]\nq2_deg = [-210, 30]\nq3_mm = [0, 9]\n"
        + "[[link]]\nmass_g = 1\ncom_mm = 0\ninertia_g_mm2 = [1, 1, 1]\n"
        * 3
    )
    found = inverse(machine, forward(machine, np.radians([190.0, -90.0, 0.0])))
    assert sorted(np.degrees([q[0] for q in found])) == pytest.approx([-170.0, 190.0])


def test_the_nearest_solution_keeps_to_the_side_where_the_joints_stand(nominal):
    facing, away = inverse(nominal, [0.0, 0.003, 0.042])
    assert facing[0] * away[0] < 0
    assert nearest_solution(nominal, [0.0, 0.003, 0.042], near=facing + 0.01) == pytest.approx(facing)
    assert nearest_solution(nominal, [0.0, 0.003, 0.042], near=away - 0.01) == pytest.approx(away)


@pytest.mark.parametrize(
    ("near", "kept"),
    [(None, 0.0), ([1.0, 0.0, 0.0], 1.0), ([-2.0, 0.0, 0.0], -2.0), ([3.0, 0.0, 0.0], 2 * np.pi / 3)],
)
@pytest.mark.parametrize("height", [0.04, -0.04])
def test_on_joint_1s_axis_q1_stays_where_it_is(nominal, near, kept, height):
    (solution,) = inverse(nominal, [0.0, 0.0, height], near)
    assert solution[0] == pytest.approx(kept)
    assert in_range(nominal, solution)
    assert forward(nominal, solution) == pytest.approx([0.0, 0.0, height], abs=1e-16)


def test_beside_joint_1s_axis_both_ways_remain(nominal):
    found = inverse(nominal, [0.0, 1e-9, 0.04])
    assert [q[0] for q in found] == pytest.approx([np.pi / 2, -np.pi / 2])
    for q in found:
        assert forward(nominal, q) == pytest.approx([0.0, 1e-9, 0.04], abs=1e-16)


# By hand on the nominal arm: a1 = 12.5 mm, l2 = 37.5 mm, q3 up to 12 mm.
OUT_OF_REACH = {
    "too far": (
        (70.0, 0.0, 0.0),
        "joint 3 would have to stand at 20 mm, 8 mm above its highest, 12 mm.",
        "tip at (62, 0, 0) mm, 8 mm away",
    ),
    "too near": (
        (30.0, 0.0, 0.0),
        "joint 3 would have to stand at -20 mm, 20 mm below its lowest, 0 mm.",
        "20 mm away",
    ),
    "on joint 2's axis": (
        (12.5, 0.0, 0.0),
        "joint 3 would have to stand at -37.5 mm, 37.5 mm below its lowest, 0 mm.",
        "37.5 mm away",
    ),
    "behind": (
        (50 * np.cos(np.radians(150)), 25.0, 0.0),
        "joint 1 would have to stand at 150 deg, 30 deg above its highest, 120 deg.",
        "tip at (-25, 43.3013, 0) mm, 25.88 mm away",
    ),
    "bent too far back": (
        (12.5 - 40 * np.sin(np.radians(60)), 0.0, 20.0),
        "joint 2 would have to stand at 60 deg, 30 deg above its highest, 30 deg.",
        "tip at (-7.5, 0, 34.641) mm, 20.71 mm away",
    ),
    "bent too far down": (
        (12.5 + 40 * np.sin(np.radians(-140)), 0.0, 40 * np.cos(np.radians(140))),
        "joint 2 would have to stand at -220 deg, 10 deg below its lowest, -210 deg.",
        "tip at (-7.5, 0, -34.641) mm, 6.972 mm away",
    ),
    "two joints": (
        (70 * np.cos(np.radians(130)), 70 * np.sin(np.radians(130)), 0.0),
        "joint 1 would have to stand at 130 deg, 10 deg above its highest, 120 deg and joint 3 would have to",
        "tip at (-31, 53.6936, 0) mm, 14 mm away",
    ),
}


@pytest.mark.parametrize("case", OUT_OF_REACH)
def test_out_of_reach_says_which_joint_and_by_how_much(nominal, case):
    target_mm, overrun, closest = OUT_OF_REACH[case]
    with pytest.raises(InputError) as error:
        inverse(nominal, np.array(target_mm) / 1e3)
    assert overrun in str(error.value)
    assert closest in str(error.value)


def test_a_nanometre_too_far_is_too_far(nominal):
    assert len(inverse(nominal, [0.062, 0.0, 0.0])) == 1
    with pytest.raises(InputError, match="1e-06 mm above its highest"):
        inverse(nominal, [0.062 + 1e-9, 0.0, 0.0])


@pytest.mark.parametrize(
    "target", [[0.05, np.nan, 0.0], [0.05, np.inf, 0.0], [0.05, 0.0], [[0.05, 0.0, 0.0]]]
)
def test_a_target_that_is_none(nominal, target):
    with pytest.raises(InputError, match="three finite numbers"):
        inverse(nominal, target)
    with pytest.raises(InputError, match="three finite numbers"):
        nearest_solution(nominal, [0.05, 0.0, 0.0], near=target)


def test_the_printed_q1_fails_where_the_arm_is_bent_back_over_the_axis(nominal):
    """A.4, q1 = atan2(y, x), picks the wrong q1 where a1 < (l2 + q3) sin q2; inverse does not."""
    q = grid(nominal, (5, 25, 4))
    tip = forward(nominal, q)
    printed = np.arctan2(tip[:, 1], tip[:, 0])
    wrong = np.abs(printed - q[:, 0]) > 1e-9
    bent_back = nominal.a1 < (nominal.l2 + q[:, 2]) * np.sin(q[:, 1])
    assert wrong.tolist() == bent_back.tolist()
    assert 0 < wrong.sum() < len(q)


def test_the_printed_q2_is_a_quarter_of_a_turn_off(nominal):
    """A.6, q2 = atan2(d_y, d_x) with d the tip seen from joint 2 in frame 1, does not invert A.2."""
    q = grid(nominal, (1, 25, 4)) * [0.0, 1.0, 1.0]
    tip = forward(nominal, q)
    across, along = tip[:, 0] - nominal.a1, tip[:, 2]
    printed, right = np.arctan2(along, across), np.arctan2(-across, along)
    assert np.cos(printed - q[:, 1]) == pytest.approx(0.0, abs=1e-12)
    assert np.cos(right - q[:, 1]) == pytest.approx(1.0, abs=1e-15)
