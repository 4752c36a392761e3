"""load_result: a saved result, checked so that what loads can be used; one message for all that cannot.

The file's format has a number: newer ones are refused. A checksum finds what was damaged or edited; types,
shapes, covariances and the laws themselves are checked too, since a file may come from elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import isfinite, tau
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from annotated_types import Ge, MinLen

from stickslip_fit._input import check_path
from stickslip_fit._typing import Array
from stickslip_fit.causes import Cause, restore
from stickslip_fit.causes.parameters import FIRST_TRAVERSE
from stickslip_fit.errors import InputError, InputIssue, shorten
from stickslip_fit.estimation.noise import Flag, NoiseLevel
from stickslip_fit.estimation.result import (
    COMMON_TOL,
    FORMAT,
    MAX_WHOLE,
    VERSION,
    JointFit,
    Provenance,
    Result,
    compute_checksum,
    parameters_to_json,
)
from stickslip_fit.estimation.shared_estimate import NEGATIVE_TOL, Covariances, SharedCovariance
from stickslip_fit.estimation.travel import are_stretches
from stickslip_fit.laws import Laws, StepLaw, UnknownLawError
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine

STEP_SIZES = 1e-12, 1e-2  # rad or m; beyond, the numbers are in other units
MAX_LENGTH = 10.0  # m, of a manipulator
MAX_REPEATABILITY = 10.0
ADVICE = "fit the log again"


def load_result(path: str | Path, causes: Sequence[Cause] = (), *, laws: Laws | None = None) -> Result:
    """Read a result that `Result.save` wrote.

    Parameters
    ----------
    path : path
    causes : sequence of Cause, optional
        Causes of your own in the result's laws; see `stickslip_fit.causes.restore`.
    laws : mapping of int to law, optional
        Laws of your own by joint, as the log was fitted with them: what a file names is not imported.

    Raises
    ------
    InputError
        If the file cannot be read, is no saved result, was made by a newer version, or is damaged,
        or has a law of someone's own that is not given.
    """
    return result_from_json(read_result_json(path), path, causes, laws)


def read_result_json(path: str | Path) -> dict[str, Any]:
    """The content of a result's file, unharmed and of a version that this one knows.

    Raises
    ------
    InputError
        As `load_result`.
    """
    return read_saved(path, (FORMAT, VERSION), "result", "fit --json", ADVICE)


def read_saved(
    path: str | Path, form: tuple[str, int], kind: str, command: str, advice: str
) -> dict[str, Any]:
    """The content of a file of some form and at most that version, which a command wrote, unharmed.

    Raises
    ------
    InputError
        If the file cannot be read, is of another form or a newer version, or is damaged.
    """
    check_path(path, kind)
    try:
        text = Path(path).read_text(encoding="utf-8")
        content = json.loads(text, parse_float=_finite, parse_int=_whole, parse_constant=_finite)
        checksum = compute_checksum(content) if isinstance(content, dict) else ""
    except OSError as error:
        message = f"cannot be read ({error.strerror}); give a file that `{command}` wrote"
        raise InputError(InputIssue(message, str(path))) from None
    except (ValueError, RecursionError) as error:
        message = f"is no JSON ({shorten(str(error), 80)}); give a file that `{command}` wrote"
        raise InputError(InputIssue(message, str(path))) from None
    schema = content.get("schema") if isinstance(content, dict) else None
    name, _, version = str(schema).rpartition("/")
    if name != form[0] or not version.isdecimal() or version.startswith("0"):
        message = f"is no saved {kind}; give a file that `{command}` wrote"
        raise InputError(InputIssue(message, str(path)))
    if int(version[:9]) > form[1]:
        message = f"was made by a newer version of stickslip-fit (its format is {shorten(version, 9)}, "
        raise InputError(InputIssue(f"{message}here {form[1]} is known); update stickslip-fit", str(path)))
    if content.get("checksum", checksum) != checksum:
        message = f"is a damaged {kind}: it is not what was saved (its checksum is another); {advice}"
        raise InputError(InputIssue(message, str(path)))
    return dict(content)


def result_from_json(
    content: dict[str, Any], path: str | Path, causes: Sequence[Cause] = (), laws: Laws | None = None
) -> Result:
    """The result in the content of a file.

    Raises
    ------
    InputError
        If the content is damaged, naming `path`.
    """
    try:
        # Impossible numbers are found by what comes out.
        with np.errstate(all="ignore"):
            return _build_result(content, causes, laws)
    except UnknownLawError as error:
        raise InputError(InputIssue(str(error), str(path))) from None
    except (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, InputError) as error:
        what = error.args[0] if error.args else type(error).__name__
        message = f"is a damaged result: {shorten(str(what), 200)}; {ADVICE}"
        raise InputError(InputIssue(message, str(path))) from None


def _finite(text: str) -> float:
    if not isfinite(float(text)):
        raise ValueError(f"the number {shorten(text, 20)} is not finite")
    return float(text)


def _whole(text: str) -> int:
    if len(text) > len(str(-(2**62))):
        raise ValueError(f"the number {shorten(text, 20)} is too large")
    return int(text)


def _build_result(content: dict[str, Any], causes: Sequence[Cause], laws: Laws | None) -> Result:
    file = _validate(content)
    machine = file.machine
    _check_machine(machine)
    common = _read_triangle(file.cause_covariance)
    require(len(common) <= MAX_WHOLE or is_covariance(common), "cause_covariance is none")
    fits = [_build_joint(item, machine, causes, laws, common) for item in file.joints]
    joints = {fit.law.joint: fit for fit in fits}
    require(len(joints) == len(fits) > 0, "a joint stands in it twice, or none does")
    _check_common_values(fits)
    read = file.residuals
    require(len({len(read.row), len(read.joint), len(read.residual), len(read.used)}) == 1, "residuals")
    require(len(set(read.row)) == len(read.row) and {*read.joint} <= {*joints}, "residuals")
    residuals = {
        "joint": np.array(read.joint, dtype=np.int64),
        "residual": np.array(read.residual, dtype=float),
        "used": np.array(read.used, dtype=bool),
    }
    result = Result(
        method=file.method,
        machine=machine,
        joints=joints,
        residuals=pd.DataFrame(residuals, index=np.array(read.row, dtype=np.int64)),
        flags=tuple(file.remarks),
        provenance=file.provenance,
    )
    _check_parameters(parameters_to_json(result.parameters), content["parameters"])
    return result


def require(holds: bool, what: str) -> None:
    """Refuse what does not hold in a file; raises ValueError."""
    if not holds:
        raise ValueError(what)


def _validate(content: dict[str, Any]) -> Any:
    """The content as objects with the types of a result's members."""
    from pydantic import BaseModel, ConfigDict, ValidationError

    class Table(BaseModel):
        model_config = ConfigDict(strict=True, allow_inf_nan=False)

    class NoiseTable(Table):
        value: float | None
        df: Annotated[int, Ge(0)]
        source: Literal["replicates", "residuals", "posterior", "given"]

    class JointTable(Table):
        law: dict[str, Any]
        sessions: Annotated[list[str], MinLen(1)]
        directions: list[Literal["+", "-"]]
        shared: list[str]
        values: list[list[float | None]]
        known: list[list[bool]]
        covariance: list[list[list[float | None]]]
        interval: list[list[list[float | None]]]
        repeatability: dict[Literal["+", "-"], NoiseTable]
        travel: dict[Literal["+", "-"], list[tuple[float, float]]] = {}

    class ResidualTable(Table):
        row: list[int]
        joint: list[int]
        residual: list[float | None]
        used: list[bool]

    class ResultTable(Table):
        method: Literal[
            "closed-form",
            "least-squares",
            "weighted-least-squares",
            "heavy-tailed-least-squares",
            "weighted-heavy-tailed-least-squares",
            "bayes",
        ]
        remarks: list[Flag]
        provenance: Provenance
        machine: Machine
        cause_covariance: list[list[float]] = []
        joints: list[JointTable]
        residuals: ResidualTable

    try:
        return ResultTable.model_validate_json(json.dumps(content))
    except ValidationError as error:
        detail = error.errors(include_url=False, include_context=False)[0]
        raise ValueError(f"{' '.join(map(str, detail['loc']))}: {detail['msg']}") from None


