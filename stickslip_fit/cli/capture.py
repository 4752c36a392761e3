"""Commands at the rig: capture, capture tune, capture listen; at a real or an emulated rig."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from stickslip_fit.cli._commands import APP_SETTINGS, CAPTURE_EXAMPLES, format_example
from stickslip_fit.cli._files import INPUT, Output, check_files
from stickslip_fit.cli._options import (
    Device,
    Dialect,
    DialectOption,
    Force,
    MachinePath,
    Page,
    PagePort,
    PlanPath,
    Port,
    Ratio,
    check_chart,
    check_same_machine,
    reference_law,
    reject_options,
    require_option,
)

if TYPE_CHECKING:
    import pandas as pd

    from stickslip_fit.capture.operator import CountPredictor, Operator
    from stickslip_fit.estimation import Result
    from stickslip_fit.machine import Machine
    from stickslip_fit.simulation import LawValues

COUNT_COLUMNS = ["steps", "low", "high"]

CheckEvery = Annotated[int, typer.Option(min=1, help="Steps between two checks, as in the plan.")]
StepPeriod = Annotated[float, typer.Option(min=0.1, help="Of the controller, ms.")]


def tune(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Tuning to write, for `--tuning`."),
        Output(permits=("force",)),
    ],
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    joint: Annotated[int, typer.Option(min=1, max=3, help="Which joint to listen to.")] = 3,
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
    moving: Annotated[
        Path | None, typer.Option(help="A recording of the moving joint, not a rig."), INPUT
    ] = None,
    at_stop: Annotated[Path | None, typer.Option(help="With --moving: one of it at its stop."), INPUT] = None,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    snr: Ratio = 12.0,
    chart: Annotated[
        Path | None, typer.Option(help="Also draw both spectra here: .png, .svg or .pdf."), Output()
    ] = None,
    force: Force = False,
) -> None:
    """Tune the end-stop detector: record a joint moving and at its stop, and choose the band."""
    check_chart(chart)

    from stickslip_fit.capture import rigs
    from stickslip_fit.capture.tuning import save_tuning
    from stickslip_fit.units import to_si

    period = to_si(step_period, "ms")
    at_rig = {"--port": port, "--device": device}
    if emulate:
        reject_options(at_rig | {"--moving": moving, "--at-stop": at_stop}, "at an emulated rig")
        from stickslip_fit.capture.emulator.campaign import tune_at_emulated_rig
        from stickslip_fit.machine import load_machine
        from stickslip_fit.simulation import read_law_values

        laws = read_law_values(reference_law(), load_machine())
        tuning = tune_at_emulated_rig(laws, check_every, period, snr)
    elif moving or at_stop:
        reject_options(at_rig, "beside recordings")
        recordings = require_option(moving, "--moving"), require_option(at_stop, "--at-stop")
        tuning = rigs.tune_from_recordings(*recordings, check_every * period)
    else:
        usage = "--port; or recordings, with --moving and --at-stop; or try it with --emulate"
        connection = rigs.RigConnection(require_option(port, usage), dialect.value, device)
        tuning = rigs.tune_at_rig(connection, joint, check_every, period)
    save_tuning(tuning, output)
    print(f"{tuning.conclusion}\n\nsaved to {output}")
    if chart is not None:
        from stickslip_fit.plotting._style import write_figure
        from stickslip_fit.plotting.strategies import plot_spectrum

        write_figure(plot_spectrum(tuning), chart, "spectrum")
        print(f"chart written to {chart}")


def listen(
    recording: Annotated[Path, typer.Argument(help="WAV file of one traverse.", show_default=False), INPUT],
    tuning: Annotated[Path, typer.Option(help="What `capture tune` wrote."), INPUT],
    check_every: CheckEvery = 5,
    step_period: StepPeriod = 10.0,
) -> None:
    """Say where in a recording the end stop is detected."""
    from stickslip_fit.capture.audio import read_wav
    from stickslip_fit.capture.end_stop import SequentialDetector
    from stickslip_fit.capture.tuning import check_tuning, load_tuning
    from stickslip_fit.units import to_si

    tuned = load_tuning(tuning)
    check_tuning(tuned, tuning)
    sound = read_wav(recording)
    detector = SequentialDetector(sound, tuned)
    seconds = check_every * to_si(step_period, "ms")
    checks = int(len(sound.values) / sound.rate / seconds)
    for check in range(1, checks + 1):
        detection = detector.check(seconds)
        time = f"at {check * seconds:.2f} s (check {check:,} of {checks:,})"
        if detection.at_stop:
            steps = (check - detection.late_checks) * check_every
            print(
                f"the stop is heard {time}, {detection.level:+.1f} dB; that makes a count of {steps:,} steps"
            )
            return
        if detection.fault:
            print(f"broken off {time}: {detection.fault}")
            return
    print(f"no stop is heard in {checks * seconds:.1f} s ({checks:,} checks)")


DEFAULT_COMMAND = "plan"  # where no command is named


class _DefaultToPlan(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = [DEFAULT_COMMAND, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_DefaultToPlan,
    help="Drive the joints, detect the end stops, write the log. `capture PLAN` is `capture plan PLAN`.",
    **APP_SETTINGS,
)

for command in (tune, listen):
    app.command(epilog=format_example(CAPTURE_EXAMPLES[command.__name__]))(check_files(command))


def _journal_path(log: Path) -> Path:
    from stickslip_fit.capture.campaign import journal_path

    return journal_path(log)


@app.command(DEFAULT_COMMAND, epilog=format_example(CAPTURE_EXAMPLES["plan"]))
@check_files
def plan(
    plan: PlanPath,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Log to write; the journal goes beside it."),
        Output(beside=(_journal_path,)),  # begin_journal refuses a log that exists
    ],
    port: Port = None,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    tuning: Annotated[Path | None, typer.Option(help="What `capture tune` wrote today."), INPUT] = None,
    law: Annotated[
        Path | None,
        typer.Option(help="Law file (TOML) or saved result (JSON) that predicts each count."),
        INPUT,
    ] = None,
    by_count: Annotated[
        bool, typer.Option("--by-count", help="Bring joints to where there is no stop by count, not by hand.")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an earlier capture ended.")] = False,
    condition: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=NUMBER", help="Holds as a session begins: temperature_C=22; repeatable."),
    ] = None,
    most_steps: Annotated[int, typer.Option(min=1, help="Limit of any drive.")] = 60_000,
    machine: MachinePath = None,
    page: Page = False,
    page_port: PagePort = 0,
    emulate: Annotated[bool, typer.Option("--emulate", help="Try it without hardware.")] = False,
    hide: Annotated[
        list[str] | None,
        typer.Option(metavar="CAUSE", help="Emulated: a cause at work, e.g. thermal-warm-up; repeatable."),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(help="Emulated: law file by which the joints step, with or without causes."),
        INPUT,
    ] = None,
    snr: Ratio = 12.0,
    ideal_detector: Annotated[
        bool,
        typer.Option("--ideal-detector", help="Emulated: detect each stop without error or sound; quicker."),
    ] = False,
    unattended: Annotated[bool, typer.Option("--unattended", help="Emulated: ask nobody.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Emulated: of the noise.")] = 0,
    pace: Annotated[
        float | None,
        typer.Option(min=0.1, help="Emulated: so many times as fast as a rig; without it, at once."),
    ] = None,
) -> None:
    """Make the traverses of a plan: drive, listen, record."""
    of_real = {"--port": port, "--tuning": tuning, "--device": device}
    of_emulated = {
        "--hide": hide,
        "--truth": truth,
        "--ideal-detector": ideal_detector,
        "--unattended": unattended,
        "--pace": pace,
    }
    reject_options(of_real if emulate else of_emulated, f"at {'an emulated' if emulate else 'a real'} rig")

    from stickslip_fit.capture import rigs
    from stickslip_fit.capture.emulator import campaign as emulated
    from stickslip_fit.capture.operator import parse_conditions
    from stickslip_fit.capture.traverse import DriveLimits
    from stickslip_fit.logs.plan_reader import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulation import read_law_values

    geometry = load_machine(machine)
    planned = read_plan(plan, geometry)
    law_file = law or (reference_law() if emulate else None)
    predictor = load_predictor(law_file, geometry) if law_file else None
    if predictor:
        predictor.predict(planned.rows())  # refuses a law under which a joint stalls before anything moves
    count_predictor = require_option(predictor, "--law, by which --by-count counts") if by_count else None
    conditions = parse_conditions(" ".join(condition or ()), "--condition")
    counts = (predictor, count_predictor, DriveLimits(most_steps), conditions)
    job = rigs.CaptureJob(planned, geometry, output, resume, *counts)
    with _watch(page, page_port, planned.name or plan.stem) as watch:
        if emulate:
            laws = read_law_values(truth or reference_law(), geometry)
            laws = emulated.hide_causes(laws, tuple(hide or ()), planned, geometry)
            emulation = emulated.EmulationOptions(laws, dialect.value, ideal_detector, snr, seed, pace)
            print(emulated.capture_emulated(job, emulation, unattended, watch))
        else:
            usage = "--port; or try it without hardware, with --emulate"
            connection = rigs.RigConnection(require_option(port, usage), dialect.value, device)
            tuned = require_option(tuning, "--tuning, which `capture tune` writes")
            print(rigs.capture_real(job, connection, tuned, watch))


@contextmanager
def _watch(page: bool, port: int, title: str) -> Iterator[Callable[[Operator], Operator]]:
    """What makes an operator show everything on a page, too; the operator as it is without one."""
    from stickslip_fit.capture.operator import keep_operator

    if not page:
        reject_options({"--page-port": port or None}, "without --page")
        yield keep_operator
        return
    from stickslip_fit.drive.live_capture import LiveOperator, serve_capture_page

    with serve_capture_page(title, port) as shown:
        print(f"page: {shown.address}", flush=True)
        yield lambda operator: LiveOperator(operator, shown)


class _GroupPredictor(ABC):
    """A `CountPredictor` that predicts the traverses of each joint and direction together."""

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        """See `CountPredictor.predict`."""
        import pandas as pd

        counts = pd.DataFrame(nan, rows.index, COUNT_COLUMNS)
        for (joint, direction), subset in rows.groupby(["joint", "direction"]):
            self._fill(counts, subset, int(str(joint)), str(direction))
        return counts

    @abstractmethod
    def _fill(self, counts: pd.DataFrame, rows: pd.DataFrame, joint: int, direction: str) -> None: ...


@dataclass(frozen=True)
class LawPredictor(_GroupPredictor):
    """Predicts by known laws, without intervals; nothing for a joint and direction without a law."""

    laws: LawValues

    def _fill(self, counts: pd.DataFrame, rows: pd.DataFrame, joint: int, direction: str) -> None:
        from stickslip_fit.simulation import expected_counts

        if (joint, direction, None) in self.laws.values:
            values, _ = self.laws.of_rows(rows, joint)
            counts.loc[rows.index, "steps"] = expected_counts(self.laws.laws[joint], rows, values)


@dataclass(frozen=True)
class ResultPredictor(_GroupPredictor):
    """Predicts by the latest calibration of each joint and direction; nothing where there is none."""

    result: Result

    def _fill(self, counts: pd.DataFrame, rows: pd.DataFrame, joint: int, direction: str) -> None:
        if joint not in self.result.joints:
            return
        fit = self.result.joints[joint]
        known = (fit.groups["direction"] == direction).to_numpy() & fit.known.all(axis=1)
        if known.any():
            session = str(fit.groups["session"][known].iloc[-1])
            counts.loc[rows.index] = self.result.predict(rows.assign(session=session))[COUNT_COLUMNS]


def load_predictor(path: Path, machine: Machine) -> CountPredictor:
    """Predict by a law file (TOML) or a result saved with ``fit --json`` for the same machine."""
    from stickslip_fit.estimation import load_result
    from stickslip_fit.simulation import read_law_values

    if path.suffix != ".json":
        return LawPredictor(read_law_values(path, machine))
    result = load_result(path)
    check_same_machine(result, machine, path)
    return ResultPredictor(result)
