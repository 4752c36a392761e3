"""What traverses yet to be made would say: a session to come is calibrated anew, and only the rest can tell.

Calibrating takes up a share of every effect: with J and g the slopes of calibration and traverse by the
session's own parameters, a traverse shows e - g (J'J)^-1 J' e_calibration of an effect e, whatever the
session's step sizes turn out to be. The parameters of the causes are known from the log, with covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

Array = npt.NDArray[np.float64]

LEANS = 1e-3  # share of a calibrating reading below which a traverse does without it


@dataclass(frozen=True, eq=False)
class Forecast:
    """Traverses under one law in a session to come, after those by which the session is calibrated.

    Attributes
    ----------
    law : object
        With `model` and `predict`, as of a `StepLaw`; it says nothing of causes.
    values : array, shape (p,)
        Its parameters, about as they will be.
    calibration : DataFrame
        k rows, enough to make all p parameters known.
    traverses : DataFrame
        m rows, each a choice.
    follow : array, shape (m, k)
        By how much what is expected of each traverse follows each reading of the calibration.
    variance : array, shape (m,)
        Of one reading of each traverse about what one calibration makes expected.
    wait : array, shape (m,)
        Seconds of the session until the first reading and the calibration are there.
    seconds : array, shape (m,)
        What each further reading takes, and one of each calibrating traverse that it leans on.
    """

    law: Any
    values: Array
    calibration: pd.DataFrame
    traverses: pd.DataFrame
    follow: Array
    variance: Array
    wait: Array
    seconds: Array

    def shown(self, law: Any, sizes: Array) -> Array:
        """What each traverse would show of causes, shape (m,).

        Parameters
        ----------
        law : object
            `self.law` with causes in it.
        sizes : array, shape (q,)
            Of their parameters.
        """
        both = np.concatenate([self.values, sizes])
        ahead, calibration = (
            law.predict(rows, both) - self.law.predict(rows, self.values)
            for rows in (self.traverses, self.calibration)
        )
        return np.asarray(ahead - self.follow @ calibration)

    def uncertainty(self, law: Any, sizes: Array, covariance: Array) -> Array:
        """Variance of `shown` by what the log leaves open of the causes' parameters, shape (m,)."""
        both, own = np.concatenate([self.values, sizes]), len(self.values)
        ahead, calibration = (
            law.model(rows)(np.broadcast_to(both, (len(rows), len(both))))[1][:, own:]
            for rows in (self.traverses, self.calibration)
        )
        slopes = ahead - self.follow @ calibration
        return np.asarray(np.einsum("mi,ij,mj->m", slopes, covariance, slopes))


def forecast(
    law: Any,
    values: Array,
    calibration: pd.DataFrame,
    traverses: pd.DataFrame,
    repeatability: float,
    rounding: Array,
) -> Forecast:
    """Look ahead at a session.

    Parameters
    ----------
    law : object
    values : array, shape (p,)
    calibration, traverses : DataFrame
        k and m rows, with ``session_seconds`` and ``seconds``, when each begins and how long it takes.
    repeatability : float
        Standard deviation of a response.
    rounding : array, shape (m,)
        Variance that rounding adds to each traverse; a calibration's long traverses have next to none.
    """
    known = law.model(calibration)(values)[1]
    slopes = law.model(traverses)(values)[1]
    follow = slopes @ np.linalg.pinv(known)
    variance = repeatability**2 * (1.0 + np.sum(follow**2, axis=1)) + rounding
    leans = np.abs(follow) > LEANS
    seconds = traverses["seconds"].to_numpy(float) + leans @ calibration["seconds"].to_numpy(float)
    wait = np.maximum(traverses["session_seconds"], calibration["session_seconds"].max()).to_numpy(float)
    return Forecast(law, values, calibration, traverses, follow, variance, wait, seconds)
