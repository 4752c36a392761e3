from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from stickslip_fit.strategies import (
    AtRandom,
    CalibrationTask,
    DOptimal,
    IOptimal,
    NotApplicable,
    Thesis,
    other_sessions,
)
from stickslip_fit.strategies.designs import exchange_rows, mean_variance_loss, negative_log_determinant
from stickslip_fit.strategies.evaluation import make_cases


@pytest.fixture(scope="module")
def task(log) -> CalibrationTask:
    """Joint 2, first session."""
    return next(trial.task for trial in make_cases(log, other_sessions) if trial.task.law.joint == 2)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("criterion", ["determinant", "mean variance"])
def test_exchange_finds_what_trying_everything_finds(criterion, seed):
    rng = np.random.default_rng(seed)
    slopes, prior = rng.standard_normal((9, 3)), 1e-9 * np.eye(3)
    loss = negative_log_determinant if criterion == "determinant" else mean_variance_loss(slopes)

    def lost(chosen):
        return float(loss((prior + slopes[list(chosen)].T @ slopes[list(chosen)])[None])[0])

    best = min(map(lost, combinations(range(9), 4)))
    assert lost(exchange_rows(slopes, 4, loss, prior)) <= best + 0.02 * abs(best)


def test_with_few_traverses_what_is_known_before_decides():
    """One slope is large where nothing is open, so that the smaller one tells more."""
    slopes = np.array([[3.0, 0.0], [0.0, 1.0]])
    assert exchange_rows(slopes, 1, negative_log_determinant, np.diag([1e-6, 1e-6])).tolist() == [0]
    assert exchange_rows(slopes, 1, negative_log_determinant, np.diag([100.0, 1e-6])).tolist() == [1]


def test_designs_choose_each_traverse_once_and_say_when_there_are_too_few(task):
    for design in (Thesis(), AtRandom(3), DOptimal(), IOptimal()):
        for count in (4, 6, len(task.offered)):
            chosen = design.pick(task, count)
            assert len(set(chosen.tolist())) == count
        with pytest.raises(NotApplicable, match=f"the session has {len(task.offered)} of them"):
            design.pick(task, len(task.offered) + 1)


def test_random_choices_differ_between_seeds_and_sessions_and_repeat(task):
    again = AtRandom(1).pick(task, 5)
    assert again.tolist() == AtRandom(1).pick(task, 5).tolist()
    others = [AtRandom(seed).pick(task, 5).tolist() for seed in range(2, 8)]
    others += [AtRandom(1).pick(replace(task, session=f"day {day}"), 5).tolist() for day in range(6)]
    assert sum(each != again.tolist() for each in others) > 8


def test_random_choices_determine_all_parameters(task):
    """Most choices of four leave the arm in or the load out."""
    values, _ = task.nominal
    for seed in range(20):
        made = task.offered.iloc[AtRandom(seed).pick(task, 4)]
        slopes = task.law.jacobian(made, np.tile(values, (4, 1)))
        assert np.linalg.cond(slopes / np.linalg.norm(slopes, axis=0)) < 1e5


def test_the_thesis_begins_with_its_calibration(task):
    offered = task.offered.iloc[Thesis().pick(task, 6)]
    assert offered["q3"].iloc[:4].tolist() == pytest.approx([0.0, 0.012, 0.0, 0.012])
    assert np.cos(offered["theta"].iloc[:4]).round(9).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert offered.index[4:].tolist() == np.setdiff1d(task.offered.index, offered.index[:4])[:2].tolist()
