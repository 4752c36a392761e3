"""The report's first sentences and table: what a lab can act on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_direction,
    format_percent,
    format_value,
    join_words,
    joint_name,
    pluralize,
    step_unit,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.fit import Result, summarise
from stickslip_fit.fit.held_out import held_out_misfit
from stickslip_fit.laws import expected_steps
from stickslip_fit.logs import Log
from stickslip_fit.report.figures.traverses import enough_replicates, repeatability_of

CHANCE = 1e-3  # below that errors are more than chance explains; heavy tails reach 1e-2
ONE_SIDED = 0.7  # average over rms
BORROWED = "†"


def answer(log: Log, calibration: Result, errors: pd.DataFrame) -> list[str]:
    """How well the law predicts, whether that is as good as can be, and what is missing."""
    kept = promises_kept(log, calibration, errors).groupby(errors["joint"]).mean()
    return [
        *_predicted(errors),
        *_judged(kept, held_out_misfit(log, calibration), errors),
        *_untested(errors, calibration),
        _missing(calibration),
    ]


def promises_kept(log: Log, calibration: Result, errors: pd.DataFrame) -> pd.Series[float]:
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
        enough_replicates(calibration.joints[joint].repeatability[sign])
        for joint, sign in zip(rows["joint"], rows["direction"], strict=True)
    ]
    return inside.where(np.array(enough, dtype=bool))


def answer_table(log: Log, calibration: Result, fit: Result, errors: pd.DataFrame) -> Table:
    """The answer in numbers, for each joint and direction."""
    columns = (
        *words("joint", "direction"),
        Column("traverses predicted"),
        *numbers("rms", "average", "worst", "inside its 95 %", unit="%", group="law"),
        *numbers("rms", "worst", unit="%", group="constant step"),
        Column("repeatability", "%"),
    )
    by = ["joint", "direction"]
    kept = promises_kept(log, calibration, errors).groupby([errors[name] for name in by]).mean()
    body = []
    for _, row in summarise(errors, by).iterrows():
        joint, sign = row["joint"], row["direction"]
        noise = repeatability_of(joint, sign, calibration, fit)
        shares = [row[f"law_{what}_relative"] for what in ("rms", "bias", "worst")]
        shares += [kept[joint, sign], row["constant_rms_relative"], row["constant_worst_relative"]]
        borrowed = "" if noise.source == "replicates" else BORROWED
        cells = (
            f"{row['traverses']:,}",
            *(format_percent(share, with_unit=False) for share in shares),
            format_percent(noise.value, with_unit=False) + borrowed,
        )
        body.append((joint_name(joint), format_direction(sign), *cells))
    note = (
        "An error is predicted less measured step size. Inside its 95 %: traverses within the interval that "
        "the calibration gives. Repeatability: how much a repeated traverse scatters."
    )
    if any(BORROWED in row[-1] for row in body):
        note += f" {BORROWED} From the fit's residuals, for want of replicates."
    caption = "Error on traverses that the calibration did not use"
    return Table(caption, columns, tuple(body), stubs=2, note=note)


def _predicted(errors: pd.DataFrame) -> list[str]:
    if errors.empty:
        return []
    totals = summarise(errors, ["joint"])
    law = [
        f"{format_percent(row.law_rms_relative)} rms for joint {row.joint} "
        f"({format_value(row.law_rms, step_unit(row.joint))})"
        for row in totals.itertuples()
    ]
    constant = [format_percent(share) for share in totals["constant_rms_relative"]]
    return [
        "Calibrated in each session, the law predicts the step size of "
        f"{pluralize(len(errors), 'traverse')} that the calibration did not use to {join_words(law)}. "
        f"A constant step is off by {join_words(constant)} rms."
    ]


def _judged(kept: pd.Series[float], misfit: pd.DataFrame, errors: pd.DataFrame) -> list[str]:
    one_sided = [joint for joint in kept.index if _is_one_sided(errors[errors["joint"] == joint])]
    p_values = misfit.groupby("joint")["p_value"]
    surprising = p_values.min() * p_values.size() < CHANCE
    short = [joint for joint in kept.index if surprising.get(joint, False)]
    unsure = [joint for joint, share in kept.items() if np.isnan(share)]
    fine = [joint for joint in kept.index if joint not in {*one_sided, *short, *unsure}]
    told = []
    if fine:
        told.append(
            f"For {_named(fine)} that is no more than repeatability and the calibration's own uncertainty "
            "explain."
        )
    if short:
        shares = join_words([format_percent(kept[joint]) for joint in short])
        told.append(
            f"For {_named(short)} that is more than repeatability and the calibration's own uncertainty "
            f"explain ({shares} of the traverses lie within the interval that should hold 95 %), so the law "
            "lacks something or the joint has changed since its calibration."
        )
    if one_sided:
        told.append(
            f"The errors of {_named(one_sided)} mostly have one sign: at calibration the step was not what "
            "it was in the rest of the session. See what the law leaves over against the hours in the "
            "session."
        )
    if unsure:
        told.append(
            f"Whether that is as good as repeatability allows cannot be said for {_named(unsure)}: too few "
            "replicates within a session. Make each calibration traverse twice."
        )
    return [" ".join(told)] if told else []


def _is_one_sided(errors: pd.DataFrame) -> bool:
    total = summarise(errors, ["joint"]).iloc[0]
    return bool(abs(total["law_bias_relative"]) > ONE_SIDED * total["law_rms_relative"])


def _untested(errors: pd.DataFrame, calibration: Result) -> list[str]:
    joints = [joint for joint in calibration.joints if not (errors["joint"] == joint).any()]
    uncalibrated = [joint for joint in joints if joint in _uncalibrated(calibration)]
    alone = [joint for joint in joints if joint not in uncalibrated]
    told = []
    if uncalibrated:
        told.append(f"The law of {_named(uncalibrated)} cannot be judged, since it cannot be calibrated.")
    if alone:
        told.append(
            f"The law of {_named(alone)} cannot be judged: there is no traverse beside those that the "
            "calibration used."
        )
    return told


def _missing(calibration: Result) -> str:
    told = []
    if joints := _uncalibrated(calibration):
        told.append(
            f"Not every parameter of {_named(joints)} can be calibrated: the remarks name the traverses "
            "to make."
        )
    for joint, fit in calibration.joints.items():
        driven = set(fit.groups["direction"])
        told += [
            f"Joint {joint} was not driven in direction {format_direction(sign)}: nothing is known of that."
            for sign in ("+", "-")
            if sign not in driven
        ]
    return " ".join(told) or "Every parameter of the laws can be calibrated from this log."


def _uncalibrated(calibration: Result) -> list[int]:
    return sorted({remark.joint for remark in calibration.remarks if remark.flag == "not_identified"})


def _named(joints: Sequence[int]) -> str:
    return join_words([f"joint {joint}" for joint in joints])
