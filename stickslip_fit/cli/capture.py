"""Commands at the rig: capture, capture tune, capture listen; at a real or an emulated rig."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC
from math import nan
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from typer.core import TyperGroup

from stickslip_fit._io import check_folder
from stickslip_fit.capture.audio import Microphone
from stickslip_fit.capture.campaign import Campaign, begin_journal, resume_journal
from stickslip_fit.capture.devices import open_controller
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import EmulatedOperator, emulate_rig
from stickslip_fit.capture.end_stop import SequentialDetector
from stickslip_fit.capture.journal import Journal, JournalReplay
from stickslip_fit.capture.operator import (
    CountPredictor,
    Keyboard,
    Operator,
    TerminalOperator,
    UnattendedOperator,
)
from stickslip_fit.capture.protocols import (
    AudioSource,
    Clock,
    Controller,
    EndStopDetector,
    RealClock,
    VirtualClock,
)
from stickslip_fit.capture.traverse import DriveLimits, Rig
from stickslip_fit.capture.tuning import Tuning, choose_tuning, load_tuning, record_joint
from stickslip_fit.causes import ExtendedLaw, library
from stickslip_fit.cli._options import (
    Device,
    Dialect,
    DialectOption,
    MachinePath,
    PlanPath,
    Port,
    Ratio,
    reference_law,
    reject_options,
    require_option,
)
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.estimation import Result, load_result
from stickslip_fit.logs.plan import Noise, Plan
from stickslip_fit.logs.schema import CONDITIONS
from stickslip_fit.machine import Machine, load_machine
from stickslip_fit.simulation import LawValues, expected_counts, read_law_values
from stickslip_fit.simulation.campaign import INITIAL_HISTORY

TUNING_CHECKS = 60  # of a listen: 3 s with 5 steps of 10 ms
RETURN_CHECKS = 2 * TUNING_CHECKS  # checks that take a joint back to the stop it came from, and against it
RETRACTED_JOINT = 3  # the joint that an emulated rig has at its stop when it is switched on


@dataclass(frozen=True, eq=False)
class CaptureJob:
    """What is to be captured, and into which log."""

    plan: Plan
    machine: Machine
    log: Path
    resuming: bool
    predictor: CountPredictor | None
    counting: CountPredictor | None
    drive_limits: DriveLimits
    conditions: Mapping[str, float]


@dataclass(frozen=True)
class RigConnection:
    """Where a real rig is."""

    port: str
    dialect: str
    device: str | None


@dataclass(frozen=True, eq=False)
class EmulationOptions:
    """What an emulated rig is to be like."""

    laws: LawValues
    dialect: str
    perfect_ear: bool
    snr_db: float
    seed: int


def capture_real(job: CaptureJob, connection: RigConnection, tuning: Path) -> str:
    """Go through a plan at a controller and a microphone; what there is to say in the end."""
    with (
        make_terminal_operator() as (operator, _),
        _open_journal(job) as (journal, ledger),
        open_rig(connection, job.plan.timing.step_period, operator) as (controller, source),
    ):
        rig = Rig(controller, SequentialDetector(source, load_tuning(tuning)), RealClock())
        return _capture(job, journal, ledger, rig, operator)


def capture_emulated(job: CaptureJob, emulation: EmulationOptions, unattended: bool) -> str:
    """Go through a plan at an emulated rig; what there is to say in the end."""
    with _open_journal(job) as (journal, ledger):
        if unattended:
            return _capture(
                job, journal, ledger, *make_emulated_rig(job, emulation, ledger, UnattendedOperator())
            )
        with make_terminal_operator() as (operator, _):
            return _capture(job, journal, ledger, *make_emulated_rig(job, emulation, ledger, operator))


@contextmanager
def _open_journal(job: CaptureJob) -> Iterator[tuple[Journal, JournalReplay]]:
    journal, ledger = resume_journal(job.log) if job.resuming else begin_journal(job.log)
    with journal:
        yield journal, ledger


def _capture(job: CaptureJob, journal: Journal, ledger: JournalReplay, rig: Rig, operator: Operator) -> str:
    where = (job.plan, job.machine, job.log, journal, ledger, rig, operator)
    campaign = Campaign(*where, job.predictor, job.counting, job.drive_limits, job.conditions)
    complete = campaign.run()
    total = job.plan.traverses_per_session * len(job.plan.sessions)
    made = f"{len(ledger.finished):,} of {total:,} traverses are done; the log is {job.log}"
    return made if complete else f"{made}; --resume goes on"


@contextmanager
def make_terminal_operator() -> Iterator[tuple[TerminalOperator, Keyboard]]:
    """The person at this terminal, and their keys."""
    with Keyboard() as keys:
        yield TerminalOperator(keys), keys


@contextmanager
def open_rig(
    connection: RigConnection, step_period: float, operator: Operator
) -> Iterator[tuple[Controller, AudioSource]]:
    """A controller at its port, and a microphone."""
    microphone = Microphone(connection.device)
    try:
        controller = open_controller(connection.port, connection.dialect, operator.tell, step_period)
        try:
            yield controller, microphone
        finally:
            controller.close()
    finally:
        microphone.close()


def make_emulated_rig(
    job: CaptureJob, emulation: EmulationOptions, ledger: JournalReplay, operator: Operator
) -> tuple[Rig, Operator]:
    """An emulated rig, its ear tuned, and a person whose word is carried out there."""
    plan, period = job.plan, job.plan.timing.step_period
    truth = HiddenLaws(emulation.laws, job.machine, plan.noise or Noise({}), emulation.seed)
    begins = ledger.last_time or plan.sessions[0].begins.replace(tzinfo=UTC)
    emulator = emulate_rig(truth, emulation.dialect, VirtualClock(begins), period)
    controller, clock = emulator.controller(operator.tell), emulator.clock
    emulator.hands.set(**job.conditions)
    emulator.hands.remember(ledger.rows(), clock.today(), clock.now())
    ear: EndStopDetector = emulator.perfect_ear()
    if not emulation.perfect_ear:
        microphone = emulator.microphone(Acoustics(emulation.snr_db, period=period))
        tuning = tune_emulated(controller, microphone, clock, plan.check_every)
        operator.tell(tuning.conclusion)
        ear = SequentialDetector(microphone, tuning)
    return Rig(controller, ear, clock), EmulatedOperator(operator, emulator.hands, clock, plan)


def tune_at_rig(connection: RigConnection, joint: int, check_every: int, step_period: float) -> Tuning:
    """Listen at a real rig, with a person who says when the joint has met its stop."""
    with (
        make_terminal_operator() as (operator, keys),
        open_rig(connection, step_period, operator) as (controller, microphone),
    ):
        return tune_by_hand(controller, microphone, RealClock(), joint, check_every, keys, operator)


def tune_at_emulated_rig(check_every: int, step_period: float, snr_db: float) -> Tuning:
    """Listen at an emulated rig."""
    machine = load_machine()
    truth = HiddenLaws(read_law_values(reference_law(), machine), machine, Noise({}), 0)
    emulator = emulate_rig(truth, "new", VirtualClock(), step_period)
    microphone = emulator.microphone(Acoustics(snr_db, period=step_period))
    return tune_emulated(emulator.controller(print), microphone, emulator.clock, check_every)


def tune_emulated(controller: Controller, source: AudioSource, clock: Clock, check_every: int) -> Tuning:
    """Listen to a joint that leaves its stop, and to it as it has come back there."""
    moving = record_joint(controller, source, clock, RETRACTED_JOINT, TUNING_CHECKS, check_every)
    controller.step(RETRACTED_JOINT, -RETURN_CHECKS * check_every)
    at_stop = record_joint(controller, source, clock, RETRACTED_JOINT, TUNING_CHECKS, -check_every)
    return choose_tuning(moving, at_stop, source.rate, len(moving) / TUNING_CHECKS / source.rate)


def tune_by_hand(
    controller: Controller,
    source: AudioSource,
    clock: Clock,
    joint: int,
    check_every: int,
    keys: Keyboard,
    operator: Operator,
) -> Tuning:
    """Listen to a joint that moves freely, then to it at its stop, which a person says it has met.

    Raises
    ------
    InputError
        If nobody says so before the joint must have met it.
    """
    operator.tell(f"Bring joint {joint} well away from its stops by hand, and be quiet.\n  [Enter listens]")
    keys.key()
    moving = record_joint(controller, source, clock, joint, TUNING_CHECKS, check_every)
    operator.tell(f"Joint {joint} goes - now.\n  [press a key when it has met its stop]")
    for _ in range(DriveLimits().max_steps // check_every):
        if keys.pressed():
            break
        controller.step(joint, -check_every)
    else:
        raise InputError("nobody said that the joint has met its stop; tune again")
    at_stop = record_joint(controller, source, clock, joint, TUNING_CHECKS, -check_every)
    return choose_tuning(moving, at_stop, source.rate, len(moving) / TUNING_CHECKS / source.rate)


CheckEvery = Annotated[int, typer.Option(min=1, help="Steps between two checks, as in the plan.")]
StepPeriod = Annotated[float, typer.Option(min=0.1, help="Of the controller, ms.")]


def tune(
    output: Annotated[Path, typer.Option("-o", "--output", help="Tuning to write, for `--tuning`.")],
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    joint: Annotated[int, typer.Option(min=1, max=3, help="Which joint to listen to.")] = 3,
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
    moving: Annotated[Path | None, typer.Option(help="A recording of the moving joint, not a rig.")] = None,
    at_stop: Annotated[Path | None, typer.Option(help="With --moving: one of it at its stop.")] = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    snr: Ratio = 12.0,
    chart: Annotated[
        Path | None, typer.Option(help="Also draw both spectra here: .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Listen to a joint moving and at its stop; say where the stop is heard best, and how well."""
    from stickslip_fit.cli.diagnose import check_plan_outputs

    check_folder(output)
    check_plan_outputs(None, chart)

    from stickslip_fit.capture.tuning import save_tuning
    from stickslip_fit.units import to_si

    period = to_si(step_period, "ms")
    at_rig = {"--port": port, "--device": device}
    if emulate:
        reject_options(at_rig | {"--moving": moving, "--at-stop": at_stop}, "at an emulated rig")
        found = tune_at_emulated_rig(check_every, period, snr)
    elif moving or at_stop:
        reject_options(at_rig, "beside recordings")
        found = _tune_from_recordings(
            require_option(moving, "--moving"), require_option(at_stop, "--at-stop"), check_every * period
        )
    else:
        at = require_option(
            port, "--port; or recordings, with --moving and --at-stop; or try it with --emulate"
        )
        found = tune_at_rig(RigConnection(at, dialect.value, device), joint, check_every, period)
    save_tuning(found, output)
    print(f"{found.conclusion}\n\nsaved to {output}")
    if chart is not None:
        from stickslip_fit.plotting._style import write_figure
        from stickslip_fit.plotting.strategies import plot_spectrum

        write_figure(plot_spectrum(found), chart, "spectrum")
        print(f"chart written to {chart}")


