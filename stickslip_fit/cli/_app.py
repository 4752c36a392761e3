"""The command line: one verb for each question."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from stickslip_fit import __version__
from stickslip_fit.cli._files import check_files
from stickslip_fit.cli.capture import app as capture
from stickslip_fit.cli.diagnose import anova, diagnose, plan
from stickslip_fit.cli.fit import calibrate, dead_reckon, fit, plan_move, predict
from stickslip_fit.cli.logs import check, demo, report, sheet, simulate
from stickslip_fit.cli.strategies import compare, study
from stickslip_fit.errors import InputError

VERBS = (
    *(check, calibrate, fit, predict, anova, diagnose, report, compare, study, simulate, plan, sheet),
    *(plan_move, dead_reckon, demo),
)
INTERRUPTED = 130  # typer's status of a run that was interrupted by a person

app = typer.Typer(
    help="Step-size laws of piezoelectric stick-slip actuators: from step counts to calibrated moves.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for verb in VERBS:
    app.command()(check_files(verb))
app.add_typer(capture, name="capture")


@app.callback()
def _main_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=lambda wanted: _print_version(wanted), is_eager=True, help="Version."
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; bad input ends with one clear message and status 2."""
    # The matrices are many and small: threads within one product cost more than they gain.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except SystemExit as ended:
        if ended.code == INTERRUPTED:
            print("interrupted; nothing was left half-written", file=sys.stderr)
        raise
    except BrokenPipeError:
        # The reader of the output has gone; other tools end quietly, too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip-fit {__version__}")
        raise typer.Exit
