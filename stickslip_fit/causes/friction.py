"""Causes that change the stage, as they act under a physical law.

The published laws do not know friction, so that such a cause multiplies the step size. Under a physical law
(`laws.physical`) it multiplies a_f T1^2, r and lambda, to the powers of `POWERS`, and the step follows. Far
from lambda = 1 this is, to first order in r^2:

====================  =========================  ==========================
times f               friction-limited           velocity-limited
====================  =========================  ==========================
friction              the step f, the load 1/f   the load 1/f^2
voltage               nothing                    the step f, the load f
ramp time             the step f^2               the load 1/f^2
====================  =========================  ==========================

Where a log leaves lambda open, a cause is tried with lambda as the law has it and well within either regime.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.kinds import FactorCause, StateCause
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.laws.integration import DriveChange
from stickslip_fit.laws.physical import POWERS, Physical

STEP, FRICTION, VOLTAGE, RAMP_TIME = "step", *POWERS
Assumed = tuple[tuple[int, float, float], ...]
"""By joint lambda in `+` and in `-`; that of the law for joints that it lacks."""
_OWN = (
    *("name", "phrase", "physics", "shows_best", "joints", "kind", "session", "columns", "parameters"),
    *("null_values", "scale", "max_panel", "varies_along_traverse", "affects_stop_only"),
)


class StageEffect(StateCause):
    """A cause whose factor multiplies a quantity of the stage instead of the step.

    Parameters
    ----------
    ratios : tuple of float
        lambda before the change, in `+` and in `-`.
    quantity : {"friction", "voltage", "ramp time"}
    """

    def __init__(self, cause: FactorCause, ratios: tuple[float, float], quantity: str) -> None:
        self.cause = cause
        self.ratios = ratios
        self.quantity = quantity
        for name in _OWN:
            setattr(self, name, getattr(cause, name))

    def with_cause(self, cause: FactorCause) -> StageEffect:
        """The same of another factor."""
        return StageEffect(cause, self.ratios, self.quantity)

    def change(self, state: State, values: list[Array]) -> State:
        factor = self.cause.factor(state, values)
        with np.errstate(invalid="ignore", divide="ignore"):
            unit, share, ratio = (np.asarray(factor**power) for power in POWERS[self.quantity])
        change = DriveChange(unit, share, ratio, np.where(state.direction_sign > 0, *self.ratios))
        return state.with_changes(drive_change=change.after(state.drive_change))


@dataclass(frozen=True, kw_only=True)
class StageCause(FactorCause):
    """A cause that changes a quantity of the stage, where a law knows it.

    Attributes
    ----------
    assumed : tuple of (int, float, float)
        lambda before the change, see `Assumed`.
    tried : tuple of (str, Assumed)
        Quantities and lambdas that its trials have; without any, its own.
    """

    assumed: Assumed = ()
    tried: tuple[tuple[str, Assumed], ...] = ()

    @property
    def quantity(self) -> str:
        """What it changes."""
        return FRICTION

    def with_quantity(self, quantity: str) -> Self:
        """The same cause of another quantity; it has but one unless it says otherwise."""
        return self

    @property
    def versions(self) -> tuple[Self, ...]:
        """The cause with each quantity and lambda that it is tried with."""
        return tuple(
            replace(self.with_quantity(quantity), assumed=assumed, tried=())
            for quantity, assumed in self.tried or ((self.quantity, self.assumed),)
        )

    def for_laws(self, laws: Iterable[StepLaw]) -> Self:
        tried = tuple((FRICTION, assumed) for assumed in open_ratios(laws))
        return replace(self, tried=tried) if len(tried) > 1 else self

    def under(self, law: StepLaw) -> Cause:
        """See `Cause.under`: it changes a quantity of the stage."""
        if self.quantity == STEP or not isinstance(law, Physical):
            return self
        by_joint = {joint: (up, down) for joint, up, down in self.assumed}
        return StageEffect(self, by_joint.get(law.joint, law.ratios), self.quantity)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        return [one for version in self.versions for one in version.own_trials(rows)]

    def own_trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """Trials of this version."""
        return super().trials(rows)


def open_ratios(laws: Iterable[StepLaw]) -> tuple[Assumed, ...]:
    """The laws' own lambdas, and those well within a regime that a log leaves open (`Physical.regimes`)."""
    physical = [law for law in laws if isinstance(law, Physical)]
    regimes = dict.fromkeys(regime for law in physical for regime in law.regimes)
    found: dict[Assumed, None] = {(): None}
    for regime in regimes:
        found[tuple((law.joint, *law.regimes.get(regime, law.ratios)) for law in physical)] = None
    return tuple(found)


def distinct_changes(laws: Iterable[StepLaw]) -> tuple[tuple[str, Assumed], ...]:
    """The step size, and what changes of the stage leave a trace of their own under these laws."""
    physical = [law for law in laws if isinstance(law, Physical)]
    found: list[tuple[str, Assumed]] = [(STEP, ())]
    for assumed in open_ratios(physical) if physical else ():
        ratios = [ratio for _, *own in assumed for ratio in own] or [
            x for law in physical for x in law.ratios
        ]
        is_limited = {ratio > 1.0 for ratio in ratios}
        voltage, ramp_time = (VOLTAGE,) * (False in is_limited), (RAMP_TIME,) * (len(is_limited) > 1)
        found += [(quantity, assumed) for quantity in (FRICTION, *voltage, *ramp_time)]
    return tuple(found)
