"""The extended law in use: simulated from, and asked for the steps of a move."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import (
    Drift,
    EndStopLatency,
    EndStopMisfire,
    LoadHysteresis,
    ReversalLoss,
    ThermalWarmUp,
    Wear,
    extend,
)
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.moves import DriveCommand, calibrated_arm, dead_reckon, plan_move
from stickslip_fit.moves.arm import parse_conditions
from stickslip_fit.moves.drives import read_drives
from stickslip_fit.moves.prediction import predict
from stickslip_fit.simulation import LawValues, read_law_values, simulate, step_through

MACHINE = load_machine()
REFERENCE = Path(__file__).parents[2] / "data" / "reference"
QUIET = 1e-9


@pytest.fixture(scope="module")
def plan():
    found = read_plan(REFERENCE / "plan.toml", MACHINE)
    from dataclasses import replace

    silent = replace(found.noise, repeatability=dict.fromkeys(found.noise.repeatability, QUIET))
    return replace(found, noise=silent, check_every=1)


@pytest.fixture(scope="module")
def truth() -> LawValues:
    read = read_law_values(REFERENCE / "law.toml", MACHINE)
    return LawValues(read.laws, read.values)


def with_causes(truth: LawValues, *causes_and_values) -> LawValues:
    laws, values = dict(truth.laws), dict(truth.values)
    for cause, sizes in causes_and_values:
        laws = {joint: extend(law, cause) for joint, law in laws.items()}
        values = {key: np.append(own, sizes) for key, own in values.items()}
    return LawValues(laws, values)


def published(plan, truth) -> pd.DataFrame:
    return simulate(plan, truth, MACHINE).rows


ACTS = {
    "thermal-warm-up": (
        ThermalWarmUp(),
        (0.05, 1200.0),
        lambda r, n: n / (1 + 0.05 * (1 - np.exp(-r["session_seconds"] / 1200))),
    ),
    "wear": (Wear(), (0.01, 1e5), lambda r, n: n / (1 + 0.01 * np.log(1 + r["steps_before"] / 1e5))),
    "load-hysteresis": (LoadHysteresis(), (0.03,), lambda r, n: n / (1 + 0.03 * r["before_load"])),
    "reversal-loss": (
        ReversalLoss(),
        (80.0,),
        lambda r, n: n + 80 * ((r["before_direction"] != "") & (r["before_direction"] != r["direction"])),
    ),
    "end-stop-latency": (EndStopLatency(), (120.0,), lambda r, n: n + 120),
}


@pytest.mark.parametrize("name", ACTS)
def test_a_simulated_log_has_the_cause_in_it_by_its_own_history(name, plan, truth):
    cause, values, act = ACTS[name]
    rows = simulate(plan, with_causes(truth, (cause, values)), MACHINE).rows
    expected = act(rows, published(plan, truth)["steps"].astype(float))
    # A whole step each from two roundings of the count.
    assert np.all(np.abs(rows["steps"] - expected) <= 1.5)
    assert (rows["steps"] != published(plan, truth)["steps"]).mean() > 0.3


def test_misfires_hit_the_share_of_counts_that_they_should(plan, truth):
    rows = simulate(plan, with_causes(truth, (EndStopMisfire(), (0.05, 0.08))), MACHINE).rows
    off = np.log(rows["steps"] / published(plan, truth)["steps"])
    hit = off.abs() > 1e-3
    assert hit.mean() == pytest.approx(0.05, abs=0.025)
    assert off[hit].abs().between(0.08 * 0.69, 0.08 * 1.31).all()


def test_what_is_left_to_chance_is_as_it_was_without_causes(plan, truth):
    """A law with causes of no effect gives the very log of the law without them."""
    same = with_causes(truth, (Drift(), (0.0,)), (EndStopMisfire(), (0.0, 0.1)))
    pd.testing.assert_frame_equal(simulate(plan, same, MACHINE).rows, published(plan, truth))


def test_what_was_simulated_is_found_again(plan, truth):
    hidden = with_causes(truth, (ThermalWarmUp(), (0.05, 1200.0)), (EndStopLatency(), (120.0,)))
    result = fit_least_squares(simulate(plan, hidden, MACHINE), causes=(ThermalWarmUp(), EndStopLatency()))
    table = result.si.parameters.set_index("name")["estimate"]
    assert table["thermal-warm-up.A"] == pytest.approx(0.05, rel=0.01)
    assert table["thermal-warm-up.tau"] == pytest.approx(1200, rel=0.02)
    assert table["end-stop-latency.L"] == pytest.approx(120, abs=2)


@pytest.fixture(scope="module")
def arm_log(plan, truth):
    return simulate(
        plan, with_causes(truth, (ThermalWarmUp(), (0.05, 1200.0)), (EndStopLatency(), (120.0,))), MACHINE
    )


@pytest.fixture(scope="module")
def result(arm_log):
    return fit_least_squares(arm_log, causes=(ThermalWarmUp(), EndStopLatency()))


START, TARGET = np.radians([0.0, -90.0, 0.0]), np.array([0.2, -1.0, 0.006])


def test_a_move_takes_the_published_law_s_steps_less_what_warmth_saves_and_none_for_the_stop(result):
    cold, hot = (calibrated_arm(result, conditions={"session_seconds": t}) for t in (0.0, 1e6))
    moves = [plan_move(arm, START, TARGET).segments for arm in (cold, hot)]
    q = START.copy()
    for before, after in zip(*moves, strict=True):
        assert before.steps / after.steps == pytest.approx(1.05, rel=2e-3)
        law, values, _, _ = cold.law(before.joint, before.direction)
        row = cold.drive_row(q, before.joint, before.stop)
        alone = law.law.counts(row, values[: len(law.law.parameters)])[0][0]
        assert before.steps == pytest.approx(alone, abs=0.51)
        q[before.joint - 1] = before.stop


def test_stepping_through_a_traverse_gives_its_count(result):
    arm = calibrated_arm(result, conditions={"session_seconds": 900.0})
    law, values, _, _ = arm.law(2, "-")
    row = arm.drive_row(np.radians([0.0, -90.0, 0.0]), 2, np.radians(-100.0))
    assert abs(int(step_through(law, row, values)[0]) - law.counts(row, values)[0][0]) <= 1


def test_following_the_steps_of_a_move_leads_to_its_target(result):
    arm = calibrated_arm(result, conditions={"session_seconds": 900.0})
    drives = [
        DriveCommand(leg.joint, leg.direction, leg.steps) for leg in plan_move(arm, START, TARGET).segments
    ]
    found = dead_reckon(arm, START, drives)
    np.testing.assert_allclose(found.q, TARGET, atol=1e-4)


def test_a_law_that_knows_the_clock_asks_for_the_time(result):
    with pytest.raises(InputError, match="time since the session's first traverse"):
        plan_move(calibrated_arm(result), START, TARGET)


def drive_of_joint_2() -> pd.DataFrame:
    row = {"joint": 2, "direction": "+", "q1": 0.1, "q2": np.nan, "q3": 0.01, "theta": 0.0, "psi": 0.0}
    return pd.DataFrame([row | {"start": -0.5, "stop": 0.5, "check_every": 1}])


@pytest.mark.parametrize(
    "use",
    [
        lambda result, plan, given: calibrated_arm(result, conditions=given),
        lambda result, plan, given: predict(result, plan, conditions=given),
        lambda result, plan, given: predict(result, drive_of_joint_2(), conditions=given),
        lambda result, plan, given: read_drives("absent.csv", result, conditions=given),
    ],
    ids=["calibrated_arm", "predict a plan", "predict drives", "read_drives"],
)
def test_conditions_that_no_drive_can_have_are_refused(result, plan, use):
    given = {"session_seconds": -5, "temperatur": 293.0, "temperature": 293.0}
    with pytest.raises(InputError) as refused:
        use(result, plan, given)
    time, name = map(str, refused.value.problems)
    assert time.startswith("conditions, value 'session_seconds=-5': ")
    assert time.endswith("give a number of 0 or more")
    assert name.startswith("conditions, value 'temperatur=293.0': is no condition; give session_seconds, ")
    assert name.endswith("; did you mean temperature?")


def test_conditions_give_the_position_of_a_joint_to_drives_without_it(result):
    drive, given = drive_of_joint_2(), {"session_seconds": 600.0}
    whole = predict(result, drive, conditions=given)
    without = predict(result, drive.assign(q1=np.nan), conditions=given | {"q1": 0.1})
    pd.testing.assert_frame_equal(whole, without)


def test_conditions_at_the_shell_are_numbers_that_a_drive_can_have(result):
    for text, told in (
        ("session_min=-30", "give a number of 0 or more, e.g. session_min"),
        ("session_s=nan", "number"),
    ):
        with pytest.raises(InputError, match=f"--condition, value '{text}': .*{told}"):
            parse_conditions([text], result, "--condition")
    assert parse_conditions(["session_min=0"], result, "--condition") == {"session_seconds": 0.0}


@pytest.mark.slow
def test_a_plan_is_predicted_with_the_clock_that_it_will_have(plan, result, arm_log):
    found = predict(result, plan, session=str(arm_log.rows["session"].iloc[0]))
    rows = arm_log.rows
    first = (rows["session"] == rows["session"].iloc[0]).to_numpy()
    # The pauses of a person are known on average only: some minutes by the end of a session.
    np.testing.assert_allclose(found["steps"][first], rows["steps"][first], rtol=4e-3)
    cold = found["steps"].to_numpy()[first][0] / rows["steps"].to_numpy()[first][0]
    assert cold == pytest.approx(1.0, abs=2e-4)


def test_a_notebook_shows_the_causes_once_in_a_table_of_their_own(result):
    html = result._repr_html_()
    assert html.count("thermal-warm-up.A") == 1
    assert html.index("Departures from the published laws") < html.index("thermal-warm-up.A")
