"""All figures of the report, in the order of the page."""

from __future__ import annotations

import pandas as pd

from stickslip_fit._format import joint_name
from stickslip_fit.fit import Result
from stickslip_fit.logs import Log
from stickslip_fit.report import accuracy
from stickslip_fit.report.figures.configurations import configurations_picture
from stickslip_fit.report.figures.control import control_picture
from stickslip_fit.report.figures.departures import departures_picture
from stickslip_fit.report.figures.errors import errors_picture
from stickslip_fit.report.figures.load_coefficient import load_coefficient_picture
from stickslip_fit.report.figures.picture import Picture
from stickslip_fit.report.figures.prismatic import prismatic_pictures
from stickslip_fit.report.figures.rotary import rotary_pictures
from stickslip_fit.report.figures.traverses import traverses_of


def accuracy_pictures(log: Log, calibration: Result, fit: Result, errors: pd.DataFrame) -> list[Picture]:
    """Errors of the two models over all traverses, and where the law is worst."""
    joints = sorted(errors["joint"].unique())
    worst = [
        configurations_picture(accuracy.configurations_of(errors, joint), log.machine.span(joint))
        for joint in joints
    ]
    return [errors_picture(errors, calibration, fit), *worst]


def joint_pictures(
    joint: int, log: Log, calibration: Result, fit: Result, coefficients: pd.DataFrame
) -> list[Picture]:
    """One joint's sweeps, what the law leaves over, and its parameters."""
    rows = traverses_of(joint, log, calibration, fit)
    sweeps = prismatic_pictures(rows, fit) if joint == 3 else rotary_pictures(rows, fit)
    d = [load_coefficient_picture(coefficients, fit)] if joint == 2 else []
    return [departures_picture(rows), *sweeps, *d, control_picture(joint, fit)]


def gallery(
    log: Log, calibration: Result, fit: Result, errors: pd.DataFrame, coefficients: pd.DataFrame
) -> list[tuple[str, list[Picture]]]:
    """Headed groups of figures."""
    groups = [("Accuracy", accuracy_pictures(log, calibration, fit, errors))]
    for joint in fit.joints:
        pictures = joint_pictures(joint, log, calibration, fit, coefficients)
        groups.append((joint_name(joint).capitalize(), pictures))
    return groups
