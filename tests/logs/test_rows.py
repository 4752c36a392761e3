"""Rows that no reader has checked are refused at the log's door, all faults at once."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.errors import InputError, check_count, check_rate, check_workers
from stickslip_fit.estimation import fit_least_squares
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden


@pytest.fixture(scope="module")
def log():
    return read_hidden(hide("session", seed=1))


@pytest.mark.parametrize("compute", [diagnose, fit_least_squares])
def test_rows_that_were_changed_after_reading_are_refused(log, compute):
    changed = replace(log, rows=log.rows.copy())
    changed.rows.loc[4, "steps"] = -5
    with pytest.raises(InputError, match="not allowed in row 4"):
        compute(changed)


@pytest.mark.parametrize("alpha", [0, 1, -0.1, 2, np.nan, None, "0.01", True])
def test_a_false_alarm_rate_lies_between_0_and_1(log, alpha):
    with pytest.raises(InputError, match="alpha"):
        diagnose(log, alpha=alpha)
    with pytest.raises(InputError, match="rate"):
        check_rate("rate", alpha)


@pytest.mark.parametrize("seed", [-1, 0.5, None, True])
def test_a_seed_is_a_whole_number(log, seed):
    with pytest.raises(InputError, match="seed"):
        diagnose(log, seed=seed)
    with pytest.raises(InputError, match="count"):
        check_count("count", seed)


def test_workers_are_all_cores_or_some():
    check_workers(-1)
    check_workers(3)
    for wrong in (0, -2, 1.5):
        with pytest.raises(InputError, match="workers"):
            check_workers(wrong)
