"""A joint with coarse counts beside others with fine ones: its rounding tells nothing of their noise."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.diagnosis import diagnose
from tests.hidden.generate import hide
from tests.hidden.noise import seen
from tests.hidden.reading import read_hidden

CHECK_EVERY, FEWER = 5, 1_000


def with_coarse_counts(hidden, table):
    """The log of some rows, with a thousandth of joint 3's counts: some tens."""
    coarse = (table["joint"] == 3).to_numpy()
    counts = np.where(coarse, seen(table["steps"] / FEWER, CHECK_EVERY), table["steps"])
    return read_hidden(replace(hidden, table=table.assign(steps=counts.astype(int))))


@pytest.mark.parametrize("seed", [4, 5])
def test_few_fine_counts_beside_coarse_ones_raise_no_alarm(seed):
    """Nine in ten such logs did: of all rows' squares less their rounding, noise of 0 was left."""
    hidden = hide("session", seed=seed)
    table = hidden.table[hidden.table["joint"] != 1]
    some = np.random.default_rng(seed).permutation(len(table))[:44]
    found = diagnose(with_coarse_counts(hidden, table.iloc[np.sort(some)]), gain=False)
    assert found.verdict == "nothing wrong"
    assert 0.001 < found.repeatability < 0.006  # 0.003 in joint 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_beside_coarse_counts_a_cause_is_found_and_nothing_else(seed):
    hidden = hide("session", ("thermal-warm-up",), 25, seed=seed)
    found = diagnose(with_coarse_counts(hidden, hidden.table), gain=False)
    assert [one.cause for one in found.findings] == ["thermal-warm-up"]
