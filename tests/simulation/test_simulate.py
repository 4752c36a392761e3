from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.laws import expected_steps
from stickslip_fit.logs import read_log, write_log
from stickslip_fit.simulation import LawValues, simulate

# Steps of joint 3 by hand: 12 mm over a, and over (1 - b) (a - c).
LEVEL, UPRIGHT = 0.012 / 976e-9, 0.012 / (0.7 * (976e-9 - 438e-9))
LEVEL_BACK, UPRIGHT_BACK = 0.012 / 903e-9, 0.012 / (0.7 * (903e-9 + 405e-9))


def test_without_noise_counts_are_the_laws_seen_at_the_next_check(rows_of):
    wanted = [LEVEL, LEVEL_BACK, UPRIGHT, UPRIGHT_BACK]
    assert list(rows_of(repeatability=0)["steps"]) == [5 * int(np.ceil(n / 5)) for n in wanted] * 3
    assert list(rows_of(repeatability=0, check_every=1)["steps"]) == [round(n) for n in wanted] * 3


def test_arguments_in_a_wrong_place_are_told_by_their_names(plan_of, law_of, machine):
    log = simulate(plan_of(), law_of(), machine)
    with pytest.raises(InputError, match=r"^plan: a Plan is wanted, not a Log; "):
        simulate(log, law_of(), machine)
    with pytest.raises(InputError, match=r"^truth: a LawValues is wanted, not a Machine; "):
        simulate(plan_of(), machine, law_of())


def test_a_simulated_log_reads_back_the_same(plan_of, law_of, machine, tmp_path):
    sweep = "q2_deg = [-90, 12.3]\npsi_deg = [0, 33.3]\nranges_mm = [[0, 7.7], [7.7, 12]]"
    log = simulate(plan_of(sweep=sweep), law_of(1.8), machine)
    write_log(log, tmp_path / "log.csv")
    pd.testing.assert_frame_equal(read_log(tmp_path / "log.csv").rows, log.rows, check_like=True)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(plan_of, law_of, machine, tmp_path):
    def written(seed):
        write_log(simulate(plan_of(seed=1), law_of(1.8), machine, seed), tmp_path / "log.csv")
        return (tmp_path / "log.csv").read_bytes()

    assert written(None) == written(1) == written(1)
    assert written(1) != written(2)


def test_another_session_changes_no_other(rows_of):
    two = rows_of(1.8, dates="2012-03-05, 2012-03-06", order="random")
    three = rows_of(1.8, dates="2012-03-05, 2012-03-06, 2012-03-07", order="random")
    pd.testing.assert_frame_equal(three[: len(two)], two)
    assert len(set(three.groupby("session")["steps"].sum())) == 3


@pytest.mark.parametrize("kind", ["gaussian", "t5"])
def test_counts_scatter_by_the_stated_repeatability(rows_of, kind):
    rows = rows_of(kind=kind, replicates=5_000, check_every=1, dates="2012-03-05", sweep="q2_deg = -90")
    departures = np.log(rows["steps"] / rows["direction"].map({"+": LEVEL, "-": LEVEL_BACK}))
    # Sampling error of a standard deviation: sqrt((kurtosis - 1) / 4 n), kurtosis 3 and 9; four of them.
    excess = {"gaussian": 2, "t5": 8}[kind]
    assert departures.std() == pytest.approx(0.0027, rel=4 * np.sqrt(excess / (4 * len(rows))))
    tails = np.mean(np.abs(departures) > 4 * 0.0027)
    assert (tails > 1e-3) == (kind == "t5")


def test_counts_are_unbiased_once_half_a_check_is_taken_off(rows_of):
    rows = rows_of(replicates=10_000, dates="2012-03-05", sweep="q2_deg = -90\ndirections = ['+']")
    spread = 0.0027 * LEVEL
    seen = expected_steps(rows["steps"], rows["check_every"]).mean()
    assert seen == pytest.approx(LEVEL * np.exp(0.0027**2 / 2), abs=4 * spread / np.sqrt(len(rows)))


def test_days_differ_by_the_stated_factor_of_the_step_size(rows_of):
    dates = ", ".join(map(str, np.arange("2012-01-01", "2015-01-01", dtype="datetime64[D]")))
    rows = rows_of(1.8, dates=dates, repeatability=0, check_every=1)
    level, upright = {"+": LEVEL, "-": LEVEL_BACK}, {"+": UPRIGHT, "-": UPRIGHT_BACK}
    wanted = rows["direction"].map(level).where(rows["q2"] < -1, rows["direction"].map(upright))
    factor = (wanted / rows["steps"]).groupby([rows["session"], rows["direction"]])
    assert (factor.max() - factor.min()).max() < 1e-4  # one factor for a session and direction
    forward, backward = factor.mean().unstack().to_numpy().T
    error = 1 / np.sqrt(2 * len(forward))
    for days in (forward, backward):
        assert days.std() == pytest.approx(0.018, rel=4 * error)
        assert days.mean() == pytest.approx(1.0, abs=4 * 0.018 / np.sqrt(len(days)))
    assert abs(np.corrcoef(forward, backward)[0, 1]) < 4 / np.sqrt(len(forward))


