"""The verb `capture`: a plan gone through at the rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from stickslip_fit.cli import hearing
from stickslip_fit.cli.arguments import reference_law
from stickslip_fit.cli.options import MachinePath, PlanPath
from stickslip_fit.cli.rig_options import Device, Dialect, DialectOption, Port, Ratio, given, refuse
from stickslip_fit.files import check_folder

PLAIN = "plan"  # the command that is meant where none is named


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

app.command()(hearing.tune)
app.command()(hearing.listen)


@app.command(PLAIN)
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
        refuse(of_real, "at an emulated rig")
    else:
        refuse(of_emulated, "at a real rig")
    check_folder(output)

    from stickslip_fit.capture.conditions import conditions_of
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
    counting = given(predictor, "--law, by which --by-count counts") if by_count else None
    said = conditions_of(" ".join(condition or ()), "--condition")
    job = capturing.Job(planned, chosen, output, resume, predictor, counting, Safety(most_steps), said)
    if emulate:
        laws = hidden(read_law_values(truth or reference_law(), chosen), tuple(hide or ()), planned, chosen)
        emulation = capturing.Emulation(laws, dialect.value, perfect_ear, snr, seed)
        print(capturing.capture_emulated(job, emulation, unattended))
    else:
        connection = capturing.Connection(
            given(port, "--port; or try it without hardware, with --emulate"), dialect.value, device
        )
        print(capturing.capture_real(job, connection, given(tuning, "--tuning, which `capture tune` writes")))
