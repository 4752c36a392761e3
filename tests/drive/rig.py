"""A rig for drives in tests: joints that step as they are told, and inputs that say what they are told."""

from dataclasses import dataclass, field

import numpy as np

from stickslip_fit.capture.protocols import ConnectionLost, VirtualClock
from stickslip_fit.drive.state import DriveState, VelocityInput


class Steps:
    """A controller that notes its steps; each takes 10 ms."""

    def __init__(self, clock: VirtualClock, period: float = 0.01) -> None:
        self.clock = clock
        self.period = period
        self.made: list[tuple[float, int, int]] = []
        self.fails_after = np.inf
        self.stopped = 0

    def step(self, joint: int, steps: int) -> None:
        if len(self.made) >= self.fails_after:
            raise ConnectionLost("the plug is out")
        self.made.append((self.clock.now(), joint, steps))
        self.clock.sleep(abs(steps) * self.period)

    def stop(self) -> None:
        self.stopped += 1

    def total(self, joint: int) -> int:
        return sum(steps for _, moved, steps in self.made if moved == joint)


@dataclass
class Hand:
    """Wants one thing from a time to another, in order; then ends."""

    wishes: list[tuple[float, dict]]  # until when, s, and the fields of the input
    lag: float = 0.02

    def read(self, now: float) -> VelocityInput:
        for until, wish in self.wishes:
            if now < until - 1e-9:
                return VelocityInput(**{"valid_until": now + self.lag} | wish)
        return VelocityInput(ends=True)


@dataclass
class Shown:
    """A screen that keeps what it showed."""

    states: list[DriveState] = field(default_factory=list)

    def show(self, state: DriveState) -> None:
        self.states.append(state)


def tip(x: float, y: float, z: float) -> dict:
    """A wish for a velocity of the tip, µm/s."""
    return {"tip_velocity": np.array([x, y, z]) * 1e-6}


def joint(number: int, rate: float) -> dict:
    """A wish for a velocity of one joint, rad/s or m/s."""
    rates = np.zeros(3)
    rates[number - 1] = rate
    return {"joint_velocity": rates}
