"""What every cause of a fall that is not free has, and what `diagnose` asks of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import CauseParameter
from tests.balls.fall import Fall, Rows

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FallCause:
    """Does nothing; a cause overrides the one station at which it acts.

    Attributes
    ----------
    name, phrase : str
    parameters : tuple of CauseParameter
    scale : tuple of float
        A size of each that matters.
    tried : tuple of float
        A size to look for.
    max_trial_factor : float
        How many times that is still plausible.
    combine_trials : bool
        Whether trials act in any combination.
    moves : bool
        Whether it changes how the ball moves.
    session : str
        The drop to which it is confined; none.
    """

    name: ClassVar[str]
    phrase: ClassVar[str]
    parameters: ClassVar[tuple[CauseParameter, ...]]
    scale: ClassVar[tuple[float, ...]]
    tried: ClassVar[tuple[float, ...]]
    max_trial_factor: ClassVar[float] = 10.0
    combine_trials: ClassVar[bool] = False
    moves: ClassVar[bool] = False
    session: ClassVar[str] = ""

    @property
    def null_values(self) -> tuple[float, ...]:
        return (0.0,) * len(self.parameters)

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return None

    def trials(self, rows: pd.DataFrame) -> list[tuple[FallCause, Array]]:
        return [(self, np.array([self.tried]))]

    def largest_plausible(self) -> tuple[Array, ...]:
        return ()

    def extend(self, law: Fall) -> Fall:
        return Fall((*law.causes, self))

    def changes(self, law: Fall, rows: Rows, values: Array, trials: Array) -> Array:
        """Change of every height that each trial makes, shape (m, q) -> (n, m)."""
        extended, n = self.extend(law), len(values)
        both = [np.concatenate([values, np.tile(trial, (n, 1))], axis=1) for trial in trials]
        return (
            np.stack([extended.predict(rows, each) for each in both], 1) - law.predict(rows, values)[:, None]
        )

    def clock(self, seconds: Array, sizes: Array) -> Array:
        """What a right clock would have shown, shape (n,); `sizes` has shape (q, n)."""
        return seconds

    def acceleration(self, velocity: Array, rows: Rows, sizes: Array) -> Array:
        """Beside that of gravity, upwards, m/s^2."""
        return np.zeros_like(velocity)

    def seen(self, height: Array, rows: Rows, sizes: Array) -> Array:
        """The height that the camera gives a ball."""
        return height
