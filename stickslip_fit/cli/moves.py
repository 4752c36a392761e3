"""Commands that use a calibration: predict, plan-move, dead-reckon, accuracy-map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit.cli._files import INPUT, Output
from stickslip_fit.cli._options import (
    ArmSource,
    At,
    Condition,
    LawNames,
    MachinePath,
    Session,
    Sheet,
    check_chart,
    load_fit,
    parse_drive,
    parse_joint_order,
    parse_path,
    parse_plan_conditions,
    parse_positions,
    parse_tip_position,
)
from stickslip_fit.cli._show import Display, save_chart, show
from stickslip_fit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

    from stickslip_fit._summary import Summary
    from stickslip_fit.estimation import Result
    from stickslip_fit.logs.plan import Plan

MapChart = Annotated[
    Path | None, typer.Option("--chart", help="Also draw the map here: .png, .svg or .pdf."), Output()
]


class Direction(StrEnum):
    """Direction of a drive."""

    plus = "+"
    minus = "-"


@dataclass(frozen=True)
class OneDrive:
    """A drive as typed, in place of a file: degrees, or mm of a prismatic joint."""

    joint: Annotated[
        int | None,
        typer.Option(min=1, help="One drive in place of a file: its joint, if several were fitted."),
    ] = None
    start: Annotated[
        float | None, typer.Option("--from", help="Where it begins, deg or mm; at a stop without it.")
    ] = None
    stop: Annotated[
        float | None, typer.Option("--to", help="Where it ends, deg or mm; at a stop without it.")
    ] = None
    direction: Annotated[
        Direction | None, typer.Option(help="Of that drive, where one of its ends is not given.")
    ] = None

    @property
    def given(self) -> bool:
        """Whether there is one."""
        return any(one is not None for one in (self.joint, self.start, self.stop, self.direction))

    def row(self, result: Result, conditions: Mapping[str, float]) -> DataFrame:
        """The drive as `read_drives` returns it."""
        from stickslip_fit.moves.drives import one_drive

        way = None if self.direction is None else self.direction.value
        return one_drive(result, self.joint, way, (self.start, self.stop), conditions)


def predict(
    *,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG|RESULT PLAN|DRIVES",
            parser=parse_path,
            help="A log to fit, or a saved result; then a plan (TOML), or drives: a log without counts.",
        ),
        INPUT,
    ],
    drive: OneDrive,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="CSV to write with every traverse."), Output()
    ] = None,
    session: Session = None,
    condition: Condition = None,
    law: LawNames = None,
    machine: MachinePath = None,
    sheet: Sheet = None,
    display: Display,
) -> None:
    """Predict the counts of a plan's traverses, or of drives of any machine, with 95 % intervals."""
    from stickslip_fit._io import write_atomically
    from stickslip_fit.moves.prediction import predict
    from stickslip_fit.reporting.predictions import predictions_csv, summarize_predictions

    if not drive.given and len(files) < 2:
        raise InputError(
            f"after {files[0]} name a plan (TOML) or a file of drives (CSV), or give one drive by --joint, "
            "--from, --to and --direction"
        )
    calibration, file = (files, None) if drive.given else (files[:-1], files[-1])
    fitted, result = load_fit(calibration, machine, law, sheet)
    if file is not None and file.suffix == ".toml":
        from stickslip_fit.logs.plan_reader import read_plan

        planned: Plan | DataFrame = read_plan(file, result.machine)
        conditions = known = parse_plan_conditions(condition, result)
    else:
        from stickslip_fit.moves.arm import parse_conditions
        from stickslip_fit.moves.drives import read_drives

        conditions = parse_conditions(condition or (), result, "--condition")
        drives = drive.row(result, conditions) if file is None else read_drives(file, fitted, conditions)
        known = {name: 0.0 for name in drives if drives[name].notna().all()}
        planned = drives if session is None else drives.assign(session=drives["session"].replace("", session))
    predicted = predict(fitted, planned, session, conditions)
    if output is not None:
        write_atomically(output, predictions_csv(result, planned, predicted))
    summary = summarize_predictions(result, planned, predicted, "One drive" if file is None else file.name)
    saved = [f"all {len(predicted):,} written to {output}"] if output is not None else []
    show(with_conditions(summary, result, known), display, files, saved)


def plan_move(
    *,
    at: At,
    tip: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Tip position to reach, base frame, mm.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,Q3", help="Or the joint positions to reach: deg,deg,mm.")
    ] = None,
    order: Annotated[str, typer.Option(help="Order in which the joints move.")] = "1,2,3",
    source: ArmSource,
    display: Display,
) -> None:
    """Compute the steps that take the tip to a position, or the joints."""
    from stickslip_fit import moves
    from stickslip_fit.machine import nearest_solution
    from stickslip_fit.reporting.moves import summarize_move

    arm = source.load()
    start = parse_positions(at, "--at")
    if (tip is None) == (joints is None):
        raise InputError("say where to go: either --tip X,Y,Z (mm) or --joints Q1,Q2,Q3 (deg,deg,mm)")
    if tip is not None:
        target = nearest_solution(arm.machine, parse_tip_position(tip, "--tip"), start)
    else:
        target = parse_positions(str(joints), "--joints")
    move = moves.plan_move(arm, start, target, parse_joint_order(order, "--order"))
    summary = with_conditions(summarize_move(arm, move), arm.result, arm.conditions)
    show(summary, display, source.calibration)


def dead_reckon(
    *,
    at: At,
    drive: Annotated[
        list[str], typer.Option(metavar="JOINT±STEPS", help="A drive, e.g. 3+5000 or 2-1200; repeatable.")
    ],
    tolerance: Annotated[
        float, typer.Option(help="Uncertainty of the tip, µm (95 %), at which to re-home.")
    ] = 10.0,
    source: ArmSource,
    display: Display,
) -> None:
    """Compute where the tip is after a run of drives, how accurately, and when to re-home."""
    from stickslip_fit import moves
    from stickslip_fit.reporting.moves import summarize_pose
    from stickslip_fit.units import to_si

    arm = source.load()
    drives = [parse_drive(text, "--drive") for text in drive]
    pose = moves.dead_reckon(arm, parse_positions(at, "--at"), drives)
    summary = with_conditions(summarize_pose(arm, pose, to_si(tolerance, "µm")), arm.result, arm.conditions)
    show(summary, display, source.calibration)


def with_conditions(summary: Summary, result: Result, conditions: Mapping[str, float]) -> Summary:
    """The summary, and at its end the conditions that an extended law was evaluated at, if any."""
    from stickslip_fit._summary import Section
    from stickslip_fit.moves.arm import describe_conditions

    text = describe_conditions(result, conditions, "--condition")
    return replace(summary, sections=(*summary.sections, Section(paragraphs=(text,)))) if text else summary


def accuracy_map(*, source: ArmSource, chart: MapChart = None, display: Display) -> None:
    """Compute how far from its goal a move may end, over the workspace."""
    from stickslip_fit.moves import map_accuracy

    check_chart(chart)
    arm = source.load()
    accuracy = map_accuracy(arm)
    saved = []
    if chart is not None:
        from stickslip_fit.plotting.accuracy import draw_accuracy_map

        saved = save_chart(partial(draw_accuracy_map, accuracy), chart, "accuracy-map", "map")
    summary = with_conditions(accuracy.summary(), arm.result, arm.conditions)
    show(summary, display, source.calibration, saved)
