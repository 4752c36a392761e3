"""Predicted counts of planned traverses and of drives, as text and as CSV."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from stickslip_fit._format import (
    MISSING,
    capitalize_first,
    coordinate_unit,
    format_configuration,
    format_direction,
    format_percent,
    format_position,
    format_significant,
    join_words,
    pluralize,
    position_unit,
)
from stickslip_fit._summary import Section, Summary, Table, numbers, words
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.errors import shorten
from stickslip_fit.estimation import Result
from stickslip_fit.estimation.prediction import has_order
from stickslip_fit.estimation.travel import Stretches, close_gaps, undriven_pieces
from stickslip_fit.logs.history import FURTHER_HISTORY
from stickslip_fit.logs.plan import Plan, build_sheet, format_cells
from stickslip_fit.logs.schema import position_columns

ON_SCREEN = slice(0, 14)  # rows of a long table
MAX_STRETCHES = 3  # that are named
NEW_SESSION = "a session to come"
FULL_TRAVEL = "full travel"
STEP_SIZES = {"step_size_nm": "nm", "step_size_urad": "µrad"}


def summarize_predictions(
    result: Result, planned: Plan | pd.DataFrame, predicted: pd.DataFrame, name: str = "drives"
) -> Summary:
    """The traverses with their counts, where no traverse of the log went, and why some have no interval.

    Parameters
    ----------
    result : Result
        What `predicted` was worked out from.
    planned : Plan or DataFrame
        A plan, or drives as `read_drives` returns them.
    predicted : DataFrame
        As `moves.predict` returns it.
    name : str, optional
        Of drives.
    """
    rows = planned.rows() if isinstance(planned, Plan) else planned
    beyond = (predicted["extrapolated_pct"] > 0).to_numpy()
    cells = tuple(
        (
            shorten(str(row["session"]), 20) or NEW_SESSION,
            f"{row['joint']} {format_direction(row['direction'])}",
            format_configuration(row, result.machine) or FULL_TRAVEL,
            f"{row['steps']:,.0f}",
            f"{row['low']:,.0f} to {row['high']:,.0f}" if pd.notna(row["low"]) else MISSING,
            f"{format_significant(row['step_size'], 4)} {row['unit']}",
            *((_never_driven(row, result),) if beyond.any() else ()),
        )
        for _, row in pd.concat([rows, predicted], axis=1).iterrows()
    )
    heads = (*words("session", "joint", "configuration"), *numbers("steps", "95 % of counts", "step size"))
    columns = (*heads, *words(*["never driven"] * bool(beyond.any())))
    table = Table("Predicted counts", columns, cells, stubs=3, short=ON_SCREEN)
    to_come = True if isinstance(planned, Plan) else bool((rows["session"] == "").any())
    heading = (
        _plan_heading(planned, predicted)
        if isinstance(planned, Plan)
        else _drives_heading(result, name, rows, predicted)
    )
    return Summary(
        planned.name if isinstance(planned, Plan) else name,
        (heading,),
        (Section(tables=(table,)),),
        flags=(
            *_beyond_travel(result, rows[beyond]),
            *_without_interval(result, rows, predicted),
            *(_of_single_sessions(result) if to_come else ()),
            *(() if isinstance(planned, Plan) else _without_history(result, rows)),
            *(() if isinstance(planned, Plan) else _of_other_sessions(result, rows, predicted)),
            *_without_travel(predicted),
        ),
    )


def predictions_csv(result: Result, planned: Plan | pd.DataFrame, predicted: pd.DataFrame) -> str:
    """Every traverse in a log's columns, with steps, low, high, step size and whose calibration it is.

    extrapolated_pct is the share of the traverse where none of the fitted log's went in its direction, and
    never_driven says where that is, in degrees or mm.
    """
    if isinstance(planned, Plan):
        rows, sheet = planned.rows(), build_sheet(planned)
        sheet = sheet.drop(columns=["time", "steps", "step_period_ms", "status", "note"])
    else:
        rows, sheet = planned, _drive_cells(result, planned)
    for name in ("steps", "low", "high"):
        sheet[name] = predicted[name].astype("Int64").to_numpy()
    for name, unit in STEP_SIZES.items():
        shown = zip(predicted["step_size"], predicted["unit"] == unit, strict=True)
        sheet[name] = [f"{value:.6g}" if own else "" for value, own in shown]
    sheet["calibration"] = predicted["calibration"].replace("", NEW_SESSION).to_numpy()
    sheet["extrapolated_pct"] = predicted["extrapolated_pct"].round(1).to_numpy()
    both = pd.concat([rows, predicted], axis=1)
    texts = [_never_driven(row, result) for _, row in both.iterrows()]
    sheet["never_driven"] = [text.replace("°", " deg") for text in texts]
    return sheet.to_csv(index=False, lineterminator="\n")


def _drive_cells(result: Result, drives: pd.DataFrame) -> pd.DataFrame:
    """What is known of each drive, as text in a log's columns."""
    machine, sheet = result.machine, drives[["session", "joint", "direction"]].copy()
    if "time" in drives and drives["time"].notna().all():
        sheet.insert(1, "time", [moment.isoformat() for moment in drives["time"]])
    for name in position_columns(drives) if "theta" in drives else []:
        if drives[name].notna().any():
            unit = coordinate_unit(name, machine)
            sheet[f"{name}_{unit}"] = format_cells(drives[name], unit)
    units = drives["joint"].map({joint: position_unit(joint, machine) for joint in machine.joints})
    for unit in dict.fromkeys(units):
        for name, end in (("from", "start"), ("to", "stop")):
            sheet[f"{name}_{unit}"] = format_cells(drives[end].where(units == unit), unit)
    return sheet.assign(check_every=drives["check_every"])


