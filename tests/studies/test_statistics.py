"""Intervals over campaigns hold what they should as often as they say."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.studies.study import summarize_step_errors, summarize_tip_errors

STUDIES, CAMPAIGNS, PREDICTIONS = 2000, 40, 10


def test_intervals_hold_over_studies():
    rng = np.random.default_rng(5)
    errors = rng.normal(0.001, 0.004, (STUDIES * CAMPAIGNS, PREDICTIONS))
    steps = pd.DataFrame(
        {
            "scenario": "any", "joint": 3, "direction": "+", "sessions": 1, "failed": 0,
            "strategy": np.repeat(np.arange(STUDIES), CAMPAIGNS),
            "campaign": np.tile(np.arange(CAMPAIGNS), STUDIES),
            "predictions": PREDICTIONS, "traverses": 3.0, "seconds": 60.0,
            "covered": rng.binomial(PREDICTIONS, 0.7, len(errors)) / PREDICTIONS,
        }
    )  # fmt: skip
    for end in ("", "_relative"):
        steps[f"rms{end}"] = np.sqrt(np.mean(errors**2, axis=1))
        steps[f"bias{end}"], steps[f"worst{end}"] = errors.mean(axis=1), errors.max(axis=1)
    found = summarize_step_errors(steps, ["scenario", "joint", "strategy"])
    truth = {"rms_relative": np.hypot(0.001, 0.004), "bias": 0.001, "covered": 0.7}
    for name, true in truth.items():
        held = found[f"{name}_low"].le(true) & found[f"{name}_high"].ge(true)
        assert held.mean() == pytest.approx(0.95, abs=0.02), name


def test_directions_with_more_predictions_count_for_more():
    both = pd.DataFrame(
        {
            "scenario": "any", "strategy": "one", "joint": 3, "direction": ["+", "-"], "campaign": 0,
            "predictions": [30, 10], "sessions": 2, "failed": [1, 0], "traverses": 3.0,
            "seconds": [60.0, 90.0],
            "covered": [1.0, 0.6], "rms": [1e-9, 3e-9], "bias": [1e-9, -3e-9], "worst": [2e-9, -4e-9],
            "rms_relative": 0.0, "bias_relative": 0.0, "worst_relative": 0.0,
        }
    )  # fmt: skip
    row = summarize_step_errors(both, ["scenario", "joint", "strategy"]).iloc[0]
    assert row["rms"] == pytest.approx(np.sqrt((30 * 1 + 10 * 9) / 40) * 1e-9)
    assert row["bias"] == pytest.approx(0.0, abs=1e-20)
    assert (row["worst"], row["seconds"], row["failed"]) == (-4e-9, 150.0, 0.25)
    assert row["covered"] == pytest.approx(0.9)
    assert np.isnan(row["rms_low"])  # one campaign says nothing of others


def test_moves_that_are_known_make_the_tips_square():
    tips = pd.DataFrame(
        {
            "scenario": "any", "strategy": "one", "moves": 4, "unknown": [0, 2], "rms": [1e-6, 2e-6],
            "median": [1e-6, 3e-6], "often": [2e-6, 4e-6], "worst": [3e-6, 5e-6],
            "share_1": [1.0, 0.0], "share_2": [0.0, 1.0], "share_3": 0.0,
        }
    )  # fmt: skip
    row = summarize_tip_errors(tips).iloc[0]
    assert row["rms"] == pytest.approx(np.sqrt((4 * 1 + 2 * 4) / 6) * 1e-6)
    assert (row["unknown"], row["share_1"], row["worst"]) == (0.25, pytest.approx(1 / 3), 5e-6)
