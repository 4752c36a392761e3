"""The headline of a report: what is wrong and what to do, how well the law predicts, and one table.

Where a diagnosis named what is wrong, the headline is the diagnosis's, and the accuracy is told of the law
with and without it; no other reason is looked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeGuard

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_direction,
    format_p_value,
    format_percent,
    format_value,
    join_words,
    joint_name,
    pluralize,
    step_unit,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.diagnosis import Diagnosis, Gain
from stickslip_fit.diagnosis._words import baseline_name
from stickslip_fit.estimation import Result, summarize_errors
from stickslip_fit.estimation.prediction import assess_held_out
from stickslip_fit.estimation.result import choose_repeatability, has_enough_replicates
from stickslip_fit.laws import ConstantStep, expected_steps
from stickslip_fit.logs import Log

MISFIT_ALPHA = 1e-3  # below that errors are more than chance explains; heavy tails reach 1e-2
MIN_BIAS_SHARE = 0.7  # average over rms
MIN_COVERAGE = 0.85  # of a joint and direction; a smaller share needs a word beside what a test says
BORROWED_MARK = "†"
NO_VALUE = "–"


def write_headline(
    log: Log, calibration: Result, errors: pd.DataFrame, diagnosis: Diagnosis | None = None
) -> list[str]:
    """What is wrong and what knowing it gains, how well the law predicts, and what could not be judged."""
    sentences = _describe_diagnosis(diagnosis) if diagnosis is not None else []
    if diagnosis is not None and diagnosis.findings:
        sentences += _describe_both_laws(diagnosis, errors, calibration)
    else:
        sentences += _describe_predictions(errors, calibration)
        sentences += _describe_coverage(log, calibration, errors, diagnosis)
    missing = [*_describe_untested(errors, calibration), *_describe_missing(calibration)]
    return [*sentences, " ".join(missing)] if missing else sentences


def _describe_diagnosis(diagnosis: Diagnosis) -> list[str]:
    """The diagnosis's sentences: what is wrong with what to do about it, then what else is wrong."""
    headline = diagnosis.summary().headline
    if not diagnosis.findings:
        return [headline[0]]
    others = headline[2 : 1 + len(diagnosis.findings)]
    return [*headline[:2], *([" ".join(others)] if others else [])]


def is_extended(diagnosis: Diagnosis | None) -> bool:
    """Whether a diagnosis found what extends the law."""
    return diagnosis is not None and any(one.version is not None for one in diagnosis.findings)


def _describe_both_laws(diagnosis: Diagnosis, errors: pd.DataFrame, calibration: Result) -> list[str]:
    """The errors of the law and of the extended law, from calibration traverses alone where that is known."""
    if not is_extended(diagnosis):
        return _describe_predictions(errors, calibration)
    session, held_out = diagnosis.gain_new_session, diagnosis.gain
    name = baseline_name(diagnosis)
    if _has_joints(session):
        totals = _pool(session.by_joint)
        before, after = (
            join_words(
                [f"{format_percent(row[law])} rms for joint {joint}" for joint, row in totals.iterrows()]
            )
            for law in ("baseline", "extended")
        )
        return [
            f"Calibrated by a new session's few calibration traverses, the {name} predicts its other "
            f"traverses to {before}, the extended law to {after}.{_describe_constant(errors, calibration)}"
        ]
    if held_out is not None:
        return [
            f"On held-out traverses the {name} is off by {format_percent(held_out.baseline)} rms, the "
            f"extended law by {format_percent(held_out.extended)}; repeatability and rounding alone make "
            f"{format_percent(held_out.noise_floor)}.{_describe_constant(errors, calibration)}"
        ]
    return _describe_predictions(errors, calibration)


def _pool(by_joint: pd.DataFrame) -> pd.DataFrame:
    """Rms errors of both directions together, by joint."""
    table = by_joint.assign(
        **{law: by_joint[law] ** 2 * by_joint["traverses"] for law in ("baseline", "extended")}
    )
    sums = table.groupby("joint")[["baseline", "extended", "traverses"]].sum()
    return np.sqrt(sums[["baseline", "extended"]].div(sums["traverses"], axis=0))


def _describe_predictions(errors: pd.DataFrame, calibration: Result) -> list[str]:
    if errors.empty:
        return []
    totals = summarize_errors(errors, ["joint"])
    law = [
        f"{format_percent(row.law_rms_relative)} rms for joint {row.joint} "
        f"({format_value(row.law_rms, step_unit(row.joint, calibration.machine))})"
        for row in totals.itertuples()
    ]
    return [
        "Calibrated in each session, the law predicts the step size of "
        f"{pluralize(len(errors), 'traverse')} that the calibration did not use to {join_words(law)}."
        f"{_describe_constant(errors, calibration)}"
    ]