def _plan_heading(plan: Plan, predicted: pd.DataFrame) -> str:
    sources = [
        f"session {shorten(name, 30)}" if name else NEW_SESSION for name in predicted["calibration"].unique()
    ]
    number = pluralize(len(predicted), "traverse")
    return f"{plan.name}: counts of {number}, as a log has them, by the calibration of {', '.join(sources)}."


def _drives_heading(result: Result, name: str, drives: pd.DataFrame, predicted: pd.DataFrame) -> str:
    text = f"{name}: counts of {pluralize(len(drives), 'traverse')}."
    coming = predicted.loc[drives["session"] == "", "calibration"].unique()
    if not len(coming):
        return text
    sources = [f"the calibration of session {shorten(one, 30)}" for one in coming if one]
    where = "Where no session is named" if (drives["session"] != "").any() else "Since no session is named"
    what = join_words(sources) or "what the sessions have in common"
    several = any(fit.groups["session"].nunique() > 1 for fit in result.joints.values())
    unordered = several and bool(sources) and not has_order(result)
    doubt = ", the last by name: the log has no times" if unordered else ""
    return f"{text} {where}, {NEW_SESSION} is predicted, by {what}{doubt}."


def _never_driven(row: pd.Series, result: Result) -> str:
    """Where the log's traverses never went in this one's direction; empty for nowhere."""
    if not row["extrapolated_pct"] > 0:
        return ""
    joint = int(row["joint"])
    travel = result.joints[joint].travel.get(row["direction"], ())
    pieces = undriven_pieces(row["start"], row["stop"], travel, result.machine.span(joint))
    return join_words([_format_stretch(one, joint, result) for one in pieces])


def _format_stretch(ends: tuple[float, float], joint: int, result: Result) -> str:
    return " to ".join(format_position(end, joint, result.machine) for end in ends)


