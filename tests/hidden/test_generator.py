"""The logs themselves: format, designs, clock, noise, decoys, seeds."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import kurtosis

from stickslip_fit.logs import read_log
from tests.hidden.conditions import DECOYS
from tests.hidden.designs import DESIGNS
from tests.hidden.generate import hide


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("noise", ["gaussian", "t5", "uneven"])
def test_the_reader_takes_every_log_and_sees_the_history_that_acted(design, noise, read):
    hidden = hide(design, ("drift", "unknown:harmonic"), 8, noise, DECOYS, seed=4)
    rows, campaign = read(hidden), hidden.campaign
    assert list(rows["steps"]) == list(hidden.table["steps"])
    np.testing.assert_allclose(rows["session_seconds"], 3600 * campaign.hours, atol=1e-6)
    np.testing.assert_allclose(rows["before_load"], campaign.previous(campaign.load), atol=1e-9)
    sign = rows["before_direction"].map({"+": 1, "-": -1, "": 0}).astype(int)
    np.testing.assert_array_equal(sign, campaign.previous(campaign.plan.forward))
    # Wear goes by the steps expected, which differ from those logged by the effects and the noise.
    np.testing.assert_allclose(rows["steps_before"], campaign.steps_before, rtol=0.05, atol=1)
    assert {f"covariate:{name}" for name in hidden.truth["decoys"]} <= set(rows.columns)


def test_a_log_is_the_same_in_parquet(read, tmp_path):
    hidden = hide("many", seed=1)
    hidden.write(tmp_path / "log.parquet")
    pd.testing.assert_frame_equal(read_log(tmp_path / "log.parquet").rows, read(hidden))


@pytest.mark.parametrize(
    ("design", "rows", "sessions"),
    [("session", (150, 200), (1, 1)), ("thesis", (620, 680), (3, 3)), ("many", (620, 680), (12, 15))],
)
@pytest.mark.parametrize("seed", range(4))
def test_designs_are_as_large_as_they_say_and_leave_time_for_hands(design, rows, sessions, seed, read):
    hidden = hide(design, seed=seed)
    log = read(hidden)
    assert rows[0] <= len(log) <= rows[1]
    assert sessions[0] <= log["session"].nunique() <= sessions[1]
    driven = (hidden.campaign.counts * hidden.campaign.plan.step_period)[:-1]
    pause = log["time"].diff().dt.total_seconds()[1:] - driven
    within = log["session"].eq(log["session"].shift())[1:]
    assert pause[within].between(30, 91).all()
    assert (pause[~within] > 3600).all()


@pytest.mark.parametrize("kind", DECOYS)
def test_decoys_act_on_nothing(kind):
    without, decoyed = (hide("many", ("wear",), 8, decoys=decoys, seed=6) for decoys in ((), (kind,)))
    pd.testing.assert_frame_equal(decoyed.table[without.table.columns], without.table)
    assert decoyed.table["sensor_1"].std() > 0
    noise = decoyed.campaign.innovations
    assert abs(np.corrcoef(decoyed.table["sensor_1"], noise)[0, 1]) < 4 / np.sqrt(len(noise))


def test_where_nothing_is_hidden_nothing_the_lab_writes_down_explains_the_counts():
    nothing = hide("many", seed=6)
    campaign = nothing.campaign
    departure = np.log((nothing.table["steps"] - 2.5) / campaign.counts) / campaign.repeatability
    assert nothing.truth["effects"] == []
    for column in (*campaign.columns, "q1_deg", "theta_deg"):
        known = nothing.table[column].notna()
        correlation = np.corrcoef(nothing.table[column][known], departure[known])[0, 1]
        assert abs(correlation) < 4 / np.sqrt(known.sum())


def test_steps_are_the_first_check_at_or_after_the_expected_count():
    hidden = hide("thesis", seed=1)
    exact = hidden.expected() * np.exp(hidden.campaign.repeatability * hidden.campaign.innovations)
    late = hidden.table["steps"] - exact
    assert late.between(0, 5, inclusive="left").all()
    assert late.mean() == pytest.approx(2.5, abs=4 * 5 / np.sqrt(12 * len(late)))
    assert (hidden.table["steps"] % 5 == 0).all()


def test_the_same_seed_gives_the_same_log_and_another_replicate_other_noise_alone():
    def made(**changes):
        return hide(
            "many", **{"effects": ("temperature",), "strength": 8, "noise": "t5", "seed": 11} | changes
        )

    one, again, fresh = made(), made(decoys=("walk",)), made(replicate=1)
    pd.testing.assert_frame_equal(one.table, again.table[one.table.columns])
    assert one.truth["effects"] == fresh.truth["effects"]
    np.testing.assert_array_equal(one.expected(), fresh.expected())
    assert (one.table["steps"] != fresh.table["steps"]).mean() > 0.8
    pd.testing.assert_frame_equal(one.table.drop(columns="steps"), fresh.table.drop(columns="steps"))
    assert len(made(seed=12).table.merge(one.table, on="time")) < len(one.table) / 2


def test_repeatability_is_one_for_each_joint_and_direction_and_uneven_doubles_it_in_some_configurations():
    even, uneven = (hide("thesis", noise=kind, seed=8).campaign for kind in ("gaussian", "uneven"))
    levels = pd.Series(even.repeatability).groupby([even.plan.joint, even.plan.forward])
    assert levels.nunique().tolist() == [1] * 6
    assert even.repeatability.min() >= 0.0025
    assert even.repeatability.max() <= 0.0035
    ratio = pd.Series(uneven.repeatability / even.repeatability).round(9)
    assert set(ratio) == {1.0, 2.0}
    assert 0.1 < np.mean(ratio == 2) < 0.5
    assert ratio.groupby(uneven.plan.configuration()).nunique().eq(1).all()


def test_noise_has_unit_variance_and_the_tails_of_its_kind():
    draws = {
        kind: np.concatenate(
            [hide("thesis", noise=kind, seed=seed).campaign.innovations for seed in range(20)]
        )
        for kind in ("gaussian", "t5")
    }
    assert draws["gaussian"].std() == pytest.approx(1, abs=0.03)
    assert draws["t5"].std() == pytest.approx(1, abs=0.06)
    assert abs(kurtosis(draws["gaussian"])) < 0.3
    assert kurtosis(draws["t5"]) > 1.5


def test_what_is_not_known_is_refused():
    with pytest.raises(ValueError, match="moonlight"):
        hide("many", ("moonlight",), 8)
    with pytest.raises(ValueError, match="fortnight"):
        hide("fortnight")
    with pytest.raises(ValueError, match="pink"):
        hide("many", noise="pink")
    with pytest.raises(ValueError, match="rumour"):
        hide("many", decoys=("rumour",))
