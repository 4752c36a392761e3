"""Rows that no reader has checked are refused at the log's door, all faults at once."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.changes import detect_changes
from stickslip_fit.diagnosis import diagnose, diagnose_table
from stickslip_fit.errors import ALPHA_LIMITS, InputError, check_alpha, check_count, check_workers
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


@pytest.mark.parametrize("alpha", [0, 1, -0.1, 2, 1e-9, 0.0009, 0.21, np.nan, None, "0.01", True])
def test_a_false_alarm_rate_lies_within_the_limits_of_the_commands(log, alpha):
    told = "alpha must lie between 0.001 and 0.2, not "
    with pytest.raises(InputError, match=told):
        diagnose(log, alpha=alpha)
    with pytest.raises(InputError, match=told):
        diagnose_table(pd.DataFrame({"x": [1.0], "y": [2.0]}), "y ~ a*x", alpha=alpha)
    with pytest.raises(InputError, match=told):
        detect_changes(log, log, alpha=alpha)
    for alpha in ALPHA_LIMITS:
        check_alpha(alpha)


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
