"""Sections on accuracy: held-out errors of law and constant step, claims of the thesis (Ch. 7)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    format_configuration,
    format_direction,
    format_number,
    format_percent,
    format_value,
    join_words,
    joint_name,
    pluralize,
    step_unit,
)
from stickslip_fit._summary import Column, Table, numbers, words
from stickslip_fit.estimation import Result, summarize_errors
from stickslip_fit.estimation.prediction import assess_held_out
from stickslip_fit.estimation.result import choose_repeatability, has_enough_replicates
from stickslip_fit.laws import ConstantStep, expected_steps
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import position_columns
from stickslip_fit.machine import Machine

MAX_SESSIONS, MAX_CONFIGURATIONS = 12, 15
MIN_TRAVERSES = 3  # traverses whose rms has an interval worth printing
NO_VALUE = "–"


def direction_table(errors: pd.DataFrame, joint: int, machine: Machine) -> Table:
    """One row for each direction, and one for both together."""
    subset, unit = errors[errors["joint"] == joint], step_unit(joint, machine)
    each, both = summarize_errors(subset, ["joint", "direction"]), summarize_errors(subset, ["joint"])
    body = [(format_direction(row["direction"]), *_error_cells(row, unit)) for _, row in each.iterrows()]
    body += [("both", *_error_cells(row, unit)) for _, row in both.iterrows()] if len(each) > 1 else []
    return Table(
        f"Accuracy of {joint_name(joint, machine)} by direction",
        _error_columns(unit, "direction"),
        tuple(body),
    )


def session_table(errors: pd.DataFrame, joint: int, machine: Machine) -> Table:
    """One row for each session and direction."""
    subset, unit = errors[errors["joint"] == joint], step_unit(joint, machine)
    order = list(dict.fromkeys(subset["session"]))
    shown = order[-MAX_SESSIONS:]
    summary = summarize_errors(subset[subset["session"].isin(shown)], ["session", "direction"])
    summary = summary.sort_values("session", key=lambda names: names.map(order.index), kind="stable")
    body = (
        (str(row["session"]), format_direction(row["direction"]), *_error_cells(row, unit))
        for _, row in summary.iterrows()
    )
    note = f"The latest {len(shown)} of {len(order)} sessions." if len(shown) < len(order) else ""
    return _make_table(
        f"Accuracy of {joint_name(joint, machine)} by session", unit, ("session", "direction"), body, note
    )


def summarize_configurations(errors: pd.DataFrame, joint: int) -> pd.DataFrame:
    """Summary of a joint's errors by configuration and direction, the law's worst first."""
    subset = errors[errors["joint"] == joint]
    positions = [*position_columns(subset), "start", "stop"]
    subset = subset.assign(**{name: subset[name].round(9) + 0.0 for name in positions})
    summary = summarize_errors(subset, ["joint", "direction", *positions])
    return summary.sort_values("law_rms_relative", ascending=False, kind="stable")


def configuration_table(summary: pd.DataFrame, machine: Machine) -> Table:
    """One row for each of the configurations and directions in which the law is worst."""
    joint = int(summary["joint"].iloc[0])
    shown, unit = summary.head(MAX_CONFIGURATIONS), step_unit(joint, machine)
    body = (
        (
            format_configuration(row, machine),
            format_direction(row["direction"]),
            *_error_cells(row, unit),
        )
        for _, row in shown.iterrows()
    )
    note = (
        ""
        if len(shown) == len(summary)
        else f"The worst {len(shown)} of {len(summary):,}, over all sessions."
    )
    heads = ("configuration", "direction")
    return _make_table(
        f"Accuracy of {joint_name(joint, machine)} by configuration, worst first", unit, heads, body, note
    )


def explain_tables(errors: pd.DataFrame) -> str:
    """What the tables hold."""
    if errors.empty:
        return "The log has no traverse that a calibration of its session predicts and did not use."
    return (
        f"{pluralize(len(errors), 'traverse')} that took no part in the calibration, each predicted by its "
        "own session's closed-form calibration and by that session's constant step. An error is predicted "
        "less measured mean step size; rms with its 95 % interval (for Gaussian errors); worst is the "
        "largest of all, with its sign; bias is the mean."
    )


def _make_table(
    caption: str, unit: str, heads: tuple[str, ...], body: Iterable[tuple[str, ...]], note: str
) -> Table:
    return Table(caption, _error_columns(unit, *heads), tuple(body), stubs=len(heads), note=note)


def _error_columns(unit: str, *heads: str) -> tuple[Column, ...]:
    return (
        *(Column(head, text=True) for head in heads),
        Column("traverses"),
        *numbers("rms", "95 % interval", "worst", "bias", unit=unit, group="law"),
        *numbers("rms", "worst", unit="%", group="law"),
        Column("rms", unit, "constant step"),
        *numbers("rms", "worst", unit="%", group="constant step"),
    )


def _error_cells(row: pd.Series, unit: str) -> tuple[str, ...]:

    def shown(name: str) -> str:
        return format_number(row[name], unit)

    return (
        f"{int(row['traverses']):,}",
        shown("law_rms"),
        f"{shown('law_rms_low')} to {shown('law_rms_high')}"
        if row["traverses"] >= MIN_TRAVERSES
        else NO_VALUE,
        shown("law_worst"),
        shown("law_bias"),
        format_percent(row["law_rms_relative"], with_unit=False),
        format_percent(row["law_worst_relative"], with_unit=False),
        shown("constant_rms"),
        format_percent(row["constant_rms_relative"], with_unit=False),
        format_percent(row["constant_worst_relative"], with_unit=False),
    )


MISFIT_ALPHA = 1e-3  # below that errors are more than chance explains; heavy tails reach 1e-2
MIN_BIAS_SHARE = 0.7  # average over rms
BORROWED_MARK = "†"


def write_headline(log: Log, calibration: Result, errors: pd.DataFrame) -> list[str]:
    """How well the law predicts, whether that is as good as can be, and what is missing."""
    kept = check_coverage(log, calibration, errors).groupby(errors["joint"]).mean()
    return [
        *_describe_predictions(errors, calibration),
        *_describe_coverage(kept, assess_held_out(log, calibration), errors),
        *_describe_untested(errors, calibration),
        _describe_missing(calibration),
    ]


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


def headline_table(log: Log, calibration: Result, fit: Result, errors: pd.DataFrame) -> Table:
    """The answer in numbers, for each joint and direction."""
    columns = (
        *words("joint", "direction"),
        Column("traverses predicted"),
        *numbers("rms", "average", "worst", "inside its 95 %", unit="%", group="law"),
        *numbers("rms", "worst", unit="%", group="constant step"),
        Column("repeatability", "%"),
    )
    by = ["joint", "direction"]
    kept = check_coverage(log, calibration, errors).groupby([errors[name] for name in by]).mean()
    body = []
    for _, row in summarize_errors(errors, by).iterrows():
        joint, sign = row["joint"], row["direction"]
        noise = choose_repeatability(joint, sign, calibration, fit)
        shares = [row[f"law_{what}_relative"] for what in ("rms", "bias", "worst")]
        shares += [kept[joint, sign], row["constant_rms_relative"], row["constant_worst_relative"]]
        borrowed = "" if noise.source == "replicates" else BORROWED_MARK
        cells = (
            f"{row['traverses']:,}",
            *(format_percent(share, with_unit=False) for share in shares),
            format_percent(noise.value, with_unit=False) + borrowed,
        )
        body.append((joint_name(joint, log.machine), format_direction(sign), *cells))
    note = (
        "An error is predicted less measured step size. Inside its 95 %: traverses within the interval that "
        "the calibration gives. Repeatability: how much a repeated traverse scatters."
    )
    if any(BORROWED_MARK in row[-1] for row in body):
        note += f" {BORROWED_MARK} From the fit's residuals, for want of replicates."
    caption = "Error on traverses that the calibration did not use"
    return Table(caption, columns, tuple(body), stubs=2, note=note)


def _describe_predictions(errors: pd.DataFrame, calibration: Result) -> list[str]:
    if errors.empty:
        return []
    totals = summarize_errors(errors, ["joint"])
    law = [
        f"{format_percent(row.law_rms_relative)} rms for joint {row.joint} "
        f"({format_value(row.law_rms, step_unit(row.joint, calibration.machine))})"
        for row in totals.itertuples()
    ]
    constant = [format_percent(share) for share in totals["constant_rms_relative"]]
    alike = all(isinstance(fit.law, ConstantStep) for fit in calibration.joints.values())
    return [
        "Calibrated in each session, the law predicts the step size of "
        f"{pluralize(len(errors), 'traverse')} that the calibration did not use to {join_words(law)}."
        + ("" if alike else f" A constant step is off by {join_words(constant)} rms.")
    ]


def _describe_coverage(kept: pd.Series[float], misfit: pd.DataFrame, errors: pd.DataFrame) -> list[str]:
    one_sided = [joint for joint in kept.index if _is_one_sided(errors[errors["joint"] == joint])]
    p_values = misfit.groupby("joint")["p_value"]
    surprising = p_values.min() * p_values.size() < MISFIT_ALPHA
    short = [joint for joint in kept.index if surprising.get(joint, False)]
    unsure = [joint for joint, share in kept.items() if np.isnan(share)]
    fine = [joint for joint in kept.index if joint not in {*one_sided, *short, *unsure}]
    sentences = []
    if fine:
        sentences.append(
            f"For {_name_joints(fine)} that is no more than repeatability and the calibration's own "
            "uncertainty explain."
        )
    if short:
        shares = join_words([format_percent(kept[joint]) for joint in short])
        sentences.append(
            f"For {_name_joints(short)} that is more than repeatability and the calibration's own "
            f"uncertainty explain ({shares} of the traverses lie within the interval that should hold "
            "95 %), so the law lacks something or the joint has changed since its calibration."
        )
    if one_sided:
        sentences.append(
            f"The errors of {_name_joints(one_sided)} mostly have one sign: at calibration the step was not "
            "what it was in the rest of the session. See what the law leaves over against the hours in the "
            "session."
        )
    if unsure:
        sentences.append(
            f"Whether that is as good as repeatability allows cannot be said for {_name_joints(unsure)}: too "
            "few replicates within a session. Make each calibration traverse twice."
        )
    return [" ".join(sentences)] if sentences else []


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


def _describe_missing(calibration: Result) -> str:
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
    return " ".join(sentences) or "Every parameter of the laws can be calibrated from this log."


def _list_uncalibrated(calibration: Result) -> list[int]:
    return sorted({flag.joint for flag in calibration.flags if flag.flag == "not_identified"})


def _name_joints(joints: Sequence[int]) -> str:
    return join_words([f"joint {joint}" for joint in joints])
