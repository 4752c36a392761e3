"""What is believed of causes' parameters, one number each for the campaign, before the counts are seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtr, ndtri

from stickslip_fit._format import format_value
from stickslip_fit.causes import Cause, ExtendedLaw

Array = npt.NDArray[np.float64]

FARTHEST = 4.0  # standard deviations of the prior; beyond, a bound is as good as reached


@dataclass(frozen=True, eq=False)
class CausePriors:
    """The prior of q parameters of causes.

    A parameter between two bounds is even between them, in its logarithm where both are above 0; any other is
    normal, as far as its bound lets it. A width of 0 holds a parameter at its centre.

    Attributes
    ----------
    names, units : tuple of str
    centre, width, lower, upper : array, shape (q,)
        SI.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    centre: Array
    width: Array
    lower: Array
    upper: Array

    def values(self, eta: Array) -> Array:
        """Parameters at points that are standard normal under the prior, (..., q) -> (..., q).

        Examples
        --------
        >>> numbers = np.array([[0.0, 0.0], [0.1, 1.0], [-np.inf, 60.0], [np.inf, 6000.0]])
        >>> priors = CausePriors(("A", "tau"), ("%", "min"), *numbers)
        >>> priors.values(np.array([1.0, 0.0])).tolist()
        [0.1, 600.0]
        """
        columns = [self._value(j, eta[..., j]) for j in range(len(self.names))]
        return np.stack(columns, axis=-1) if columns else np.zeros(eta.shape)

    def at(self, values: Array) -> Array:
        """Points at which parameters have these values, (..., q) -> (..., q); none beyond the plausible."""
        places = [self._place(j, values[..., j]) for j in range(len(self.names))]
        return np.clip(np.stack(places, axis=-1), -FARTHEST, FARTHEST) if places else np.zeros(values.shape)

    def draw(self, size: int, rng: np.random.Generator) -> Array:
        """Parameters from the prior, shape (size, q)."""
        return self.values(rng.standard_normal((size, len(self.names))))

    @property
    def free(self) -> npt.NDArray[np.bool_]:
        """Which parameters are not held, shape (q,)."""
        return self.width > 0

    def lines(self) -> list[list[str]]:
        """Name, and range of 95 %, of each parameter, as people read it."""
        low, high = (self.values(np.full(len(self.names), sign * 1.96)) for sign in (-1, 1))
        told = []
        for j, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            if self.free[j]:
                told.append([name, f"{format_value(low[j], unit, 3)} to {format_value(high[j], unit, 3)}"])
            else:
                told.append([name, f"held at {format_value(self.centre[j], unit, 3)}"])
        return told

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types that `from_json` reads; no bound is null."""
        content = asdict(self)
        for name in ("centre", "width", "lower", "upper"):
            content[name] = [float(value) if np.isfinite(value) else None for value in content[name]]
        return content

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> CausePriors:
        """The priors that `to_json` wrote."""
        nothing = {"lower": -np.inf, "upper": np.inf}
        numbers = {
            name: np.array([nothing.get(name) if value is None else value for value in content[name]], float)
            for name in ("centre", "width", "lower", "upper")
        }
        return cls(tuple(content["names"]), tuple(content["units"]), **numbers)

    def _value(self, j: int, eta: Array) -> Array:
        centre, width, low, high = self.centre[j], self.width[j], self.lower[j], self.upper[j]
        if not width or not np.isfinite([low, high]).any():
            return centre + width * eta
        if np.isfinite([low, high]).all():
            even = ndtr(eta)
            return low * (high / low) ** even if low > 0 else low + (high - low) * even
        below, above = ndtr((low - centre) / width), ndtr((high - centre) / width)
        return centre + width * ndtri(below + (above - below) * ndtr(eta))

    def _place(self, j: int, value: Array) -> Array:
        centre, width, low, high = self.centre[j], self.width[j], self.lower[j], self.upper[j]
        if not width:
            return np.zeros_like(value)
        if not np.isfinite([low, high]).any():
            return (value - centre) / width
        if np.isfinite([low, high]).all():
            share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
            return np.asarray(ndtri(np.clip(share, 0.0, 1.0)))
        below, above = ndtr((low - centre) / width), ndtr((high - centre) / width)
        share = (ndtr((value - centre) / width) - below) / (above - below)
        return np.asarray(ndtri(np.clip(share, 0.0, 1.0)))


def weak_cause_priors(law: ExtendedLaw, chosen: Array, rows: pd.DataFrame) -> CausePriors:
    """Priors as wide as the largest plausible sizes of a law's causes.

    Parameters
    ----------
    law : ExtendedLaw
    chosen : array, shape (q,)
        Where parameters that are chosen among trials, such as a moment, are held.
    rows : DataFrame
        Of the log.
    """
    width = np.concatenate([_width(cause, rows) for cause in law.causes])
    sudden = np.array([each.sudden for each in law.common])
    return CausePriors(
        names=tuple(each.name for each in law.common),
        units=tuple(each.unit for each in law.common),
        centre=np.where(sudden, chosen, law.absent),
        width=np.where(sudden, 0.0, width),
        lower=np.array([each.lower for each in law.common]),
        upper=np.array([each.upper for each in law.common]),
    )


def _width(cause: Cause, rows: pd.DataFrame) -> Array:
    """How far each parameter may plausibly be from no effect, shape (q,)."""
    absent = np.array(cause.absent, dtype=float)
    sizes: Sequence[Array] = cause.largest()
    if not sizes:
        trials = np.concatenate([values for version, values in cause.trials(rows) if version == cause])
        most = np.where(np.arange(len(absent)) == 0, cause.most, 1.0)
        sizes = list(absent + most * (trials - absent))
    return np.maximum(np.max(np.abs(np.array(sizes) - absent), axis=0), cause.scale)
