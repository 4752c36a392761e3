"""Designs: which traverses to calibrate from: those of the thesis, random, D-optimal, I-optimal.

Optimal designs are found by adding traverses one at a time and exchanging them while the criterion
improves (V. V. Fedorov, Theory of Optimal Experiments, 1972, Ch. 3). The closed form takes as many
traverses as the law has parameters (thesis Eqs. 6.2 to 6.4); the constant step takes one (Ch. 7).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol
from zlib import crc32

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.bayes.marginal import solve_spd_batched
from stickslip_fit.estimation._optimize import RANK_TOL
from stickslip_fit.estimation.identifiability import describe_configuration
from stickslip_fit.laws import StepLaw, constant_law
from stickslip_fit.strategies.base import (
    CalibrationPlan,
    CalibrationTask,
    NotApplicable,
    PlannedStrategy,
    plan_law,
)

Loss = Callable[[Array], Array]
"""From information matrices, shape (m, p, p), to the criterion to minimize, shape (m,)."""

# Relative difference of losses that counts as none: rows at one configuration have the same loss but for
# rounding, which is another on each processor.
LOSS_TOL = 1e-6


def exchange_rows(jacobian: Array, count: int, loss: Loss, prior: Array) -> IntArray:
    """The design of least loss by greedy addition and exchange, no row twice; positions in ascending order.

    Parameters
    ----------
    jacobian : array, shape (n, p)
        Of each row's response, over its standard deviation.
    count : int
        At most n.
    prior : array, shape (p, p)
        Prior information; positive definite.
    """
    return improve_design(jacobian, add_rows(jacobian, count, loss, prior), loss, prior)


def add_rows(jacobian: Array, count: int, loss: Loss, prior: Array) -> IntArray:
    """The greedy part of `exchange_rows`; positions in the order of addition."""
    single, left = jacobian[:, :, None] * jacobian[:, None, :], np.arange(len(jacobian))
    chosen: list[int] = []
    for _ in range(count):
        best = _first_least(loss(prior + single[chosen].sum(axis=0) + single[left]))
        chosen.append(int(left[best]))
        left = np.delete(left, best)
    return np.array(chosen, dtype=np.intp)


def improve_design(jacobian: Array, begin: IntArray, loss: Loss, prior: Array) -> IntArray:
    """The exchanges of `exchange_rows`, from a design to begin with."""
    single, chosen, rows = jacobian[:, :, None] * jacobian[:, None, :], begin.copy(), np.arange(len(jacobian))
    best = float(loss((prior + single[chosen].sum(axis=0))[None])[0])
    while len(left := np.delete(rows, chosen)):
        information = prior + single[chosen].sum(axis=0)
        exchanged = information - single[chosen][:, None] + single[left][None]
        losses = loss(exchanged.reshape(-1, *information.shape))
        place = _first_least(losses)
        if not losses[place] < best - LOSS_TOL * abs(best):
            break
        best = float(losses[place])
        removed, added = divmod(place, len(left))
        chosen[removed] = left[added]
    return np.sort(chosen)


def _first_least(losses: Array) -> int:
    """Position of the first loss, of shape (m,), that is no greater than the least."""
    least = losses.min()
    return int(np.argmax(losses <= least + LOSS_TOL * abs(least)))


def negative_log_determinant(information: Array) -> Array:
    """D-optimality: the volume of the parameters' confidence region."""
    return -np.linalg.slogdet(information)[1]


def mean_variance_loss(region: Array) -> Loss:
    """I-optimality: the variance of a prediction, averaged over the rows of `region`, shape (m, p)."""
    moment = region.T @ region / len(region)

    def loss(information: Array) -> Array:
        matrix = np.moveaxis(information, 0, -1)
        right = np.broadcast_to(moment[..., None], matrix.shape)
        return np.trace(solve_spd_batched(matrix, right)[0])

    return loss


@dataclass(frozen=True)
class ClosedForm(PlannedStrategy):
    """The thesis's configurations: in each direction three traverses of joint 3, four of a rotary joint.

    With so many traverses, least squares gives the solution of the closed form.
    """

    name: ClassVar[str] = "closed form"

    def choose(self, task: CalibrationTask) -> IntArray:
        return pick_calibration_traverses(task, task.law)

    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        return plan_law(task.law, task, measured)


@dataclass(frozen=True)
class ConstantStepStrategy(PlannedStrategy):
    """One step size everywhere (thesis Ch. 7), from a traverse in the law's first configuration."""

    name: ClassVar[str] = "constant step"

    def choose(self, task: CalibrationTask) -> IntArray:
        return pick_calibration_traverses(task, constant_law(task.law))

    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        return plan_law(constant_law(task.law), task, measured)


