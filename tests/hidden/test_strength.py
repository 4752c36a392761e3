"""Strength is what a baseline fitted anew cannot take up, and what was asked for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.hidden.campaign import Campaign
from tests.hidden.catalogue import CAUSES, EFFECTS
from tests.hidden.generate import UnreachableError, hide
from tests.hidden.generate import testable as can_show
from tests.hidden.physics import Array


def _left_by_refitting(campaign: Campaign, log_counts: Array, weights: Array) -> float:
    """Root sum of squares of weighted residuals, each session and direction fitted by itself."""
    group, left = 2 * campaign.plan.session + (campaign.plan.forward > 0), 0.0
    for place in campaign.places:
        for each in np.unique(group[place.rows]):
            subset = group[place.rows] == each

            def residual(shares, place=place, subset=subset):
                named = zip(place.values.items(), shares, strict=True)
                moved = replace(place, values={name: value * (1 + share) for (name, value), share in named})
                rows = place.rows[subset]
                return (log_counts[rows] - np.log(moved.counts(moved.step_size()))[subset]) * weights[rows]

            left += 2 * least_squares(residual, np.zeros(len(place.values)), xtol=1e-12, ftol=1e-12).cost
    return float(np.sqrt(left))


@pytest.mark.parametrize("noise", ["gaussian", "uneven"])
@pytest.mark.parametrize("name", ["psi-offset", "session-jump"])
def test_strength_is_what_refitting_the_baseline_leaves(name, noise):
    hidden = hide("session", (name,), 12, noise, seed=5)
    campaign, log_counts = hidden.campaign, np.log(hidden.expected())
    (effect,) = hidden.truth["effects"]
    # Strength goes by the slope of the law: a little apart for effects of some per cent.
    assert _left_by_refitting(campaign, log_counts, 1 / campaign.repeatability) == pytest.approx(12, rel=0.02)
    even = _left_by_refitting(campaign, log_counts, np.ones(len(campaign))) / np.sqrt(len(campaign))
    assert effect["effect_rms_pct"] == pytest.approx(100 * even, rel=1e-4)


@pytest.mark.slow
def test_sessions_of_few_rows_are_refitted_to_the_least_that_can_be_left():
    # Undamped steps end at 4 % in a session of seven traverses, which is 0.35 %.
    hidden = hide("many", ("bearing-runout",), 25, "uneven", seed=8900035)
    campaign, log_counts = hidden.campaign, np.log(hidden.expected())
    (effect,) = hidden.truth["effects"]
    even = _left_by_refitting(campaign, log_counts, np.ones(len(campaign))) / np.sqrt(len(campaign))
    assert effect["effect_rms_pct"] == pytest.approx(100 * even, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form"), [(name, form) for name in EFFECTS for form in EFFECTS[name]])
def test_every_form_has_the_strength_asked_for(name, form):
    # The first campaign that has what the form needs: half of them write down no payload.
    for seed in range(1, 9):
        try:
            hidden = hide("many", (name,), 12, seed=seed, forms={name: form})
        except UnreachableError:
            continue
        break
    (effect,) = hidden.truth["effects"]
    assert effect["form"] == form
    assert effect["strength"] == pytest.approx(12, rel=2e-3)
    columns = ("covariate:air_pressure_hPa", "covariate:operator_load")
    named = columns if name == "covariate" else (name.split(":")[0],)
    assert effect["cause"] in named


@pytest.mark.parametrize(
    "names",
    [("drift", "psi-offset"), ("recoil-axis", "payload-change"), ("cable-torque", "end-stop-latency")],
)
def test_strengths_of_a_pair_are_each_its_own_and_both_act(names):
    pair = hide("many", names, (8, 16), seed=2)
    strengths = {effect["name"]: effect["strength"] for effect in pair.truth["effects"]}
    assert strengths == pytest.approx(dict(zip(names, (8, 16), strict=True)), rel=2e-3)
    together = np.log(pair.expected() / pair.campaign.counts)
    apart = [pair.effect(name) for name in names]
    smaller = min(np.abs(effect).max() for effect in apart)
    np.testing.assert_allclose(together, sum(apart), atol=0.2 * smaller)


def test_what_a_design_cannot_show_is_not_testable():
    thesis, session, many = (set(can_show(design, seed=1)) for design in ("thesis", "session", "many"))
    whole_traverses = {"worn-spot", "guide-gradient"}
    no_column = {"temperature", "humidity", "supply-voltage", "covariate"}
    assert not thesis & (no_column | whole_traverses | {"q1-gravity", "step-rate"})
    assert not session & (whole_traverses | {"q1-gravity", "step-rate", "humidity"})
    assert {"thermal-warm-up", "drift", "psi-offset", "session-jump"} <= thesis & session
    assert many == set(CAUSES)
    with pytest.raises(UnreachableError, match="worn-spot"):
        hide("thesis", ("worn-spot",), 8, seed=1)


@pytest.mark.slow
def test_a_cause_testable_at_a_strength_has_it_at_a_plausible_size():
    assert "end-stop-misfire" in can_show("thesis", 1, strength=12)
    assert "end-stop-misfire" not in can_show("thesis", 1, strength=5)
    strong = can_show("session", 1, strength=25)
    assert set(strong) < set(can_show("session", 1))
    for name in strong:
        (effect,) = hide("session", (name,), 25, seed=1).truth["effects"]
        assert effect["share_of_largest"] <= 1


@pytest.mark.parametrize("seed", range(8))
def test_a_runout_is_drawn_where_it_can_be_seen_before_it_is_made_implausibly_large(seed):
    (effect,) = hide("thesis", ("bearing-runout",), 12, seed=seed).truth["effects"]
    assert ("bearing-runout" in can_show("thesis", seed, strength=12)) == (effect["share_of_largest"] <= 1)
