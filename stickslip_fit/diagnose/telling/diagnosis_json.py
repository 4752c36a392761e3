"""A diagnosis as JSON; field names and meanings are a contract with whoever reads it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit.diagnose.diagnosis import Diagnosis, Finding, Gain, NextTraverse, SizedParameter
from stickslip_fit.files import write_atomically
from stickslip_fit.units import Interval, from_si

SCHEMA = "stickslip-fit/diagnosis/1"
METRIC = "held-out rms error of the step size, %"


def save_diagnosis(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write a diagnosis as JSON; nothing is left half-written."""
    text = json.dumps(to_json(diagnosis), indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n")


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """A diagnosis in plain JSON types; an unknown number is None."""
    bench = diagnosis.search.bench
    rows = bench.rows
    return {
        "schema": SCHEMA,
        "log": {
            "file": Path(diagnosis.log_file).name,
            "sha256": diagnosis.log_sha256,
            "runs": len(rows) + len(diagnosis.search.misfired),
            "sessions": int(rows["session"].nunique()),
            "joints": sorted(int(joint) for joint in rows["joint"].unique()),
        },
        "noise": {"repeatability_pct": _percent(diagnosis.repeatability), "source": "residuals"},
        "misfit": {"p_value": diagnosis.p_value, "rms_pct": _percent(diagnosis.misfit)},
        "verdict": diagnosis.verdict,
        "findings": [_finding(each) for each in diagnosis.findings],
        "inclusion": dict(diagnosis.inclusion),
        "untestable": [{"cause": cause, "reason": why} for cause, why in diagnosis.untestable.items()],
        "alike": [list(pair) for pair in diagnosis.alike],
        "gain": _gain(diagnosis.gain) and {"metric": METRIC, **(_gain(diagnosis.gain) or {})},
        "gain_new_session": _gain(diagnosis.gain_new_session),
        "next_experiment": [traverse_json(each) for each in diagnosis.next_experiment],
        "alpha": diagnosis.alpha,
        "seed": diagnosis.seed,
        "seconds": round(diagnosis.seconds, 2),
    }


def _finding(finding: Finding) -> dict[str, Any]:
    gain = _gain(finding.gain)
    if gain is not None:
        gain.pop("noise_floor_pct")
    found: dict[str, Any] = {
        "cause": finding.cause,
        "equivalent": list(finding.equivalent),
        "p_value": finding.p_value,
        "joints": list(finding.joints),
        "effect_rms_pct": _interval(finding.effect.times(100.0)),
        "parameters": [_parameter(each) for each in finding.parameters],
        "gain": gain,
    }
    if finding.closest:
        found["closest"] = {"cause": finding.closest, "share": finding.share, "carrier": finding.carrier}
    return found


def _parameter(parameter: SizedParameter) -> dict[str, Any]:
    size = parameter.size
    shown = Interval(
        *(float(from_si(value, parameter.unit)) for value in (size.estimate, size.low, size.high))
    )
    further = {"joint": parameter.joint, "direction": parameter.direction, "session": parameter.session}
    known = {key: value for key, value in further.items() if value is not None}
    return {"name": parameter.name, "unit": parameter.unit, **_interval(shown), **known}


def _gain(gain: Gain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {
        "baseline_pct": _percent(gain.baseline),
        "extended_pct": _percent(gain.extended),
        "noise_floor_pct": _percent(gain.noise_floor),
        "low": _percent(gain.low),
        "high": _percent(gain.high),
    }


def traverse_json(traverse: NextTraverse) -> dict[str, Any]:
    """A traverse to make, in the units that people set."""
    ends = "mm" if traverse.joint == 3 else "deg"
    return {
        "session": traverse.session,
        "joint": traverse.joint,
        "direction": traverse.direction,
        "q1_deg": _number(from_si(traverse.q1, "deg")),
        "q2_deg": _number(from_si(traverse.q2, "deg")),
        "q3_mm": _number(from_si(traverse.q3, "mm")),
        "theta_deg": _number(from_si(traverse.theta, "deg")),
        "psi_deg": _number(from_si(traverse.psi, "deg")),
        "from": _number(from_si(traverse.start, ends)),
        "to": _number(from_si(traverse.stop, ends)),
        "repeats": traverse.repeats,
        "tells_apart": list(traverse.tells_apart),
        "note": traverse.note,
    }


def _interval(interval: Interval) -> dict[str, float | None]:
    return {
        "estimate": _number(interval.estimate),
        "low": _number(interval.low),
        "high": _number(interval.high),
    }


def _percent(value: float) -> float | None:
    return _number(100.0 * value)


def _number(value: float) -> float | None:
    """JSON has no NaN: an unknown number is null."""
    return float(value) if np.isfinite(value) else None
