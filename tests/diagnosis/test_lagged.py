"""A logged column that steps follow late is told beside structure without a name."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lsim

from stickslip_fit.causes.late_columns import low_pass
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis.lagged import delay
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden

PERIOD, LAG = 5400.0, 600.0  # s


def test_the_filter_is_that_of_a_body_that_follows_its_surroundings():
    seconds = np.arange(0.0, 7200.0, 90.0)
    rows = pd.DataFrame({"session": np.repeat(["a", "b"], 80), "session_seconds": np.tile(seconds, 2)})
    values = np.concatenate([np.sin(seconds / 800.0), np.cos(seconds / 500.0)])
    expected = [lsim(([1.0], [LAG, 1.0]), one - one[0], seconds)[1] + one[0] for one in np.split(values, 2)]
    np.testing.assert_allclose(low_pass(rows, values, LAG), np.concatenate(expected), atol=1e-10)
    late = np.split(delay(rows, values, 900.0), 2)
    for one, own in zip(late, np.split(values, 2), strict=True):
        np.testing.assert_allclose(one[10:], own[:-10])
        np.testing.assert_allclose(one[:10], own[0])


@pytest.mark.slow
@pytest.mark.parametrize("follows", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_a_column_that_steps_follow_late_is_told_with_its_lag(follows):
    hidden = hide("thesis", seed=4)
    table = hidden.table.copy()
    time = pd.to_datetime(table["time"])
    seconds = (time - time.groupby(table["session"]).transform("min")).dt.total_seconds().to_numpy()
    phase = 1.7 * pd.factorize(table["session"])[0]

    def swing(late, period=PERIOD):
        return np.sin(2 * np.pi * (seconds - late) / period + phase)

    table["temperature_C"] = (22.0 + 1.2 * swing(0.0)).round(2)
    effect = 0.01 * (swing(LAG) if follows else swing(0.0, 0.45 * PERIOD))
    table["steps"] = (5 * np.round(table["steps"] / (1.0 + effect) / 5)).astype(int)
    found = diagnose(read_hidden(replace(hidden, table=table), (3,)), gain=False)
    (unknown,) = (one for one in found.findings if one.cause == "unknown")
    if not follows:
        assert unknown.lagged is None
        return
    assert unknown.lagged.column == "temperature"
    assert unknown.lagged.lag == pytest.approx(LAG, rel=0.35)
    assert unknown.lagged.share > 0.9
    (content,) = (one for one in diagnosis_to_json(found)["findings"] if one["cause"] == "unknown")
    assert content["lagged"]["column"] == "temperature"
    assert content["lagged"]["lag_min"] == pytest.approx(unknown.lagged.lag / 60)
    assert content["lagged"]["share"] > content["lagged"]["share_without_lag"]
    text = " ".join(str(found.summary()).split())
    assert re.search(
        "Steps seem to follow temperature some 10 min late: with this lag it explains 9. %", text
    )
