import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.strategies import (
    ClosedForm,
    ConstantStepStrategy,
    DOptimal,
    Hierarchical,
    LeastSquares,
    compare_strategies,
    earlier_sessions,
    save_comparison,
)
from stickslip_fit.strategies._summary import compare_with_best
from stickslip_fit.strategies.compare import make_tables
from stickslip_fit.strategies.statistics import CONFIGURATION_UNIT
from tests.conftest import CALIBRATION, SWEEPS

MONDAY, TUESDAY, WEDNESDAY = "2012-03-05", "2012-03-06", "2012-03-07"


class FirstOfAll:
    """What a user may write: the mean step of whatever was driven first."""

    name = "first of all"

    def choose(self, task):
        return np.array([0])

    def calibrate(self, task, made):
        step = abs(made["stop"] - made["start"]).sum() / made["steps"].sum()
        return lambda rows: (np.log(abs(rows["stop"] - rows["start"]) / step), np.zeros(len(rows)))


@pytest.fixture(scope="module")
def found(log):
    return compare_strategies(
        log, [ConstantStepStrategy(), ClosedForm(), LeastSquares(DOptimal(), 2), FirstOfAll()]
    )


def test_errors_are_those_of_traverses_that_nobody_calibrated_from(found, log):
    shared = found.shared
    assert shared.groupby("traverse")["strategy"].nunique().eq(4).all()
    by_hand = shared["predicted"] / shared["measured"] - 1.0
    rows = log.usable.loc[shared["traverse"]]
    measured = abs(rows["stop"] - rows["start"]).to_numpy() / (rows["steps"].to_numpy() - 2.5)
    assert shared["measured"].to_numpy() == pytest.approx(measured)
    subset = shared[(shared["joint"] == 3) & (shared["strategy"] == "closed form")]
    squares = (by_hand[subset.index] ** 2).groupby(subset["session"]).mean()
    summed = found.accuracy().set_index(["joint", "strategy"]).loc[(3, "closed form")]
    assert summed["rms_relative"] == pytest.approx(np.sqrt(squares.mean()))
    assert summed["worst_relative"] == pytest.approx(
        by_hand[subset.index][by_hand[subset.index].abs().idxmax()]
    )
    assert summed["units"] == 3


def test_the_thesis_calibration_beats_the_constant_step_and_a_twin_is_no_better(found, log):
    class Twin(ClosedForm):
        name = "twin"

    two_joints = log.select(log.rows["joint"] != 1)
    pairs = compare_strategies(two_joints, [ConstantStepStrategy(), ClosedForm(), Twin()]).pairs.set_index(
        ["joint", "strategy", "other"]
    )
    for joint in (2, 3):
        assert pairs.loc[(joint, "constant step", "closed form"), "verdict"] == "worse"
        twins = pairs.loc[(joint, "closed form", "twin")]
        assert twins["difference"] == 0
        assert twins["verdict"] == "indistinguishable on this log"
    told = " ".join(str(found).split())
    assert "cannot be told from it on this log" in told
    assert "None of" not in told


def test_the_best_is_the_one_that_others_exceed(found):
    accuracy = found.accuracy().set_index(["joint", "strategy"])["rms_relative"]
    for joint in found.joints:
        best, others = compare_with_best(found, joint)
        assert best == accuracy[joint].idxmin()
        assert list(others["strategy"]) == [name for name in found.strategies if name != best]
        for _, pair in others.iterrows():
            assert pair["other"] == best
            low, middle, high = (pair[f"difference_relative{end}"] for end in ("_low", "", "_high"))
            assert low < middle < high
            assert middle == pytest.approx(
                accuracy[joint, pair["strategy"]] - accuracy[joint, best], abs=5e-4
            )
        assert others.set_index("strategy").loc["constant step", "verdict"] == "worse"


def test_cost_is_steps_and_what_lies_between_them(found, log):
    """The generator takes 10 ms a step and 90 s to turn round, less a fraction of a second."""
    cost = found.cost().set_index(["joint", "strategy"]).loc[(2, "closed form")]
    assert cost["traverses"] == 4
    full = log.usable[(log.usable["joint"] == 2) & (abs(log.usable["stop"] - log.usable["start"]) > 4.1)]
    calibration = full[full["q3"].isin([0.0, 0.012]) & (full["psi"] == 0)].drop_duplicates(
        ["session", "direction", "q3", "theta"]
    )
    assert len(calibration) == 3 * 2 * 4
    assert cost["seconds"] == pytest.approx(calibration["steps"].sum() * 0.01 / 3 + 8 * 90, rel=2e-3)


@pytest.mark.slow
def test_a_session_that_lacks_traverses_is_left_out_for_all(campaign, written):
    two_joints = tuple(each for each in CALIBRATION + SWEEPS if each["joint"] != 1)
    table = campaign((MONDAY, TUESDAY, WEDNESDAY), two_joints)
    lacking = (
        (table["session"] == TUESDAY)
        & (table["joint"] == 3)
        & (table["q2_deg"] == 0)
        & (table["theta_deg"] < 0)
    )
    found = compare_strategies(read_log(written(table[~lacking])), [ConstantStepStrategy(), ClosedForm()])
    left_out = found.left_out
    assert set(zip(left_out["strategy"], left_out["session"], left_out["joint"], strict=True)) == {
        ("closed form", TUESDAY, 3)
    }
    assert "lacks a full traverse at q2 = 0°, theta = -90°" in left_out["reason"].iloc[0]
    assert found.sessions(3) == (MONDAY, WEDNESDAY)
    assert found.sessions(2) == (MONDAY, TUESDAY, WEDNESDAY)
    row = next(line for line in str(found).splitlines() if TUESDAY in line)
    assert row.split()[:6] == ["closed", "form", "3", "+", "and", "\N{MINUS SIGN}"]


