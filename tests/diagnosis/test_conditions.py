"""Steps that follow a logged temperature: with empty cells, and by a curve."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden


def read_with_temperature(change, seed, empty=0, joints=(3,)):
    """A log of joints that follow a room's slow swing; `empty` of its cells are lost."""
    rng, hidden = np.random.default_rng(seed), hide("thesis", seed=seed)
    table = hidden.table[hidden.table["joint"].isin(joints)].reset_index(drop=True)
    hours = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 3600.0
    kelvin = 4.0 * np.sin(2.0 * np.pi * hours.to_numpy() / 4.0 + seed)
    table["steps"] = (5 * np.round(table["steps"] / (1.0 + change(kelvin)) / 5)).astype(int)
    readings = np.round(21.0 + kelvin, 1).astype(object)
    readings[rng.choice(len(readings), empty, replace=False)] = ""
    table["temperature_C"] = readings
    return read_hidden(replace(hidden, table=table))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.nightly)])
def test_empty_cells_of_a_slow_temperature_do_not_hide_it(seed):
    """With the column's mean in them a few rows are far off, and any function of time is likelier."""
    found = ssf.diagnose(read_with_temperature(lambda k: 0.01 * k, seed, empty=20), gain=False)
    (finding,) = found.findings
    assert (found.verdict, finding.cause) == ("cause named", "temperature")
    assert "Filled in between readings: 20 empty cells of temperature." in " ".join(str(found).split())
    (slope,) = finding.parameters
    assert slope.size.low < 0.01 < slope.size.high


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.nightly)])
def test_an_effect_that_saturates_is_told_and_predicted_with_its_bend(seed):
    # Of one joint alone a curve of its own may be likelier.
    log = read_with_temperature(lambda k: 0.03 * np.tanh((k + 4.0) / 6.0), seed, joints=(2, 3))
    found = ssf.diagnose(log, gain=False)
    finding = found.findings[0]
    assert finding.cause == "temperature"
    sizes = {one.name: one.size for one in finding.parameters}
    assert sizes["bend"].high < 0.0
    assert "where it is cold" in str(found.summary())


@pytest.mark.slow
def test_what_no_equation_describes_is_a_curve_of_its_own():
    """A threshold: by the straight or gently curved equation a third of the effect would be left."""
    log = read_with_temperature(lambda k: 0.02 * np.tanh((k + 1.0) / 0.5), 5)
    found = ssf.diagnose(log, gain=False)
    (finding,) = found.findings
    assert (finding.cause, [one.name for one in finding.parameters]) == ("temperature", ["rms"])
    assert "along a curve" in str(found.summary())
    error = np.log(log.rows["steps"] / found.extended_law().predict(log.rows)["steps"])
    assert np.sqrt(np.mean(error**2)) < 1.1 * found.repeatability