def pick_calibration_traverses(task: CalibrationTask, law: StepLaw) -> IntArray:
    """Positions among the offered traverses of a law's own calibration, one for each parameter.

    A constant step is measured in the first calibration configuration of the law that it is compared with.

    Raises
    ------
    NotApplicable
        If the session lacks one, naming it.
    """
    required = task.law.calibration()[: len(law.parameters)]
    picked = task.calibration_traverses[: len(law.parameters)]
    if np.all(picked >= 0):
        return picked
    if not required:
        names = join_words([parameter.name for parameter in law.parameters])
        raise NotApplicable(f"the session's traverses do not determine {names}")
    missing = [describe_configuration(required[k]) for k in np.flatnonzero(picked < 0)]
    raise NotApplicable(f"the session lacks {'; '.join(missing)}")


PRIOR_INFORMATION = 1e-9  # of a traverse's information
MAX_DRAWS = 100


class Design(Protocol):
    """An experimental design: which traverses to measure."""

    @property
    def name(self) -> str:
        """Qualifies the traverses, such as "random"."""
        ...

    def pick(self, task: CalibrationTask, count: int, spread: float | None = None) -> IntArray:
        """Positions of `count` of the offered traverses.

        Parameters
        ----------
        spread : float, optional
            Prior standard deviation of the parameters, in units of their scales; by default infinite.

        Raises
        ------
        NotApplicable
            If fewer are offered.
        """
        ...


@dataclass(frozen=True)
class Thesis(Design):
    """The thesis's calibration, then the session's next traverses."""

    name: ClassVar[str] = "thesis"

    def pick(self, task: CalibrationTask, count: int, spread: float | None = None) -> IntArray:
        _check_count(task, count)
        first = pick_calibration_traverses(task, task.law)
        others = np.setdiff1d(np.arange(len(task.offered)), first)
        return np.concatenate([first, others])[:count]


@dataclass(frozen=True)
class AtRandom(Design):
    """Random ones that determine the parameters; the same for the same seed, session and direction.

    Least squares may still have two solutions and find the wrong one: with the base level throughout, b and
    c / a of joint 3 are exchangeable.
    """

    seed: int = 0
    name: ClassVar[str] = "random"

    def pick(self, task: CalibrationTask, count: int, spread: float | None = None) -> IntArray:
        _check_count(task, count)
        where = f"{task.session} {task.law.joint} {task.direction}"
        rng, slopes = np.random.default_rng([self.seed, crc32(where.encode())]), _scaled_jacobian(task)
        for _ in range(MAX_DRAWS):
            drawn = np.sort(rng.choice(len(task.offered), count, replace=False))
            if np.linalg.matrix_rank(slopes[drawn], rtol=RANK_TOL) == slopes.shape[1]:
                return drawn
        raise NotApplicable(f"no {count} of its configurations were drawn that determine all parameters")


@dataclass(frozen=True)
class DOptimal(Design):
    """Those of least generalized variance of the parameters."""

    name: ClassVar[str] = "D-optimal"

    def pick(self, task: CalibrationTask, count: int, spread: float | None = None) -> IntArray:
        return _pick_optimal(task, count, spread, lambda region: negative_log_determinant)


@dataclass(frozen=True)
class IOptimal(Design):
    """Those of least mean variance of predictions over the session's configurations."""

    name: ClassVar[str] = "I-optimal"

    def pick(self, task: CalibrationTask, count: int, spread: float | None = None) -> IntArray:
        return _pick_optimal(task, count, spread, mean_variance_loss)


def _pick_optimal(
    task: CalibrationTask, count: int, spread: float | None, criterion: Callable[[Array], Loss]
) -> IntArray:
    _check_count(task, count)
    slopes = _scaled_jacobian(task)
    prior = PRIOR_INFORMATION if spread is None else (task.repeatability / spread) ** 2
    return exchange_rows(slopes, count, criterion(slopes), prior * np.eye(slopes.shape[1]))


def _scaled_jacobian(task: CalibrationTask) -> Array:
    if not np.all(np.isfinite(task.scaled_jacobian)):
        raise NotApplicable("the joint would stall in a traverse that is offered")
    return task.scaled_jacobian


def _check_count(task: CalibrationTask, count: int) -> None:
    if count > len(task.offered):
        raise NotApplicable(
            f"configurations to calibrate from: {count}; the session has {len(task.offered)} of them to offer"
        )
