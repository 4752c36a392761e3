"""From where the joints should be to whole steps: error diffusion with a dead band, one step after another.

A controller makes the steps of all joints one after the other, each in its step period. So the joint that
lags most makes the next step, once it lags by half a step; what rounding leaves undone goes into the next
ones. A joint reverses only when it is a whole step off: rounding alone would otherwise make it step to and
fro, and reversals cost accuracy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from stickslip_fit.units import JOINTS

FORWARD_STEPS, REVERSAL_STEPS = 0.5, 1.0  # by which a joint lags before it steps, on and back
SPARE_LAG = 1.0  # steps beyond those of a tick; where a joint lags more, the target waits for it


@dataclass(frozen=True)
class Burst:
    """Steps of one joint in one direction, commanded at once."""

    joint: int
    direction: str
    steps: int

    @property
    def signed_steps(self) -> int:
        """More than 0 in `+`, less in `-`."""
        return self.steps if self.direction == "+" else -self.steps


StepSize = Callable[[int, str], float]
"""From a joint and a direction to the size of its next step, rad or m."""


class StepDiffusion:
    """Where the joints should be, and the steps that take them there.

    Parameters
    ----------
    q : sequence of float
        Where they are, rad, rad, m.
    slots : int
        Steps of all joints together that a tick has room for.

    Attributes
    ----------
    target : list of float
        rad, rad, m.
    """

    def __init__(self, q: Sequence[float], step_size: StepSize, slots: int = 1) -> None:
        self.target = list(q)
        self.slots = slots
        self._step_size = step_size
        self._last = dict.fromkeys(JOINTS, "")

    def advance(self, q: Sequence[float], displacement: Sequence[float]) -> bool:
        """Move the target, from joints at `q`, unless one would lag too much; whether it was moved."""
        moved = [target + change for target, change in zip(self.target, displacement, strict=True)]
        for joint in JOINTS:
            lag = self._lag(joint, moved[joint - 1] - q[joint - 1])
            if displacement[joint - 1] and abs(lag) > self.slots + SPARE_LAG:
                return False
        self.target = moved
        return True

    def settle(self, q: Sequence[float], joint: int | None = None) -> None:
        """Give up whole steps that joints at `q` still lag; of one joint, e.g. at a stop, everything."""
        for number in JOINTS if joint is None else (joint,):
            lag = self.target[number - 1] - q[number - 1]
            if joint is not None or abs(self._lag(number, lag)) > REVERSAL_STEPS:
                self.target[number - 1] = q[number - 1]

    def bursts(self, q: Sequence[float]) -> Iterator[Burst]:
        """The bursts of a tick, of joints at `q`, which the caller keeps up to date."""
        slots = self.slots
        while slots > 0:
            lags = {joint: self._lag(joint, self.target[joint - 1] - q[joint - 1]) for joint in JOINTS}
            due = {joint: abs(lag) / self._threshold(joint, lag) for joint, lag in lags.items()}
            joint = max(due, key=lambda number: due[number])
            if due[joint] < 1.0:
                return
            steps = min(slots, max(round(abs(lags[joint])), 1))
            direction = _direction(lags[joint])
            self._last[joint] = direction
            slots -= steps
            yield Burst(joint, direction, steps)

    def _lag(self, joint: int, displacement: float) -> float:
        """A displacement in steps, signed."""
        return displacement / self._step_size(joint, _direction(displacement)) if displacement else 0.0

    def _threshold(self, joint: int, lag: float) -> float:
        same = self._last[joint] in ("", _direction(lag))
        return FORWARD_STEPS if same else REVERSAL_STEPS


def _direction(displacement: float) -> str:
    return "+" if displacement > 0 else "-"
