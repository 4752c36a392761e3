import numpy as np
import pytest

from stickslip_fit.estimation import fit_closed_form, fit_constant_step, held_out_errors, summarize_errors
from stickslip_fit.logs import read_log


def mean_steps(table, q2, theta):
    """Step size in nm of the first traverse in this configuration, in `+`."""
    subset = table[
        (table.joint == 3) & (table.direction == "+") & (table.q2_deg == q2) & (table.theta_deg == theta)
    ]
    first = subset[(subset.psi_deg == 0)].sort_values("time").iloc[0]
    return 12e6 / (first.steps - 2.5)


def test_prismatic_joint_by_hand(campaign, read_table):
    table = campaign(("2012-03-05",))
    plain, recoiling, loaded = (mean_steps(table, *at) for at in ((-90.0, 0.0), (0.0, -90.0), (0.0, 0.0)))
    found = fit_closed_form(read_table(table)).joints[3]
    b = 1 - recoiling / plain
    assert found.values[0] == pytest.approx([plain * 1e-9, b, (plain - loaded / (1 - b)) * 1e-9], rel=1e-9)


def test_rotary_joints_recover_the_truth(campaign, read_table):
    result = fit_closed_form(read_table(campaign(repeatability=0.0, check_every=1)))
    assert result.joints[2].values[0] * 1e6 == pytest.approx([95.0, 90.0, -15.0, -19.85], rel=2e-4)
    assert result.joints[2].values[1] * 1e6 == pytest.approx([94.0, 91.0, 19.6, 25.91], rel=2e-4)
    assert result.joints[1].values[0] * [1e6, 1e3, 1e6, 1e3] == pytest.approx(
        [97.0, -0.05, -1.0, -0.35], rel=0.01
    )


def test_error_bars_match_the_scatter_of_many_sessions(campaign, read_table):
    sessions = tuple(f"2012-{month:02d}-{day:02d}" for month in (1, 2, 3, 4) for day in range(1, 26))
    calibration = (
        {"joint": 3, "q2_deg": -90.0},
        {"joint": 3, "q2_deg": 0.0, "theta_deg": -90.0},
        {"joint": 3, "q2_deg": 0.0},
    )
    result = fit_closed_form(read_table(campaign(sessions, calibration, seed=7)))
    table = result.si.parameters
    for (name, direction), subset in table.groupby(["name", "direction"]):
        ratio = subset["estimate"].std() / subset["standard_error"].mean()
        assert ratio == pytest.approx(1.0, abs=4 / np.sqrt(2 * 99)), (name, direction)


def test_only_the_first_traverse_of_each_configuration_calibrates(campaign, read_table):
    log = read_table(campaign())
    result = fit_closed_form(log)
    used = log.usable.loc[result.residuals.index[result.residuals["used"]]]
    assert len(used) == 2 * 2 * (3 + 4 + 4)
    assert result.residuals.loc[used.index, "residual"].abs().max() < 1e-9


def test_the_base_may_lie_on_either_side(campaign, read_table):
    table = campaign(("2012-03-05",))
    table["theta_deg"] = table["theta_deg"].replace(-90.0, 90.0)
    result = fit_closed_form(read_table(table[table.joint != 1]))
    assert all(fit.known.all() for fit in result.joints.values())


@pytest.mark.slow
def test_a_missing_traverse_is_named_and_spoils_no_other_parameter(campaign, read_table):
    table = campaign(("2012-03-05",))
    lost = (table.joint == 3) & (table.q2_deg == 0.0) & (table.theta_deg == 0.0)
    lost |= (table.joint == 2) & (table.q3_mm == 12.0) & (table.theta_deg == 0.0)
    lost |= (table.joint == 1) & (table.q3_mm == 12.0) & (table.theta_deg == -90.0)
    result = fit_closed_form(read_table(table[~lost]))
    estimate = result.si.parameters.query("direction == '+'").set_index("name")
    assert set(estimate.index[estimate["estimate"].isna()]) == {"c", "d_q3_12", "d_reach_0", "d_per_mm"}
    assert estimate["standard_error"].notna().sum() == len(estimate) - 4
    message = next(r.message for r in result.flags if r.joint == 3 and r.direction == "+")
    assert "c cannot be calibrated" in message
    assert "q2 = 0°, theta = 0°" in message


@pytest.mark.slow
def test_of_many_missing_traverses_what_is_left_keeps_its_error_bars():
    """Every eighth row of a campaign: some loaded traverses stand without their unloaded ones."""
    log = read_log("data/reference/campaign.csv")
    thin = log.select(np.arange(len(log)) % 8 == 0)
    result = fit_closed_form(thin)
    a = result.si.parameters.set_index(["joint", "name", "direction"]).loc[3, "a", "+"]
    truth = fit_closed_form(log).si.parameters.set_index(["joint", "name", "direction"]).loc[3, "a", "+"]
    assert np.all(a["standard_error"] > 0)
    assert np.all(abs(a["estimate"].to_numpy() - truth["estimate"].to_numpy()) < 4 * a["standard_error"])


@pytest.mark.slow
def test_a_gravity_effect_beyond_any_law_is_refused_with_a_reason(campaign, read_table):
    table = campaign(("2012-03-05",))
    odd = (table.joint == 2) & (table.theta_deg == 0.0) & (table.q3_mm == 0.0) & (table.psi_deg == 0.0)
    table.loc[odd, "steps"] = 1000
    result = fit_closed_form(read_table(table))
    flag = next(r for r in result.flags if r.joint == 2 and r.direction == "+")
    assert flag.parameters == ("d_q3_0",)
    assert "repeat them" in flag.message


@pytest.mark.slow
def test_accuracy_is_measured_on_traverses_that_calibrated_nothing(campaign, read_table):
    log = read_table(campaign())
    law = fit_closed_form(log)
    constant = fit_constant_step(log, law)
    table = held_out_errors(log, law, constant).si
    used = law.residuals.index[law.residuals["used"]]
    assert not table.index.isin(used).any()
    assert len(table) == len(log.usable) - len(used)
    row = table[table.joint == 3].iloc[0]
    assert row["measured"] == pytest.approx(0.012 / (log.usable.loc[row.name, "steps"] - 2.5))
    summary = summarize_errors(table, ["joint", "direction"]).set_index(["joint", "direction"])
    subset = table[(table.joint == 3) & (table.direction == "+")]
    rms = np.sqrt(np.mean((subset["law"] - subset["measured"]) ** 2))
    assert summary.loc[(3, "+"), "law_rms"] == pytest.approx(rms)
    assert summary.loc[(3, "+"), "law_rms_relative"] < 0.02
    assert summary.loc[(3, "+"), "constant_rms_relative"] > 0.2
