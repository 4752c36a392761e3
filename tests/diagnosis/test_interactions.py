"""Effects of the traverse's own length and of two columns together, put into logs by hand."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.diagnosis import diagnose
from tests.hidden.generate import CHECK_EVERY, hide
from tests.hidden.reading import read_hidden


def own_length(table):
    """Of joint 3, in shares of its longest traverse."""
    length = (table["to_mm"].astype(float) - table["from_mm"].astype(float)).abs().to_numpy()
    return np.where(table["joint"] == 3, 0.03 * np.cos(np.pi * length / np.nanmax(length)), 0.0)


def two_columns(table):
    """Neither of which has an effect on the average over the other."""
    rng = np.random.default_rng(3)
    volts, warmth = rng.choice([-1.0, 1.0], (2, len(table)))
    table["supply_V"], table["temperature_C"] = 60.0 + 2.0 * volts, 22.0 + 1.5 * warmth
    return 0.01 * volts * warmth


@pytest.mark.parametrize(
    ("effect", "design", "carriers"),
    [
        (own_length, "many", {"own_length"}),
        (two_columns, "thesis", {"supply", "temperature"}),
    ],
)
def test_what_steps_follow_is_found(effect, design, carriers):
    hidden = hide(design, seed=4)
    table = hidden.table.copy()
    table["steps"] = (CHECK_EVERY * np.round(table["steps"] / (1.0 + effect(table)) / CHECK_EVERY)).astype(
        int
    )
    found = diagnose(read_hidden(replace(hidden, table=table)), gain=False)
    assert found.findings[0].cause == "unknown"
    assert {*found.findings[0].version.carriers} == carriers, found.summary().headline
