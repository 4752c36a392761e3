"""Traverses of the manipulator that a lab could make next: where, which way, and when.

A session to come begins with the law's calibration, each configuration both ways; what is worth making
comes after it, or before. The history of every such traverse is what it would be.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.diagnose.experiments.forecast import Forecast, forecast
from stickslip_fit.diagnose.experiments.moments_ahead import before_calibration, moments_ahead
from stickslip_fit.diagnose.experiments.places_ahead import places_ahead
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.fit.identifiability import configuration_rows
from stickslip_fit.laws.count import rounding_variance
from stickslip_fit.logs.columns import CONDITIONS, COVARIATE
from stickslip_fit.machine import Machine
from stickslip_fit.machine.load import mean_load

Array = npt.NDArray[np.float64]

TO_COME = ""  # no session of a log has this name
PAUSE = 120.0  # s, to set the next configuration
PERIOD = 0.010  # s a step, where the log does not say
LATER = 3600.0  # s, when a session is calibrated that begins with something else
SLOWEST = 0.3  # of the usual step size; what is nearer to a stall is left out


def ahead(bench: Bench, machine: Machine) -> list[Forecast]:
    """What could be made next by each joint of a log, in each direction.

    Parameters
    ----------
    bench : Bench
    machine : Machine

    Returns
    -------
    list of Forecast
        The traverses carry ``note`` (when to make them) and ``seconds`` (what one takes).
    """
    found = []
    for part in bench.parts:
        rows = bench.rows.iloc[part.rows]
        for direction in sorted(rows["direction"].astype(str).unique()):
            mine = np.flatnonzero((rows["direction"] == direction).to_numpy())
            values = part.values[mine[-1]]
            repeatability = float(bench.repeatability[bench.drive[part.rows[mine[-1]]]])
            session = _Session(part.law, values, _usual(bench.rows, part.law.joint), machine)
            found += session.forecasts(direction, bench.rows, repeatability)
    return found


class _Session:
    """A session to come in which one joint is looked at.

    Parameters
    ----------
    law : StepLaw
    values : array, shape (p,)
        About what its parameters will be.
    usual : dict
        Conditions, steps of the joint so far, and how often the stop is looked for.
    machine : Machine
    """

    def __init__(self, law: Any, values: Array, usual: dict[str, Any], machine: Machine) -> None:
        self.law = law
        self.values = values
        self.usual = usual
        self.machine = machine

    def forecasts(self, direction: str, log: pd.DataFrame, repeatability: float) -> list[Forecast]:
        """Traverses after the session's calibration, and those before it."""
        places = self.finished(places_ahead(self.law, direction, self.machine))
        calibration = self.calibration(0.0)
        after = self.after(calibration, places)
        known = self.finished(
            configuration_rows(self.law.calibration(), self.law.joint, direction, self.machine)
        )
        # Steps that are lost or added, however many, are a larger share of a short stretch.
        short = places.loc[[np.abs(places["stop"] - places["start"]).idxmin()]]
        few = self.after(calibration, pd.concat([known, short], ignore_index=True))
        late = self.calibration(LATER)
        pairs = (
            (calibration, pd.concat([after, moments_ahead(few, places, log)], ignore_index=True)),
            (late, before_calibration(known)),
        )
        return [
            forecast(
                self.law, self.values, begun[begun["direction"] == direction].reset_index(drop=True),
                traverses, repeatability, rounding_variance(traverses["steps"], traverses["check_every"]),
            )
            for begun, traverses in pairs
        ]  # fmt: skip

    def finished(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows with all that a log has of a traverse but history; those near a stall are left out."""
        rows = rows.assign(session=TO_COME, **self.usual)
        with np.errstate(invalid="ignore"):
            steps = np.exp(self.law.predict(rows, self.values))
        pace = np.abs(rows["stop"] - rows["start"]).to_numpy(float) / steps
        usual = np.abs(self.values[0])
        moves = np.isfinite(pace) & (pace > SLOWEST * usual)
        load = mean_load(
            self.law.joint,
            *(rows[name].to_numpy(float) for name in ("start", "stop", "q1", "q2", "theta", "psi")),
        )
        period = rows["step_period"].fillna(PERIOD)
        rows = rows.assign(steps=steps, load=load, seconds=steps * period + PAUSE)
        return rows[moves].reset_index(drop=True)

    def calibration(self, begins: float) -> pd.DataFrame:
        """The law's calibration, each configuration both ways, from a moment of the session on."""
        ways = [configuration_rows(self.law.calibration(), self.law.joint, way, self.machine) for way in "+-"]
        rows = self.finished(pd.concat(ways).sort_index(kind="stable"))
        driven, passed = rows["steps"].cumsum() - rows["steps"], rows["seconds"].cumsum() - rows["seconds"]
        return rows.assign(
            session_seconds=begins + passed,
            steps_before=rows["steps_before"] + driven,
            before_direction=rows["direction"].shift(fill_value=""),
            before_load=rows["load"].shift(fill_value=0.0),
        )

    def after(self, calibration: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows as they are right after the calibration, each configuration being driven both ways."""
        return rows.assign(
            session_seconds=calibration["session_seconds"].iloc[-1] + calibration["seconds"].iloc[-1],
            steps_before=calibration["steps_before"].iloc[-1] + calibration["steps"].iloc[-1],
            before_direction=np.where(rows["direction"] == "+", "-", "+"),
            before_load=rows["load"],
            note="once the session is calibrated",
        )


def _usual(log: pd.DataFrame, joint: int) -> dict[str, Any]:
    """Conditions as in the log's middle, and the steps that a joint has made by its end."""
    mine = log[log["joint"] == joint]
    columns = [*CONDITIONS, *(name for name in log.columns if name.startswith(COVARIATE))]
    middle = {
        name: float(values.median()) if (values := log[name]).notna().any() else np.nan for name in columns
    }
    driven = float((mine["steps_before"] + mine["steps"]).max())
    return {**middle, "steps_before": driven, "check_every": int(mine["check_every"].median())}