def listen(
    recording: Annotated[Path, typer.Argument(help="WAV file of one traverse.", show_default=False)],
    tuning: Annotated[Path, typer.Option(help="What `capture tune` wrote.")],
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
) -> None:
    """Say where in a recording the ear hears the stop."""
    from stickslip_fit.capture.audio import read_wav
    from stickslip_fit.capture.end_stop import SequentialDetector
    from stickslip_fit.capture.tuning import load_tuning
    from stickslip_fit.units import to_si

    sound = read_wav(recording)
    detector = SequentialDetector(sound, load_tuning(tuning))
    seconds = check_every * to_si(step_period, "ms")
    detector.begin()
    checks = int(len(sound.values) / sound.rate / seconds)
    for check in range(1, checks + 1):
        heard = detector.check(seconds)
        at = f"at {check * seconds:.2f} s (check {check:,} of {checks:,})"
        if heard.at_stop:
            steps = (check - heard.late_checks) * check_every
            print(f"the stop is heard {at}, {heard.level:+.1f} dB; that makes a count of {steps:,} steps")
            return
        if heard.fault:
            print(f"broken off {at}: {heard.fault}")
            return
    print(f"no stop is heard in {checks * seconds:.1f} s ({checks:,} checks)")


def _tune_from_recordings(moving: Path, at_stop: Path, seconds: float) -> Tuning:
    from stickslip_fit.capture.audio import read_wav
    from stickslip_fit.capture.tuning import choose_tuning as tuned
    from stickslip_fit.errors import InputError, InputIssue

    freely, pushing = read_wav(moving), read_wav(at_stop)
    if freely.rate != pushing.rate:
        message = (
            f"has {pushing.rate:,} samples per second and {moving} has {freely.rate:,}; record both alike"
        )
        raise InputError(InputIssue(message, str(at_stop)))
    return tuned(freely.values, pushing.values, freely.rate, seconds)


