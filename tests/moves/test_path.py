from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.stats import ks_2samp

from stickslip_fit.errors import InputError
from stickslip_fit.machine import inverse, load_machine, published_load
from stickslip_fit.moves import draw_random_paths, straight_path

MACHINE = load_machine()
N_PATHS = 400


def tip_by_hand(q):
    """The product of the Denavit-Hartenberg matrices, rows (theta, d, a, alpha)."""
    rows = [(q[0], 0, MACHINE.a1, np.pi / 2), (q[1], 0, 0, -np.pi / 2), (0, MACHINE.l2 + q[2], 0, 0)]
    whole = np.eye(4)
    for theta, d, a, alpha in rows:
        (ct, ca), (st, sa) = np.cos([theta, alpha]), np.sin([theta, alpha])
        whole = whole @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return whole[:3, 3]


@pytest.mark.parametrize("order", [(1, 2, 3), (3, 1, 2)])
def test_every_leg_ends_on_the_line_where_a_solver_puts_the_joints(order):
    start, way = np.array([0.4, -2.0, 0.003]), np.array([2.0, -1.0, 2.0]) / 3
    path = straight_path(MACHINE, start, way, 5e-3, n_segments=10, order=order)
    assert path.order == order * 10
    origin, q = tip_by_hand(start), start
    for leg in range(1, 11):
        target = origin + way * 5e-3 * leg / 10
        q = fsolve(lambda there, target=target: (tip_by_hand(there) - target) * 1e3, q, xtol=1e-13)
        assert path.joint_positions[0, 3 * leg] == pytest.approx(q, abs=1e-9)


def test_each_drive_moves_its_joint_only():
    paths = draw_random_paths(MACHINE, 50, seed=2, n_segments=3)
    moved = np.diff(paths.joint_positions, axis=1) != 0
    for drive, joint in enumerate(paths.order):
        assert not np.delete(moved[:, drive], joint - 1, axis=1).any()
    made = np.zeros((50, len(paths.order)), int)
    for part in paths.segments:
        assert np.all((part.stop > part.start) == (part.direction == "+"))
        made[part.moves, part.drive_index] += 1
    assert np.array_equal(made, moved.any(axis=2))


def test_what_each_drive_follows():
    paths, last = draw_random_paths(MACHINE, 60, seed=3, length=5e-3, n_segments=4), {}
    for drive, joint in enumerate(paths.order):
        for move in range(60):
            start, stop = (
                paths.joint_positions[move, drive, joint - 1],
                paths.joint_positions[move, drive + 1, joint - 1],
            )
            part = next((p for p in paths.segments if p.drive_index == drive and move in p.moves), None)
            if part is None:
                continue
            at = int(np.flatnonzero(part.moves == move)[0])
            arrival_direction = {1: "+", -1: "-"}[paths.arrival_direction[move, joint - 1]]
            way, between = last.get((move, joint), (arrival_direction, np.full(2, start)))
            assert part.before_direction[at] == way
            q = np.tile(paths.joint_positions[move, drive], (201, 1))
            q[:, joint - 1] = np.linspace(*between, 201)
            loads = published_load(joint, q[:, 0], q[:, 1], paths.theta[move], paths.psi[move])
            assert part.before_load[at] == pytest.approx(loads.mean(), abs=0.03)
            last[move, joint] = ("+" if stop > start else "-", (start, stop))
    turned = [part.before_direction != part.direction for part in paths.segments if part.drive_index > 2]
    assert np.concatenate(turned).sum() > 3


def test_how_far_the_tip_strays_between_the_ends_of_its_drives():
    start, way = [0.0, -1.2, 0.004], [0.0, 0.0, 1.0]
    strays = []
    for legs in (1, 2, 8):
        path = straight_path(MACHINE, start, way, 1e-3, legs)
        ends = zip(path.joint_positions[0, :-1], path.joint_positions[0, 1:], strict=True)
        way_there = np.concatenate([np.linspace(*pair, 50) for pair in ends])
        tips = np.array([tip_by_hand(q) for q in way_there]) - tip_by_hand(start)
        farthest = np.linalg.norm(np.cross(tips, way), axis=1).max()
        strays.append(path.max_deviation()[0])
        assert strays[-1] == pytest.approx(farthest, rel=0.01)
    assert strays[0] / strays[2] == pytest.approx(8, rel=0.1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"direction": [1.0, 1.0, 0.0]}, "vector of length 1"),
        ({"order": (1, 2)}, "every joint once"),
        ({"n_segments": 0}, "one segment or more"),
        ({"length": 0.2}, "out of reach"),
        ({"start": [0.0, -1.2, 0.013]}, "start q3 = 13.00 mm is outside its range"),
    ],
)
def test_a_path_that_makes_no_sense_is_refused(given, said):
    usual = {"start": [0.0, -1.2, 0.004], "direction": [0.0, 0.0, 1.0], "length": 1e-3}
    with pytest.raises(InputError, match=said):
        straight_path(MACHINE, **(usual | given))


