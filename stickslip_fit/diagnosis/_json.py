"""A diagnosis as JSON, of a log or of a table.

Field names and meanings are a contract, version stickslip-fit/diagnosis/1. Unknown numbers are NaN in a
`Diagnosis` and null here. Per cent are of a step in a log, of the response's standard deviation in a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stickslip_fit._format import position_unit
from stickslip_fit._json import to_plain, write_json
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis.finding import Finding, Gain, NextTraverse, TableInfo, shown_size
from stickslip_fit.diagnosis.result import Diagnosis
from stickslip_fit.diagnosis.stage_change import StageReading
from stickslip_fit.units import PRISMATIC, Interval, from_si

SCHEMA = "stickslip-fit/diagnosis/1"
EVERY = 5  # of the places of a profile, one is written
METRIC = "held-out rms error of the step size, %"


def save_diagnosis(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write a diagnosis as JSON; raises InputError if the file is the log, or cannot be written."""
    write_json(path, diagnosis_to_json(diagnosis), diagnosis.files)


def diagnosis_to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """A diagnosis in plain JSON types; an unknown number is None."""
    rows, table = diagnosis.selection.problem.rows, diagnosis.table
    percent = _Percent(table.response_sd if table is not None else 1.0)
    gain = percent.of_gain(diagnosis.gain)
    metric = (
        METRIC if table is None else f"held-out rms error of {table.response}, % of its standard deviation"
    )
    joints = sorted(int(joint) for joint in rows["joint"].unique()) if table is None else []
    return {
        "schema": SCHEMA,
        "log": {
            "file": Path(diagnosis.log_file).name,
            "sha256": diagnosis.log_sha256,
            "runs": len(rows) + len(diagnosis.selection.outliers),
            "sessions": int(rows["session"].nunique()),
            "joints": joints,
        },
        **(_table_to_json(table) if table is not None else {}),
        "noise": {
            "repeatability_pct": percent.of(diagnosis.repeatability),
            "source": "residuals",
            "properties": list(diagnosis.noise_properties),
        },
        "misfit": {"p_value": diagnosis.p_value, "rms_pct": percent.of(diagnosis.misfit)},
        "verdict": diagnosis.verdict,
        "findings": [
            _finding_to_json(finding, percent, joints) | _travel_to_json(finding, diagnosis)
            for finding in diagnosis.findings
        ],
        "inclusion": dict(diagnosis.inclusion),
        "untestable": [{"cause": cause, "reason": why} for cause, why in diagnosis.untestable.items()],
        "withdrawn": [{"cause": cause, "reason": why} for cause, why in diagnosis.withdrawn.items()],
        "notes": list(diagnosis.notes),
        "alike": [list(pair) for pair in diagnosis.aliased_causes],
        "gain": gain and {"metric": metric, **gain},
        "gain_new_session": percent.of_gain(diagnosis.gain_new_session),
        "stage": [_stage_reading_to_json(reading) for reading in diagnosis.stage],
        "next_experiment": [traverse_to_json(traverse) for traverse in diagnosis.next_experiment],
        "alpha": diagnosis.alpha,
        "seed": diagnosis.seed,
        "seconds": round(diagnosis.seconds, 2),
    }


# Errors on held-out rows, each given those before it, where the noise persists.
GIVEN_BEFORE = ("baseline_given_before_pct", "extended_given_before_pct")


@dataclass(frozen=True)
class _Percent:
    """Sizes as per cent of `whole`."""

    whole: float

    def of(self, value: float) -> float | None:
        return to_plain(100.0 * value / self.whole)

    def of_gain(self, gain: Gain | None) -> dict[str, Any] | None:
        if gain is None:
            return None
        return {
            "baseline_pct": self.of(gain.baseline),
            "extended_pct": self.of(gain.extended),
            "noise_floor_pct": self.of(gain.noise_floor),
            "low": self.of(gain.low),
            "high": self.of(gain.high),
            **({"held_out": gain.held_out} if gain.held_out else {}),
            **dict(zip(GIVEN_BEFORE, map(self.of, gain.given_before), strict=False)),
        }


def _table_to_json(table: TableInfo) -> dict[str, Any]:
    """What all per cent are of, and how many independent values there are."""
    return {
        "response": {
            "name": table.response,
            "unit": table.unit,
            "standard_deviation": to_plain(table.response_sd),
        },
        "table": {
            "rows": table.rows,
            "independent_values": to_plain(table.independent),
            "correlation_rows": to_plain(table.correlation_rows),
            "correlation_time": to_plain(table.correlation_time),
            "noise_period": to_plain(table.noise_period),
            "roles": {role: column for role, column in table.roles.items() if column},
            "notes": list(table.notes),
        },
    }


