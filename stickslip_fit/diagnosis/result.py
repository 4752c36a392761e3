"""Diagnosis, its findings and gains: the result of `diagnose`, and its JSON form.

Field names and meanings of the JSON are a contract, version stickslip-fit/diagnosis/1. Unknown numbers
are NaN here and null there.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from stickslip_fit._io import write_atomically
from stickslip_fit._summary import Summarized
from stickslip_fit.causes import SizedParameter
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.estimation.result import AxesArray
from stickslip_fit.units import Interval, from_si

Verdict = Literal["nothing wrong", "cause named", "cannot tell apart", "unknown cause"]


@dataclass(frozen=True)
class Gain:
    """Error on traverses that took no part, before and after extending the law; relative, rms.

    Attributes
    ----------
    baseline, extended : float
    noise_floor : float
        What even the true law would leave, rounding included.
    low, high : float
        95 % interval of baseline less extended for a fresh replicate of the campaign.
    by_session : DataFrame
        session, baseline, extended, traverses.
    """

    baseline: float
    extended: float
    noise_floor: float
    low: float
    high: float
    by_session: pd.DataFrame


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    cause : str
    version : object or None
        The cause as it acts in this log.
    equivalent : tuple of str
        Causes that this log cannot tell from it.
    p_value : float
    joints : tuple of int
    effect : Interval
        Rms over all rows of the relative change in the count, recalibration taken out.
    parameters : tuple of SizedParameter
    gain : Gain or None
        From the findings before it to those with it.
    closest, share : str, float
        For ``unknown``: the cause that comes closest, and the share of the structure that it explains.
    carrier : str
        For ``unknown``: what the structure follows.
    traverses : DataFrame or None
        For misfires: those traverses, with `departure` (relative) from the law.
    """

    cause: str
    version: Any
    equivalent: tuple[str, ...]
    p_value: float
    joints: tuple[int, ...]
    effect: Interval
    parameters: tuple[SizedParameter, ...]
    gain: Gain | None = None
    closest: str = ""
    share: float = 0.0
    carrier: str = ""
    traverses: pd.DataFrame | None = None


