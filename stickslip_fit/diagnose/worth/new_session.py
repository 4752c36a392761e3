"""What a user has in a new session: its calibration traverses for the laws, causes known from before."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.worth.folds import Split
from stickslip_fit.fit.closed_form import pick_calibration
from stickslip_fit.fit.groups import group_rows
from stickslip_fit.machine import Machine

Indices = npt.NDArray[np.intp]

FEWEST = 3  # sessions
MOST = 5  # times that sessions are held out; of more sessions several are held out together


def new_sessions(bench: Bench, machine: Machine) -> list[Split]:
    """Hold out whole sessions but for their calibration; only what that calibrates is predicted.

    Returns
    -------
    list of Split
        Empty where the log has too few sessions, or none was calibrated as the laws ask for.
    """
    session, labels = pd.factorize(bench.rows["session"].astype(object))
    if len(labels) < FEWEST:
        return []
    calibrating, calibrated = _calibration(bench, machine)
    splits = []
    for sessions in np.array_split(np.arange(len(labels)), min(len(labels), MOST)):
        new = np.isin(session, sessions)
        held = np.flatnonzero(new & calibrated & ~calibrating)
        if len(held):
            splits.append(Split(np.flatnonzero(~new), np.flatnonzero(new & calibrating), held))
    return splits


def _calibration(bench: Bench, machine: Machine) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Which rows are calibration traverses, and which are of a session and direction that has them all."""
    calibrating, calibrated = np.zeros(len(bench), dtype=bool), np.zeros(len(bench), dtype=bool)
    for part in bench.parts:
        rows = bench.rows.iloc[part.rows]
        groups = group_rows(rows)
        picked = pick_calibration(part.law, rows, groups, machine)
        complete = np.all(picked >= 0, axis=1)
        calibrating[part.rows[picked[complete].ravel()]] = True
        calibrated[part.rows] = complete[groups.of_row]
    return calibrating, calibrated
