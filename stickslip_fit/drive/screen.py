"""A drive in the terminal: joints, tip, certainty, limits, advice and the arm from two sides.

`TerminalScreen` redraws at a terminal and leaves it clean; elsewhere it prints a plain line now and then.
`ScreenThread` shows in a thread of its own whatever can stall, and says since when it has.
"""

from __future__ import annotations

import shutil
import sys
import textwrap
import threading
from collections.abc import Callable

import numpy as np
import typer

from stickslip_fit._format import format_direction, format_number, format_value, pluralize
from stickslip_fit.drive.state import DriveState, Screen
from stickslip_fit.moves.error_ellipsoid import semi_axes
from stickslip_fit.units import JOINTS, PRISMATIC, Z_95, from_si

LINE_INTERVAL = 1.0  # s between two lines where there is no terminal
PICTURE_HEIGHT = 14
NO_ADVICE = "none: the tip is known well enough"
Picture = Callable[[DriveState, int, int], list[str]]
"""From a state, width and height to the lines of a picture."""


class TerminalScreen(Screen):
    """Shows a drive on the standard output.

    Parameters
    ----------
    help_lines : tuple of str
        Which keys do what.
    picture : callable, optional
        Draws the arm.
    """

    def __init__(self, help_lines: tuple[str, ...] = (), picture: Picture | None = None) -> None:
        self.help_lines = help_lines
        self.picture = picture
        self._drawn = 0
        self._line_at = -LINE_INTERVAL
        self._message = ""

    def show(self, state: DriveState) -> None:
        if sys.stdout.isatty():
            self._draw(state)
            return
        if state.time - self._line_at >= LINE_INTERVAL or state.message != self._message:
            self._line_at, self._message = state.time, state.message
            typer.echo(format_line(state))

    def close(self) -> None:
        """Leave the terminal as it was, below what was drawn."""
        if self._drawn:
            typer.echo("\x1b[?25h", nl=False)
            self._drawn = 0

    def _draw(self, state: DriveState) -> None:
        width, height = shutil.get_terminal_size()
        lines = format_state(state)
        help_lines = [part for line in self.help_lines for part in textwrap.wrap(line, width - 1)]
        room = height - len(lines) - len(help_lines) - 2
        if self.picture is not None and room >= 5:
            lines += self.picture(state, width - 1, min(room, PICTURE_HEIGHT))
        lines = [line[: width - 1] for line in [*lines, *help_lines]][: height - 1]
        begin = f"\x1b[{self._drawn}A\r" if self._drawn else "\x1b[?25l"
        typer.echo(begin + "\n".join(f"{line}\x1b[K" for line in lines) + "\n\x1b[J", nl=False)
        self._drawn = len(lines)


class Screens(Screen):
    """Several screens as one."""

    def __init__(self, screens: tuple[Screen, ...]) -> None:
        self.screens = screens

    def show(self, state: DriveState) -> None:
        for screen in self.screens:
            screen.show(state)


class ScreenThread(Screen):
    """A `Screen` in a thread of its own, so that a terminal that stands still does not hold up the joints."""

    def __init__(self, screen: Screen, now: Callable[[], float]) -> None:
        self.screen = screen
        self._now = now
        self._latest: DriveState | None = None
        self._busy_since: float | None = None
        self._failure = ""
        self._ended = False
        self._wake = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def show(self, state: DriveState) -> None:
        with self._wake:
            self._latest = state
            if self._busy_since is None:
                self._busy_since = self._now()
            self._wake.notify()

    def age(self) -> float:
        """Seconds for which the screen has not shown what it was given; infinite once it has failed."""
        with self._wake:
            if self._failure:
                return float("inf")
            return 0.0 if self._busy_since is None else self._now() - self._busy_since

    def close(self, seconds: float = 1.0) -> None:
        """End the thread; wait that long for it to show the last state."""
        with self._wake:
            self._ended = True
            self._wake.notify()
        self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            with self._wake:
                while self._latest is None and not self._ended:
                    self._wake.wait()
                if self._latest is None:
                    return
                state, self._latest = self._latest, None
            try:
                self.screen.show(state)
            except Exception as error:  # of a terminal that was closed: the loop is to know, and to stop
                with self._wake:
                    self._failure = str(error) or type(error).__name__
                return
            with self._wake:
                self._busy_since = None if self._latest is None else self._now()