def stands(machine, point):
    try:
        return inverse(machine, point)
    except InputError:
        return []


def leads_to(machine, start, target, length):
    """Whether the arm gets there without swinging round."""
    here = tip_by_hand(start)
    turned = [(there[0], *start[1:]) for there in stands(machine, target)]
    return any(np.linalg.norm(tip_by_hand(q) - here) < 2 * length for q in turned)


def test_an_arm_that_would_have_to_swing_round_is_refused():
    """Joint 1 at its stop, 2 mm from its axis: the other way to the target is half a turn away."""
    q2 = -np.arcsin(-0.0105 / 0.0405)
    assert np.hypot(*tip_by_hand([2.09, q2, 0.003])[:2]) == pytest.approx(0.002)
    way = np.array([-np.sin(2.09), np.cos(2.09), 0.0])
    assert stands(MACHINE, tip_by_hand([2.09, q2, 0.003]) + 1e-3 * way)
    with pytest.raises(InputError, match="swing round, which takes the tip"):
        straight_path(MACHINE, [2.09, q2, 0.003], way, 1e-3)
    straight_path(MACHINE, [2.09, q2, 0.003], -way, 1e-3)


# All joints go so far that much is reached both with the arm's face and with its back.
FAR = replace(MACHINE, ranges={1: (-np.pi, np.pi), 2: (-11 * np.pi / 6, np.pi / 6), 3: (-0.02, 0.02)})


@pytest.mark.slow
@pytest.mark.parametrize("machine", [MACHINE, FAR])
def test_moves_are_drawn_uniformly_from_all_that_are_within_reach(machine):
    paths = draw_random_paths(machine, N_PATHS, seed=4, length=3e-3)
    rng, wide = np.random.default_rng(5), machine.a1 + machine.l2 + machine.ranges[3][1]
    starts, ways = [], []
    while len(starts) < N_PATHS:
        start, (z, turn) = rng.uniform(-wide, wide, 3), rng.uniform([-1, -np.pi], [1, np.pi])
        way = np.array([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
        found = stands(machine, start)
        if found and leads_to(machine, found[rng.integers(len(found))], start + 3e-3 * way, 3e-3):
            starts.append(start)
            ways.append(way)
    drawn, boxed = (paths.tips[:, 0], paths.direction), (np.array(starts), np.array(ways))
    for seen in (
        lambda at, way: np.hypot(at[:, 0], at[:, 1]),
        lambda at, way: at[:, 2],
        lambda at, way: np.arctan2(at[:, 1], at[:, 0]),
        lambda at, way: way[:, 2],
        lambda at, way: np.sum(at * way, axis=1),
    ):
        assert ks_2samp(seen(*drawn), seen(*boxed)).pvalue > 0.01
    twice, expected = (np.mean([len(stands(machine, at)) > 1 for at in where]) for where, _ in (drawn, boxed))
    assert twice == pytest.approx(expected, abs=3 * np.sqrt(2 * 0.25 / N_PATHS))


def test_the_seed_settles_the_moves_and_the_base_stands_within_its_ranges():
    one, same, other = (
        draw_random_paths(MACHINE, 40, seed, theta=(-0.2, 0.1), psi=(1.0, 1.0)) for seed in (1, 1, 2)
    )
    assert np.array_equal(one.joint_positions, same.joint_positions)
    assert np.array_equal(one.theta, same.theta)
    assert not np.array_equal(one.joint_positions, other.joint_positions)
    assert one.theta.min() > -0.2
    assert one.theta.max() < 0.1
    assert np.all(one.psi == 1.0)
    assert set(np.unique(one.arrival_direction)) == {-1, 1}


@pytest.mark.slow
def test_moves_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="hardly any move of 150 mm"):
        draw_random_paths(MACHINE, 1, seed=1, length=0.15)
