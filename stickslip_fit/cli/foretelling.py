"""What counts should be while they are captured: by a law file, or a saved result."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from pathlib import Path

import pandas as pd

from stickslip_fit.capture.expected import Predictor
from stickslip_fit.errors import InputError, Problem
from stickslip_fit.fit import Result, load_result
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import LawValues, expected_counts, read_law_values


@dataclass(frozen=True)
class ByLaw:
    """Predicts by known laws; a joint and direction without one has no prediction."""

    laws: LawValues

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """See `Predictor.predict`; how sure it is, is not known."""
        found = pd.DataFrame({"steps": nan, "low": nan, "high": nan}, index=rows.index)
        for (joint, direction), mine in rows.groupby(["joint", "direction"]):
            if (int(str(joint)), str(direction), None) in self.laws.values:
                values, _ = self.laws.of_rows(mine, int(str(joint)))
                found.loc[mine.index, "steps"] = expected_counts(
                    self.laws.laws[int(str(joint))], mine, values
                )
        return found


@dataclass(frozen=True)
class ByResult:
    """Predicts by each joint and direction's latest calibration; without one, there is no prediction."""

    result: Result

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """See `Predictor.predict`."""
        found = pd.DataFrame({"steps": nan, "low": nan, "high": nan}, index=rows.index)
        for (joint, direction), mine in rows.groupby(["joint", "direction"]):
            session = self._latest(int(str(joint)), str(direction))
            if session is not None:
                found.loc[mine.index] = self.result.predict(mine.assign(session=session))[found.columns]
        return found

    def _latest(self, joint: int, direction: str) -> str | None:
        fit = self.result.joints.get(joint)
        if fit is None:
            return None
        known = (fit.groups["direction"] == direction).to_numpy() & fit.known.all(axis=1)
        return str(fit.groups["session"][known].iloc[-1]) if known.any() else None


def predictor_of(path: Path, machine: Machine) -> Predictor:
    """Predict by a law file (TOML) or a result saved with ``fit --json``.

    Raises
    ------
    InputError
        If the file is faulty, or the result belongs to another machine.
    """
    if path.suffix != ".json":
        return ByLaw(read_law_values(path, machine))
    result = load_result(path)
    if result.machine.sha256 != machine.sha256:
        message = f"was fitted for the machine {result.machine.name!r}; pass that with --machine"
        raise InputError(Problem(message, str(path)))
    return ByResult(result)