def _check_machine(machine: Machine) -> None:
    require(tuple(machine.ranges) == machine.joints and machine.joints != (), "the machine's joints")
    ends = [machine.ranges[joint] for joint in machine.joints]
    require(all(-np.inf < low < high < np.inf for low, high in ends), "the machine's ranges")
    require(len(machine.joint_names) in (0, len(machine.kinds)), "the machine's joints")
    if not machine.has_published_geometry:
        require(not machine.links and np.isnan(machine.a1) and np.isnan(machine.l2), "the machine's lengths")
        return
    require(len(machine.links) == 3, "its links")
    require(all(abs(end) <= tau for end in (*ends[0], *ends[1])), "the machine's ranges")
    lengths = [machine.a1, machine.l2, machine.l2 + ends[2][0], *(abs(link.com) for link in machine.links)]
    require(max(*lengths, abs(ends[2][0]), abs(ends[2][1])) <= MAX_LENGTH, "the machine's lengths")
    require(min(lengths) >= 0 and machine.l2 + ends[2][0] > 0, "the machine's lengths")
    require(all(0 < link.mass < np.inf and min(link.inertia) >= 0 for link in machine.links), "its links")


def _read_triangle(rows: list[list[float]]) -> Array:
    """The covariance of the parameters of causes, (q, q), if it stands apart; else (0, 0)."""
    require([len(row) for row in rows] == list(range(1, len(rows) + 1)), "cause_covariance")
    covariance = np.zeros((len(rows), len(rows)))
    for k, row in enumerate(rows):
        covariance[k, : k + 1] = covariance[: k + 1, k] = row
    return covariance