def format_state(state: DriveState) -> list[str]:
    """The state of a drive in a few lines."""
    tip = ", ".join(format_number(float(x), "mm", 4) for x in state.tip)
    variances = np.linalg.eigvalsh(state.tip_covariance)[::-1]
    axes = " × ".join(f"{from_si(length, 'µm'):.1f}" for length in semi_axes(variances))
    share = state.tip_radius / state.tolerance
    velocity, wanted = (
        ", ".join(format_number(float(x), "µm", 1) for x in of)
        for of in (state.tip_velocity, state.wanted_velocity)
    )
    joints = [
        f"joint {joint} {format_joint(state, joint)} (95 %), {format_count(state.steps[joint - 1])} steps"
        for joint in JOINTS
    ]
    return [
        f"{state.time:8.1f} s  {state.status}",
        f"tip     ({tip}) mm",
        f"        within {format_um(state.tip_radius)} of {format_um(state.tolerance)} (95 %) {_bar(share)}",
        f"        95 % ellipsoid, semi-axes {axes} µm",
        f"speed   ({velocity}) µm/s of ({wanted}) wanted",
        *joints,
        f"advice  {format_advice(state) or NO_ADVICE}",
        f"limits  {'; '.join(state.limits) or 'none'}",
        f"        {state.message}",
    ]


def format_line(state: DriveState) -> str:
    """The state of a drive in one line."""
    tip = ", ".join(format_number(float(x), "mm", 4) for x in state.tip)
    parts = [f"{state.time:.1f} s", state.status, f"tip ({tip}) mm", f"within {format_um(state.tip_radius)}"]
    if state.advice is not None:
        parts.append(format_advice(state))
    return "  ".join([*parts, *state.limits, *([state.message] if state.message else [])])


def format_advice(state: DriveState) -> str:
    """What the advice says, in words; empty where there is none."""
    advice = state.advice
    if advice is None:
        return ""
    exceeded = state.tip_radius >= state.tolerance or not advice.steps_left
    within = (
        "now: the tolerance is exceeded" if exceeded else f"within {pluralize(advice.steps_left, 'step')}"
    )
    stop = f"the {format_direction(advice.direction)} stop of joint {advice.joint}"
    return f"Go back to {stop} {within}. It is about {pluralize(advice.steps_to_stop, 'step')} away."


def format_joint(state: DriveState, joint: int) -> str:
    """A joint's position with its 95 % error.

    Examples
    --------
    >>> zero = np.zeros(3)
    >>> tip = (zero, np.eye(3), 0.0, 1e-5, zero, zero)
    >>> rest = DriveState(0.0, "idle", zero, np.array([0.0, 2e-6, 0.0]), *tip, steps=(0, 0, 0))
    >>> format_joint(rest, 2)
    '0.0000 deg ± 4 µrad'
    """
    unit, fine, decimals = ("mm", "µm", 2) if joint == PRISMATIC else ("deg", "µrad", 0)
    error = format_value(Z_95 * float(state.q_error[joint - 1]), fine, decimals)
    return f"{format_value(float(state.q[joint - 1]), unit, 4)} ± {error}"


def format_count(steps: int) -> str:
    """A signed count of steps."""
    return f"{steps:+,}".replace("-", "−")


def format_um(value: float) -> str:
    """A length in µm, to a tenth."""
    return format_value(value, "µm", 1)


def _bar(share: float) -> str:
    full = min(round(20 * share), 20)
    return f"[{'#' * full}{'.' * (20 - full)}]"
