"""Effects from outside the library: what they do, that no cause does the same, and their true forms."""

from __future__ import annotations

from functools import cache
from math import cos, exp, pi, sin, tanh

import numpy as np
import pytest

from tests.hidden.by_hand import count
from tests.hidden.campaign import make_campaign
from tests.hidden.catalogue import CAUSES, OUTSIDE_LIBRARY
from tests.hidden.effect import change
from tests.hidden.effects.outside_history import reversals
from tests.hidden.generate import hide
from tests.hidden.outside import OutsideCase, baseline, cases, log_counts, rms, true_form
from tests.hidden.strength import recalibrations

DEG = pi / 180
# Joints, and the share of A at one position of a traverse, in plain numbers.
BY_HAND = {
    "cos q1, joint 3": ((3,), lambda t: cos(t.q1)),
    "cubic in q2, joint 3": ((3,), lambda t: ((t.q2 / DEG + 75) / 105) ** 3),
    "sin 2 q1, joint 2": ((2,), lambda t: sin(2 * t.q1)),
    "bump in q2, joint 3": ((3,), lambda t: exp(-(((t.q2 / DEG + 60) / 25) ** 2))),
    "period of 5 mm in q3, joint 1": ((1,), lambda t: sin(2 * pi * t.q3 / 0.005)),
    "q3 and sin theta, joint 2": ((2,), lambda t: (t.q3 / 0.006 - 1) * sin(t.theta)),
    "saturating in sin theta, one way": (
        (1, 2, 3),
        lambda t: tanh(3 * sin(t.theta)) if t.forward > 0 else 0.0,
    ),
    "step period and load": ((1, 2, 3), lambda t: np.log(t.row["step_period"] / 0.004) * t.load),
}


@cache
def _first_cases() -> dict[str, OutsideCase]:
    """Cases by their form; those of all forms are made before one can be taken."""
    return {each.form: each for each in cases((25.0,), first=9)}


def _pairs() -> list[tuple[str, str]]:
    return [(name, form) for name, forms in OUTSIDE_LIBRARY.items() for form in forms]


@pytest.mark.parametrize("form", BY_HAND)
def test_an_effect_departs_as_its_name_says(form, read):
    (name,) = (name for name, forms in OUTSIDE_LIBRARY.items() if form in forms)
    hidden = hide("many", (name,), 12, seed=3, forms={name: form})
    joints, shape = BY_HAND[form]
    size = hidden.truth["effects"][0]["amplitude"]
    if hidden.truth["effects"][0]["parameters"][0]["value"] < 0:
        size = -size
    rows, effect = read(hidden), hidden.effect(name)

    def work(traverse, p) -> None:
        traverse.factor = 1 + size * shape(traverse) if traverse.joint in joints else 1.0

    assert np.abs(effect).max() > 1e-3
    for row in [int(np.argmax(effect)), int(np.argmin(effect)), 5, 300]:
        law = next(
            {key: float(value[number, 0]) for key, value in place.values.items()}
            for place in hidden.campaign.places
            for number, each in enumerate(place.rows)
            if each == row
        )
        by_hand = np.log(count(rows.loc[row], law, work) / hidden.campaign.counts[row])
        assert effect[row] == pytest.approx(by_hand, abs=2e-7)