def _beyond_travel(result: Result, beyond: pd.DataFrame) -> Iterator[str]:
    """The remarks that traverses go where none of the log's went, by joint and direction."""
    for (joint, way), own in beyond.groupby(["joint", "direction"], sort=True, observed=True):
        fit, number = result.joints[int(joint)], len(own)
        seen: Stretches = close_gaps(fit.travel.get(str(way), ()), result.machine.span(int(joint)))
        named = [_format_stretch(one, int(joint), result) for one in seen[:MAX_STRETCHES]]
        more = [pluralize(len(seen) - MAX_STRETCHES, "other place")] * (len(seen) > MAX_STRETCHES)
        covered = f"they cover {join_words([*named, *more])}" if seen else "none went in that direction"
        yield (
            f"{pluralize(number, 'traverse')} of joint {joint} in direction "
            f"{format_direction(str(way))} {'goes' if number == 1 else 'go'} where those of the fitted log "
            f"never went ({covered}). There the law is a guess, and so is the interval"
        )


def _without_interval(result: Result, rows: pd.DataFrame, predicted: pd.DataFrame) -> list[str]:
    """The remarks that say why there are no error bars."""
    bare = {
        (int(j), str(direction))
        for j, direction in rows.loc[predicted["low"].isna(), ["joint", "direction"]].to_numpy()
    }
    messages = [
        capitalize_first(flag.message)
        for flag in result.flags
        if (flag.joint, flag.direction) in bare and flag.flag == "few_replicates"
    ]
    return list(dict.fromkeys(messages))


def _without_history(result: Result, drives: pd.DataFrame) -> list[str]:
    """The remark that the law follows what came before, which drives without times do not say."""
    joints = [
        f"joint {joint}"
        for joint, fit in result.joints.items()
        if (drives["joint"] == joint).any()
        and any(name not in drives for name in fit.law.columns if name in FURTHER_HISTORY)
    ]
    if not joints:
        return []
    return [
        f"The law of {join_words(joints)} follows what was driven before and when, of which the counts have "
        "nothing: the drives have no times. Give each its time"
    ]


def _of_single_sessions(result: Result) -> list[str]:
    """The remark that counts have no part of what the law has for each session."""
    joints = [
        f"joint {joint}"
        for joint, fit in result.joints.items()
        if isinstance(fit.law, ExtendedLaw)
        and any(
            one.session and one.joint in (None, joint) and np.isfinite(one.prior_sd)
            for one in fit.law.cause_parameters
        )
    ]
    if not joints:
        return []
    return [
        f"The law of {join_words(joints)} has a function of each logged session; a session to come has "
        "another one, which the counts leave out and the intervals allow for"
    ]


def _of_other_sessions(result: Result, drives: pd.DataFrame, predicted: pd.DataFrame) -> list[str]:
    """The remark that by other sessions' calibrations counts would be outside the intervals."""
    own = (drives["session"] == "").to_numpy() & (predicted["calibration"] != "").to_numpy()
    coming, rows, expected = result.for_session_to_come(), drives[own], predicted[own]
    ratios = [1.0]
    for joint, fit in result.joints.items():
        for session in fit.groups["session"].unique():
            asked = rows[rows["joint"] == joint].assign(session=session)
            group = fit.group_index(asked)
            asked = asked[(group >= 0) & fit.known.all(axis=1)[group]]
            if asked.empty:
                continue
            steps, interval = coming.si.predict(asked)["steps"], expected.loc[asked.index]
            outside = (steps < interval["low"]) | (steps > interval["high"])
            ratios += (steps / interval["steps"])[outside].tolist()
    if len(ratios) == 1:
        return []
    ends = [f"{format_percent(1.0 - min(ratios))} lower"] * (min(ratios) < 1.0)
    ends += [f"{format_percent(max(ratios) - 1.0)} higher"] * (max(ratios) > 1.0)
    return [
        f"Sessions differ: by the calibrations of others, counts would be up to {join_words(ends, 'or')}; "
        "the interval of a session to come does not allow for that. Log a few of its traverses and fit them "
        "too"
    ]


def _without_travel(predicted: pd.DataFrame) -> list[str]:
    """The remark that it is not known where the fitted log's traverses went."""
    if not predicted["extrapolated_pct"].isna().any():
        return []
    return [
        "This law, saved by an earlier version, does not say where the log's traverses went, so that a drive "
        "beyond them has no warning; save it anew for that"
    ]
