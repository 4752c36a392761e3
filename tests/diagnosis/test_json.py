"""The JSON that others read: every field of the contract, of every verdict, with numbers or null."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis import Gain, NextTraverse, save_diagnosis
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.units import Interval

ROOT = Path(__file__).parents[2]
CAUSES = ROOT.parent / "shared" / "causes.md"
PARAMETER = {"name": str, "unit": str, "estimate": float, "low": float, "high": float}
SIZE = {"estimate": float, "low": float, "high": float}
GAIN = {"baseline_pct": float, "extended_pct": float, "low": float, "high": float}
SCHEMA = {
    "schema": str,
    "log": {"file": str, "sha256": str, "runs": int, "sessions": int, "joints": [int]},
    "noise": {"repeatability_pct": float, "source": str},
    "misfit": {"p_value": float, "rms_pct": float},
    "verdict": str,
    "findings": [
        {
            "cause": str, "equivalent": [str], "p_value": float, "joints": [int], "effect_rms_pct": SIZE,
            "parameters": [PARAMETER], "gain": GAIN,
        }
    ],
    "inclusion": dict,
    "untestable": [{"cause": str, "reason": str}],
    "gain": {"metric": str, **GAIN, "noise_floor_pct": float},
    "stage": [
        {
            "causes": [str], "regime": str, "p_value": float, "credible": [str], "left_out_joints": [int],
            "changes": [{"quantity": str, "probability": float, "size_pct": SIZE}],
            "fingerprint": [
                {
                    "joint": int, "direction": str, "unloaded_pct": float, "unloaded_error_pct": float,
                    "response_pct": float, "response_error_pct": float, "friction_limited": float,
                }
            ],
        }
    ],
    "next_experiment": [
        {
            "session": str, "joint": int, "direction": str, "q1_deg": float, "q2_deg": float, "q3_mm": float,
            "theta_deg": float, "psi_deg": float, "from": float, "to": float, "repeats": int,
            "tells_apart": [str],
        }
    ],
    "seconds": float,
}  # fmt: skip


def check(found: object, wanted: object, where: str = "") -> None:
    """Hold a value against the contract; null stands for what is not known."""
    if isinstance(wanted, dict):
        if found is None:
            return
        assert isinstance(found, dict), where
        for name, kind in wanted.items():
            assert name in found, f"{where}.{name} is missing"
            check(found[name], kind, f"{where}.{name}")
    elif isinstance(wanted, list):
        assert isinstance(found, list), where
        for each in found:
            check(each, wanted[0], f"{where}[]")
    elif wanted is float:
        assert found is None or (isinstance(found, (int, float)) and not isinstance(found, bool)), where
        assert found is None or math.isfinite(found), where
    else:
        assert isinstance(found, wanted), where


def names_in(markdown: str) -> set[str]:
    """The causes that the documentation's table lists."""
    first = [line.split("|")[1].strip() for line in markdown.splitlines() if line.startswith("| `")]
    return {name.strip("`") for name in first if "<" not in name}


@pytest.fixture(scope="module")
def filled(named):
    """A diagnosis with everything in it that one may have."""
    gain = Gain(
        0.008,
        0.003,
        0.0027,
        0.004,
        0.006,
        pd.DataFrame({"session": ["a"], "baseline": 0.008, "extended": 0.003}),
    )
    traverse = NextTraverse(
        "new", 3, "+", 0.0, -np.pi / 2, np.nan, -np.pi / 2, 0.0, 0.002, 0.01, 4, ("drift", "thermal-warm-up")
    )
    first = replace(named.findings[0], gain=gain, equivalent=("drift",))
    return replace(
        named, findings=(first,), verdict="cannot tell apart", gain=gain, gain_new_session=gain,
        next_experiment=(traverse,),
    )  # fmt: skip


@pytest.mark.parametrize("which", ["named", "nothing", "unnamed", "tiny", "filled"])
def test_every_field_is_there_whatever_the_verdict(which, request, tmp_path):
    diagnosis = request.getfixturevalue(which)
    save_diagnosis(diagnosis, tmp_path / "out.json")
    text = (tmp_path / "out.json").read_text("utf-8")
    assert "NaN" not in text
    assert "Infinity" not in text
    content = json.loads(text)
    check(content, SCHEMA)
    assert content["schema"] == "stickslip-fit/diagnosis/1"
    assert content["verdict"] == diagnosis.verdict
    assert (content["verdict"] == "nothing wrong") == (content["misfit"]["p_value"] >= diagnosis.alpha)
    assert (content["verdict"] == "nothing wrong") == (content["findings"] == [])
    untestable = {each["cause"] for each in content["untestable"]}
    assert untestable == {cause for cause, value in content["inclusion"].items() if value is None}
    assert all(value is None or 0.0 <= value <= 1.0 for value in content["inclusion"].values())


@pytest.mark.skipif(not CAUSES.exists(), reason="the table of causes is not beside this package")
@pytest.mark.parametrize("which", ["named", "nothing", "tiny"])
def test_every_cause_is_judged_or_not_testable(which, request):
    inclusion = diagnosis_to_json(request.getfixturevalue(which))["inclusion"]
    assert names_in(CAUSES.read_text("utf-8")) <= set(inclusion)


def test_numbers_are_in_the_units_they_are_named_after(filled):
    content = diagnosis_to_json(filled)
    assert content["gain"]["baseline_pct"] == pytest.approx(0.8)
    assert content["gain"]["metric"] == "held-out rms error of the step size, %"
    assert "noise_floor_pct" not in content["findings"][0]["gain"]
    (traverse,) = content["next_experiment"]
    assert (traverse["q2_deg"], traverse["q3_mm"]) == (pytest.approx(-90.0), None)
    assert (traverse["from"], traverse["to"]) == (pytest.approx(2.0), pytest.approx(10.0))
    size = filled.findings[0].effect
    assert content["findings"][0]["effect_rms_pct"]["estimate"] == pytest.approx(100 * size.estimate)


def test_what_is_not_known_is_null(named):
    unknown = replace(named.findings[0], effect=Interval(0.004, np.nan, np.inf))
    size = diagnosis_to_json(replace(named, findings=(unknown,)))["findings"][0]["effect_rms_pct"]
    assert (size["low"], size["high"]) == (None, None)


def test_the_log_is_the_one_that_was_read(named, drifting):
    content = diagnosis_to_json(named)["log"]
    assert content["file"] == "drifting.csv"
    assert content["sha256"] == drifting.sha256
    assert (content["runs"], content["sessions"], content["joints"]) == (len(drifting.usable), 2, [2, 3])