@dataclass(frozen=True)
class NextTraverse:
    """A traverse worth making next; SI, NaN where it does not matter.

    Attributes
    ----------
    session : str
        ``new``, or one that is still going on.
    joint : int
    direction : str
    q1, q2, q3, theta, psi, start, stop : float
    repeats : int
    tells_apart : tuple of str
    note : str
        When to make it, where that matters.
    """

    session: str
    joint: int
    direction: str
    q1: float
    q2: float
    q3: float
    theta: float
    psi: float
    start: float
    stop: float
    repeats: int
    tells_apart: tuple[str, ...]
    note: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Summarized):
    """The answer, and what it rests on.

    Attributes
    ----------
    verdict : str
    findings : tuple of Finding
        Strongest first.
    p_value : float
        Of anything at all, corrected for everything that was searched.
    misfit : float
        Rms residual of the baseline.
    repeatability : float
        Root mean square over the rows of each row's own.
    inclusion : dict of str to float or None
        Probability that each cause is at work; None where the log cannot show it.
    untestable : dict of str to str
        Why the log cannot show a cause.
    gain, gain_new_session : Gain or None
    next_experiment : tuple of NextTraverse
    alpha : float
    seed : int
    seconds : float
    log_file, log_sha256 : str
    search : Search
        What all this follows from, for pictures.
    aliased_causes : tuple of (str, str)
        Causes of which the second can do in this log all that the first does, whatever the size.
    """

    verdict: Verdict
    findings: tuple[Finding, ...]
    p_value: float
    misfit: float
    repeatability: float
    inclusion: Mapping[str, float | None]
    untestable: Mapping[str, str]
    gain: Gain | None
    gain_new_session: Gain | None
    next_experiment: tuple[NextTraverse, ...]
    alpha: float
    seed: int
    seconds: float
    log_file: str
    log_sha256: str
    search: Selection
    aliased_causes: tuple[tuple[str, str], ...] = ()

    @property
    def parameters(self) -> pd.DataFrame:
        """Every parameter of what was named, one row each.

        cause, name, joint, direction, session (None for one of the whole campaign), unit (the one people read
        it in), estimate, low, high: SI, 95 %.
        """
        columns = ["cause", "name", "joint", "direction", "session", "unit", "estimate", "low", "high"]
        rows = [
            (each.cause, one.name, one.joint, one.direction, one.session, one.unit, *astuple(one.size))
            for each in self.findings
            for one in each.parameters
        ]
        return pd.DataFrame(rows, columns=columns)

    @property
    def residuals(self) -> pd.DataFrame:
        """The log's rows with before and after, counts less the law's, relative.

        Before under the published law, after with all that was named in it; what recalibration absorbs is
        taken out, and counts that misfired are not among them.
        """
        first, last = self.search.problem.study(), self.search.study
        return self.search.problem.rows.assign(
            before=first.residual * first.scale, after=last.residual * last.scale
        )

    @property
    def ranking(self) -> pd.DataFrame:
        """Every cause that was asked about, likeliest first.

        cause, probability (NaN where the log cannot show it), untestable: why it cannot.
        """
        table = pd.DataFrame({"cause": list(self.inclusion), "probability": list(self.inclusion.values())})
        table["probability"] = table["probability"].astype(float)
        table["untestable"] = table["cause"].map(dict(self.untestable)).fillna("")
        return table.sort_values("probability", ascending=False, kind="stable", ignore_index=True)

    def plot_residuals(self, finding: int = 0) -> AxesArray:
        """What a finding explains: counts less the law before and after, over what carries it.

        Raises
        ------
        InputError
            If there is no such finding, or it has no shape.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_residuals

        return collect_axes(plot_residuals(self, finding))

    def plot_ranking(self) -> AxesArray:
        """How likely each cause is, at each look at the residuals."""
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_ranking

        return collect_axes(plot_ranking(self))

    def plot_gain(self) -> AxesArray:
        """Errors on held-out traverses by session, before and after.

        Raises
        ------
        InputError
            If nothing was named, so that nothing was gained.
        """
        from stickslip_fit.plotting._style import collect_axes
        from stickslip_fit.plotting.diagnosis import plot_gain

        return collect_axes(plot_gain(self))


SCHEMA = "stickslip-fit/diagnosis/1"
METRIC = "held-out rms error of the step size, %"


def save_diagnosis(diagnosis: Diagnosis, path: str | Path) -> None:
    """Write a diagnosis as JSON; nothing is left half-written."""
    text = json.dumps(diagnosis_to_json(diagnosis), indent=1, ensure_ascii=False, allow_nan=False)
    write_atomically(path, text + "\n")


def diagnosis_to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """A diagnosis in plain JSON types; an unknown number is None."""
    problem = diagnosis.search.problem
    rows = problem.rows
    return {
        "schema": SCHEMA,
        "log": {
            "file": Path(diagnosis.log_file).name,
            "sha256": diagnosis.log_sha256,
            "runs": len(rows) + len(diagnosis.search.outliers),
            "sessions": int(rows["session"].nunique()),
            "joints": sorted(int(joint) for joint in rows["joint"].unique()),
        },
        "noise": {"repeatability_pct": _percent_or_null(diagnosis.repeatability), "source": "residuals"},
        "misfit": {"p_value": diagnosis.p_value, "rms_pct": _percent_or_null(diagnosis.misfit)},
        "verdict": diagnosis.verdict,
        "findings": [_finding_to_json(each) for each in diagnosis.findings],
        "inclusion": dict(diagnosis.inclusion),
        "untestable": [{"cause": cause, "reason": why} for cause, why in diagnosis.untestable.items()],
        "alike": [list(pair) for pair in diagnosis.aliased_causes],
        "gain": _gain_to_json(diagnosis.gain) and {"metric": METRIC, **(_gain_to_json(diagnosis.gain) or {})},
        "gain_new_session": _gain_to_json(diagnosis.gain_new_session),
        "next_experiment": [traverse_to_json(each) for each in diagnosis.next_experiment],
        "alpha": diagnosis.alpha,
        "seed": diagnosis.seed,
        "seconds": round(diagnosis.seconds, 2),
    }


def _finding_to_json(finding: Finding) -> dict[str, Any]:
    gain = _gain_to_json(finding.gain)
    if gain is not None:
        gain.pop("noise_floor_pct")
    found: dict[str, Any] = {
        "cause": finding.cause,
        "equivalent": list(finding.equivalent),
        "p_value": finding.p_value,
        "joints": list(finding.joints),
        "effect_rms_pct": _interval_to_json(finding.effect.times(100.0)),
        "parameters": [_parameter_to_json(each) for each in finding.parameters],
        "gain": gain,
    }
    if finding.closest:
        found["closest"] = {"cause": finding.closest, "share": finding.share, "carrier": finding.carrier}
    return found


def _parameter_to_json(parameter: SizedParameter) -> dict[str, Any]:
    size = parameter.size
    shown = Interval(
        *(float(from_si(value, parameter.unit)) for value in (size.estimate, size.low, size.high))
    )
    further = {"joint": parameter.joint, "direction": parameter.direction, "session": parameter.session}
    known = {key: value for key, value in further.items() if value is not None}
    return {"name": parameter.name, "unit": parameter.unit, **_interval_to_json(shown), **known}


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
    """A traverse to make, in the units that people set."""
    ends = "mm" if traverse.joint == 3 else "deg"
    return {
        "session": traverse.session,
        "joint": traverse.joint,
        "direction": traverse.direction,
        "q1_deg": _number_or_null(from_si(traverse.q1, "deg")),
        "q2_deg": _number_or_null(from_si(traverse.q2, "deg")),
        "q3_mm": _number_or_null(from_si(traverse.q3, "mm")),
        "theta_deg": _number_or_null(from_si(traverse.theta, "deg")),
        "psi_deg": _number_or_null(from_si(traverse.psi, "deg")),
        "from": _number_or_null(from_si(traverse.start, ends)),
        "to": _number_or_null(from_si(traverse.stop, ends)),
        "repeats": traverse.repeats,
        "tells_apart": list(traverse.tells_apart),
        "note": traverse.note,
    }


def _interval_to_json(interval: Interval) -> dict[str, float | None]:
    return {
        "estimate": _number_or_null(interval.estimate),
        "low": _number_or_null(interval.low),
        "high": _number_or_null(interval.high),
    }


def _percent_or_null(value: float) -> float | None:
    return _number_or_null(100.0 * value)


def _number_or_null(value: float) -> float | None:
    """JSON has no NaN: an unknown number is null."""
    return float(value) if np.isfinite(value) else None