def _complete_covariance(own: Array, common: Array) -> Covariances:
    """Columns of own parameters, shape (g, p, p - q), with those of the causes, (g, p, p)."""
    by_own = own[:, own.shape[2] :]
    if len(common) > MAX_WHOLE:
        across = by_own.swapaxes(1, 2)
        return SharedCovariance(own[:, : own.shape[2]], across, common, np.isnan(across).any(axis=(1, 2)))
    has_bars = ~np.isnan(by_own).any(axis=(1, 2), keepdims=True)
    last = np.concatenate([by_own.swapaxes(1, 2), np.where(has_bars, common, np.nan)], axis=1)
    return np.concatenate([own, last], axis=2)


def _build_joint(
    item: Any, machine: Machine, causes: Sequence[Cause], laws: Laws | None, common: Array
) -> JointFit:
    law = restore(item.law, machine, causes, laws)
    g, p = len(item.sessions), len(law.parameters)
    name = f"joint {law.joint}"
    require(item.law["joint"] == law.joint, f"the law of {name} is of another joint")
    groups = pd.DataFrame({"session": item.sessions, "direction": item.directions})
    require(not groups.duplicated().any(), f"a group of {name} stands in it twice")
    fit = JointFit(
        law=law,
        groups=groups,
        values=_array(item.values, (g, p), f"values of {name}"),
        known=_array(item.known, (g, p), f"known of {name}").astype(bool),
        covariance=_complete_covariance(
            _array(item.covariance, (g, p, p - len(common)), f"covariance of {name}"), common
        ),
        interval=_array(item.interval, (g, p, 2), f"interval of {name}"),
        repeatability={
            direction: NoiseLevel(np.nan if noise.value is None else noise.value, noise.df, noise.source)
            for direction, noise in item.repeatability.items()
        },
        shared=tuple(item.shared),
        travel={way: tuple(stretches) for way, stretches in item.travel.items()},
    )
    require(all(map(are_stretches, fit.travel.values())), f"travel of {name}")
    require({*item.directions} <= {*fit.repeatability}, f"repeatability of {name}")
    noise = [level.value for level in fit.repeatability.values()]
    require(not any(value < 0 or value > MAX_REPEATABILITY for value in noise), f"repeatability of {name}")
    require({*fit.shared} <= {parameter.name for parameter in law.parameters}, f"shared of {name}")
    require(not (fit.known & np.isnan(fit.values)).any(), f"a known value of {name} is null")
    require(not (fit.interval[..., 0] > fit.interval[..., 1]).any(), f"interval of {name}")
    covariance = fit.covariance
    if isinstance(covariance, SharedCovariance):
        positive = covariance.is_covariance()
    else:
        positive = all(map(is_covariance, covariance))
    require(positive, f"covariance of {name} is none: not symmetric and positive")
    require(_has_plausible_steps(fit, machine), f"values of {name} give no step size that can be")
    return fit


