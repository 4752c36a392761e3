"""One joint on its way in one direction, from wherever it stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.capture.emulator.truth import Truth, counts_over
from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.moves import position_after

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Leg:
    """A traverse as it truly goes, however many steps of it are made.

    Attributes
    ----------
    row : DataFrame
        One row of a log, with its history; stop is the mechanical stop ahead.
    reached : float
        Steps, not necessarily whole, after which the joint is at its stop.
    heard : float
        Steps after which it sounds so: a cause may have the stop heard late, or imagined.
    departure : float
        Log steps by which this traverse takes more than usual.
    """

    truth: Truth
    joint: int
    direction: str
    row: pd.DataFrame
    reached: float
    heard: float
    departure: float

    def position(self, steps: int) -> float:
        """Where the joint stands after so many steps, rad or m.

        Raises
        ------
        InputError
            If it has come to a halt.
        """
        if steps >= self.reached:
            return float(self.row["stop"].iloc[0])
        law, values, factor = self.truth.law_of(self.row)
        lost = 0.0
        if isinstance(law, ExtendedLaw):
            values = law.in_motion(values)
            lost = float(law.added(self.row, values)[0])
        usual = steps * np.exp(-self.departure)
        moved = max(lost + (usual - lost) * factor, 0.0)
        return float(position_after(law, self.row, values, moved)[0])


def leg_of(truth: Truth, row: pd.DataFrame, departure: float, luck: Array) -> Leg:
    """A leg along a row of a log.

    Parameters
    ----------
    truth : Truth
    row : DataFrame
        One row; equal start and stop are a joint that stands at its stop already.
    departure : float
        Log steps by which it takes more than usual.
    luck : array, shape (3,)
        See `simulate.chance.Chance`.

    Raises
    ------
    InputError
        If the joint has no law, or comes to a halt on its way.
    """
    joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
    if row["start"].iloc[0] == row["stop"].iloc[0]:
        return Leg(truth, joint, direction, row, 0.0, 0.0, departure)
    law, values, factor = truth.law_of(row)
    moving, misfire = values, 0.0
    if isinstance(law, ExtendedLaw):
        moving, misfire = law.in_motion(values), float(law.misfires(values, luck[None])[0])
    reached = counts_over(law, row, moving, factor) * np.exp(departure)
    heard = counts_over(law, row, values, factor) * np.exp(departure + misfire)
    return Leg(truth, joint, direction, row, float(reached), float(heard), departure)
