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
    of_stop = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: no direction in which counts depart together."""
        return []

    def departures(self, values: Array, luck: Array) -> Array:
        """Log steps that misfires add to counts, shape (n,).

        Parameters
        ----------
        values : array, shape (n, 2)
        luck : array, shape (n, 3)
            Uniform between 0 and 1: whether there is one, how large it is, and which way.
        """
        hit, spread, way = luck.T
        size = values[:, 1] * (0.7 + 0.6 * spread) * np.where(way < 0.5, -1.0, 1.0)
        return np.where(hit < values[:, 0], size, 0.0)