def _check_common_values(fits: Sequence[JointFit]) -> None:
    """That a parameter of all sessions, or of the campaign, has the same estimate wherever it stands."""
    first: dict[tuple[str, ...], Array] = {}
    for fit in fits:
        places = {parameter.name: place for place, parameter in enumerate(fit.law.parameters)}
        of_campaign = fit.cause_parameters
        of_direction = tuple(name for name in places if name in fit.shared and name not in of_campaign)
        for group, direction in enumerate(fit.groups["direction"]):
            for common, key in ((of_campaign, ()), (of_direction, (str(fit.law.joint), str(direction)))):
                here = _estimates_of(fit, group, [places[name] for name in common])
                other = first.setdefault((*key, *common), here)
                for lacks, has in ((here, other), (other, here)):
                    if np.isnan(lacks[:, 2:]).all():  # a group without error bars
                        lacks[:, 2:] = has[:, 2:]
                sd = np.nan_to_num(np.sqrt(np.abs(np.diag(other[:, 2:]))))
                slack: Array | float = 0.0
                if len(sd):
                    slack = COMMON_TOL * np.column_stack([sd, sd, np.outer(sd, sd)])
                same = np.isclose(here, other, rtol=COMMON_TOL, atol=slack, equal_nan=True).all()
                require(bool(same), f"joint {fit.law.joint}: {', '.join(common)} differ between its groups")


def _estimates_of(fit: JointFit, group: int, columns: list[int]) -> Array:
    """Value, whether it is known, and covariance of some parameters, shape (p, 2 + p).

    In files of earlier versions their intervals may differ, by the degrees of freedom of each group's noise,
    and the moment of a sudden change has a variance, of rounding.
    """
    if isinstance(fit.covariance, SharedCovariance):  # which has that of the causes once
        return np.column_stack([fit.values[group, columns], fit.known[group, columns]])
    covariance = fit.covariance[group][np.ix_(columns, columns)]
    sudden = [getattr(fit.law.parameters[column], "sudden", False) for column in columns]
    covariance[sudden] = covariance[:, sudden] = 0.0
    return np.column_stack([fit.values[group, columns], fit.known[group, columns], covariance])


def _array(values: Any, shape: tuple[int, ...], what: str) -> Array:
    array = np.array(values, dtype=float)
    require(array.shape == shape, f"{what}: its shape is {array.shape}, not {shape}")
    return array


def is_covariance(matrix: Array) -> bool:
    """Whether it is symmetric and positive semi-definite where it is known."""
    known = ~np.isnan(np.diag(matrix))
    part = matrix[np.ix_(known, known)]
    scale = np.sqrt(np.abs(np.diag(part)))
    if np.isnan(part).any() or (np.diag(part) < 0).any() or not np.isfinite(scale).all():
        return False
    correlation = part / np.where(scale > 0, scale, 1.0)[:, None] / np.where(scale > 0, scale, 1.0)
    if (
        not np.isfinite(correlation).all()
        or np.abs(correlation - correlation.T).max(initial=0) > NEGATIVE_TOL
    ):
        return False
    correlation[np.diag_indices_from(correlation)] += NEGATIVE_TOL * len(part)
    try:  # which takes a tenth of the time of all eigenvalues
        np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        return False
    return True


def _has_plausible_steps(fit: JointFit, machine: Machine) -> bool:
    """Whether every group with values has a step size in the law's first calibration configuration."""
    if not fit.law.calibration():
        return True
    fitted = ~np.isnan(fit.values).any(axis=1)
    rows = _calibration_rows(fit.law, fit.groups[fitted], machine)
    sizes = machine.span(fit.law.joint) / np.exp(fit.law.predict(rows, fit.values[fitted]))
    return bool(np.all((sizes > STEP_SIZES[0]) & (sizes < STEP_SIZES[1])))


def _calibration_rows(law: StepLaw, groups: pd.DataFrame, machine: Machine) -> pd.DataFrame:
    """A full traverse for each group, the first of its session, under mean conditions."""
    configuration = law.calibration()[0]
    places = {name: getattr(configuration, name) for name in ("q1", "q2", "q3", "theta", "psi")}
    low, high = machine.ranges[law.joint]
    constant = {**dict.fromkeys(law.columns, np.nan), **dict.fromkeys(CONDITIONS, np.nan), **FIRST_TRAVERSE}
    constant |= {**places, "joint": law.joint, "start": low, "stop": high, "session_seconds": 0.0}
    return groups.assign(**constant | {"steps_before": 0, "session": groups["session"]})


def _check_parameters(expected: list[dict[str, Any]], listed: Any) -> None:
    """That the list for people says what the arrays do."""
    require(isinstance(listed, list) and len(listed) == len(expected), "parameters")
    for one, other in zip(expected, listed, strict=True):
        require(isinstance(other, dict) and one.keys() == other.keys(), "parameters")
        for key, value in one.items():
            same = value == other[key]
            if isinstance(value, float) and isinstance(other[key], float):
                same = bool(np.isclose(value, other[key], rtol=1e-6, atol=0))
            require(same, f"parameters: {key} of {one['name']} is not what the joints say")
