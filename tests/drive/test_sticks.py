"""Gamepad and SpaceMouse, played; and what is said without them."""

import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from stickslip_fit.drive.sticks import (
    MAX_AGE,
    StickDevice,
    StickState,
    gamepad_poll,
    open_gamepad,
    open_spacemouse,
    spacemouse_poll,
)
from stickslip_fit.errors import InputError


class Stick:
    """A device that is deflected as a test says."""

    def __init__(self):
        self.state = StickState()
        self.hangs = threading.Event()
        self.hangs.set()
        self.error = None

    def poll(self):
        self.hangs.wait(10)
        if self.error:
            raise self.error
        return self.state


@pytest.fixture
def stick():
    return Stick()


@pytest.fixture
def device(stick):
    device = StickDevice(lambda: stick.poll, speed=50e-6)
    yield device
    stick.hangs.set()
    device.close()


def until(condition):
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end, "never"
        time.sleep(0.002)


def test_a_deflection_moves_and_a_release_ends_it_within_a_tick(stick, device):
    assert device.read(1.0).tip_velocity is None
    stick.state = StickState((1.0, -1.0, 0.05))
    until(lambda: device.read(1.0).tip_velocity is not None)
    wanted = device.read(1.0)
    assert wanted.tip_velocity == pytest.approx([50e-6, -50e-6, 0.0])
    assert wanted.valid_until == pytest.approx(1.01)
    stick.state = StickState()
    until(lambda: device.read(1.0).tip_velocity is None)


def test_a_driver_that_hangs_moves_nothing(stick, device):
    stick.state = StickState((1.0, 0.0, 0.0))
    until(lambda: device.read(1.0).tip_velocity is not None)
    stick.hangs.clear()
    time.sleep(2 * MAX_AGE)
    began = time.perf_counter()
    assert device.read(2.0).tip_velocity is None
    assert time.perf_counter() - began < 0.05


def test_an_unplugged_device_moves_nothing(stick, device):
    stick.state = StickState((1.0, 0.0, 0.0))
    until(lambda: device.read(1.0).tip_velocity is not None)
    stick.error = OSError("gone")
    until(lambda: device.read(1.0).tip_velocity is None)


def test_the_button_that_ends_is_not_missed(stick, device):
    stick.state = StickState(ends=True)
    until(lambda: device.read(1.0).ends)
    stick.state = StickState()
    time.sleep(0.03)
    assert device.read(1.1).ends


def test_a_device_that_cannot_be_opened_says_so():
    def missing():
        raise InputError("no gamepad is connected")

    with pytest.raises(InputError, match="no gamepad"):
        StickDevice(missing, 1e-5)


class Pad:
    axes = (0.5, -0.25, 0.0, -1.0)
    buttons = (0,) * 7 + (1,)

    def get_axis(self, number):
        return self.axes[number]

    def get_numaxes(self):
        return len(self.axes)

    def get_button(self, number):
        return self.buttons[number]

    def get_numbuttons(self):
        return len(self.buttons)


def test_the_sticks_of_a_gamepad():
    pumped = []
    pad = Pad()
    assert gamepad_poll(pad, lambda: pumped.append(1), lambda: True)() == StickState((0.5, 0.25, 1.0), True)
    assert pumped
    pad.axes, pad.buttons = (0.5, 0.0), ()
    assert gamepad_poll(pad, lambda: None, lambda: True)() == StickState((0.5, 0.0, 0.0), False)
    with pytest.raises(OSError, match="gone"):
        gamepad_poll(pad, lambda: None, lambda: False)()


class Mouse:
    def __init__(self):
        self.reports = []
        self.state = SimpleNamespace(t=-1.0, x=0.0, y=0.0, z=0.0, buttons=[0, 0])

    def read(self):
        if self.reports:
            self.state = SimpleNamespace(**{**vars(self.state), **self.reports.pop(0)})
        return self.state


def test_a_spacemouse_is_read_up_to_its_latest_report_and_not_after_it_fell_silent():
    mouse, now = Mouse(), [0.0]
    poll = spacemouse_poll(mouse, lambda: now[0])
    assert poll() == StickState()
    mouse.reports = [{"t": 0.1 * k, "x": 0.1 * k} for k in range(1, 6)]
    assert poll().deflection == pytest.approx((0.5, 0, 0))
    now[0] = 0.2
    assert poll().deflection[0] == pytest.approx(0.5)
    now[0] = 0.3
    assert not np.any(poll().deflection)
    mouse.reports = [{"t": 9.0, "y": -0.7, "buttons": [0, 1]}]
    assert poll() == StickState((0.5, -0.7, 0.0), True)


@pytest.mark.parametrize(
    ("library", "opener", "said"),
    [("pygame", open_gamepad, r"stickslip-fit\[gamepad\]"), ("pyspacemouse", open_spacemouse, "spacemouse")],
)
def test_a_missing_library_is_named(monkeypatch, library, opener, said):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=said):
        opener()
