"""Diagnosis: the result of `diagnose`, what can be asked of it, and its JSON form.

Field names and meanings of the JSON are a contract, version stickslip-fit/diagnosis/1. Unknown numbers
are NaN here and null there.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from stickslip_fit._io import ProgressCallback, ignore_progress, write_atomically
from stickslip_fit._summary import Summarized
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis.finding import Finding, Gain, NextTraverse
from stickslip_fit.diagnosis.gain import measure_gain
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.diagnosis.withdrawal import find_unsupported, withdraw_causes
from stickslip_fit.errors import InputError, check_workers
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.logs import Log
from stickslip_fit.units import PRISMATIC, Interval, from_si

Verdict = Literal["nothing wrong", "cause named", "cannot tell apart", "unknown cause"]


def choose_verdict(findings: tuple[Finding, ...]) -> Verdict:
    """The verdict: the first finding decides it."""
    if not findings:
        return "nothing wrong"
    if findings[0].cause == UNKNOWN:
        return "unknown cause"
    return "cannot tell apart" if findings[0].equivalent else "cause named"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Summarized):
    """What is wrong with the published laws in a log, and the selection that it follows from.

    Attributes
    ----------
    verdict : str
    findings : tuple of Finding
        Largest effect first.
    p_value : float
        Of the whole search; `misfit` says how it is computed.
    misfit : float
        Rms residual of the baseline, relative.
    repeatability : float
        Repeatability standard deviation, relative; rms over the rows.
    inclusion : dict of str to float or None
        Posterior probability of each cause; None where it is untestable.
    untestable : dict of str to str
        Causes that the log could not show, with the reason.
    alpha : float
    seed : int
    seconds : float
    selection : Selection
    aliased_causes : tuple of (str, str)
        Pairs of which the second cause can produce in this log every effect of the first.
    gain, gain_new_session : Gain or None
        On held-out traverses, and on new sessions known by their calibration; None if not measured.
    next_experiment : tuple of NextTraverse
    log : Log or None
        None where the data were no log.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    p_value: float
    misfit: float
    repeatability: float
    inclusion: Mapping[str, float | None]
    untestable: Mapping[str, str]
    alpha: float
    seed: int
    seconds: float
    selection: Selection
    aliased_causes: tuple[tuple[str, str], ...] = ()
    gain: Gain | None = None
    gain_new_session: Gain | None = None
    next_experiment: tuple[NextTraverse, ...] = ()
    log: Log | None = None

    @property
    def log_file(self) -> str:
        """The first file of the log; empty where there is none."""
        return self.log.sources[0][0] if self.log is not None and self.log.sources else ""

    @property
    def log_sha256(self) -> str:
        """Hash of the log; empty where there is none."""
        return self.log.sha256 if self.log is not None else ""

    def require_log(self) -> Log:
        """The log, for what needs its machine and its laws.

        Raises
        ------
        InputError
            If the data were no log.
        """
        if self.log is None:
            raise InputError("this diagnosis is not of a log: use `diagnose` on a log instead")
        return self.log

    def measure_gain(self, *, workers: int = -1, progress: ProgressCallback = ignore_progress) -> Diagnosis:
        """The same diagnosis with `gain`, `gain_new_session` and the gain of each finding.

        A cause with which held-out traverses are predicted worse is no longer named: it becomes ``unknown``
        with a note (`withdrawal`), and the gain is measured again.

        `workers` are processes, all cores without it; the numbers do not depend on it.

        Raises
        ------
        InputError
            If `workers` is neither -1 nor at least 1.
        """
        check_workers(workers)
        began, selection, findings = time.perf_counter(), self.selection, self.findings
        machine, inclusion = self.log.machine if self.log is not None else None, dict(self.inclusion)
        options: Any = {"alpha": self.alpha, "seed": self.seed, "workers": workers, "progress": progress}
        while True:
            gain, new_session, findings = measure_gain(selection, findings, machine, **options)
            unsupported = find_unsupported(findings)
            if not unsupported:
                break
            selection, findings = withdraw_causes(selection, findings, unsupported, self.alpha)
            for one in unsupported:
                unknown = inclusion.get(UNKNOWN) or 0.0
                inclusion |= {UNKNOWN: max(inclusion[one.cause] or 0.0, unknown), one.cause: unknown}
        return replace(
            self,
            verdict=choose_verdict(findings),
            findings=findings,
            selection=selection,
            inclusion=inclusion,
            gain=gain,
            gain_new_session=new_session,
            seconds=self.seconds + time.perf_counter() - began,
        )

    def extended_law(self, *, command: str = "") -> Result:
        """The published laws extended by the named causes, fitted to the log.

        Of causes that the log cannot separate, the likeliest is in the law. Outlying counts are excluded;
        unknown structure has no place in a law. `command` is for the result's provenance.

        Raises
        ------
        InputError
            If the data were no log.
        """
        log = self.require_log()
        usable = log.rows.index[log.rows["status"] == "ok"]
        for finding in self.findings:
            if finding.traverses is not None:
                log = log.exclude(usable[finding.traverses.index])
        causes = [finding.version for finding in self.findings if finding.version is not None]
        laws = {part.law.joint: part.law for part in self.selection.problem.parts}
        return fit_least_squares(log, laws=laws, causes=causes, command=command)

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of the named causes, one row each.

        cause, name, joint, direction, session (None for one of the whole campaign), unit (for display),
        estimate, low, high: SI, 95 %.
        """
        columns = ["cause", "name", "joint", "direction", "session", "unit", "estimate", "low", "high"]
        rows = [
            (finding.cause, p.name, p.joint, p.direction, p.session, p.unit, *astuple(p.size))
            for finding in self.findings
            for p in finding.parameters
        ]
        return pd.DataFrame(rows, columns=columns)

    @property
    def residuals(self) -> pd.DataFrame:
        """The log's rows with the relative residuals `before` (published law) and `after` (extended law).

        The directions of the calibration parameters are projected out; outlying counts are left out.
        """
        first, last = self.selection.problem.linearize(), self.selection.linearized
        return self.selection.problem.rows.assign(
            before=first.residual * first.scale, after=last.residual * last.scale
        )

    @property
    def ranking(self) -> pd.DataFrame:
        """Every candidate cause, likeliest first.

        cause, probability (NaN where it is untestable), untestable: the reason.
        """
        table = pd.DataFrame({"cause": list(self.inclusion), "probability": list(self.inclusion.values())})
        table["probability"] = table["probability"].astype(float)
        table["untestable"] = table["cause"].map(dict(self.untestable)).fillna("")
        return table.sort_values("probability", ascending=False, kind="stable", ignore_index=True)

    def plot_residuals(self, finding: int = 0) -> AxesArray:
        """Residuals before and after a finding, over the variable that it follows.

        Raises
        ------
        InputError
            If there is no such finding, or it has no shape.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_residuals

        return collect_axes(plot_residuals(self, finding))

    def plot_ranking(self) -> AxesArray:
        """Probability of each cause, in each test of the residuals."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_ranking

        return collect_axes(plot_ranking(self))

    def plot_gain(self) -> AxesArray:
        """Errors on held-out traverses by session, before and after.

        Raises
        ------
        InputError
            If no gain was measured, or no cause is named.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_gain

        return collect_axes(plot_gain(self))


