"""Gamepad and SpaceMouse as input devices.

Both report where they are, and so that they were released: what is wanted holds for one tick. They are polled
in a thread of their own, since a driver may hang; what is older than `MAX_AGE` moves nothing. A SpaceMouse
reports many times a second while it is deflected; one that falls silent in that position was unplugged.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any

import numpy as np

from stickslip_fit.drive.state import InputDevice, VelocityInput
from stickslip_fit.errors import InputError

POLL_SECONDS = 0.004
MAX_AGE = 0.050  # s
MAX_SILENCE = 0.250  # s of a SpaceMouse that is deflected
VALID = 0.010  # s, a tick
DEAD_ZONE = 0.12  # of the full deflection: a stick at rest is not quite in the middle
OPEN_SECONDS = 5.0
GAMEPAD_AXES = ((0, 1.0), (1, -1.0), (3, -1.0))  # left stick to the right and up, right stick up
GAMEPAD_END = 7  # the button "start" of most
MAX_REPORTS = 16  # of a SpaceMouse that may wait to be read


@dataclass(frozen=True)
class StickState:
    """Deflections along x, y, z, from -1 to 1, and whether the button was pressed that ends the drive."""

    deflection: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ends: bool = False


Poll = Callable[[], StickState]
"""Reads a device; raises any error where it is gone."""


class StickDevice(InputDevice):
    """An `InputDevice` of something that is deflected, polled in a thread.

    Parameters
    ----------
    open_device : callable
        Opens the device, and returns how it is polled; called in the thread, as some drivers demand.
    speed : float
        Of the tip at full deflection, m/s.

    Raises
    ------
    InputError
        If it cannot be opened; with its message.
    """

    def __init__(self, open_device: Callable[[], Poll], speed: float) -> None:
        self.speed = speed
        self._open = open_device
        self._latest = StickState()
        self._polled_at = -np.inf
        self._failure: Exception | None = None
        self._closed = False
        self._opened = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        if not self._opened.wait(OPEN_SECONDS):
            raise InputError(f"the device has not answered for {OPEN_SECONDS:g} s; plug it in again")
        if isinstance(self._failure, InputError):
            raise self._failure

    def read(self, now: float) -> VelocityInput:
        latest, age = self._latest, monotonic() - self._polled_at
        if latest.ends:
            return VelocityInput(ends=True)
        velocity = self.speed * shape_deflection(latest.deflection)
        if age > MAX_AGE or not velocity.any():
            return VelocityInput()
        return VelocityInput(tip_velocity=velocity, valid_until=now + VALID)

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self._thread.join(1.0)

    def _run(self) -> None:
        try:
            poll = self._open()
            while not self._closed:
                latest = poll()
                ends = self._latest.ends or latest.ends
                self._latest, self._polled_at = StickState(latest.deflection, ends), monotonic()
                self._opened.set()
                sleep(POLL_SECONDS)
        except Exception as error:  # of any driver: the loop sees the age of what was read last
            self._failure = error
            self._opened.set()


def shape_deflection(deflection: tuple[float, float, float]) -> np.ndarray:
    """Shares of the full speed: none within the dead zone, then slowly more, shape (3,).

    Examples
    --------
    >>> shape_deflection((0.1, -1.0, 0.56))
    array([ 0.  , -1.  ,  0.25])
    """
    amount = np.clip((np.abs(deflection) - DEAD_ZONE) / (1.0 - DEAD_ZONE), 0.0, 1.0)
    return np.asarray(np.sign(deflection) * amount**2)


def open_gamepad() -> Poll:
    """Open the first gamepad by pygame; raises InputError without one, or without pygame."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # events need a display, and no window is wanted
    os.environ.setdefault("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")
    try:
        import pygame
    except ImportError:
        message = "a gamepad needs pygame-ce; install it: pip install 'stickslip-fit[gamepad]'"
        raise InputError(message) from None
    pygame.display.init()
    pygame.joystick.init()
    if not pygame.joystick.get_count():
        raise InputError("no gamepad is connected; plug one in, or drive by the keyboard")
    pad = pygame.joystick.Joystick(0)
    return gamepad_poll(pad, pygame.event.pump, pad.get_init)


def gamepad_poll(pad: Any, pump: Callable[[], object], connected: Callable[[], bool]) -> Poll:
    """How a pygame ``Joystick`` is polled."""

    def poll() -> StickState:
        pump()
        if not connected():
            raise OSError("the gamepad is gone")
        x, y, z = (
            sign * pad.get_axis(axis) if axis < pad.get_numaxes() else 0.0 for axis, sign in GAMEPAD_AXES
        )
        ends = pad.get_numbuttons() > GAMEPAD_END and bool(pad.get_button(GAMEPAD_END))
        return StickState((x, y, z), ends)

    return poll


def open_spacemouse() -> Poll:
    """Open the first SpaceMouse by pyspacemouse; raises InputError without one, or without that library."""
    try:
        import pyspacemouse
    except (ImportError, OSError):  # OSError: without the system's library hidapi
        raise InputError(
            "a SpaceMouse needs pyspacemouse and the system's hidapi; install them: "
            "pip install 'stickslip-fit[spacemouse]', and libhidapi-hidraw0 or hidapi of your system"
        ) from None
    try:
        device = pyspacemouse.open(axis_convention=pyspacemouse.AxisConvention.HID_Z_UP)
    except (RuntimeError, OSError) as error:
        raise InputError(
            f"no SpaceMouse can be opened ({error}); plug it in, and see that you may read hidraw devices"
        ) from None
    return spacemouse_poll(device)


def spacemouse_poll(device: Any, now: Callable[[], float] = monotonic) -> Poll:
    """How a pyspacemouse device is polled; its second button ends the drive."""
    reported, reported_at = -1.0, now()  # the time of a device that has not reported yet

    def poll() -> StickState:
        nonlocal reported, reported_at
        state = device.read()
        for _ in range(MAX_REPORTS):
            if state.t == reported:
                break
            reported, reported_at = state.t, now()
            state = device.read()
        deflection = (float(state.x), float(state.y), float(state.z))
        buttons = list(state.buttons)
        if any(shape_deflection(deflection)) and now() - reported_at > MAX_SILENCE:
            deflection = (0.0, 0.0, 0.0)
        return StickState(deflection, len(buttons) > 1 and bool(buttons[1]))

    return poll
