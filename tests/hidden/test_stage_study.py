"""Rates of what is read of logs made by friction, of 1,000 by night."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from tests.hidden.stage_optimum import compute_optimum
from tests.hidden.stage_study import (
    WITHOUT_TRACE,
    StageCase,
    StageScore,
    diagnose_stage,
    stage_cases,
)

LOGS = 1000


def at_least(share: float, results: list[bool]) -> None:
    """No more than two standard errors of a share below it."""
    assert np.mean(results) >= share - 2 * np.sqrt(share * (1 - share) / len(results))


def check_rates(scores: list[StageScore]) -> None:
    """Those of the set are of all logs with a finding, read or not."""
    shown = [one for one in scores if (one.case.regime, one.case.change) not in WITHOUT_TRACE]
    found = [one for one in shown if one.case.change and one.found]
    read = [one for one in found if one.credible]
    at_least(0.95, [not one.absent for one in scores])
    at_least(0.95, [one.holds for one in found])
    at_least(0.80, [one.is_family for one in read])
    at_least(0.90, [right for one in read for right in one.regimes])


@pytest.mark.nightly
def test_what_changed_in_a_stage_is_read():
    with ProcessPoolExecutor() as pool:
        check_rates(list(pool.map(diagnose_stage, stage_cases(LOGS, first=10_000))))


def test_scores_know_what_is_right():
    payload = StageCase("friction", "payload", False, 0)
    right = StageScore(payload, ("payload-change",), False, ("friction", "mass"), (True,))
    wrong = StageScore(payload, ("side-load",), True, ("voltage",), (False,))
    assert (right.holds, right.is_family) == (True, True)
    assert (wrong.holds, wrong.is_family) == (False, False)


def test_one_who_knows_the_stage_tells_what_can_be_told():
    """Voltage, and in friction-limited steps all; friction from ramp time hardly in velocity-limited ones."""
    voltage, ramp_time, preload = (
        compute_optimum(StageCase(regime, change, False, seed))
        for regime, change, seed in (
            ("velocity", "voltage", 1),
            ("friction", "ramp-time", 2),
            ("velocity", "preload", 3),
        )
    )
    assert voltage.calibrated["voltage"] > 0.999
    assert ramp_time.calibrated["ramp time"] > 0.999
    assert preload.strength > 8
    assert 0.1 < preload.calibrated["ramp time"] < 0.9
    assert preload.calibrated["voltage"] < 1e-3
