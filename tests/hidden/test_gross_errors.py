"""Gross errors are gross errors: no cause is blamed for them, and no large effect is taken for them."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.gross_errors import find_gross_errors, set_aside
from stickslip_fit.diagnosis.pipeline import GROSS_ALPHA_SHARE
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.diagnosis.selection import explain_outliers, select_causes
from tests.hidden.generate import hide
from tests.hidden.gross import make_gross, spoil
from tests.hidden.reading import read_hidden

MISFIRE = "end-stop-misfire"
LEVEL = GROSS_ALPHA_SHARE * 0.01


def tally(size, rate, seeds):
    """How often each set of findings is the answer."""
    answers = Counter()
    for seed in seeds:
        hidden, _ = make_gross(size, rate, seed)
        found = diagnose(read_hidden(hidden), seed=seed, gain=False)
        answers[tuple(each.cause for each in found.findings)] += 1
    return answers


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_gross_errors_of_a_small_log_are_named_and_nothing_else(seed):
    hidden, rows = make_gross("small", 0.01, seed)
    (finding,) = diagnose(read_hidden(hidden), seed=seed, gain=False).findings
    assert finding.cause == MISFIRE
    assert set(finding.traverses.index) == set(rows)


@pytest.mark.parametrize(
    ("size", "rate", "seed"),
    [
        ("small", 0.01, 0),
        *(pytest.param("small", 0.01, seed, marks=pytest.mark.nightly) for seed in range(1, 4)),
        pytest.param("campaign", 0.01, 1005, marks=pytest.mark.slow),
        pytest.param("campaign", 0.01, 2, marks=pytest.mark.nightly),
        pytest.param("campaign", 0.0025, 5, marks=pytest.mark.nightly),
    ],
)
def test_gross_errors_are_found_before_anything_is_searched(size, rate, seed):
    """In the fifth, least squares without them sets aside a parameter at its bound."""
    hidden, rows = make_gross(size, rate, seed)
    problem, _ = problem_from_log(read_hidden(hidden), ())
    assert set(find_gross_errors(problem, LEVEL).rows) == set(rows)


@pytest.mark.slow
def test_several_that_no_noise_gives_together_are_found():
    """Three of 160 to 174 counts, some 15 standard deviations off: noise with heavy tails might give one."""
    found, others = 0, 0
    for seed in range(8):
        hidden, rng = hide("session", seed=seed, noise="gaussian"), np.random.default_rng(seed)
        table = hidden.table.copy()
        rows = rng.choice(len(table), 3, replace=False)
        factor = 1 + 0.045 * rng.choice([-1, 1], 3)
        table.loc[rows, "steps"] = (table.loc[rows, "steps"] * factor / 10).round().astype(int) * 10
        problem, _ = problem_from_log(read_hidden(replace(hidden, table=table)), ())
        errors = set(find_gross_errors(problem, LEVEL).rows)
        found, others = found + (set(rows) <= errors), others + len(errors - set(rows))
    assert found >= 6
    assert others == 0


def test_one_wild_count_among_heavy_tails_is_found():
    """27 standard deviations off, in a session of 160 traverses with noise of Student's t with 5 df."""
    hidden = hide("session", (MISFIRE,), 25, "t5", seed=8900012, forms={MISFIRE: "missed only"})
    problem, _ = problem_from_log(read_hidden(hidden), ())
    assert [*find_gross_errors(problem, LEVEL).rows] == [*np.flatnonzero(hidden.effect(MISFIRE))]


def test_beside_a_certain_gross_error_a_smaller_one_is_found():
    hidden = spoil(hide("session", seed=1), np.array([20]), 1.05)
    problem, _ = problem_from_log(read_hidden(hidden), ())
    assert not len(find_gross_errors(problem, LEVEL).rows)
    problem, _ = problem_from_log(read_hidden(spoil(hidden, np.array([90]))), ())
    assert [*find_gross_errors(problem, LEVEL).rows] == [20, 90]