def _finding_to_json(finding: Finding, percent: _Percent, joints: list[int]) -> dict[str, Any]:
    gain = percent.of_gain(finding.gain)
    if gain is not None:
        gain.pop("noise_floor_pct")
    content: dict[str, Any] = {
        "cause": finding.cause,
        "equivalent": list(finding.equivalent),
        "p_value": finding.p_value,
        "joints": list(finding.joints) if joints else [],
        "effect_rms_pct": _interval_to_json(finding.effect.times(100.0 / percent.whole)),
        "parameters": [_parameter_to_json(parameter) for parameter in finding.parameters],
        "gain": gain,
    }
    if finding.note:
        content["note"] = finding.note
    if finding.together_with:
        content["together_with"] = list(finding.together_with)
    if finding.term:
        content["term"] = finding.term
    if form := getattr(finding.version, "form", ""):
        content["form"] = form
    if finding.explains:
        content["explains"] = dict(finding.explains)
        content["explains_by_equation"] = dict(finding.explains_by_equation)
    if (late := finding.lagged) is not None:
        content["lagged"] = {
            "column": late.column,
            "lag_min": late.lag / 60.0,
            "share": late.share,
            "share_without_lag": late.without_lag,
        }
    if finding.closest:
        content["closest"] = {"cause": finding.closest, "share": finding.share, "carrier": finding.carrier}
    return content


def _travel_to_json(finding: Finding, diagnosis: Diagnosis) -> dict[str, Any]:
    """The step size along the travel, where the finding follows the position."""
    profiles = []
    for one in finding.travel:
        unit = position_unit(one.joint, diagnosis.require_log().machine)
        columns = {
            f"position_{unit}": from_si(one.position, unit),
            "change_pct": 100.0 * one.change,
            "standard_error_pct": 100.0 * one.error,
        }
        scope = {"joint": one.joint, "direction": one.direction or None, "session": one.session or None}
        profiles.append(scope | {name: list(map(to_plain, own[::EVERY])) for name, own in columns.items()})
    return {"travel": profiles} if profiles else {}


def _parameter_to_json(parameter: SizedParameter) -> dict[str, Any]:
    scope = {"joint": parameter.joint, "direction": parameter.direction, "session": parameter.session}
    known = {key: value for key, value in scope.items() if value is not None}
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        **_interval_to_json(shown_size(parameter)),
        **known,
    }


def traverse_to_json(traverse: NextTraverse) -> dict[str, Any]:
    """A traverse to make, in the units in which positions are set."""
    ends = "mm" if traverse.joint == PRISMATIC else "deg"
    units = {"q1": "deg", "q2": "deg", "q3": "mm", "theta": "deg", "psi": "deg"}
    return {
        "session": traverse.session,
        "joint": traverse.joint,
        "direction": traverse.direction,
        **{
            f"{name}_{unit}": to_plain(from_si(getattr(traverse, name), unit)) for name, unit in units.items()
        },
        "from": to_plain(from_si(traverse.start, ends)),
        "to": to_plain(from_si(traverse.stop, ends)),
        "repeats": traverse.repeats,
        "tells_apart": list(traverse.tells_apart),
        "note": traverse.note,
    }


def _stage_reading_to_json(reading: StageReading) -> dict[str, Any]:
    """Which change of the stage findings may be; `credible` are those that together hold it with 95 %."""
    fingerprint = [
        {
            "joint": int(row["joint"]),
            "direction": str(row["direction"]),
            **{
                f"{name}_pct": to_plain(100.0 * row[name])
                for name in ("unloaded", "unloaded_error", "response", "response_error")
            },
            "friction_limited": to_plain(row["friction_limited"]),
        }
        for _, row in reading.fingerprint.iterrows()
    ]
    return {
        "causes": list(reading.causes),
        "regime": reading.regime or None,
        "p_value": to_plain(reading.p_value),
        "credible": [change.quantity for change in reading.credible],
        "changes": [
            {
                "quantity": change.quantity,
                "probability": to_plain(change.probability),
                "size_pct": {
                    name: to_plain(100.0 * getattr(change.size, name)) for name in ("estimate", "low", "high")
                },
            }
            for change in reading.changes
        ],
        "fingerprint": fingerprint,
        "left_out_joints": list(reading.left_out),
    }


def _interval_to_json(interval: Interval) -> dict[str, float | None]:
    return {name: to_plain(getattr(interval, name)) for name in ("estimate", "low", "high")}
