"""Rows laid period over period stand where a wave of that period has them."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.plotting.residuals import fold_phase


def test_a_wave_is_largest_at_its_fold_whenever_a_session_begins():
    rng = np.random.default_rng(1)
    minutes = np.concatenate([np.sort(rng.uniform(0, 500, 60)) for _ in range(2)])
    begun = np.repeat([0.0, 13.0], 60)
    rows = pd.DataFrame({"session": np.repeat(["a", "b"], 60), "session_seconds": 60 * minutes})
    shape = 0.01 * np.cos(2 * np.pi * (minutes - begun) / 50.0)
    label, into = fold_phase("period of 50.0 min", rows, shape)
    assert label == "minutes into a period of 50"
    assert ((into >= 0) & (into < 50)).all()
    np.testing.assert_allclose(0.01 * np.cos(2 * np.pi * into / 50), shape, atol=1e-9)


def test_traverses_are_counted_within_their_session():
    rows = pd.DataFrame({"session": ["a"] * 8 + ["b"] * 8, "session_seconds": np.arange(16.0)})
    shape = np.tile([1.0, 0.0, -1.0, 0.0], 4)
    label, into = fold_phase("period of 4.0 traverses", rows, shape)
    assert label == "traverses into a period of 4"
    assert np.mod(into + 1e-9, 4) == pytest.approx(np.tile([0.0, 1.0, 2.0, 3.0], 4), abs=1e-6)


@pytest.mark.parametrize("carrier", ["time, joint 3", "configuration", ""])
def test_what_has_no_period_is_not_folded(carrier):
    assert fold_phase(carrier, pd.DataFrame(), np.zeros(0)) is None
