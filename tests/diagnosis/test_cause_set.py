"""Two causes of which neither is right: how many nats between them are left."""

import numpy as np
import pytest
from scipy.stats import binom

from stickslip_fit.diagnosis.cause_set import CauseSet, limit_evidence

N_SESSIONS, ROWS = 12, 20
SESSION = np.repeat(np.arange(N_SESSIONS), ROWS)


def ahead(likelier, other):
    return float(other @ other - likelier @ likelier) / 2


def test_a_cause_that_is_right_keeps_its_evidence():
    """Sessions contradict it in 5 of 100 logs, however unequal what they can tell."""
    rng = np.random.default_rng(0)
    difference = 0.8 * rng.standard_normal(len(SESSION)) * (0.2 + (SESSION == 3))
    residuals = rng.standard_normal((1000, len(SESSION)))
    right = [ahead(one, one + difference) for one in residuals]
    kept = sum(
        limit_evidence(nats, one, one + difference, SESSION) == nats
        for nats, one in zip(right, residuals, strict=True)
    )
    assert kept >= binom.ppf(1e-4, 1000, 0.95)


@pytest.mark.parametrize("lead", [4.0, 6.0])
def test_where_sessions_are_divided_a_small_lead_says_little(lead):
    """Half of the sessions are as one of two causes says, half as the other, which is a little ahead."""
    rng = np.random.default_rng(1)
    difference = np.full(len(SESSION), 0.8)
    noise = rng.standard_normal(len(SESSION))
    likelier = np.where(SESSION % 2, noise, noise - difference)
    plain = limit_evidence(lead, noise, noise + difference, SESSION)
    divided = limit_evidence(lead, likelier, likelier + difference, SESSION)
    assert plain == lead
    assert divided < 1.0


def test_where_sessions_are_divided_a_large_lead_counts():
    """Nine of twelve sessions are as the first says: it is nearer to the truth, if by less than it seems."""
    rng = np.random.default_rng(2)
    noise = rng.standard_normal(len(SESSION))
    likelier = np.where(SESSION < 9, noise, noise - 1.0)
    nats = ahead(likelier, likelier + 1.0)
    assert 3.0 < limit_evidence(nats, likelier, likelier + 1.0, SESSION) < nats / 2


def test_a_cause_that_is_nearer_in_every_session_is_ahead_of_one_whose_bent_form_has_evidence():
    """What sessions tell is of the fits, and by these no session is as the other one says."""
    rng = np.random.default_rng(4)
    likelier = 1.5 * rng.standard_normal(len(SESSION))
    other = likelier * np.where(SESSION % 3, 1.3, 2.5)
    assert limit_evidence(0.05 * ahead(likelier, other), likelier, other, SESSION) > 3.0


def test_causes_that_predict_the_same_keep_the_evidence_of_their_priors():
    residual = np.random.default_rng(3).standard_normal(len(SESSION))
    assert limit_evidence(4.0, residual, residual, SESSION) == 4.0


def test_rivals_that_are_as_likely_share_the_probability():
    alone = CauseSet("drift", ("wear",), {"drift": 0.6, "wear": 0.3, "side-load": 0.1})
    together = alone.with_rivals(["wear", "side-load"])
    assert together.rivals == ("wear", "side-load")
    assert together.probability == pytest.approx({"drift": 0.3, "wear": 0.3, "side-load": 0.3})
    assert alone.with_rivals([]) == alone


def test_what_was_found_as_well_is_no_rival():
    found = CauseSet("wear", ("drift", "humidity"), {"wear": 0.5, "drift": 0.3, "humidity": 0.2}, ("drift",))
    left = found.without_rivals(["wear", "drift", "unknown"])
    assert left == CauseSet("wear", ("humidity",), {"wear": 0.8, "drift": 0.0, "humidity": 0.2})
