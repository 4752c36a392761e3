"""Rates of what is read of logs made by friction; tests of every run are beside the reading of a stage."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from tests.hidden.stage_study import WITHOUT_TRACE, StageCase, StageScore, diagnose_stage, stage_cases

LOGS = 200


def at_least(share: float, results: list[bool]) -> None:
    """No more than two standard errors of a share below it."""
    assert np.mean(results) >= share - 2 * np.sqrt(share * (1 - share) / len(results))


@pytest.mark.nightly
def test_what_changed_in_a_stage_is_read():
    with ProcessPoolExecutor() as pool:
        scores = list(pool.map(diagnose_stage, stage_cases(LOGS, first=10_000)))
    shown = [one for one in scores if (one.case.regime, one.case.change) not in WITHOUT_TRACE]
    read = [one for one in shown if one.case.change and one.credible]
    at_least(0.95, [not one.absent for one in scores])
    at_least(0.95, [one.holds for one in read])
    at_least(0.80, [one.is_family for one in read])
    at_least(0.90, [right for one in read for right in one.regimes])


def test_scores_know_what_is_right():
    payload = StageCase("friction", "payload", False, 0)
    right = StageScore(payload, ("payload-change",), False, ("friction", "mass"), (True,))
    wrong = StageScore(payload, ("side-load",), True, ("voltage",), (False,))
    assert (right.holds, right.is_family) == (True, True)
    assert (wrong.holds, wrong.is_family) == (False, False)
