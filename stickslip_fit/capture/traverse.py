"""One joint driven until its end stop is heard, or for so many steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import repeat
from typing import Literal, Protocol

from stickslip_fit.capture.clock import Clock
from stickslip_fit.capture.controller import Controller, ControllerError, Unplugged
from stickslip_fit.capture.ear import Ear, Heard

AT_ONCE = 20  # steps in one command; whoever presses a key waits no longer than these take


@dataclass(frozen=True)
class Rig:
    """What drives, what listens, and the time they go by."""

    controller: Controller
    ear: Ear
    clock: Clock


@dataclass(frozen=True)
class Way:
    """Where a joint is to go, and what it may not exceed.

    Attributes
    ----------
    joint : int
    direction : {'+', '-'}
    check_every : int
        The stop is listened for after so many steps.
    most_steps : int
        No more steps than that, whatever is heard.
    most_seconds : float
        No longer than that; a command that has been given is waited for.
    """

    joint: int
    direction: str
    check_every: int
    most_steps: int
    most_seconds: float


@dataclass(frozen=True)
class Outcome:
    """What came of a drive.

    Attributes
    ----------
    steps : int
        Commanded, up to the check at which the stop was first heard.
    status : {'ok', 'interrupted'}
    why : str
        Why it was broken off.
    unplugged : bool
        Nothing can be driven until somebody sees to the controller.
    pushed : int
        Steps commanded after that, until the ear was sure: the joint was at its stop already.
    """

    steps: int
    status: Literal["ok", "interrupted"]
    why: str = ""
    unplugged: bool = False
    pushed: int = 0


class Watch(Protocol):
    """Whoever follows a drive."""

    def commanding(self, steps: int) -> None:
        """So many steps will have been commanded in all; they are when this returns, and not if it raises."""

    def heard(self, steps: int, heard: Heard) -> None:
        """What was heard after so many steps."""

    def stop_wanted(self) -> bool:
        """Whether somebody asks for the drive to be broken off, as with a key."""


class _BrokenOffError(Exception):
    def __init__(self, why: str, unplugged: bool = False) -> None:
        self.why = why
        self.unplugged = unplugged
        super().__init__(why)


def drive_to_stop(rig: Rig, way: Way, watch: Watch) -> Outcome:
    """Drive a joint until its stop is heard: one traverse, where it began at the other stop.

    What is counted is honest only from stop to stop. A traverse that began elsewhere or ended by count
    would put the law's own prediction into the log as if it were a reading, so the campaign begins each
    at a stop, the joint's own or one that a person has set, and ends it at one; see `placing`.

    Parameters
    ----------
    rig : Rig
    way : Way
    watch : Watch

    Returns
    -------
    Outcome
        ``interrupted`` where the ear is at fault, the controller refuses, a limit is met or `watch` asks
        for it; the controller has been told to stop then.

    Raises
    ------
    InputError
        From the ear or from `watch`; the controller has been told to stop.
    """
    return _drive(rig, way, watch, repeat(way.check_every))


def drive_steps(rig: Rig, way: Way, steps: int, watch: Watch) -> Outcome:
    """Drive a joint so many steps, to bring it near a position; fewer where it meets a stop before.

    Parameters
    ----------
    rig : Rig
    way : Way
    steps : int
    watch : Watch

    Raises
    ------
    InputError
        As `drive_to_stop`.
    """
    whole, rest = divmod(steps, way.check_every)
    stretches = [way.check_every] * whole + [rest] * (rest > 0)
    return _drive(rig, way, watch, stretches)


def _drive(rig: Rig, way: Way, watch: Watch, stretches: Iterable[int]) -> Outcome:
    """Make one stretch of steps after another until a stop is heard."""
    run = _Run(rig, way, watch)
    try:
        for heard in run.checks(stretches):
            if heard.fault:
                raise _BrokenOffError(heard.fault)
            if heard.at_stop:
                pushed = min(heard.checks_late * way.check_every, run.steps)
                return Outcome(run.steps - pushed, "ok", pushed=pushed)
        return Outcome(run.steps, "ok")
    except _BrokenOffError as broken:
        _stop(rig)
        return Outcome(run.steps, "interrupted", broken.why, broken.unplugged)
    except BaseException:
        _stop(rig)
        raise


def _stop(rig: Rig) -> None:
    with suppress(ControllerError):
        rig.controller.stop()


class _Run:
    """A drive under way."""

    def __init__(self, rig: Rig, way: Way, watch: Watch) -> None:
        self.rig = rig
        self.way = way
        self.watch = watch
        self.steps = 0
        self.began = rig.clock.now()

    def checks(self, stretches: Iterable[int]) -> Iterator[Heard]:
        """Make one stretch of steps after another, and listen after each."""
        self.rig.ear.begin()
        heard_until = self.began
        for stretch in stretches:
            self._make(stretch)
            now = self.rig.clock.now()
            heard = self.rig.ear.check(now - heard_until)
            heard_until = now
            self.watch.heard(self.steps, heard)
            yield heard

    def _make(self, steps: int) -> None:
        for begin in range(0, steps, AT_ONCE):
            command = min(AT_ONCE, steps - begin)
            self._refuse(command)
            self.watch.commanding(self.steps + command)
            self.steps += command
            try:
                self.rig.controller.step(self.way.joint, command if self.way.direction == "+" else -command)
            except ControllerError as error:
                raise _BrokenOffError(str(error), isinstance(error, Unplugged)) from None

    def _refuse(self, command: int) -> None:
        if self.watch.stop_wanted():
            raise _BrokenOffError("stopped by a key")
        if self.steps + command > self.way.most_steps:
            raise _BrokenOffError(f"no stop was heard within the limit of {self.way.most_steps:,} steps")
        if self.rig.clock.now() - self.began > self.way.most_seconds:
            raise _BrokenOffError(
                f"no stop was heard within the limit of {self.way.most_seconds:,.0f} s ({self.steps:,} steps)"
            )
