"""Campaigns simulated side by side are those that one after the other would have been."""

import numpy as np
import pytest

from stickslip_fit.causes import EndStopMisfire, ReversalLoss, ThermalWarmUp, Wear
from stickslip_fit.simulation import LawValues, simulate
from stickslip_fit.studies import Scenario
from stickslip_fit.studies.simulation import campaign_seed, draw_campaigns, simulate_campaigns
from tests.studies.conftest import JOINT_3, ROTARY

CAUSES = {
    "nothing": ((), ()),
    "history": ((ThermalWarmUp(), Wear(), ReversalLoss()), (0.03, 2400.0, 0.01, 1e4, 30.0)),
    "misfires": ((EndStopMisfire(),), (0.05, 0.1)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CAUSES)
def test_side_by_side_as_one_after_the_other(kind, study, machine):
    causes, sizes = CAUSES[kind]
    scenario = Scenario("any", causes, np.array(sizes))
    plan = study(JOINT_3 + ROTARY, between_campaigns=0.0, between_sessions=0.0)
    found = simulate_campaigns(plan, scenario, draw_campaigns(plan, scenario, [7, 3]))

    laws, values = dict(plan.truth.laws), dict(plan.truth.values)
    if causes:
        for joint, law in laws.items():
            for cause in causes:
                law = cause.extend(law)
            laws[joint] = law
        values = {key: np.append(own, sizes) for key, own in values.items()}
    truth = LawValues(laws, values, plan.truth.day_to_day)
    for place, number in enumerate((7, 3)):
        alone = simulate(plan.plan, truth, machine, campaign_seed(plan, scenario, number)).rows
        subset = found.campaign_rows(place).sort_values("time", kind="stable")
        for name in ("steps", "session_seconds", "before_load", "steps_before", "q2", "joint"):
            np.testing.assert_array_equal(subset[name], alone[name], err_msg=name)
        assert list(subset["session"]) == list(alone["session"])


def test_a_campaign_is_the_same_whatever_stands_beside_it(study):
    plan = study(scatter="uneven")
    scenario = plan.scenarios[0]
    together = simulate_campaigns(plan, scenario, draw_campaigns(plan, scenario, range(5)))
    alone = simulate_campaigns(plan, scenario, draw_campaigns(plan, scenario, [3]))
    np.testing.assert_array_equal(together.campaign_rows(3)["steps"], alone.rows["steps"])
    assert not np.array_equal(together.campaign_rows(2)["steps"], together.campaign_rows(3)["steps"])
    other = Scenario("of another name")
    assert not np.array_equal(
        simulate_campaigns(plan, other, draw_campaigns(plan, other, [3])).rows["steps"], alone.rows["steps"]
    )


@pytest.mark.parametrize("scatter", ["gaussian", "t5", "uneven"])
def test_counts_scatter_as_asked(scatter, study):
    plan = study(scatter=scatter, repeatability=0.01, check_every=1, day_to_day_pct=0.0, campaigns=300)
    scenario = plan.scenarios[0]
    found = simulate_campaigns(plan, scenario, draw_campaigns(plan, scenario, range(300)))
    off = np.log(found.rows["steps"].to_numpy() / found.true_steps).reshape(300, -1)
    assert off.std() == pytest.approx(0.01, rel=0.02)
    assert abs(off.mean()) < 4 * 0.01 / np.sqrt(off.size)
    by_campaign = (off**2).reshape(300, 2, -1).mean(axis=1)
    tails = np.mean(off**4) / np.mean(off**2) ** 2
    if scatter == "gaussian":
        assert tails == pytest.approx(3.0, abs=0.15)
    if scatter == "t5":
        assert tails > 4.5
    if scatter == "uneven":
        # Uniform between 1 and 2, the fourth moment over the second one's square is 3 times 6.2 / (7/3)^2.
        assert tails == pytest.approx(3 * 6.2 / (7 / 3) ** 2, rel=0.05)
        # What is wide in one session is wide in the other.
        first, second = ((off**2).reshape(300, 2, -1)[:, k] for k in (0, 1))
        assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.03
    assert by_campaign.shape[1] == plan.plan.traverses_per_session
