"""Now and then the stop is missed or imagined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter


@dataclass(frozen=True)
class EndStopMisfire(Cause):
    """A few counts are off by a lot, up or down; the rest are right."""

    name = "end-stop-misfire"
    phrase = "now and then the end stop is missed or imagined"
    physics = (
        "A noise from elsewhere passes for the stop and ends a traverse early, or the stop's own sound is "
        "missed and the joint goes on stepping against it. Such counts say nothing about step sizes."
    )
    shows_best = "replicates: a misfire does not come back"
    parameters = (
        CauseParameter("share", "%", "of the counts", lower=0.0, upper=1.0),
        CauseParameter("size", "%", "typical departure of such a count", lower=0.0),
    )
    absent = (0.0, 0.0)
    scale = (0.01, 0.05)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: no direction in which counts depart together."""
        return []

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return ()

    def departures(self, number: int, values: Array, rng: np.random.Generator) -> Array:
        """Log steps that misfires add to so many counts, shape (n,)."""
        share, size = values
        hit = rng.uniform(size=number) < share
        spread = rng.uniform(0.7, 1.3, number) * rng.choice([-1.0, 1.0], number)
        return np.where(hit, size * spread, 0.0)
