"""What a person sets at an emulated rig is set there as they say so."""

from __future__ import annotations

from datetime import UTC

from stickslip_fit.capture.clock import Clock
from stickslip_fit.capture.ear import Heard
from stickslip_fit.capture.emulator.manipulator import Manipulator
from stickslip_fit.capture.person import Answer, Choice, Person, Reading, Setting, Work
from stickslip_fit.logs.plan import Plan


class EmulatedPerson:
    """Passes everything on to a person, and does with the emulated rig what they have agreed to do.

    Parameters
    ----------
    person : Person
    hands : Manipulator
    clock : Clock
        Goes on while the person sets things and sleeps.
    plan : Plan
        Says when its sessions begin, and how long setting takes.
    """

    def __init__(self, person: Person, hands: Manipulator, clock: Clock, plan: Plan) -> None:
        self.person = person
        self.hands = hands
        self.clock = clock
        self.plan = plan

    def tell(self, text: str) -> None:
        """See `Person.tell`."""
        self.person.tell(text)

    def begin_session(self, label: str) -> Answer:
        """See `Person.begin_session`."""
        answer = self.person.begin_session(label)
        begins = next(each.begins for each in self.plan.sessions if each.label == label)
        self.clock.sleep((begins.replace(tzinfo=UTC) - self.clock.today()).total_seconds())
        self.hands.begin_session(label)
        self.hands.set(**answer.conditions)
        return answer

    def set_up(self, wanted: Setting, before: Setting | None) -> Answer:
        """See `Person.set_up`."""
        answer = self.person.set_up(wanted, before)
        self.hands.set(**answer.conditions)
        if answer.choice is Choice.GO_ON:
            self.clock.sleep(sum(self.plan.timing.pause) / 2)
            self.hands.set(theta=wanted.theta, psi=wanted.psi)
            stops = self.hands.truth.machine.ranges | {joint: ends for joint, *ends in wanted.stops}
            for joint, (low, high) in stops.items():
                self.hands.set_stops(joint, low, high)
        return answer

    def bring(self, joint: int, position: float) -> Answer:
        """See `Person.bring`."""
        answer = self.person.bring(joint, position)
        self.hands.set(**answer.conditions)
        if answer.choice is Choice.GO_ON:
            self.hands.set(**{f"q{joint}": position})
        return answer

    def begins(self, work: Work) -> None:
        """See `Person.begins`."""
        self.person.begins(work)

    def progress(self, work: Work, steps: int, heard: Heard) -> None:
        """See `Person.progress`."""
        self.person.progress(work, steps, heard)

    def stop_wanted(self) -> bool:
        """See `Person.stop_wanted`."""
        return self.person.stop_wanted()

    def reading(self, reading: Reading) -> Answer:
        """See `Person.reading`."""
        answer = self.person.reading(reading)
        self.hands.set(**answer.conditions)
        return answer

    def trouble(self, work: Work, why: str) -> Answer:
        """See `Person.trouble`."""
        answer = self.person.trouble(work, why)
        self.hands.set(**answer.conditions)
        return answer