SCHEMA = "stickslip-fit/diagnosis/1"
METRIC = "held-out rms error of the step size, %"


def save_diagnosis(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write a diagnosis as JSON; raises InputError if the file is the log, or cannot be written."""
    text = json.dumps(diagnosis_to_json(diagnosis), indent=1, ensure_ascii=False, allow_nan=False)
    files = diagnosis.log.files if diagnosis.log is not None else ()
    write_atomically(path, text + "\n", files)


def diagnosis_to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """A diagnosis in plain JSON types; an unknown number is None."""
    rows = diagnosis.selection.problem.rows
    gain = _gain_to_json(diagnosis.gain)
    return {
        "schema": SCHEMA,
        "log": {
            "file": Path(diagnosis.log_file).name,
            "sha256": diagnosis.log_sha256,
            "runs": len(rows) + len(diagnosis.selection.outliers),
            "sessions": int(rows["session"].nunique()),
            "joints": sorted(int(joint) for joint in rows["joint"].unique()),
        },
        "noise": {"repeatability_pct": _percent_or_null(diagnosis.repeatability), "source": "residuals"},
        "misfit": {"p_value": diagnosis.p_value, "rms_pct": _percent_or_null(diagnosis.misfit)},
        "verdict": diagnosis.verdict,
        "findings": [_finding_to_json(finding) for finding in diagnosis.findings],
        "inclusion": dict(diagnosis.inclusion),
        "untestable": [{"cause": cause, "reason": why} for cause, why in diagnosis.untestable.items()],
        "alike": [list(pair) for pair in diagnosis.aliased_causes],
        "gain": gain and {"metric": METRIC, **gain},
        "gain_new_session": _gain_to_json(diagnosis.gain_new_session),
        "next_experiment": [traverse_to_json(traverse) for traverse in diagnosis.next_experiment],
        "alpha": diagnosis.alpha,
        "seed": diagnosis.seed,
        "seconds": round(diagnosis.seconds, 2),
    }


def _finding_to_json(finding: Finding) -> dict[str, Any]:
    gain = _gain_to_json(finding.gain)
    if gain is not None:
        gain.pop("noise_floor_pct")
    content: dict[str, Any] = {
        "cause": finding.cause,
        "equivalent": list(finding.equivalent),
        "p_value": finding.p_value,
        "joints": list(finding.joints),
        "effect_rms_pct": _interval_to_json(finding.effect.times(100.0)),
        "parameters": [_parameter_to_json(parameter) for parameter in finding.parameters],
        "gain": gain,
    }
    if finding.note:
        content["note"] = finding.note
    if finding.closest:
        content["closest"] = {"cause": finding.closest, "share": finding.share, "carrier": finding.carrier}
    return content


def _parameter_to_json(parameter: SizedParameter) -> dict[str, Any]:
    size = Interval(*(float(from_si(value, parameter.unit)) for value in astuple(parameter.size)))
    scope = {"joint": parameter.joint, "direction": parameter.direction, "session": parameter.session}
    known = {key: value for key, value in scope.items() if value is not None}
    return {"name": parameter.name, "unit": parameter.unit, **_interval_to_json(size), **known}


def _gain_to_json(gain: Gain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {
        "baseline_pct": _percent_or_null(gain.baseline),
        "extended_pct": _percent_or_null(gain.extended),
        "noise_floor_pct": _percent_or_null(gain.noise_floor),
        "low": _percent_or_null(gain.low),
        "high": _percent_or_null(gain.high),
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
            f"{name}_{unit}": _number_or_null(from_si(getattr(traverse, name), unit))
            for name, unit in units.items()
        },
        "from": _number_or_null(from_si(traverse.start, ends)),
        "to": _number_or_null(from_si(traverse.stop, ends)),
        "repeats": traverse.repeats,
        "tells_apart": list(traverse.tells_apart),
        "note": traverse.note,
    }


def _interval_to_json(interval: Interval) -> dict[str, float | None]:
    return {name: _number_or_null(getattr(interval, name)) for name in ("estimate", "low", "high")}


def _percent_or_null(value: float) -> float | None:
    return _number_or_null(100.0 * value)


def _number_or_null(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
