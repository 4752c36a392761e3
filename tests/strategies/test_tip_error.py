from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.laws import constant_law
from stickslip_fit.machine import forward
from stickslip_fit.moves import (
    TrueLaws,
    draw_random_paths,
    step_model_from_parameters,
)
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    compute_tip_errors,
    other_sessions,
)
from stickslip_fit.strategies.evaluation import make_cases
from tests.moves.test_open_loop import HAND, LAWS, MACHINE, VALUES
from tests.moves.truth import step_models_from_truth

OWN = {1: np.ones(4), 2: np.ones(4), 3: np.array([1.0, 0.0, 1.0])}  # powers of a step's length
# Steps a thousand times shorter: nothing is left of their being whole.
FINE = {group: own * 1e-3 ** OWN[group[0]] for group, own in VALUES.items()}
STEADY = dict.fromkeys(VALUES, 0.0)


def off_by(values, joint, share):
    """A calibration that takes one joint's steps for longer than they are."""
    wrong = {g: own * ((1 + share) ** OWN[joint] if g[0] == joint else 1.0) for g, own in values.items()}
    return {group: step_model_from_parameters(LAWS[group[0]], own) for group, own in wrong.items()}


def slopes_by_hand(q):
    """How the tip moves with each joint, by finite differences, shape (m, 3, 3)."""
    apart = 1e-6 * np.eye(3)
    both = [forward(MACHINE, q + apart[j]) - forward(MACHINE, q - apart[j]) for j in range(3)]
    return np.stack(both, axis=-1) / 2e-6


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_step_taken_for_longer_leaves_that_share_of_its_joints_way(joint):
    paths, truth = draw_random_paths(MACHINE, 200, seed=1), TrueLaws(("Monday",), LAWS, FINE)
    table = compute_tip_errors(paths, truth, {"wrong": off_by(FINE, joint, 0.01)}, [1]).table
    way = paths.joint_positions[:, -1, joint - 1] - paths.joint_positions[:, 0, joint - 1]
    middle = paths.joint_positions[:, -1].copy()
    middle[:, joint - 1] -= way * 0.005
    error = -(1 - 1 / 1.01) * way[:, None] * slopes_by_hand(middle)[:, :, joint - 1]
    # Steps change in length on the way, and with where the other joints stand: some share of that share.
    slack = 1e-7
    assert table["size"].to_numpy() == pytest.approx(np.linalg.norm(error, axis=1), abs=slack)
    along = np.sum(error * paths.direction, axis=1)
    assert table["along"].to_numpy() == pytest.approx(along, abs=slack)
    across = np.linalg.norm(np.cross(error, paths.direction), axis=1)
    assert table["across"].to_numpy() == pytest.approx(across, abs=slack)
    assert table[f"joint_{joint}"].to_numpy() == pytest.approx(table["size"].to_numpy(), abs=slack)
    assert along.std() > 20 * slack


def test_what_does_not_repeat_adds_up_as_it_should():
    """Independent from joint to joint, in proportion to each joint's way: the mean square their sum."""
    paths, sessions = draw_random_paths(MACHINE, 40, seed=2), ("Monday",) * 500
    sizes = {
        (1, "+"): 0.004,
        (1, "-"): 0.002,
        (2, "+"): 0.003,
        (2, "-"): 0.003,
        (3, "+"): 0.01,
        (3, "-"): 0.0,
    }
    truth = TrueLaws(sessions, LAWS, FINE, repeatability=sizes)
    way = paths.joint_positions[:, -1] - paths.joint_positions[:, 0]
    spread = np.array([[sizes[j + 1, "+" if one > 0 else "-"] for j, one in enumerate(row)] for row in way])
    squares = np.sum((slopes_by_hand(paths.joint_positions[:, -1]) * (spread * way)[:, None]) ** 2, axis=1)
    for kind in ("gaussian", "t5"):
        found = compute_tip_errors(paths, truth, {"right": step_models_from_truth(truth)}, range(500), kind)
        summary = found.distribution().iloc[0]
        assert summary["rms"] ** 2 == pytest.approx(squares.sum(axis=1).mean(), rel=0.04)
        shares = squares.mean(axis=0) / squares.sum(axis=1).mean()
        assert [summary[f"share_{joint}"] for joint in LAWS] == pytest.approx(shares, abs=0.02)
        assert abs(summary["bias"]) < 0.05 * summary["rms"]


def test_sessions_taken_together_or_apart_end_alike():
    paths, rng = draw_random_paths(MACHINE, 15, seed=3, n_segments=2), np.random.default_rng(4)
    values = {group: own * (1 + 0.01 * rng.standard_normal((4, 1))) for group, own in VALUES.items()}
    factor = {group: 1 + 0.02 * rng.standard_normal(4) for group in VALUES}
    repeatability = dict.fromkeys(VALUES, 0.003)
    truth = TrueLaws(tuple("abcd"), LAWS, values, factor, repeatability, {"session_seconds": np.ones((4, 1))})

    def calibrations(which):
        usual = {g: step_model_from_parameters(LAWS[g[0]], own[which] * 1.01) for g, own in values.items()}
        return {"usual": usual, "wrong": off_by(VALUES, 2, 0.02)}

    together = compute_tip_errors(paths, truth, calibrations(slice(None)), range(4)).table
    for k in range(4):
        own = {g: of[k : k + 1] for g, of in values.items()}
        alone = replace(
            truth, sessions=truth.sessions[k : k + 1], values=own, conditions={"session_seconds": 1.0},
            factor={g: of[k : k + 1] for g, of in factor.items()},
        )  # fmt: skip
        apart = compute_tip_errors(paths, alone, calibrations(slice(k, k + 1)), [k]).table
        subset = together[together["number"] == k].reset_index(drop=True)
        pd.testing.assert_frame_equal(subset.assign(number=0), apart, check_exact=True)