def places(hidden):
    """One row for each kind of place that a doubled count may have."""
    plan, load = hidden.campaign.plan, hidden.campaign.load
    configuration = 2 * plan.configuration() + plan.forward
    _, first, count = np.unique(configuration, return_index=True, return_counts=True)
    return {
        "the first": 0,
        "the last": len(load) - 1,
        "the extreme load": int(np.argmax(np.abs(load))),
        "the rarest configuration": int(first[np.argmin(count)]),
        # Over its whole range: one of few short traverses is a parameter's only witness.
        "joint 1": int(np.flatnonzero((plan.joint == 1) & (np.ptp(plan.settings[:, 5:], axis=1) == 240))[0]),
        "in calibration": int(np.flatnonzero((plan.joint == 3) & (plan.settings[:, 1] == -90))[1]),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["session", *(pytest.param(kind, marks=pytest.mark.nightly) for kind in ("thesis", "many"))]
)
def test_one_doubled_count_is_found_wherever_it_is(kind):
    hidden = hide(kind, noise="t5", seed=11)
    for place, row in places(hidden).items():
        problem, _ = problem_from_log(read_hidden(spoil(hidden, np.array([row]))), ())
        assert list(find_gross_errors(problem, LEVEL).rows) == [row], place


@pytest.mark.slow
def test_one_doubled_count_at_the_extreme_load_is_no_other_mass():
    """It was taken for a load coefficient of twice its size, with a gain that was a loss."""
    hidden = hide("session", noise="gaussian", seed=11)
    row = places(hidden)["the extreme load"]
    found = diagnose(read_hidden(spoil(hidden, np.array([row]))), gain=False)
    assert [each.cause for each in found.findings] == [MISFIRE]
    assert list(found.findings[0].traverses.index) == [row]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "design"),
    [
        pytest.param("session-jump", "many", marks=pytest.mark.nightly),
        ("thermal-warm-up", "session"),
        ("worn-spot", "many"),
        ("drift", "thesis"),
        pytest.param("temperature", "many", marks=pytest.mark.nightly),
        ("load-hysteresis", "session"),
    ],
)
def test_a_large_effect_is_no_gross_error(cause, design):
    hidden = hide(design, (cause,), 25.0, seed=2)
    problem, _ = problem_from_log(read_hidden(hidden), ())
    assert not len(find_gross_errors(problem, LEVEL).rows)


@pytest.mark.nightly
def test_rows_that_a_named_cause_explains_come_back():
    """The first traverses of a strong warm-up are the farthest off; a gross error among them stays aside."""
    hidden = hide("session", ("thermal-warm-up",), 25.0, seed=2)
    problem, _ = problem_from_log(read_hidden(spoil(hidden, np.array([2]))))
    aside = np.arange(3)
    found = select_causes(set_aside(problem, aside), 0.01, 399, np.random.default_rng(0))
    assert "thermal-warm-up" in (found.selected[0].cause, *found.selected[0].cause_set.rivals)
    assert explain_outliers(found, problem, aside).tolist() == [0, 1]


@pytest.mark.nightly
def test_a_very_strong_effect_is_no_gross_error():
    hidden = hide("session", ("thermal-warm-up",), 60.0, seed=2)
    found = diagnose(read_hidden(hidden, (3,)), gain=False)
    assert "thermal-warm-up" in found.findings[0].cause_set
    assert all(each.cause != MISFIRE for each in found.findings)


@pytest.mark.nightly
@pytest.mark.parametrize("size", ["small", "campaign"])
@pytest.mark.parametrize("rate", [0.0025, 0.01])
def test_gross_errors_are_blamed_on_no_cause(size, rate):
    answers = tally(size, rate, range(1000, 1400))
    right = answers[()] + answers[(MISFIRE,)]
    physical = sum(n for found, n in answers.items() if set(found) - {MISFIRE, "unknown"})
    assert right >= 0.98 * 400, answers
    assert physical <= 0.01 * 400, answers
