"""What a simulated study is to do."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, is_dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from stickslip_fit.causes import Cause
from stickslip_fit.logs.plan import NoiseKind, Plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulate import LawValues
from stickslip_fit.strategies.task import Strategy

Array = npt.NDArray[np.float64]
Scatter = Literal["gaussian", "t5", "uneven"]

GOOD_ENOUGH = 0.01


@dataclass(frozen=True, eq=False)
class Scenario:
    """What the published laws do not know of in some of the campaigns.

    Attributes
    ----------
    name : str
    causes : tuple of Cause
        None of them: nothing is hidden.
    sizes : array, shape (q,)
        Values of the causes' parameters one after the other, SI.
    """

    name: str
    causes: tuple[Cause, ...] = ()
    sizes: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class StudyPlan:
    """Campaigns to simulate, and strategies to calibrate them.

    Attributes
    ----------
    name : str
    plan : Plan
        Of every campaign; the same traverses in the same order.
    truth : LawValues
        What holds on average over the campaigns.
    machine : Machine
    scenarios : tuple of Scenario
    strategies : tuple of Strategy
    repeatability : dict of (int, str) to float
        Standard deviation of log(steps) for each joint and direction; every strategy knows it.
    scatter : {'gaussian', 't5', 'uneven'}
        ``uneven``: Gaussian, and up to twice as large in some configurations as in others.
    campaigns : int
        Of each scenario.
    seed : int
    between_campaigns, between_sessions : float
        How far each parameter spreads (standard deviation), as a share of what changes a step by its own
        size, see `StepLaw.scales`; cut off at three standard deviations.
    moves : int
        How many open-loop moves the tip makes at the end of each session; the same in all of them.
    length : float
        Of each, m.
    good_enough : float
        Relative rms error of the mean step size with which the lab can live.
    """

    name: str
    plan: Plan
    truth: LawValues
    machine: Machine
    scenarios: tuple[Scenario, ...]
    strategies: tuple[Strategy, ...]
    repeatability: dict[tuple[int, str], float]
    scatter: Scatter = "gaussian"
    campaigns: int = 1000
    seed: int = 0
    between_campaigns: float = 0.0
    between_sessions: float = 0.0
    moves: int = 20
    length: float = 1e-3
    good_enough: float = GOOD_ENOUGH

    @property
    def kind(self) -> NoiseKind:
        """Distribution of the scatter in any one configuration."""
        return "t5" if self.scatter == "t5" else "gaussian"

    def sha256(self, scenario: Scenario) -> str:
        """Of all that the numbers of a scenario's campaigns depend on: not of how many there are."""
        told = {
            "traverses": self.plan.rows().to_csv(),
            "sessions": [(each.label, each.begins.isoformat()) for each in self.plan.sessions],
            "timing": repr(self.plan.timing),
            "laws": {str(joint): _named(law) for joint, law in self.truth.laws.items()},
            "values": {str(key): list(own) for key, own in self.truth.values.items()},
            "day_to_day": {str(key): value for key, value in self.truth.day_to_day.items()},
            "machine": self.machine.sha256,
            "scenario": [scenario.name, repr(scenario.causes), list(scenario.sizes)],
            "strategies": [(strategy.name, _named(strategy)) for strategy in self.strategies],
            "repeatability": {str(key): value for key, value in self.repeatability.items()},
            "rest": [
                self.scatter,
                self.seed,
                self.between_campaigns,
                self.between_sessions,
                self.moves,
                self.length,
            ],
        }
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def _named(thing: object) -> str:
    """What a thing is, the same in every process; an object's default repr tells where it lies in memory."""
    told = repr(thing) if is_dataclass(thing) else repr(getattr(thing, "causes", ""))
    return f"{type(thing).__module__}.{type(thing).__qualname__} {told}"
