"""The keyboard of a terminal as an input device.

A terminal tells of keys that are pressed or repeat, and never of one that is released. So each press
commands one bounded move, and the tip moves on only while the key repeats; any key without a meaning stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from stickslip_fit.capture.terminal import DOWN, LEFT, PAGE_DOWN, PAGE_UP, RIGHT, UP
from stickslip_fit.drive.state import InputDevice, VelocityInput
from stickslip_fit.units import JOINTS, PRISMATIC

HOLD = 0.050  # s of motion for each press
SPEED = 20e-6  # m/s
SPEED_FACTOR = 1.5  # of each press of + or -
MIN_SPEED, MAX_SPEED = 1e-6, 500e-6  # m/s
LEVER = 0.050  # m, by which the speed of a single rotary joint is turned into rad/s
AXES: Mapping[str, tuple[int, int]] = {
    **{"a": (0, -1), "d": (0, 1), LEFT: (0, -1), RIGHT: (0, 1)},
    **{"s": (1, -1), "w": (1, 1), DOWN: (1, -1), UP: (1, 1)},
    **{"f": (2, -1), "r": (2, 1), PAGE_DOWN: (2, -1), PAGE_UP: (2, 1)},
}
STOP = np.zeros(3)
HELP = (
    "a d, s w, f r, or arrows and page keys: tip along x, y, z     + -: faster, slower     q: end",
    "1 2 3: a joint by itself, with a d     0: the tip again     h and 1 2 3: home     any other key: stop",
)


class KeyboardDevice(InputDevice):
    """An `InputDevice` of key presses.

    Parameters
    ----------
    keys : callable
        The keys pressed since the last call, as a text.
    speed : float, optional
        Of the tip, m/s.
    hold : float, optional
        How long one press moves, s.
    """

    def __init__(self, keys: Callable[[], str], speed: float = SPEED, hold: float = HOLD) -> None:
        self.speed = speed
        self.hold = hold
        self._keys = keys
        self._joint = 0  # 0 for the tip
        self._homing = False  # h was pressed
        self._wanted = VelocityInput()

    def read(self, now: float) -> VelocityInput:
        """See `InputDevice.read`; a key that stops is a velocity of zero."""
        for key in self._keys():
            if not self._wanted.ends:
                self._wanted = self._press(key.lower(), now)
        if now >= self._wanted.valid_until:
            self._wanted = VelocityInput(ends=self._wanted.ends)
        wanted = self._wanted
        if wanted.home is not None:
            self._wanted = VelocityInput()  # it is asked for once
        return wanted

    def _press(self, key: str, now: float) -> VelocityInput:
        homing, self._homing = self._homing, False
        until = now + self.hold
        if key == "q":
            return VelocityInput(ends=True)
        if key in ("0", *map(str, JOINTS)):
            if homing and key != "0":
                return VelocityInput(home=int(key), valid_until=until)
            self._joint = int(key)
        elif key == "h":
            self._homing = True
        elif key in ("+", "-"):
            faster = SPEED_FACTOR if key == "+" else 1.0 / SPEED_FACTOR
            self.speed = min(max(self.speed * faster, MIN_SPEED), MAX_SPEED)
        elif key in AXES and (self._joint == 0 or AXES[key][0] == 0):
            return self._move(*AXES[key], until)
        return VelocityInput(tip_velocity=STOP, valid_until=until)

    def _move(self, axis: int, sign: int, until: float) -> VelocityInput:
        velocity = np.zeros(3)
        if self._joint == 0:
            velocity[axis] = sign * self.speed
            return VelocityInput(tip_velocity=velocity, valid_until=until)
        lever = 1.0 if self._joint == PRISMATIC else LEVER
        velocity[self._joint - 1] = sign * self.speed / lever
        return VelocityInput(joint_velocity=velocity, valid_until=until)
