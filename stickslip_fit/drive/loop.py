"""The loop of a drive: what is wanted becomes steps, tick by tick. Start reading here.

In each tick the wanted tip velocity becomes joint velocities (`velocity`), all scaled together to what the
controller can make; soft limits stop what would take a joint to where it may stand at its stop already; whole
steps follow by error diffusion (`diffusion`). Each burst is recorded before it is commanded (`record`), and
`DriveReckoning` follows it. Going home (`homing`) is a drive of its own, in commands of five steps.

A tick takes 10 ms, or as long as its steps take: a controller makes one joint's steps after the other's, a
step in each of its periods, and returns when they are made. Nothing is ever commanded for longer than a tick,
and time that a stalled program has missed is not made up for: whatever stalls, the joints stand still
after the tick that was commanded.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.capture.protocols import STEP_PERIOD, Clock, Controller, ControllerError
from stickslip_fit.drive.advice import advise_homing
from stickslip_fit.drive.diffusion import Burst, StepDiffusion
from stickslip_fit.drive.record import BurstRecord
from stickslip_fit.drive.state import DriveState, InputDevice, Screen, VelocityInput
from stickslip_fit.drive.velocity import DAMPED_WITHIN, Triple, axis_distance, joint_velocity, tip_velocity
from stickslip_fit.errors import InputError
from stickslip_fit.machine import forward
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.units import JOINTS, Z_95

TICK = 0.010  # s
SHOW_INTERVAL = 0.1  # s
MAX_SCREEN_AGE = 0.2  # s without a sign of life of the screen, of two that it is due; then nothing moves
AT_REST = (0.0, 0.0, 0.0)
RATE_TOL = 1e-9


@dataclass(frozen=True)
class StepTiming:
    """How long steps take, s: each step, and in addition each command."""

    step_period: float = STEP_PERIOD
    command: float = 0.0

    @property
    def max_rate(self) -> float:
        """Steps per second of all joints together, commanded one by one."""
        return 1.0 / (self.step_period + self.command)

    @property
    def slots(self) -> int:
        """Steps that a tick has room for, at least one."""
        return max(int((TICK - self.command) / self.step_period + RATE_TOL), 1)


Homing = Callable[[int], str]
"""Brings a joint to its nearest stop; returns what happened, as a sentence."""


class DriveLoop:
    """A drive from its first tick to its last.

    Parameters
    ----------
    drive : DriveReckoning
    controller : Controller
    clock : Clock
    device : InputDevice
    screen : Screen
    record : BurstRecord
    tolerance : float
        The largest 95 % radius of the tip that the user accepts, m.
    timing : StepTiming, optional
    screen_age : callable, optional
        Seconds since the screen showed that it is alive; none for one that cannot stall.

    Attributes
    ----------
    commanded_tip : list of float
        Where the tip would be had it followed the velocities as commanded, base frame, m.
    """

    def __init__(
        self,
        drive: DriveReckoning,
        controller: Controller,
        clock: Clock,
        device: InputDevice,
        screen: Screen,
        record: BurstRecord,
        tolerance: float,
        timing: StepTiming | None = None,
        screen_age: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.drive = drive
        self.controller = controller
        self.clock = clock
        self.device = device
        self.screen = screen
        self.record = record
        self.tolerance = tolerance
        self.timing = timing or StepTiming()
        self.screen_age = screen_age
        self.homing: Homing | None = None
        self.began = clock.now() - record.seconds
        self.diffusion = StepDiffusion(drive.q, self._step_size, self.timing.slots)
        self.commanded_tip = [float(x) for x in forward(drive.arm.machine, drive.q)]
        self.status, self.message = "idle", ""
        self._wanted = VelocityInput()
        self._velocity: Triple = AT_REST
        self._rates: Triple = AT_REST
        self._limits: tuple[str, ...] = ()
        self._last_tick = clock.now() - TICK
        self._shown_at = -np.inf
        self._dead = False

    @property
    def seconds(self) -> float:
        """Time since the drive began, s."""
        return self.clock.now() - self.began

    @property
    def screen_is_frozen(self) -> bool:
        """Whether the screen does not show what happens, so that nothing may move."""
        return self.screen_age() > MAX_SCREEN_AGE

    def run(self) -> DriveState:
        """Drive until the input ends or the connection is lost; the state at the end.

        Raises
        ------
        InputError
            From the journal; nothing moves then.
        """
        try:
            while self.tick():
                self.clock.sleep(self._last_tick + TICK - self.clock.now())
            if not self._dead:
                self._come_to_rest()
        except KeyboardInterrupt:
            self._stop("stopped by Ctrl-C")
            with suppress(ControllerError):
                self.controller.stop()
        finally:
            self.record.rest(self.drive, self.seconds)
        state = self.state()
        self.screen.show(state)
        return state

    def tick(self) -> bool:
        """Command what is wanted for one tick at most; whether the drive goes on."""
        now = self.clock.now()
        elapsed = min(now - self._last_tick, max(TICK, 2.0 / self.timing.max_rate))
        self._last_tick = now
        wanted = self.device.read(now)
        if wanted.ends or self._dead:
            return False
        self._wanted = wanted
        if wanted.home is not None and now < wanted.valid_until:
            self._go_home(wanted.home)
        else:
            self._move(self._wanted_rates(wanted, now), elapsed)
        self.show()
        return not self._dead

    def show(self) -> None:
        """Show the state, unless it was shown a moment ago."""
        now = self.clock.now()
        if now - self._shown_at >= SHOW_INTERVAL:
            self._shown_at = now
            self.screen.show(self.state())

    def state(self) -> DriveState:
        """The drive as it is now."""
        drive, wanted = self.drive, self._wanted
        pose = drive.pose()
        velocity = AT_REST
        if wanted.tip_velocity is not None:
            velocity = _triple(wanted.tip_velocity)
        elif wanted.joint_velocity is not None:
            velocity = tip_velocity(drive.arm.machine, drive.q, _triple(wanted.joint_velocity))
        return DriveState(
            time=self.seconds,
            status=self.status,
            q=pose.q,
            q_error=pose.q_error,
            tip=pose.tip,
            tip_covariance=pose.tip_covariance,
            tip_radius=pose.tip_radius,
            tolerance=self.tolerance,
            wanted_velocity=np.array(velocity),
            tip_velocity=np.array(self._velocity),
            steps=(self.record.steps[0], self.record.steps[1], self.record.steps[2]),
            limits=self._limits,
            advice=advise_homing(drive, self.seconds, self._rates, self.tolerance),
            message=self.message,
        )

    def _step_size(self, joint: int, direction: str) -> float:
        return self.drive.step_size(joint, direction, self._last_tick - self.began)

    def _wanted_rates(self, wanted: VelocityInput, now: float) -> Triple:
        """Joint velocities as asked for; none once they are no longer valid, or the screen is frozen."""
        tip, joints = wanted.tip_velocity, wanted.joint_velocity
        if now >= wanted.valid_until or (tip is None and joints is None):
            return AT_REST
        if self.screen_is_frozen:
            self._stop("the screen is frozen: nothing moves until it is back")
            return AT_REST
        if tip is not None:
            return joint_velocity(self.drive.arm.machine, self.diffusion.target, _triple(tip))
        assert joints is not None
        return _triple(joints)

    def _move(self, rates: Triple, elapsed: float) -> None:
        self._limits = ()
        machine, target = self.drive.arm.machine, self.diffusion.target
        wanted = self._wanted.tip_velocity
        if wanted is not None and any(wanted) and abs(axis_distance(machine, target)) < DAMPED_WITHIN:
            self._limits = ("the tip is near the axis of joint 1, where it cannot follow sideways",)
        if not any(rates):
            self._come_to_rest()
            return
        try:
            rates = self._slow_down(rates)
        except InputError as error:
            self._come_to_rest()
            self._stop(str(error))
            return
        displacement = [rate * elapsed for rate in rates]
        if blocked := self._soft_limit(displacement):
            self._come_to_rest()
            self._limits = (blocked,)
            self._stop(f"{blocked}: drive the other way, or home that joint")
            return
        if self.status == "stopped":
            self.message = ""
        self.status = "moving"
        self._rates, self._velocity = AT_REST, AT_REST
        if self.diffusion.advance(self.drive.q, displacement):
            self._rates, self._velocity = rates, tip_velocity(machine, target, rates)
            for axis in range(3):
                self.commanded_tip[axis] += self._velocity[axis] * elapsed
        for burst in self.diffusion.bursts(self.drive.q):
            self._command(burst)
            if self._dead:
                return

    def _slow_down(self, rates: Triple) -> Triple:
        """All joints scaled together to what the controller can make, one joint's step after another's.

        Raises InputError where a joint that is to move has no law in both directions, or stalls.
        """
        needed = 0.0
        for joint, rate in zip(JOINTS, rates, strict=True):
            if rate:
                onwards, back = ("+", "-") if rate > 0 else ("-", "+")
                self._step_size(joint, back)
                needed += abs(rate) / self._step_size(joint, onwards)
        if needed <= self.timing.max_rate * (1.0 + RATE_TOL):
            return rates
        share = self.timing.max_rate / needed
        self._limits += (f"slowed down to {100 * share:.0f} % by the controller's step rate",)
        return rates[0] * share, rates[1] * share, rates[2] * share

    def _soft_limit(self, displacement: list[float]) -> str:
        """Which joint would come to where it may stand at its stop; empty for none."""
        for joint, change in zip(JOINTS, displacement, strict=True):
            if not change:
                continue
            low, high = self.drive.arm.machine.ranges[joint]
            margin = Z_95 * self.drive.variance(joint) ** 0.5
            margin += self._step_size(joint, "+" if change > 0 else "-")
            position = self.drive.q[joint - 1]
            if position + margin > high if change > 0 else position - margin < low:
                return f"joint {joint} is at its soft limit"
        return ""

    def _command(self, burst: Burst) -> None:
        """Record a burst, command it, and follow it."""
        joint, seconds = burst.joint, self.seconds
        self.record.burst(burst, self.drive, seconds)
        moved = self.drive.advance(joint, burst.direction, burst.steps, seconds)
        try:
            self.controller.step(joint, burst.signed_steps)
        except BaseException as error:
            self.drive.doubt(joint, moved)
            if not isinstance(error, ControllerError):
                raise
            self._dead = True
            self._stop(f"{error}; the last burst of joint {joint} may or may not have been made")
            self._velocity = self._rates = AT_REST

    def _come_to_rest(self) -> None:
        if self._rates != AT_REST or self.status == "moving":
            self.diffusion.settle(self.drive.q)
            self.record.rest(self.drive, self.seconds)
        self._rates, self._velocity = AT_REST, AT_REST
        if self.status == "moving":
            self.status = "idle"

    def _go_home(self, joint: int) -> None:
        self._come_to_rest()
        if self.homing is None:
            self._stop("a stop can be found only with a tuned microphone: give --tuning")
            return
        self.status, self.message = "homing", f"joint {joint} goes to its stop"
        self.screen.show(self.state())
        try:
            self.message = self.homing(joint)
            self.status = "idle"
        except ControllerError as error:
            self._dead = True
            self._stop(str(error))
        except InputError as error:
            self._stop(str(error))
        self.diffusion.settle(self.drive.q, joint)
        self.commanded_tip = [float(x) for x in forward(self.drive.arm.machine, self.diffusion.target)]
        self.record.rest(self.drive, self.seconds)

    def _stop(self, message: str) -> None:
        self.status, self.message = "stopped", message


def _triple(values: Array) -> Triple:
    """Plain floats, which are several times as fast as numpy's."""
    return float(values[0]), float(values[1]), float(values[2])
