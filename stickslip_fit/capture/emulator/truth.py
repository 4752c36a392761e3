"""What the emulator hides: laws, noise, and how one day differs from another."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.laws import StepLaw
from stickslip_fit.logs.plan import Noise
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import LawValues, expected_counts

Array = npt.NDArray[np.float64]
EXACT = Noise({})


@dataclass(frozen=True, eq=False)
class Truth:
    """How the emulated joints truly step.

    Attributes
    ----------
    laws : LawValues
        Laws may have causes in them.
    machine : Machine
        Its ranges end at the mechanical stops.
    noise : Noise
        How well traverses repeat; a joint and direction that it doesn't name repeat exactly.
    seed : int
        Settles how days differ, and all that is left to chance.
    """

    laws: LawValues
    machine: Machine
    noise: Noise = EXACT
    seed: int = 0

    def law_of(self, row: pd.DataFrame) -> tuple[StepLaw, Array, float]:
        """Law, parameters, shape (1, p), and the day's factor of the step size, for one row of a log.

        Raises
        ------
        InputError
            If there is no law for the joint and direction.
        """
        joint, direction = int(row["joint"].iloc[0]), str(row["direction"].iloc[0])
        values, shared = self.laws.of_rows(row, joint)
        factor = self._day(str(row["session"].iloc[0]), joint, direction) if shared[0] else 1.0
        return self.laws.laws[joint], values, factor

    def _day(self, session: str, joint: int, direction: str) -> float:
        """The same whenever a session is taken up again."""
        spread = self.laws.day_to_day.get((joint, direction), 0.0)
        stream = [self.seed, zlib.crc32(f"{session}/{joint}{direction}".encode())]
        return 1.0 + spread * float(np.random.default_rng(stream).standard_normal())


def counts_over(law: StepLaw, row: pd.DataFrame, values: Array, factor: float) -> float:
    """Steps from a row's start to its stop without noise, as `simulate` has them.

    Raises
    ------
    InputError
        If the joint comes to a halt on its way.
    """
    added = float(law.added(row, values)[0]) if isinstance(law, ExtendedLaw) else 0.0
    return (float(expected_counts(law, row, values)[0]) - added) / factor + added
