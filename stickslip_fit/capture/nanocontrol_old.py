"""Kleindiek's NanoControl, old dialect: nothing is answered, so that moves are waited out."""

from __future__ import annotations

from stickslip_fit.capture.coarse import STEP_PERIOD, channel_of, parts_of
from stickslip_fit.capture.line import Line

BAUD = 19_200
END = ";"
# There is no command to stop a move, so that none is sent that takes longer than a person's reaction.
MOST_STEPS = 50
ON_THE_WAY = 0.010  # s; what a command takes to get there at 19200 baud
LISTEN = 0.5  # s


class OldNanoControl:
    """A `Controller` that takes the time of a move for its being carried out.

    Parameters
    ----------
    line : Line
        Whose commands end in `END`.
    step_period : float
        s; what the controller is set to. A shorter one would send steps faster than they are made.
    """

    def __init__(self, line: Line, step_period: float = STEP_PERIOD) -> None:
        self.step_period = step_period
        self._line = line
        self._free_at = line.clock.now()

    def step(self, joint: int, steps: int) -> None:
        """See `Controller.step`; an error of the controller stays unknown."""
        channel = channel_of(joint)
        for part in parts_of(steps, MOST_STEPS):
            self._wait()
            self._free_at = self._line.clock.now() + ON_THE_WAY + abs(part) * self.step_period
            self._line.send(f"coarse {channel} {part:+d}")
            self._wait()

    def stop(self) -> None:
        """Wait for the last command's end, at most `MOST_STEPS` steps: nothing in this dialect stops it."""
        self._wait()

    def version(self) -> str:
        """See `Controller.version`."""
        self._wait()
        # Whatever it has said to earlier commands.
        self._line.everything(0.0)
        self._line.send("version")
        return " ".join(self._line.everything(LISTEN).split())

    def close(self) -> None:
        """See `Controller.close`."""
        self._line.close()

    def _wait(self) -> None:
        self._line.clock.sleep(self._free_at - self._line.clock.now())
