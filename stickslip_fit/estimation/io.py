"""save_result and load_result: a Result as JSON, schema stickslip-fit/result/1."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._io import write_atomically
from stickslip_fit.causes import Cause, describe, restore
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation.noise import Flag, NoiseLevel
from stickslip_fit.estimation.result import JointFit, Provenance, Result
from stickslip_fit.machine import Link, Machine
from stickslip_fit.units import from_si

SCHEMA = "stickslip-fit/result/1"


def save_result(result: Result, path: str | Path) -> None:
    """Write a result as JSON; nothing is left half-written.

    Beside what `load_result` needs, the file holds ``parameters``: a list of name, joint, direction,
    session, unit, estimate, standard_error, low, high (95 %) and flags, in people's units. Joint, direction
    and session are null where a parameter is the same for all of them.
    """
    text = json.dumps(_to_json(result), indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n")


def load_result(path: str | Path, causes: Sequence[Cause] = ()) -> Result:
    """Read a result that `save_result` wrote.

    Parameters
    ----------
    path : path
    causes : sequence of Cause, optional
        Of your own, where they are in the result's laws; see `stickslip_fit.causes.restore`.

    Raises
    ------
    InputError
        If the file cannot be read or is no saved result.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(InputIssue(f"cannot be read ({error.strerror})", str(path))) from None
    except ValueError:
        raise InputError(InputIssue("is no JSON; give a file that `fit --json` wrote", str(path))) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise InputError(InputIssue(f"is no saved result of the form {SCHEMA}; fit the log again", str(path)))
    try:
        return _from_json(content, causes)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            InputIssue(f"is a damaged result ({error!r}); fit the log again", str(path))
        ) from None


def _to_json(result: Result) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "method": result.method,
        "parameters": _parameters_to_json(result.parameters),
        "remarks": [asdict(flag) for flag in result.flags],
        "provenance": asdict(result.provenance),
        "machine": asdict(result.machine),
        "joints": [_joint_to_json(fit) for fit in result.joints.values()],
        "residuals": {
            "row": [int(row) for row in result.residuals.index],
            "joint": [int(joint) for joint in result.residuals["joint"]],
            "residual": _numbers_to_json(result.residuals["residual"].to_numpy(float)),
            "used": [bool(used) for used in result.residuals["used"]],
        },
    }


def _parameters_to_json(table: pd.DataFrame) -> list[dict[str, Any]]:
    numbers = ("estimate", "standard_error", "low", "high")
    return [
        {
            "name": row.name,
            "joint": int(row.joint) or None,
            "direction": str(row.direction) or None,
            "session": None if row.session is None else str(row.session),
            "unit": row.unit,
            **{number: _number_to_json(from_si(getattr(row, number), row.unit)) for number in numbers},
            "flags": list(row.flags),
        }
        for row in table.itertuples(index=False)
    ]


def _joint_to_json(fit: JointFit) -> dict[str, Any]:
    return {
        "law": describe(fit.law),
        "sessions": [str(session) for session in fit.groups["session"]],
        "directions": [str(direction) for direction in fit.groups["direction"]],
        "shared": list(fit.shared),
        "values": _numbers_to_json(fit.values),
        "known": fit.known.tolist(),
        "covariance": _numbers_to_json(fit.covariance),
        "interval": _numbers_to_json(fit.interval),
        "repeatability": {
            direction: {**asdict(noise), "value": _number_to_json(noise.value)}
            for direction, noise in fit.repeatability.items()
        },
    }


def _from_json(content: dict[str, Any], causes: Sequence[Cause]) -> Result:
    machine = _machine_from_json(content["machine"])
    fits = [_joint_from_json(item, machine, causes) for item in content["joints"]]
    residuals = content["residuals"]
    source = content["provenance"]
    return Result(
        method=content["method"],
        machine=machine,
        joints={fit.law.joint: fit for fit in fits},
        residuals=pd.DataFrame(
            {
                "joint": np.array(residuals["joint"], dtype=np.int64),
                "residual": _array_from_json(residuals["residual"]),
                "used": np.array(residuals["used"], dtype=bool),
            },
            index=np.array(residuals["row"], dtype=np.int64),
        ),
        flags=tuple(Flag(**{**item, "parameters": tuple(item["parameters"])}) for item in content["remarks"]),
        provenance=Provenance(**{**source, "log_files": tuple(source["log_files"])}),
    )


def _joint_from_json(item: dict[str, Any], machine: Machine, causes: Sequence[Cause]) -> JointFit:
    return JointFit(
        law=restore(item["law"], machine, causes),
        groups=pd.DataFrame(
            {
                "session": np.array(item["sessions"], dtype=object),
                "direction": np.array(item["directions"], dtype=object),
            }
        ),
        values=_array_from_json(item["values"]),
        known=np.array(item["known"], dtype=bool),
        covariance=_array_from_json(item["covariance"]),
        interval=_array_from_json(item["interval"]),
        repeatability={
            direction: NoiseLevel(**{**noise, "value": np.nan if noise["value"] is None else noise["value"]})
            for direction, noise in item["repeatability"].items()
        },
        shared=tuple(item.get("shared", ())),
    )


def _machine_from_json(item: dict[str, Any]) -> Machine:
    links = [Link(link["mass"], link["com"], tuple(link["inertia"])) for link in item["links"]]
    return Machine(
        name=item["name"],
        a1=item["a1"],
        l2=item["l2"],
        ranges={int(joint): (low, high) for joint, (low, high) in item["ranges"].items()},
        links=(links[0], links[1], links[2]),
        sha256=item["sha256"],
    )


def _number_to_json(value: float) -> float | None:
    """JSON has no NaN: an unknown number is null."""
    return float(value) if np.isfinite(value) else None


def _numbers_to_json(values: npt.NDArray[np.float64]) -> Any:
    shown = values.astype(object)
    shown[~np.isfinite(values)] = None
    return shown.tolist()


def _array_from_json(values: Any) -> npt.NDArray[np.float64]:
    return np.array(values, dtype=float)