DEFAULT_COMMAND = "plan"  # the command that is meant where none is named


class _DefaultToPlan(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = [DEFAULT_COMMAND, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_DefaultToPlan,
    no_args_is_help=True,
    help="Drive the joints, hear the end stops, write the log. `capture PLAN` is `capture plan PLAN`.",
)

app.command()(tune)
app.command()(listen)


@app.command(DEFAULT_COMMAND)
def plan(
    plan: PlanPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write; the journal goes beside it.")],
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    tuning: Annotated[Path | None, typer.Option(help="What `capture tune` wrote today.")] = None,
    law: Annotated[
        Path | None,
        typer.Option(help="Law file (TOML) or saved result (JSON) that says what each count should be."),
    ] = None,
    by_count: Annotated[
        bool,
        typer.Option(
            "--by-count", help="Let the law bring joints to where there is no stop, not the person's hand."
        ),
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an earlier capture ended.")] = False,
    condition: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=NUMBER", help="Holds as a session begins: temperature_C=22; repeatable."),
    ] = None,
    most_steps: Annotated[int, typer.Option(min=1, help="No drive makes more steps than that.")] = 60_000,
    machine: MachinePath = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    hide: Annotated[
        list[str] | None,
        typer.Option(metavar="CAUSE", help="Emulated: a cause at work, e.g. thermal-warm-up; repeatable."),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Emulated: law file by which the joints truly step, causes and all.")
    ] = None,
    snr: Ratio = 12.0,
    perfect_ear: Annotated[
        bool, typer.Option("--perfect-ear", help="Emulated: know the stop instead of listening; quicker.")
    ] = False,
    unattended: Annotated[
        bool, typer.Option("--unattended", help="Emulated: take every question as answered.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Emulated: of the noise.")] = 0,
) -> None:
    """Go through a plan: drive, listen, write down, again and again."""
    of_real = {"--port": port, "--tuning": tuning, "--device": device}
    of_emulated = {"--hide": hide, "--truth": truth, "--perfect-ear": perfect_ear, "--unattended": unattended}
    if emulate:
        reject_options(of_real, "at an emulated rig")
    else:
        reject_options(of_emulated, "at a real rig")
    check_folder(output)

    from stickslip_fit.capture.operator import parse_conditions
    from stickslip_fit.capture.traverse import DriveLimits
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulation import read_law_values

    chosen = load_machine(machine)
    planned = read_plan(plan, chosen)
    known = law or (reference_law() if emulate else None)
    predictor = load_predictor(known, chosen) if known else None
    if predictor:
        predictor.predict(planned.rows())  # a law under which a joint stalls is said before anything moves
    counting = require_option(predictor, "--law, by which --by-count counts") if by_count else None
    said = parse_conditions(" ".join(condition or ()), "--condition")
    job = CaptureJob(planned, chosen, output, resume, predictor, counting, DriveLimits(most_steps), said)
    if emulate:
        laws = hide_causes(
            read_law_values(truth or reference_law(), chosen), tuple(hide or ()), planned, chosen
        )
        emulation = EmulationOptions(laws, dialect.value, perfect_ear, snr, seed)
        print(capture_emulated(job, emulation, unattended))
    else:
        connection = RigConnection(
            require_option(port, "--port; or try it without hardware, with --emulate"), dialect.value, device
        )
        print(capture_real(job, connection, require_option(tuning, "--tuning, which `capture tune` writes")))


@dataclass(frozen=True)
class LawPredictor:
    """Predicts by known laws; a joint and direction without one has no prediction."""

    laws: LawValues

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """See `Predictor.predict`; how sure it is, is not known."""
        found = pd.DataFrame({"steps": nan, "low": nan, "high": nan}, index=rows.index)
        for (joint, direction), subset in rows.groupby(["joint", "direction"]):
            if (int(str(joint)), str(direction), None) in self.laws.values:
                values, _ = self.laws.of_rows(subset, int(str(joint)))
                found.loc[subset.index, "steps"] = expected_counts(
                    self.laws.laws[int(str(joint))], subset, values
                )
        return found


@dataclass(frozen=True)
class ResultPredictor:
    """Predicts by each joint and direction's latest calibration; without one, there is no prediction."""

    result: Result

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """See `Predictor.predict`."""
        found = pd.DataFrame({"steps": nan, "low": nan, "high": nan}, index=rows.index)
        for (joint, direction), subset in rows.groupby(["joint", "direction"]):
            session = self._latest(int(str(joint)), str(direction))
            if session is not None:
                found.loc[subset.index] = self.result.predict(subset.assign(session=session))[found.columns]
        return found

    def _latest(self, joint: int, direction: str) -> str | None:
        fit = self.result.joints.get(joint)
        if fit is None:
            return None
        known = (fit.groups["direction"] == direction).to_numpy() & fit.known.all(axis=1)
        return str(fit.groups["session"][known].iloc[-1]) if known.any() else None


def load_predictor(path: Path, machine: Machine) -> CountPredictor:
    """Predict by a law file (TOML) or a result saved with ``fit --json``.

    Raises
    ------
    InputError
        If the file is faulty, or the result belongs to another machine.
    """
    if path.suffix != ".json":
        return LawPredictor(read_law_values(path, machine))
    result = load_result(path)
    if result.machine.sha256 != machine.sha256:
        message = f"was fitted for the machine {result.machine.name!r}; pass that with --machine"
        raise InputError(InputIssue(message, str(path)))
    return ResultPredictor(result)


def hide_causes(laws: LawValues, names: tuple[str, ...], plan: Plan, machine: Machine) -> LawValues:
    """Laws with causes in them, each of the size that matters; a law file says any other size.

    Raises
    ------
    InputError
        For a cause that is not known, that looks at what the emulator doesn't have, or if the laws have
        causes in them already.
    """
    if not names:
        return laws
    if any(isinstance(law, ExtendedLaw) for law in laws.laws.values()):
        raise InputError("the law file has causes in it already; leave --hide out, or take them out")
    rows = plan.rows().assign(**INITIAL_HISTORY)
    known = {cause.name: cause for cause in library()}
    causes = []
    for name in names:
        if name not in known or not set(CONDITIONS).isdisjoint(known[name].columns):
            possible = [each for each, cause in known.items() if set(CONDITIONS).isdisjoint(cause.columns)]
            raise InputError(InputIssue(f"give one of {', '.join(possible)}", column="--hide", value=name))
        trials = known[name].trials(rows)
        if not trials:
            message = "has no usual size; write it into a law file, and give that with --truth"
            raise InputError(InputIssue(message, column="--hide", value=name))
        version, _ = trials[0]
        causes.append(version.bind(rows, machine))
    sizes = np.array([size for cause in causes for size in cause.scale])
    return LawValues(
        {joint: ExtendedLaw(law, tuple(causes)) for joint, law in laws.laws.items()},
        {key: np.append(values, sizes) for key, values in laws.values.items()},
        laws.day_to_day,
    )