def _describe_constant(errors: pd.DataFrame, calibration: Result) -> str:
    if errors.empty or all(isinstance(fit.law, ConstantStep) for fit in calibration.joints.values()):
        return ""
    shares = summarize_errors(errors, ["joint"])["constant_rms_relative"]
    return f" A constant step is off by {join_words([format_percent(share) for share in shares])} rms."


def _describe_coverage(
    log: Log, calibration: Result, errors: pd.DataFrame, diagnosis: Diagnosis | None
) -> list[str]:
    """Whether the errors are what the error bars say, as a paragraph; no reasons where none was found."""
    if errors.empty:
        return []
    coverage = check_coverage(log, calibration, errors)
    kept = coverage.groupby(errors["joint"]).mean()
    least = coverage.groupby([errors["joint"], errors["direction"]]).mean().groupby("joint").min()
    p_values = assess_held_out(log, calibration).groupby("joint")["p_value"]
    p_value = (p_values.min() * p_values.size()).clip(upper=1.0)
    searched = diagnosis is not None and np.isfinite(diagnosis.repeatability)
    one_sided = [
        joint for joint in kept.index if not searched and _is_one_sided(errors[errors["joint"] == joint])
    ]
    short = [joint for joint in kept.index if p_value.get(joint, 1.0) < MISFIT_ALPHA]
    unsure = [joint for joint in kept.index if np.isnan(kept[joint])]
    fine = [joint for joint in kept.index if joint not in {*one_sided, *short, *unsure}]
    narrow = [joint for joint in fine if least[joint] < MIN_COVERAGE]
    sentences = []
    if fine:
        sentences.append(
            f"For {_name_joints(fine)} that is no more than repeatability and the calibration's own "
            "uncertainty explain."
        )
    for joint in narrow:
        tested = format_p_value(p_value.get(joint, 1.0), relation=True)
        sentences.append(
            f"Of joint {joint}'s traverses in one direction only {format_percent(float(least[joint]))} lie "
            "within the interval that should hold 95 %: one calibration shifts all traverses of its session "
            f"together, and a test that allows for that gives p {tested}."
        )
    if short:
        shares = join_words([format_percent(kept[joint]) for joint in short])
        reason = (
            "calibrate from more traverses than the law has parameters"
            if searched
            else "so the law lacks something or the joint has changed since its calibration"
        )
        sentences.append(
            f"For {_name_joints(short)} that is more than repeatability and the calibration's own "
            f"uncertainty explain ({shares} of the traverses lie within the interval that should hold "
            f"95 %){': ' if searched else ', '}{reason}."
        )
    if one_sided:
        sentences.append(
            f"The errors of {_name_joints(one_sided)} mostly have one sign: at calibration the step was not "
            "what it was in the rest of the session. See the residuals against the hours in the session."
        )
    if unsure:
        sentences.append(
            f"Whether that is as good as repeatability allows cannot be said for {_name_joints(unsure)}: too "
            f"few replicates within a session.{'' if searched else ' Make each calibration traverse twice.'}"
        )
    return [" ".join(sentences)] if sentences else []


def check_coverage(log: Log, calibration: Result, errors: pd.DataFrame) -> pd.Series[float]:
    """Whether each uncalibrated traverse lies within the 95 % interval that its calibration gives.

    Returns
    -------
    Series, indexed as `errors`
        1 or 0; NaN in directions without enough replicates for error bars.
    """
    rows = log.usable.loc[errors.index]
    interval = calibration.predict(rows)
    seen = pd.Series(expected_steps(rows["steps"], rows["check_every"]), index=rows.index)
    inside = seen.between(interval["low"], interval["high"]).astype(float)
    enough = [
        has_enough_replicates(calibration.joints[joint].repeatability[sign])
        for joint, sign in zip(rows["joint"], rows["direction"], strict=True)
    ]
    return inside.where(np.array(enough, dtype=bool))