def test_on_the_day_the_first_session_has_none_to_look_back_on(log):
    guide = log.select(log.rows["joint"] == 3)
    found = compare_strategies(guide, [ClosedForm(), Hierarchical(1)], session_selector=earlier_sessions)
    assert set(found.left_out["session"]) == {MONDAY}
    assert found.sessions(3) == (TUESDAY, WEDNESDAY)


@pytest.mark.slow
def test_a_strategy_that_suits_no_session_of_a_joint_takes_no_part_there(log):
    class NotJointTwo(FirstOfAll):
        def choose(self, task):
            return (
                ClosedForm().choose(task)[:1]
                if task.law.joint != 2
                else LeastSquares(DOptimal(), 99).choose(task)
            )

    found = compare_strategies(log.select(log.rows["joint"] != 1), [ClosedForm(), NotJointTwo()])
    assert found.compared(2) == ("closed form",)
    assert found.compared(3) == ("closed form", "first of all")
    assert found.sessions(2) == (MONDAY, TUESDAY, WEDNESDAY)
    assert "joint 2" in str(found)


def test_one_session_is_judged_over_its_configurations(log):
    monday = log.select((log.rows["session"] == MONDAY) & (log.rows["joint"] == 3))
    found = compare_strategies(monday, [ConstantStepStrategy(), ClosedForm()])
    assert found.unit(3) == CONFIGURATION_UNIT
    accuracy = found.accuracy().set_index(["joint", "strategy"]).loc[(3, "closed form")]
    assert accuracy["units"] == len(monday.configurations()) * 2
    assert "there is one session" in " ".join(str(found).split())
    assert found.pairs.set_index("joint").loc[3, "verdict"] == "worse"


@pytest.mark.slow
def test_a_log_without_replicates_still_leaves_sweeps_to_predict(campaign, written):
    once = read_log(written(sessions=(MONDAY, TUESDAY), replicates=1))
    found = compare_strategies(once, [ConstantStepStrategy(), ClosedForm()])
    assert len(found.joints) == 3
    everything = [LeastSquares(DOptimal(), 3), *(_Slice(first) for first in range(0, 40, 4))]
    third = once.select(once.rows["joint"] == 3)
    text = " ".join(str(compare_strategies(third, everything)).split())
    assert "no traverse is left that none of the strategies calibrates from" in text


class _Slice(FirstOfAll):
    """Four of the offered traverses, from a place on."""

    def __init__(self, first):
        self.first, self.name = first, f"from {first} on"

    def choose(self, task):
        return np.arange(self.first, self.first + 4) % len(task.offered)


def test_what_never_repeats_cannot_be_judged(campaign, written):
    once = campaign(sessions=(MONDAY,), replicates=1)
    few = once[(once["joint"] == 3) & (once["direction"] == "+")].head(3)
    with pytest.raises(InputError, match="joint 3: nothing shows how well a traverse repeats"):
        compare_strategies(read_log(written(few)), [ConstantStepStrategy()])


@pytest.mark.parametrize("chosen", [[0, 0], [99], [-1]])
def test_a_strategy_may_only_choose_what_is_offered(log, chosen):
    class Wrong(FirstOfAll):
        def choose(self, task):
            return np.array(chosen)

    with pytest.raises(InputError, match="'first of all' chose traverses"):
        compare_strategies(log, [Wrong()])


def test_two_strategies_need_two_names(log):
    with pytest.raises(InputError, match="names that differ"):
        compare_strategies(log, [ClosedForm(), ClosedForm()])


@pytest.mark.slow
def test_every_number_is_saved_in_peoples_units(found, tmp_path):
    save_comparison(found, tmp_path / "numbers")
    for name, table in make_tables(found).items():
        read = pd.read_csv(tmp_path / "numbers" / f"{name}.csv", keep_default_na=False, na_values=[""])
        same = pd.read_parquet(tmp_path / "numbers" / f"{name}.parquet")
        assert len(read) == len(table)
        assert list(read) == list(same)
        for column in read.select_dtypes("number"):
            assert read[column].to_numpy() == pytest.approx(same[column].to_numpy(), rel=1e-12, nan_ok=True)
    errors = pd.read_csv(tmp_path / "numbers" / "errors.csv")
    nm = errors[errors["unit"] == "nm"]
    assert nm["measured"].between(300, 1500).all()
    assert nm["error_pct"].to_numpy() == pytest.approx((100 * nm["error"] / nm["measured"]).to_numpy())
    assert set(nm["q2_deg"]) <= {0.0, -30.0, -60.0, -90.0, -150.0}


def test_the_bound_falls_towards_the_floor_and_nothing_lies_below_it(found):
    for joint, subset in found.bounds.groupby("joint"):
        assert subset["rms_relative"].is_monotonic_decreasing
        assert (subset["rms_relative"] > subset["floor_relative"]).all()
        noise = [value for (of, _), value in found.repeatability.items() if of == joint]
        assert min(noise) <= subset["floor_relative"].iloc[0] <= max(noise) * 1.02
        assert subset["traverses"].iloc[0] == {1: 4, 2: 4, 3: 3}[int(joint)]
