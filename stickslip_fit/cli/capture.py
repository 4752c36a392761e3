"""The verb `capture`: a plan gone through at the rig; and `capture tune`, which prepares the ear."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from stickslip_fit.cli.arguments import reference_law
from stickslip_fit.cli.options import MachinePath, PlanPath
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder

PLAIN = "plan"  # the command that is meant where none is named


class Dialect(StrEnum):
    """What the controller speaks."""

    new = "new"
    old = "old"
    anc300 = "anc300"


class _PlanUnlessNamed(TyperGroup):
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "-h", "--help"):
            args = [PLAIN, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_PlanUnlessNamed,
    no_args_is_help=True,
    help="Drive the joints, hear the end stops, write the log. `capture PLAN` is `capture plan PLAN`.",
)

Port = Annotated[str, typer.Option(help="Serial port of the controller; VISA resource of an ANC300.")]
DialectOption = Annotated[Dialect, typer.Option(help="What the controller speaks.")]
Device = Annotated[str | None, typer.Option(help="Microphone: its name, a part of it, or its number.")]


@app.command(PLAIN)
def plan(
    plan: PlanPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Log to write; the journal goes beside it.")],
    port: Annotated[str | None, typer.Option(help="Serial port; VISA resource of an ANC300.")] = None,
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
    snr: Annotated[float, typer.Option(help="Emulated: how loud the stop is, dB over the room.")] = 12.0,
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
        _refuse(of_real, "an emulated rig")
    else:
        _refuse(of_emulated, "a real rig")
    check_folder(output)

    from stickslip_fit.capture.driver import Safety
    from stickslip_fit.cli import capturing
    from stickslip_fit.cli.foretelling import predictor_of
    from stickslip_fit.cli.hiding import hidden
    from stickslip_fit.logs.read_plan import read_plan
    from stickslip_fit.machine import load_machine
    from stickslip_fit.simulate import read_law_values

    chosen = load_machine(machine)
    planned = read_plan(plan, chosen)
    known = law or (reference_law() if emulate else None)
    predictor = predictor_of(known, chosen) if known else None
    if predictor:
        predictor.predict(planned.rows())  # a law under which a joint stalls is said before anything moves
    counting = _given(predictor, "--law, by which --by-count counts") if by_count else None
    job = capturing.Job(planned, chosen, output, resume, predictor, counting, Safety(most_steps))
    if emulate:
        laws = hidden(read_law_values(truth or reference_law(), chosen), tuple(hide or ()), planned, chosen)
        emulation = capturing.Emulation(laws, dialect.value, perfect_ear, snr, seed)
        print(capturing.capture_emulated(job, emulation, unattended))
    else:
        connection = capturing.Connection(
            _given(port, "--port; or try it without hardware, with --emulate"), dialect.value, device
        )
        print(
            capturing.capture_real(job, connection, _given(tuning, "--tuning, which `capture tune` writes"))
        )


@app.command()
def tune(
    output: Annotated[Path, typer.Option("-o", "--output", help="Tuning to write, for `--tuning`.")],
    port: Port,
    dialect: DialectOption = Dialect.new,
    device: Device = None,
    joint: Annotated[int, typer.Option(min=1, max=3, help="Which joint to listen to.")] = 3,
    check_every: Annotated[int, typer.Option(min=1, help="Steps between two checks, as in the plan.")] = 5,
    step_period: Annotated[float, typer.Option(help="Of the controller, ms.")] = 10.0,
    chart: Annotated[
        Path | None, typer.Option(help="Also draw both spectra here: .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Listen to a joint moving and at its stop; say where the stop is heard best, and how well."""
    from stickslip_fit.cli.planning import refuse_outputs

    check_folder(output)
    refuse_outputs(None, chart)

    from stickslip_fit.capture.clock import RealClock
    from stickslip_fit.capture.tuning import save_tuning
    from stickslip_fit.cli import capturing
    from stickslip_fit.units import to_si

    connection = capturing.Connection(port, dialect.value, device)
    with (
        capturing.at_terminal() as (person, keys),
        capturing.real_rig(connection, to_si(step_period, "ms"), person) as (controller, microphone),
    ):
        found = capturing.tune_by_hand(controller, microphone, RealClock(), joint, check_every, keys, person)
    save_tuning(found, output)
    print(f"{found.summary()}\n\nsaved to {output}")
    if chart is not None:
        from stickslip_fit.report.chart import write_figure
        from stickslip_fit.report.figures.spectrum import plot_spectrum

        write_figure(plot_spectrum(found), chart, "spectrum")
        print(f"chart written to {chart}")


def _refuse(options: Mapping[str, object], where: str) -> None:
    """Refuse options that belong to the other kind of rig."""
    for option, value in options.items():
        if value:
            raise InputError(f"{option} means nothing at {where}; leave it out")


def _given[Value](value: Value | None, option: str) -> Value:
    if value is None:
        raise InputError(f"give {option}")
    return value