def test_what_came_before_is_counted_and_measured_as_a_log_tells_it(read):
    hidden = hide("many", ("unknown:history",), 12, seed=3, forms={"unknown:history": "rest before"})
    rows, campaign = read(hidden), hidden.campaign
    turned = (rows["before_direction"] != "") & (rows["before_direction"] != rows["direction"])
    np.testing.assert_array_equal(reversals(campaign), turned.groupby(rows["joint"]).cumsum())
    first = rows["before_direction"] == ""
    assert first.any()
    assert np.all(hidden.effect("unknown:history")[first] == 0)
    end = (3600 * campaign.hours + campaign.counts * campaign.plan.step_period) / 3600
    own = np.where(campaign.before >= 0, campaign.hours - end[campaign.before], np.nan)
    effect = hidden.effect("unknown:history")[~first]
    assert abs(np.corrcoef(np.exp(-3 * own[~first]), effect)[0, 1]) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "size"),
    [
        (1, 30),
        *(pytest.param(*one, marks=pytest.mark.nightly) for one in ((2, 24), (3, 27), (4, 24))),
        (5, 20),
    ],
)
def test_there_are_so_many_cases_each_of_its_strength_at_a_plausible_size(number, size):
    made = cases((25.0,), 50, number)
    assert len({(each.name, each.form) for each in made}) == len(made) == size
    assert {each.design for each in made} == {"session", "thesis", "many"}
    for each in made[::3]:
        (effect,) = each.make().truth["effects"]
        assert (effect["strength"], effect["cause"]) == (pytest.approx(25, rel=2e-3), "unknown")


def test_none_is_what_a_cause_of_the_library_does():
    """Beside every form of every cause, each by itself: after recalibration they are not parallel."""
    campaign = make_campaign("many", "gaussian", 5)
    directions = recalibrations(campaign, np.ones(len(campaign)))

    def trace(maker) -> np.ndarray | None:
        effect = maker(campaign, np.random.default_rng(0))
        if effect is None:
            return None
        moved = change(campaign, effect, 0.2 * effect.largest)
        left = moved - directions @ (directions.T @ moved)
        return left / np.linalg.norm(left)

    causes = {
        f"{name}, {form}": trace(maker)
        for name, forms in CAUSES.items()
        if name != "end-stop-misfire"
        for form, maker in forms.items()
    }
    known = {name: one for name, one in causes.items() if one is not None}
    assert len(known) > 50
    for name, form in _pairs():
        one = trace(OUTSIDE_LIBRARY[name][form])
        closest = max(known, key=lambda cause: abs(known[cause] @ one))
        assert abs(known[closest] @ one) < 0.9, (form, closest)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["cubic in q2, joint 3", "residual before, one way"])
def test_the_true_form_saves_on_a_replicate_what_the_effect_cost(form):
    case = _first_cases()[form]
    hidden, fresh = case.make(), case.make(replicate=1)
    (effect,) = hidden.truth["effects"]
    cost = rms(fresh, baseline(hidden)) ** 2 - rms(fresh, true_form(hidden, fresh)) ** 2
    assert cost == pytest.approx((effect["effect_rms_pct"] / 100) ** 2, rel=0.25)
    # Nothing is left but noise, and what it cost to learn the parameters.
    noise = np.sqrt(np.mean((fresh.campaign.repeatability * fresh.campaign.innovations) ** 2))
    assert 0.95 * noise < rms(fresh, true_form(hidden, fresh)) < 1.2 * noise


def test_a_replicate_has_other_noise_and_the_same_effect():
    case = OutsideCase("unknown:angle", "square of psi", "thesis", "t5", 12.0, 4)
    hidden, fresh = case.make(), case.make(replicate=1)
    np.testing.assert_array_equal(hidden.expected(), fresh.expected())
    assert np.corrcoef(log_counts(hidden) - np.log(hidden.expected()),
                       log_counts(fresh) - np.log(fresh.expected()))[0, 1] < 0.2  # fmt: skip


def test_what_follows_noise_follows_a_replicates_own_with_the_same_size_and_sign():
    # Nature's draws are all too large here, and by the replicate's noise another would be the least so.
    case = OutsideCase("unknown:history", "residual before, one way", "session", "gaussian", 25.0, 104)
    hidden, fresh = case.make(), case.make(replicate=1)
    (parameter,), (again,) = (one.truth["effects"][0]["parameters"] for one in (hidden, fresh))
    assert again == parameter
    campaign = fresh.campaign
    onto = np.flatnonzero((campaign.plan.forward > 0) & (np.arange(len(campaign)) > 0))
    follows = (campaign.repeatability[1:] * campaign.innovations[:-1])[onto - 1]
    np.testing.assert_allclose(fresh.effect("unknown:history")[onto], parameter["value"] * follows, rtol=1e-9)
