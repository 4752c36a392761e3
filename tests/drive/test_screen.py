"""The terminal's screen, and one that is frozen."""

import io
import shutil
import sys
import threading
import time

import numpy as np
import pytest

from stickslip_fit.drive.screen import Screens, ScreenThread, TerminalScreen, format_line
from stickslip_fit.drive.state import DriveState, HomingAdvice
from stickslip_fit.moves.error_ellipsoid import semi_axes


def state(now=1.0, **changes):
    content = {
        "time": now,
        "status": "moving",
        "q": np.array([0.1, -1.5, 0.006]),
        "q_error": np.array([1e-5, 2e-5, 1e-6]),
        "tip": np.array([0.0561, 0.002, 0.0003]),
        "tip_covariance": np.diag([1e-12, 4e-12, 1e-13]),
        "tip_radius": 4.4e-6,
        "tolerance": 10e-6,
        "wanted_velocity": np.array([20e-6, 0.0, 0.0]),
        "tip_velocity": np.array([10e-6, 0.0, 0.0]),
        "steps": (12, -3400, 5),
    }
    return DriveState(**content | changes)


class Terminal(io.StringIO):
    def isatty(self):
        return True

    def sent(self) -> str:
        """What it was sent since it was last asked."""
        text = self.getvalue()
        self.seek(0)
        self.truncate()
        return text


def test_a_terminal_shows_everything_and_is_left_clean(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: (80, 40))
    screen = TerminalScreen(("keys",), picture=lambda state, width, height: ["the arm"] * height)
    screen.show(state(limits=("joint 2 is at its soft limit",), advice=HomingAdvice(3, "-", 6400, 250)))
    first = terminal.sent()
    for part in (
        *("(56.1000, 2.0000, 0.3000) mm", "4.4 µm of 10.0 µm", "5.6 × 2.8 × 0.9 µm", "−3,400 steps"),
        *("Go back to the − stop of joint 3 within 250 steps. It is about 6,400", "soft limit", "keys"),
        *("10.0, 0.0, 0.0", "the arm", "joint 3 6.0000 mm"),
    ):
        assert part in first
    assert first.startswith("\x1b[?25l")
    assert all(len(line) < 80 + len("\x1b[?25l\x1b[K") for line in first.splitlines())
    screen.show(state(2.0))
    drawn = first.count("\n")
    assert terminal.sent().startswith(f"\x1b[{drawn}A\r")
    screen.close()
    assert terminal.sent() == "\x1b[?25h"


def test_elsewhere_it_is_a_line_a_second_and_one_for_each_message(capsys):
    screen = TerminalScreen()
    for tenth in range(30):
        screen.show(state(tenth / 10, message="stopped here" if tenth >= 25 else ""))
    screen.close()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert not any("\x1b" in line for line in lines)
    assert lines[-1].endswith("stopped here")
    assert "the + stop of joint 1 now: the tolerance" in format_line(
        state(tip_radius=11e-6, advice=HomingAdvice(1, "+", 100, 0))
    )


def test_the_ellipsoid_holds_95_percent():
    rng = np.random.default_rng(3)
    shape = rng.standard_normal((3, 3))
    covariance = shape @ shape.T
    errors = rng.multivariate_normal(np.zeros(3), covariance, 20_000)
    variances, axes = np.linalg.eigh(covariance)
    inside = np.sum((errors @ axes / semi_axes(variances)) ** 2, axis=1) <= 1
    assert np.mean(inside) == pytest.approx(0.95, abs=4 * np.sqrt(0.05 * 0.95 / 20_000))


def test_a_frozen_screen_is_known_by_its_age_and_holds_nothing_up():
    shown, released, now = [], threading.Event(), [0.0]

    class Frozen:
        def show(self, one):
            shown.append(one.time)
            released.wait(10)

    screen = ScreenThread(Frozen(), lambda: now[0])
    assert screen.age() == 0.0
    began = time.perf_counter()
    for number in range(50):
        screen.show(state(float(number)))
    assert time.perf_counter() - began < 1.0
    now[0] = 3.0
    assert screen.age() == 3.0
    released.set()
    screen.close(10)
    assert shown[-1] == 49.0
    assert len(shown) <= 3
    assert screen.age() == 0.0


def test_a_screen_that_fails_never_comes_back():
    class Closed:
        def show(self, one):
            raise OSError("the terminal is gone")

    screen = ScreenThread(Closed(), lambda: 0.0)
    screen.show(state())
    screen.close(10)
    assert screen.age() == float("inf")


def test_several_screens_show_the_same():
    shown = []

    class Other:
        def __init__(self, name):
            self.name = name

        def show(self, one):
            shown.append((self.name, one.time))

    Screens((Other("a"), Other("b"))).show(state(3.0))
    assert shown == [("a", 3.0), ("b", 3.0)]
