"""Traverses that would tell the regimes apart: extreme loads, a known mass, another amplitude.

What is left open is simulated both ways: with the likeliest lambda above 1 and with the likeliest below, each
with its own fit to the log. A traverse tells them apart the sooner the more their predictions differ: n =
10.8 s^2 / d^2 of them leave 5 % of confusion, with s the repeatability and d the difference, both of
log(steps).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, pi, radians

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.estimation.drive_ratio import RatioProfile
from stickslip_fit.estimation.least_squares import fit_joint
from stickslip_fit.laws import FRICTION_LIMITED, StepLaw, published_law
from stickslip_fit.laws.physical import evaluate_step, physical_law_with
from stickslip_fit.machine import Machine
from stickslip_fit.units import PRISMATIC

CONFUSION = 10.8  # of 5 %
MOST = 1000  # traverses; more are no experiment
LESS, MORE = 0.8, 1.2  # of the amplitude; of the mass that slides or turns
SHORT = radians(30.0)


@dataclass(frozen=True)
class Experiment:
    """A traverse and what each hypothesis expects of it.

    Attributes
    ----------
    direction : str
    description : str
    friction_limited, velocity_limited, published : float
        Step size relative to the present one without load; NaN where a law says nothing.
    traverses : int or None
        How many tell the two regimes apart; None for more than is reasonable.
    """

    direction: str
    description: str
    friction_limited: float
    velocity_limited: float
    published: float
    traverses: int | None


def list_experiments(
    joint: int, rows: pd.DataFrame, machine: Machine, profiles: Mapping[str, RatioProfile], scatter: float
) -> tuple[Experiment, ...]:
    """Experiments of each direction, the one that tells soonest first."""
    found = []
    for direction, profile in sorted(profiles.items()):
        below = profile.ratios < 1.0
        ratio = float(profile.ratios[below][np.argmax(profile.likelihood[below])])
        laws: list[StepLaw] = [
            physical_law_with(joint, rows, machine, (each, each)) for each in (FRICTION_LIMITED, ratio)
        ]
        laws.append(published_law(joint, rows, machine))
        own = rows[rows["direction"] == direction]
        values = [np.mean(fit_joint(law, own, machine)[0].values, axis=0) for law in laws]
        for description, row in _extreme_loads(joint, machine, direction):
            expected = [_relative_step(law, row, one) for law, one in zip(laws, values, strict=True)]
            found.append(_experiment(direction, description, expected, scatter))
        heavier = _unloaded(1.0 / MORE, FRICTION_LIMITED), _unloaded(1.0 / MORE, ratio), np.nan
        what = "sliding mass" if joint == PRISMATIC else "inertia"
        found.append(_experiment(direction, f"no load, {what} +20 % (known mass)", heavier, scatter))
        smaller = 1.0, LESS, np.nan
        found.append(_experiment(direction, "no load, amplitude −20 %", smaller, scatter))
    return tuple(sorted(found, key=lambda one: (one.traverses or MOST + 1, one.direction)))


def _experiment(direction: str, description: str, expected: object, scatter: float) -> Experiment:
    limited, reached, published = map(float, expected)  # type: ignore[call-overload]
    difference = abs(np.log(limited / reached))
    traverses = None
    if np.isfinite(difference) and CONFUSION * scatter**2 < MOST * difference**2:
        traverses = max(1, ceil(CONFUSION * (scatter / difference) ** 2))
    return Experiment(direction, description, limited, reached, published, traverses)


def _unloaded(friction: float, ratio: float) -> float:
    """Step without load, relative to the present one, with friction acceleration changed by a factor."""
    one, inertia = np.ones(1), np.array([1.0 / friction])
    return float(evaluate_step(one, np.zeros(1), inertia, np.array([ratio])).gamma[0])


def _extreme_loads(joint: int, machine: Machine, direction: str) -> list[tuple[str, pd.DataFrame]]:
    """Traverses under full load of both signs."""
    poses = {
        3: [("q2 −90°, psi −90°", -pi / 2, 0.0, -pi / 2), ("q2 −90°, psi 90°", -pi / 2, 0.0, pi / 2)],
        2: [("−105° to −75°, psi 0°", -pi / 2, 0.0, 0.0), ("−105° to −75°, psi 180°", -pi / 2, 0.0, pi)],
        1: [("−15° to 15°, theta −90°", 0.0, -pi / 2, 0.0), ("−15° to 15°, theta 90°", 0.0, pi / 2, 0.0)],
    }[joint]
    low, high = machine.ranges[joint]
    outermost = machine.ranges[3][1]
    found = []
    for description, middle, theta, psi in poses:
        ends = (low, high) if joint == PRISMATIC else (middle - SHORT / 2, middle + SHORT / 2)
        start, stop = ends if direction == "+" else ends[::-1]
        pose = {"q1": 0.0, "q2": -pi / 2, "q3": outermost, "theta": theta, "psi": psi}
        row = pd.DataFrame([{"joint": joint, "direction": direction, "start": start, "stop": stop, **pose}])
        found.append((f"{description}{'' if joint == PRISMATIC else ', q3 12 mm'}", row))
    return found


def _relative_step(law: StepLaw, row: pd.DataFrame, values: Array) -> float:
    """Mean step size on a traverse over that without load."""
    length = float(abs(row["stop"].iloc[0] - row["start"].iloc[0]))
    theta = 0.0 if law.joint == 1 else -pi / 2
    without = row.assign(theta=theta, psi=0.0)
    counts = [law.counts(each, values)[0][0] for each in (row, without)]
    return float(counts[1] / counts[0]) if length else np.nan