def test_what_is_summed_up_is_what_the_errors_are():
    paths, truth = (
        draw_random_paths(MACHINE, 30, seed=5),
        TrueLaws(("a", "b"), LAWS, VALUES, repeatability=STEADY),
    )
    some = off_by(VALUES, 1, 0.05)
    some[3, "-"] = lambda rows: np.full(len(rows), np.nan)
    found = compute_tip_errors(paths, truth, {"right": step_models_from_truth(truth), "some": some}, [1, 2])
    back = paths.joint_positions[:, -1, 2] < paths.joint_positions[:, 0, 2]
    by_session = found.distribution("number")
    assert by_session["unknown"].tolist() == [0, 0, back.sum(), back.sum()]
    one = by_session.iloc[2]
    subset = found.table.query("strategy == 'some' and number == 0")
    size = subset["size"].to_numpy()[~back]
    assert one["rms"] == pytest.approx(np.sqrt(np.mean(size**2)))
    assert one["worst"] == size.max()
    assert one["median"] == pytest.approx(np.median(size))
    assert one["often"] == pytest.approx(np.quantile(size, 0.95))
    assert one["bias"] == pytest.approx(subset["along"].mean())
    assert one[["share_1", "share_2", "share_3"]].sum() == pytest.approx(1.0, abs=1e-3)
    joints = subset[["joint_1", "joint_2", "joint_3"]].to_numpy()[~back].sum(axis=1)
    assert joints == pytest.approx(size, rel=1e-3)
    assert np.hypot(subset["along"], subset["across"]).to_numpy()[~back] == pytest.approx(size)
    with pytest.raises(InputError, match=r"joint 2 has no calibration in direction \+"):
        compute_tip_errors(paths, truth, {"lame": {g: of for g, of in some.items() if g != (2, "+")}}, [1, 2])


def test_a_strategy_without_steps_for_a_move_is_told():
    paths, truth = draw_random_paths(MACHINE, 60, seed=7), TrueLaws(("a",), LAWS, VALUES)
    lost = dict.fromkeys(VALUES, lambda rows: np.full(len(rows), np.nan))
    found = compute_tip_errors(paths, truth, {"right": step_models_from_truth(truth), "lost": lost}, [1])
    (line,) = (line for line in str(found).splitlines() if line.startswith("lost"))
    assert line.split() == ["lost", "60", "60", *["–"] * 8]


@pytest.mark.slow
def test_strategies_calibrated_on_a_log_move_the_tip(log):
    """On a log of the tests' own laws."""
    strategies = (ClosedForm(), ConstantStepStrategy())
    calibrations = {strategy.name: {} for strategy in strategies}
    trials = [trial for trial in make_cases(log, other_sessions) if trial.task.session == log.sessions[0]]
    for trial in trials:
        group = trial.task.law.joint, trial.task.direction
        for strategy in strategies:
            made = trial.rows.loc[trial.task.offered.index[strategy.choose(trial.task)]]
            predict = strategy.calibrate(trial.task, made)
            calibrations[strategy.name][group] = lambda rows, predict=predict: np.exp(predict(rows)[0])
    truth = TrueLaws((log.sessions[0],), LAWS, VALUES)
    calibrations["the truth"] = step_models_from_truth(truth)
    calibrations["constant, no noise"] = {
        group: step_model_from_parameters(constant_law(LAWS[group[0]]), _constant(group)) for group in VALUES
    }
    found = compute_tip_errors(draw_random_paths(MACHINE, 300, seed=6), truth, calibrations, [1])
    rms = found.distribution().set_index("strategy")["rms"]
    # Joint 1 is calibrated with the arm far out, and steps another way where it is close in.
    assert rms["the truth"] < rms["closed form"] < 25e-6
    assert rms["constant step"] == pytest.approx(rms["constant, no noise"], rel=0.1)
    assert rms["constant step"] > 5 * rms["closed form"]


def _constant(group):
    """The mean step over the traverse in which a constant step is measured, by the tests' own quadrature."""
    joint, way = group
    where = LAWS[joint].calibration()[0]
    unit, ends = ("mm", (0.0, 12.0)) if joint == 3 else ("deg", ((-120.0, 120.0), (-210.0, 30.0))[joint - 1])
    row = {"joint": joint, "direction": way, f"from_{unit}": ends[0], f"to_{unit}": ends[1]}
    row |= {"q1_deg": np.degrees(where.q1), "q2_deg": np.degrees(where.q2), "q3_mm": where.q3 * 1e3}
    row |= {"theta_deg": np.degrees(where.theta), "psi_deg": np.degrees(where.psi)}
    row |= {name: 0.0 for name in ("q1_deg", "q2_deg", "q3_mm") if not np.isfinite(row[name])}
    length = (ends[1] - ends[0]) * (1e-3 if joint == 3 else np.radians(1))
    return np.array([length / HAND.steps(row)])
