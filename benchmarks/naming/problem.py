"""What a contender is given, and what it answers; numpy alone, so that every environment can load it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Problem:
    """A log of n traverses, as far as a data analyst sees it.

    Attributes
    ----------
    log : Path
        The log file itself, with ``log.npz`` beside it.
    y : array, shape (n,)
        Logarithm of the steps less the published laws', fitted in each session and direction.
    basis : array, shape (n, p)
        Orthonormal: the laws' derivatives by their parameters, for each session and direction.
    x : array, shape (n, m)
        What each cause would do to y: one column or a few, `basis` taken out, of unit rms.
    cause : array of str, shape (m,)
        Whose column it is.
    candidate : array of int, shape (m,)
        Columns of one number belong together: two phases, or a bend beside a slope.
    groups : array of int, shape (n,)
        Configurations of each session, to hold out together.
    """

    log: Path
    y: Array
    basis: Array
    x: Array
    cause: npt.NDArray[np.str_]
    candidate: Indices
    groups: Indices

    @classmethod
    def load(cls, log: Path) -> Problem:
        """Read what `save` wrote."""
        with np.load(log.with_suffix(".npz")) as file:
            arrays: dict[str, Any] = {name: _wide(file[name]) for name in list(cls.__annotations__)[1:]}
        return cls(log, **arrays)

    def save(self) -> None:
        """Write all arrays beside the log, in single precision."""
        arrays = {name: getattr(self, name) for name in list(self.__annotations__)[1:]}
        narrow = {name: each.astype("f4") if each.dtype == float else each for name, each in arrays.items()}
        np.savez(self.log.with_suffix(".npz"), **narrow)

    @cached_property
    def causes(self) -> list[str]:
        """Every cause once."""
        return list(dict.fromkeys(map(str, self.cause)))

    @cached_property
    def df(self) -> int:
        """Rows less what the baseline has fitted."""
        return len(self.y) - self.basis.shape[1]

    @cached_property
    def noise(self) -> float:
        """Standard deviation of y under the baseline."""
        return float(np.sqrt(self.y @ self.y / self.df))

    def strength(self, departure: Array) -> float:
        """Length of a departure over the noise."""
        return float(np.linalg.norm(departure)) / self.noise


@dataclass(frozen=True)
class Answer:
    """What a contender says of a log.

    Attributes
    ----------
    found : list of (str, float)
        Causes and how loudly each speaks, in order; at least the best guess, even where it would be silent.
    threshold : float
        Those that speak louder than this are its findings by default.
    inclusion : dict of str to float
        Probability of each cause, if it is among the findings.
    departures : array, shape (k, n)
        Predicted change of y with one finding, with two, ...; or one for any number.
    rivals : list of str
        Causes it cannot tell from the first.
    interval : (float, float) or None
        95 % of the first one's rms effect, %.
    quiet : dict of str to float
        Probability of each cause that is not among the findings.
    """

    found: list[tuple[str, float]]
    threshold: float
    inclusion: dict[str, float]
    departures: Array
    rivals: tuple[str, ...] = ()
    interval: tuple[float, float] | None = None
    quiet: dict[str, float] | None = None


Contender = Callable[[Problem], Answer]


def _wide(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return array.astype(float) if array.dtype.kind == "f" else array