def headline_table(
    log: Log, calibration: Result, fit: Result, errors: pd.DataFrame, diagnosis: Diagnosis | None = None
) -> Table:
    """The accuracy in numbers, for each joint and direction; with the extended law where there is one."""
    extended = diagnosis if is_extended(diagnosis) else None
    by = ["joint", "direction"]
    kept = check_coverage(log, calibration, errors).groupby([errors[name] for name in by]).mean()
    columns, gains = _headline_columns(extended)
    body = []
    for row in summarize_errors(errors, by).to_dict("records"):
        joint, sign = row["joint"], row["direction"]
        noise = choose_repeatability(joint, sign, calibration, fit)
        law = [row["law_rms_relative"], row["law_worst_relative"], kept[joint, sign]]
        borrowed = "" if noise.source == "replicates" else BORROWED_MARK
        cells = (
            f"{row['traverses']:,}",
            *map(_percent, [*law, *_gain_cells(gains, joint, sign)]),
            _percent(row["constant_rms_relative"]),
            _percent(noise.value) + borrowed,
        )
        body.append((joint_name(joint, log.machine), format_direction(sign), *cells))
    note = (
        "An error is predicted less measured step size. Inside its 95 %: traverses within the interval that "
        "the calibration gives. Replicate scatter: among repeated traverses of a session; drift is in it."
    )
    if extended is not None:
        note += (
            f" Law: the {baseline_name(extended)}. Of the extended law, what extends it is known from other "
            "sessions (new session) or other configurations (held out)."
        )
    if kept.isna().any():
        note += f" {NO_VALUE}: too few replicates within a session for an interval."
    if any(BORROWED_MARK in row[-1] for row in body):
        note += f" {BORROWED_MARK} Residual scatter, for want of replicates."
    caption = "Error on traverses that the calibration did not use"
    return Table(caption, columns, tuple(body), stubs=2, note=note)


def _headline_columns(extended: Diagnosis | None) -> tuple[tuple[Column, ...], list[tuple[Gain, list[str]]]]:
    """The columns, and the gains that fill those of the extended law."""
    gains: list[tuple[Gain, list[str]]] = []
    own: tuple[Column, ...] = ()
    if extended is not None and _has_joints(extended.gain_new_session):
        own += numbers("extended law", unit="%", group="new session, rms")
        gains.append((extended.gain_new_session, ["extended"]))
    if extended is not None and _has_joints(extended.gain):
        own += numbers("law", "extended law", unit="%", group="held-out traverses, rms")
        gains.append((extended.gain, ["baseline", "extended"]))
    columns = (
        *words("joint", "direction"),
        Column("traverses predicted"),
        *numbers("rms", "worst", "inside its 95 %", unit="%", group="law, calibrated"),
        *own,
        *numbers("constant step, rms", "replicate scatter", unit="%"),
    )
    return columns, gains


def _has_joints(gain: Gain | None) -> TypeGuard[Gain]:
    return gain is not None and len(gain.by_joint) > 0


def _gain_cells(gains: Sequence[tuple[Gain, list[str]]], joint: int, sign: str) -> list[float]:
    cells = []
    for gain, laws in gains:
        own = gain.by_joint[(gain.by_joint["joint"] == joint) & (gain.by_joint["direction"] == sign)]
        cells += [float(own[law].iloc[0]) if len(own) else np.nan for law in laws]
    return cells


def _percent(share: float) -> str:
    return format_percent(share, with_unit=False) if np.isfinite(share) else NO_VALUE


def _is_one_sided(errors: pd.DataFrame) -> bool:
    total = summarize_errors(errors, ["joint"]).iloc[0]
    return bool(abs(total["law_bias_relative"]) > MIN_BIAS_SHARE * total["law_rms_relative"])


def _describe_untested(errors: pd.DataFrame, calibration: Result) -> list[str]:
    joints = [joint for joint in calibration.joints if not (errors["joint"] == joint).any()]
    uncalibrated = [joint for joint in joints if joint in _list_uncalibrated(calibration)]
    alone = [joint for joint in joints if joint not in uncalibrated]
    sentences = []
    if uncalibrated:
        sentences.append(
            f"The law of {_name_joints(uncalibrated)} cannot be judged, since it cannot be calibrated."
        )
    if alone:
        sentences.append(
            f"The law of {_name_joints(alone)} cannot be judged: there is no traverse beside those that the "
            "calibration used."
        )
    return sentences


def _describe_missing(calibration: Result) -> list[str]:
    sentences = []
    if joints := _list_uncalibrated(calibration):
        sentences.append(
            f"Not every parameter of {_name_joints(joints)} can be calibrated: the remarks name the "
            "traverses to make."
        )
    for joint, fit in calibration.joints.items():
        driven = set(fit.groups["direction"])
        sentences += [
            f"Joint {joint} was not driven in direction {format_direction(sign)}: nothing is known of that."
            for sign in ("+", "-")
            if sign not in driven
        ]
    return sentences


def _list_uncalibrated(calibration: Result) -> list[int]:
    return sorted({flag.joint for flag in calibration.flags if flag.flag == "not_identified"})


def _name_joints(joints: Sequence[int]) -> str:
    return join_words([f"joint {joint}" for joint in joints])
