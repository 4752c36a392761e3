"""The keyboard: a terminal reports no key release."""

import numpy as np
import pytest

from stickslip_fit.capture.terminal import LEFT, PAGE_UP, UP
from stickslip_fit.drive.keyboard import KeyboardDevice


class Keys:
    def __init__(self):
        self.waiting = ""

    def __call__(self):
        keys, self.waiting = self.waiting, ""
        return keys


@pytest.fixture
def keys():
    return Keys()


@pytest.fixture
def keyboard(keys):
    return KeyboardDevice(keys, speed=30e-6)


def press(keyboard, keys, pressed, now=1.0):
    keys.waiting = pressed
    return keyboard.read(now)


@pytest.mark.parametrize(
    ("key", "velocity"),
    [
        *[("d", (30, 0, 0)), ("a", (-30, 0, 0)), (LEFT, (-30, 0, 0)), ("w", (0, 30, 0)), (UP, (0, 30, 0))],
        *[("r", (0, 0, 30)), (PAGE_UP, (0, 0, 30)), ("F", (0, 0, -30))],
    ],
)
def test_one_press_is_one_bounded_move(keyboard, keys, key, velocity):
    wanted = press(keyboard, keys, key)
    assert wanted.tip_velocity == pytest.approx(np.array(velocity) * 1e-6)
    assert wanted.valid_until == pytest.approx(1.05)
    assert keyboard.read(1.04).tip_velocity is not None
    assert keyboard.read(1.06).valid_until <= 1.06
    assert keyboard.read(1.07).tip_velocity is None


def test_a_repeating_key_moves_on(keyboard, keys):
    for number in range(20):
        now = 1.0 + 0.03 * number
        assert press(keyboard, keys, "d", now).valid_until > now + 0.04


@pytest.mark.parametrize("key", ["x", " ", "\x1b", "h", "+", "\n"])
def test_any_other_key_stops(keyboard, keys, key):
    press(keyboard, keys, "d")
    wanted = press(keyboard, keys, key, 1.01)
    assert not np.any(wanted.tip_velocity)
    assert keyboard.read(1.2).tip_velocity is None


def test_a_joint_by_itself(keyboard, keys):
    press(keyboard, keys, "2")
    wanted = press(keyboard, keys, "d")
    assert wanted.joint_velocity == pytest.approx([0, 30e-6 / 0.05, 0])
    assert not np.any(press(keyboard, keys, "w").tip_velocity)
    press(keyboard, keys, "3")
    assert press(keyboard, keys, "a").joint_velocity == pytest.approx([0, 0, -30e-6])
    press(keyboard, keys, "0")
    assert press(keyboard, keys, "w").tip_velocity is not None


def test_going_home_takes_two_keys_and_is_asked_for_once(keyboard, keys):
    press(keyboard, keys, "h")
    assert press(keyboard, keys, "3", 1.1).home == 3
    assert keyboard.read(1.11).home is None
    press(keyboard, keys, "h")
    press(keyboard, keys, "x")
    assert press(keyboard, keys, "3").home is None


def test_speed_has_bounds_and_q_ends(keyboard, keys):
    press(keyboard, keys, "+")
    assert press(keyboard, keys, "d").tip_velocity[0] == pytest.approx(45e-6)
    press(keyboard, keys, "-" * 50)
    assert press(keyboard, keys, "d").tip_velocity[0] == pytest.approx(1e-6)
    assert press(keyboard, keys, "q").ends
    assert keyboard.read(9.0).ends
    assert press(keyboard, keys, "d", 9.1).ends