def test_a_session_with_parameters_of_its_own_has_exactly_those(rows_of):
    own = '[[law]]\njoint = 3\ndirection = "+"\nsession = "2012-03-06"\na_nm = 900\nb = 0\nc_nm = 0\n'
    rows = rows_of(1.8, own, repeatability=0, check_every=1)
    chosen = rows[(rows["session"] == "2012-03-06") & (rows["direction"] == "+")]
    assert list(chosen["steps"]) == [round(0.012 / 900e-9)] * 2
    others = rows.drop(chosen.index)
    without = rows_of(1.8, repeatability=0, check_every=1).drop(chosen.index)
    assert list(others["steps"]) == list(without["steps"])


def test_a_machine_moves_at_the_pace_of_its_steps_and_its_operator(plan_of, law_of, machine):
    plan = plan_of(sweep="q2_deg = [-90, -60, -30, 0]", replicates=40, dates="2012-03-05")
    rows = simulate(plan, law_of(), machine).rows
    assert rows["time"][0] == pd.Timestamp("2012-03-05T08:30:00")
    assert rows["time"].iloc[-1] > pd.Timestamp("2012-03-06")  # past midnight
    assert (rows["time"] == rows["time"].dt.floor("s")).all()
    between = rows["time"].diff().dt.total_seconds()[1:] - 0.010 * rows["steps"].to_numpy()[:-1]
    turns = np.diff(plan.rows()["visit"]) == 0
    assert between[turns].between(5, 16).all()
    assert between[~turns].between(60, 241).all()
    assert between[~turns].mean() == pytest.approx(150.5, abs=4 * 180 / np.sqrt(12 * (~turns).sum()))


def test_two_traverses_never_begin_in_the_same_second(rows_of):
    more = "ranges_mm = [[0, 0.001]]\n[timing]\npause_s = [0, 0]\nturn_s = [0, 0]\nstep_period_ms = 0.1"
    rows = rows_of(sweep=f"q2_deg = [-90, 0]\n{more}", replicates=50)
    assert not rows.duplicated(["session", "time"]).any()
    assert (rows.groupby("session")["time"].diff().dropna() == pd.Timedelta(seconds=1)).all()


class TestFaults:
    def test_a_session_that_is_not_over_when_the_next_begins(self, rows_of):
        with pytest.raises(
            InputError, match=r"'2012-03-05' takes \d+\.\d h and is not over when session '2012-03-06'"
        ):
            rows_of(replicates=200)

    def test_a_plan_without_noise(self, plan_of, law_of, machine):
        with pytest.raises(InputError, match=r"no \[noise\]; add one with repeatability_pct"):
            simulate(replace(plan_of(), noise=None), law_of(), machine)

    def test_a_direction_without_repeatability(self, rows_of):
        with pytest.raises(InputError, match='drives "3-", but its repeatability_pct'):
            rows_of(repeatability="{'3+' = 0.27}")

    def test_a_joint_or_direction_without_parameters(self, plan_of, law_of, machine):
        plan, law = plan_of(), law_of()
        forward = {key: value for key, value in law.values.items() if key[1] == "+"}
        with pytest.raises(
            InputError, match="joint 3, direction - has no parameters for session '2012-03-05'"
        ):
            simulate(plan, LawValues(law.laws, forward), machine)
        with pytest.raises(InputError, match="joint 3 has no law"):
            simulate(plan, LawValues({}, {}), machine)

    def test_parameters_for_a_session_that_is_not_planned(self, rows_of):
        own = '[[law]]\njoint = 3\ndirection = "+"\nsession = "2012-3-06"\na_nm = 900\nb = 0\nc_nm = 0\n'
        with pytest.raises(
            InputError, match="parameters for session '2012-3-06', which the plan does not have"
        ):
            rows_of(0, own)

    def test_a_law_that_brings_the_joint_to_a_halt(self, rows_of):
        own = '[[law]]\njoint = 3\ndirection = "+"\nsession = "2012-03-06"\na_nm = 400\nb = 0\nc_nm = 438\n'
        with pytest.raises(InputError, match=r"joint 3 comes to a halt .* q2 = 0, theta = 0, psi = 0"):
            rows_of(0, own)
