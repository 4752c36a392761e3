"""A drive to the stop, with a controller and a detector that follow a script."""

from dataclasses import dataclass, field

import pytest

from stickslip_fit.capture.protocols import Detection, VirtualClock
from stickslip_fit.capture.traverse import DriveTarget, Rig, drive_steps, drive_to_stop

TARGET = DriveTarget(3, "-", 5, max_steps=1000, max_seconds=1e9)


@dataclass
class Controller:
    made: list[tuple[int, int]] = field(default_factory=list)
    stops: int = 0

    def step(self, joint, steps):
        self.made.append((joint, steps))

    def stop(self):
        self.stops += 1


@dataclass
class Detector:
    """Reports the stop at its check number `at`, first detected `late` checks before."""

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


class Observer:
    def before_command(self, steps):
        pass

    def detected(self, steps, detection):
        pass

    def stop_wanted(self):
        return False


def drive(detector, how=drive_to_stop, **more):
    controller = Controller()
    return how(Rig(controller, detector, VirtualClock()), TARGET, observer=Observer(), **more), controller


@pytest.mark.parametrize("late", [0, 1, 2])
def test_a_stop_that_is_believed_late_is_counted_to_where_it_was_first_heard(late):
    outcome, controller = drive(Detector(at=40, late=late))
    assert (outcome.status, outcome.steps, outcome.overrun) == ("ok", 200 - 5 * late, 5 * late)
    assert controller.made == [(3, -5)] * 40


def test_steps_end_at_a_stop_met_before():
    met, _ = drive(Detector(at=10, late=1), drive_steps, steps=50)
    free, _ = drive(Detector(at=99), drive_steps, steps=52)
    assert (met.steps, free.steps) == (45, 52)


def test_a_fault_of_the_detector_ends_the_drive_at_once():
    outcome, controller = drive(Detector(at=7, fault="the microphone is dead"))
    assert (outcome.status, outcome.steps, outcome.reason) == ("interrupted", 35, "the microphone is dead")
    assert controller.stops == 1
