"""What the verb `capture` does: a rig put together, real or emulated, and a plan gone through at it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path

from stickslip_fit.capture.campaign import Campaign, begin, resume
from stickslip_fit.capture.clock import Clock, RealClock, VirtualClock
from stickslip_fit.capture.controller import Controller
from stickslip_fit.capture.detector import Detector
from stickslip_fit.capture.driver import Safety
from stickslip_fit.capture.ear import Ear
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.emulator import emulate
from stickslip_fit.capture.emulator.person import EmulatedPerson
from stickslip_fit.capture.emulator.truth import Truth
from stickslip_fit.capture.expected import Predictor
from stickslip_fit.capture.journal import Journal
from stickslip_fit.capture.keys import Keys
from stickslip_fit.capture.ledger import Ledger
from stickslip_fit.capture.listening import listen
from stickslip_fit.capture.microphone import Microphone
from stickslip_fit.capture.open_controller import open_controller
from stickslip_fit.capture.person import Person
from stickslip_fit.capture.source import Source
from stickslip_fit.capture.terminal import Terminal, Unattended
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.capture.tune import tune
from stickslip_fit.capture.tuning import Tuning, load_tuning
from stickslip_fit.cli.arguments import reference_law
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Noise, Plan
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.simulate import LawValues, read_law_values

CHECKS = 60  # of a listen: 3 s with 5 steps of 10 ms
BACK = 2 * CHECKS  # checks that take a joint back to the stop it came from, and against it
DRAWN_IN = 3  # the joint that an emulated rig has at its stop when it is switched on


@dataclass(frozen=True, eq=False)
class Job:
    """What is to be captured, and into which log."""

    plan: Plan
    machine: Machine
    log: Path
    going_on: bool
    predictor: Predictor | None
    counting: Predictor | None
    safety: Safety
    conditions: Mapping[str, float]


@dataclass(frozen=True)
class Connection:
    """Where a real rig is."""

    port: str
    dialect: str
    device: str | None


@dataclass(frozen=True, eq=False)
class Emulation:
    """What an emulated rig is to be like."""

    laws: LawValues
    dialect: str
    perfect_ear: bool
    snr_db: float
    seed: int


def capture_real(job: Job, connection: Connection, tuning: Path) -> str:
    """Go through a plan at a controller and a microphone; what there is to say in the end."""
    with (
        at_terminal() as (person, _),
        _opened(job) as (journal, ledger),
        real_rig(connection, job.plan.timing.step_period, person) as (controller, source),
    ):
        rig = Rig(controller, Detector(source, load_tuning(tuning)), RealClock())
        return _capture(job, journal, ledger, rig, person)


def capture_emulated(job: Job, emulation: Emulation, unattended: bool) -> str:
    """Go through a plan at an emulated rig; what there is to say in the end."""
    with _opened(job) as (journal, ledger):
        if unattended:
            return _capture(job, journal, ledger, *emulated_rig(job, emulation, ledger, Unattended()))
        with at_terminal() as (person, _):
            return _capture(job, journal, ledger, *emulated_rig(job, emulation, ledger, person))


@contextmanager
def _opened(job: Job) -> Iterator[tuple[Journal, Ledger]]:
    journal, ledger = resume(job.log) if job.going_on else begin(job.log)
    with journal:
        yield journal, ledger


def _capture(job: Job, journal: Journal, ledger: Ledger, rig: Rig, person: Person) -> str:
    where = (job.plan, job.machine, job.log, journal, ledger, rig, person)
    campaign = Campaign(*where, job.predictor, job.counting, job.safety, job.conditions)
    complete = campaign.run()
    total = job.plan.traverses_per_session * len(job.plan.sessions)
    made = f"{len(ledger.done):,} of {total:,} traverses are done; the log is {job.log}"
    return made if complete else f"{made}; --resume goes on"


@contextmanager
def at_terminal() -> Iterator[tuple[Terminal, Keys]]:
    """The person at this terminal, and their keys."""
    with Keys() as keys:
        yield Terminal(keys), keys


@contextmanager
def real_rig(
    connection: Connection, step_period: float, person: Person
) -> Iterator[tuple[Controller, Source]]:
    """A controller at its port, and a microphone."""
    microphone = Microphone(connection.device)
    try:
        controller = open_controller(connection.port, connection.dialect, person.tell, step_period)
        try:
            yield controller, microphone
        finally:
            controller.close()
    finally:
        microphone.close()


def emulated_rig(job: Job, emulation: Emulation, ledger: Ledger, person: Person) -> tuple[Rig, Person]:
    """An emulated rig, its ear tuned, and a person whose word is carried out there."""
    plan, period = job.plan, job.plan.timing.step_period
    truth = Truth(emulation.laws, job.machine, plan.noise or Noise({}), emulation.seed)
    begins = ledger.last_time or plan.sessions[0].begins.replace(tzinfo=UTC)
    emulator = emulate(truth, emulation.dialect, VirtualClock(begins), period)
    controller, clock = emulator.controller(person.tell), emulator.clock
    emulator.hands.set(**job.conditions)
    emulator.hands.remember(ledger.rows(), clock.today(), clock.now())
    ear: Ear = emulator.perfect_ear()
    if not emulation.perfect_ear:
        microphone = emulator.microphone(Acoustics(emulation.snr_db, period=period))
        tuning = tune_emulated(controller, microphone, clock, plan.check_every)
        person.tell(tuning.conclusion)
        ear = Detector(microphone, tuning)
    return Rig(controller, ear, clock), EmulatedPerson(person, emulator.hands, clock, plan)


def tune_at_rig(connection: Connection, joint: int, check_every: int, step_period: float) -> Tuning:
    """Listen at a real rig, with a person who says when the joint has met its stop."""
    with (
        at_terminal() as (person, keys),
        real_rig(connection, step_period, person) as (controller, microphone),
    ):
        return tune_by_hand(controller, microphone, RealClock(), joint, check_every, keys, person)


def tune_at_nothing(check_every: int, step_period: float, snr_db: float) -> Tuning:
    """Listen at an emulated rig."""
    machine = load_machine()
    truth = Truth(read_law_values(reference_law(), machine), machine, Noise({}), 0)
    emulator = emulate(truth, "new", VirtualClock(), step_period)
    microphone = emulator.microphone(Acoustics(snr_db, period=step_period))
    return tune_emulated(emulator.controller(print), microphone, emulator.clock, check_every)


def tune_emulated(controller: Controller, source: Source, clock: Clock, check_every: int) -> Tuning:
    """Listen to a joint that leaves its stop, and to it as it has come back there."""
    moving = listen(controller, source, clock, DRAWN_IN, CHECKS, check_every)
    controller.step(DRAWN_IN, -BACK * check_every)
    at_stop = listen(controller, source, clock, DRAWN_IN, CHECKS, -check_every)
    return tune(moving, at_stop, source.rate, len(moving) / CHECKS / source.rate)


def tune_by_hand(
    controller: Controller,
    source: Source,
    clock: Clock,
    joint: int,
    check_every: int,
    keys: Keys,
    person: Person,
) -> Tuning:
    """Listen to a joint that moves freely, then to it at its stop, which a person says it has met.

    Raises
    ------
    InputError
        If nobody says so before the joint must have met it.
    """
    person.tell(f"Bring joint {joint} well away from its stops by hand, and be quiet.\n  [Enter listens]")
    keys.key()
    moving = listen(controller, source, clock, joint, CHECKS, check_every)
    person.tell(f"Joint {joint} goes - now.\n  [press a key when it has met its stop]")
    for _ in range(Safety().most_steps // check_every):
        if keys.pressed():
            break
        controller.step(joint, -check_every)
    else:
        raise InputError("nobody said that the joint has met its stop; tune again")
    at_stop = listen(controller, source, clock, joint, CHECKS, -check_every)
    return tune(moving, at_stop, source.rate, len(moving) / CHECKS / source.rate)
