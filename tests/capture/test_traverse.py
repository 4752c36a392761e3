"""A drive to the stop, with a controller and an ear that do as they are told."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from stickslip_fit.capture.protocols import Detection, VirtualClock
from stickslip_fit.capture.traverse import DriveTarget, Rig, drive_steps, drive_to_stop

WAY = DriveTarget(3, "-", 5, max_steps=1000, max_seconds=1e9)


@dataclass
class Controller:
    made: list[tuple[int, int]] = field(default_factory=list)
    stops: int = 0

    def step(self, joint, steps):
        self.made.append((joint, steps))

    def stop(self):
        self.stops += 1


@dataclass
class Ear:
    """Hears the stop at its check number `at`, and first heard it so many checks before."""

    at: int
    late: int = 0
    fault: str = ""
    checks: int = 0

    def begin(self):
        self.checks = 0

    def check(self, seconds):
        self.checks += 1
        there = self.checks == self.at
        return Detection(there, 10.0, self.fault if there else "", self.late if there else 0)


class Watch:
    def commanding(self, steps):
        pass

    def heard(self, steps, heard):
        pass

    def stop_wanted(self):
        return False


def drive(ear, how=drive_to_stop, **more):
    controller = Controller()
    return how(Rig(controller, ear, VirtualClock()), WAY, watch=Watch(), **more), controller


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_stop_that_is_believed_late_is_counted_to_where_it_was_first_heard(late):
    found, controller = drive(Ear(at=40, late=late))
    assert (found.status, found.steps, found.pushed) == ("ok", 200 - 5 * late, 5 * late)
    assert controller.made == [(3, -5)] * 40


def test_a_stop_met_on_the_way_is_told_from_the_way_that_was_asked_for():
    met, _ = drive(Ear(at=10, late=1), drive_steps, steps=50)
    free, _ = drive(Ear(at=99), drive_steps, steps=52)
    assert (met.steps, free.steps) == (45, 52)


def test_a_fault_of_the_ear_ends_the_drive_at_once():
    found, controller = drive(Ear(at=7, fault="the microphone is dead"))
    assert (found.status, found.steps, found.why) == ("interrupted", 35, "the microphone is dead")
    assert controller.stops == 1
