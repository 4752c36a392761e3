"""Which traverses to calibrate from: the thesis's, any at random, or the best for the law at hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol
from zlib import crc32

import numpy as np
import numpy.typing as npt

from stickslip_fit.fit.levenberg_marquardt import RANK_TOL
from stickslip_fit.strategies.closed_form import calibration_traverses
from stickslip_fit.strategies.exchange import Loss, determinant, exchange, mean_variance
from stickslip_fit.strategies.task import Task, Unsuited

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NOTHING = 1e-9  # share of a traverse's information: what is known before the first
DRAWS = 100


class Design(Protocol):
    """A way to choose traverses."""

    @property
    def name(self) -> str:
        """An adverb: how they are chosen."""
        ...

    def pick(self, task: Task, count: int, spread: float | None = None) -> Indices:
        """Positions of `count` of the offered traverses.

        Parameters
        ----------
        task : Task
        count : int
        spread : float, optional
            How far the parameters are known before the first traverse, in units of their scales; by default
            nothing is known of them.

        Raises
        ------
        Unsuited
            If fewer are offered.
        """
        ...


@dataclass(frozen=True)
class Thesis:
    """The thesis's calibration, then what the lab drove next."""

    name: ClassVar[str] = "thesis"

    def pick(self, task: Task, count: int, spread: float | None = None) -> Indices:
        """See `Design.pick`."""
        _check(task, count)
        first = calibration_traverses(task, task.law)
        rest = np.setdiff1d(np.arange(len(task.offered)), first)
        return np.concatenate([first, rest])[:count]


@dataclass(frozen=True)
class AtRandom:
    """Any that determine the parameters; the same for the same seed, session and direction.

    It may still leave two solutions, of which least squares may take the wrong one: with the base level
    throughout, b and c / a of joint 3 can change places.
    """

    seed: int = 0
    name: ClassVar[str] = "random"

    def pick(self, task: Task, count: int, spread: float | None = None) -> Indices:
        """See `Design.pick`."""
        _check(task, count)
        where = f"{task.session} {task.law.joint} {task.direction}"
        rng, slopes = np.random.default_rng([self.seed, crc32(where.encode())]), _slopes(task)
        for _ in range(DRAWS):
            drawn = np.sort(rng.choice(len(task.offered), count, replace=False))
            if np.linalg.matrix_rank(slopes[drawn], rtol=RANK_TOL) == slopes.shape[1]:
                return drawn
        raise Unsuited(f"no {count} of its configurations were drawn that determine all parameters")


@dataclass(frozen=True)
class DOptimal:
    """Those that pin the parameters down best, all taken together."""

    name: ClassVar[str] = "D-optimal"

    def pick(self, task: Task, count: int, spread: float | None = None) -> Indices:
        """See `Design.pick`."""
        return _optimal(task, count, spread, lambda region: determinant)


@dataclass(frozen=True)
class IOptimal:
    """Those that predict the session's configurations best, on average."""

    name: ClassVar[str] = "I-optimal"

    def pick(self, task: Task, count: int, spread: float | None = None) -> Indices:
        """See `Design.pick`."""
        return _optimal(task, count, spread, mean_variance)


def _optimal(task: Task, count: int, spread: float | None, criterion: Callable[[Array], Loss]) -> Indices:
    _check(task, count)
    slopes = _slopes(task)
    known = NOTHING if spread is None else (task.repeatability / spread) ** 2
    return exchange(slopes, count, criterion(slopes), known * np.eye(slopes.shape[1]))


def _slopes(task: Task) -> Array:
    """Change of each offered traverse's response with each parameter in units of its scale, shape (n, p)."""
    values, scales = task.nominal
    jacobian = task.law.jacobian(task.offered, np.broadcast_to(values, (len(task.offered), len(values))))
    if not np.all(np.isfinite(jacobian)):
        raise Unsuited("the joint would stall in a traverse that is offered")
    return jacobian * scales


def _check(task: Task, count: int) -> None:
    if count > len(task.offered):
        raise Unsuited(
            f"configurations to calibrate from: {count}; the session has {len(task.offered)} of them to offer"
        )
