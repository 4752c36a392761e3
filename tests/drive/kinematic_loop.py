"""A loop with nothing but kinematics, in place of a drive: what is wanted moves the tip, and errors grow."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from stickslip_fit.drive.state import DriveState, HomingAdvice, Screen
from stickslip_fit.machine import Machine, forward, jacobian
from stickslip_fit.moves.error_ellipsoid import error_radius

TICK = 0.01  # s
RELATIVE_ERROR = 0.01
HOMING_TICKS = 100
COMMAND_TICKS = 5  # of a joint on its way home, between two looks at the input
STEP_SIZES = np.array([1e-4, 1e-4, 9e-7])  # rad, rad, m


class KinematicLoop:
    """Reads, moves and shows at every tick; keeps when what was wanted changed, by the wall clock."""

    def __init__(self, device: Any, screen: Screen, machine: Machine, q: list[float]) -> None:
        self.device = device
        self.screen = screen
        self.machine = machine
        self.q = np.array(q)
        self.moved = np.zeros(3)
        self.error = np.zeros(3)
        self.ticks = 0
        self.changes: list[tuple[float, Any]] = [(time.time(), None)]
        self.ends = False

    def tick(self) -> None:
        """One tick."""
        wanted = self.device.read(self.ticks * TICK)
        self.ends = wanted.ends
        velocity = np.zeros(3) if wanted.tip_velocity is None else wanted.tip_velocity
        what = wanted.home or (tuple(velocity) if velocity.any() else None)
        self._note(what)
        if wanted.home:
            self._go_home()
            self._note(None)
            return
        matrix = jacobian(self.machine, self.q)
        damped = matrix.T @ np.linalg.inv(matrix @ matrix.T + 1e-10 * np.eye(3))
        moved = damped @ velocity * TICK
        self.q = self.q + moved
        self.moved += moved
        self.error = RELATIVE_ERROR * np.abs(self.moved)
        self.ticks += 1
        self.screen.show(self.state("moving" if velocity.any() else "idle", velocity))

    def _go_home(self) -> None:
        """In one go, as a drive's loop does; nothing is read meanwhile but whether to stop."""
        for tick in range(HOMING_TICKS):
            if tick % COMMAND_TICKS == 0 and self.device.interrupts(self.ticks * TICK):
                return
            self.ticks += 1
            self.screen.show(self.state("homing", np.zeros(3)))
            time.sleep(TICK)

    def _note(self, what: Any) -> None:
        if what != self.changes[-1][1]:
            self.changes.append((time.time(), what))

    def state(self, status: str, velocity: Any) -> DriveState:
        """The state after this tick."""
        matrix = jacobian(self.machine, self.q)
        covariance = matrix @ np.diag(self.error**2 + 1e-16) @ matrix.T
        radius, tolerance = float(error_radius(covariance)), 10e-6
        steps = np.rint(self.moved / STEP_SIZES).astype(int)
        return DriveState(
            *(self.ticks * TICK, status, self.q, self.error, forward(self.machine, self.q), covariance),
            *(radius, tolerance, velocity, velocity, (int(steps[0]), int(steps[1]), int(steps[2]))),
            advice=HomingAdvice(2, "-", 8240, 120) if radius > 0.5 * tolerance else None,
        )


@contextmanager
def running(loop: KinematicLoop) -> Iterator[None]:
    """Tick by the real clock in a thread."""
    ending = threading.Event()

    def run() -> None:
        while not ending.is_set() and not loop.ends:
            loop.tick()
            time.sleep(TICK)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()
