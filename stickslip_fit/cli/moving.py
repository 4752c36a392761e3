"""Verbs of the law in use: steps for a move, the tip after a drive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from stickslip_fit.cli.arguments import arm_of, drive_of, joint_order, positions, tip_position
from stickslip_fit.cli.options import At, Calibration, Condition, MachinePath, Psi, Session, Theta
from stickslip_fit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stickslip_fit.fit import Result


def steps(
    calibration: Calibration,
    at: At,
    tip: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Where the tip is to go, base frame, mm.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="Q1,Q2,Q3", help="Or where the joints are to go: deg,deg,mm.")
    ] = None,
    order: Annotated[str, typer.Option(help="Which joint moves first.")] = "1,2,3",
    session: Session = None,
    theta: Theta = 0.0,
    psi: Psi = 0.0,
    condition: Condition = None,
    machine: MachinePath = None,
) -> None:
    """Say how many steps take the tip from here to there."""
    from stickslip_fit.machine import nearest_solution
    from stickslip_fit.moves import steps_for_move
    from stickslip_fit.report.text import move_text

    arm = arm_of(calibration, machine, session, theta, psi, condition)
    start = positions(at, "--at")
    if (tip is None) == (joints is None):
        raise InputError("say where to go: either --tip X,Y,Z (mm) or --joints Q1,Q2,Q3 (deg,deg,mm)")
    if tip is not None:
        target = nearest_solution(arm.machine, tip_position(tip, "--tip"), start)
    else:
        target = positions(str(joints), "--joints")
    print(move_text(arm, steps_for_move(arm, start, target, joint_order(order, "--order"))))
    tell_of_conditions(arm.result, arm.conditions)


def where(
    calibration: Calibration,
    at: At,
    drive: Annotated[
        list[str],
        typer.Option(metavar="JOINT±STEPS", help="A drive, e.g. 3+5000 or 2-1200; repeat for a run."),
    ],
    tolerance: Annotated[
        float, typer.Option(help="Say when the tip is no longer known to within this many µm (95 %).")
    ] = 10.0,
    session: Session = None,
    theta: Theta = 0.0,
    psi: Psi = 0.0,
    condition: Condition = None,
    machine: MachinePath = None,
) -> None:
    """Say where the tip is after N steps, and when to re-home."""
    from stickslip_fit.moves import where_after
    from stickslip_fit.report.text import whereabouts_text
    from stickslip_fit.units import to_si

    arm = arm_of(calibration, machine, session, theta, psi, condition)
    found = where_after(arm, positions(at, "--at"), [drive_of(text, "--drive") for text in drive])
    print(whereabouts_text(arm, found, to_si(tolerance, "µm")))
    tell_of_conditions(arm.result, arm.conditions)


def tell_of_conditions(result: Result, conditions: Mapping[str, float]) -> None:
    """Say under which conditions an extended law was taken, where it looks at any."""
    from stickslip_fit.moves.conditions import conditions_text

    if told := conditions_text(result, conditions, "--condition"):
        print("\n" + told)
