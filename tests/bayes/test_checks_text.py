"""What is said of counts that are the model's own, and of some that are not."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit._summary import Summary
from stickslip_fit.bayes import fit_bayes
from stickslip_fit.bayes.checks import checks_section
from tests.bayes.test_bayes import JOINT_3

DAYS = ("2012-03-05", "2012-03-06", "2012-03-07")


@pytest.fixture(scope="module")
def log(campaign, read_table):
    return read_table(campaign(DAYS, JOINT_3, directions=("+",), replicates=6))


def said(log, **how):
    section = checks_section(fit_bayes(log, progress=False, **how))
    return Summary("", sections=(section,)).as_text()


def changed(log, factor):
    steps = (log.rows["steps"] * factor // 5 * 5).astype(np.int64)
    return replace(log, rows=log.rows.assign(steps=steps))


@pytest.mark.slow
def test_counts_of_the_model_look_like_it(log):
    text = said(log)
    assert "The counts look like the model's own." in text
    (row,) = (line for line in text.splitlines() if line.startswith("3 +"))
    elpd = float(row.split()[5])
    # 90 normal counts that repeat to 0.27 %, twelve parameters: what their log density comes to.
    expected = 90 * -0.5 * np.log(2 * np.pi * np.e * 0.0027**2)
    assert elpd == pytest.approx(expected, abs=25)
    assert row.endswith("of 90")


@pytest.mark.slow
def test_a_count_that_is_wildly_off_is_told(log):
    factor = np.ones(len(log.rows))
    factor[20] = 1.15
    assert "! joint 3 +: a count is further off than the model ever has it" in said(changed(log, factor))


@pytest.mark.slow
def test_a_drift_within_the_session_is_told(log):
    hours = log.rows["session_seconds"].to_numpy() / 3600
    assert "joint 3 +: neighbours in time have residuals of one sign" in said(changed(log, 1 + 0.02 * hours))


def test_what_has_not_converged_is_not_judged(log):
    text = said(log, max_steps=20, target_ess=10**6)
    assert (
        text == "Predictive checks\nNothing has converged, so there is nothing to check the counts against."
    )
