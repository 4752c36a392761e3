"""The command line: one verb for each question."""

from __future__ import annotations

import os
import warnings
from typing import Annotated

import typer

from stickslip_fit import __version__
from stickslip_fit.cli._examples import example_of
from stickslip_fit.cli._files import check_files
from stickslip_fit.cli._streams import open_standard_streams, run_with_streams, show_warning
from stickslip_fit.cli.capture import app as capture
from stickslip_fit.cli.changes import changed, compare_laws
from stickslip_fit.cli.demo import demo
from stickslip_fit.cli.diagnose import anova, diagnose, diagnose_table, plan
from stickslip_fit.cli.fit import calibrate, fit
from stickslip_fit.cli.logs import check, report, sheet, simulate
from stickslip_fit.cli.moves import accuracy_map, dead_reckon, plan_move, predict
from stickslip_fit.cli.strategies import compare, study

VERBS = (
    *(
        check,
        calibrate,
        fit,
        predict,
        changed,
        anova,
        diagnose,
        diagnose_table,
        report,
        compare,
        compare_laws,
        study,
        simulate,
        plan,
        sheet,
    ),
    *(plan_move, dead_reckon, accuracy_map, demo),
)

app = typer.Typer(
    help="Step-size laws of piezoelectric stick-slip actuators: from step counts to calibrated moves.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for verb in VERBS:
    app.command(epilog=example_of(verb.__name__.replace("_", "-")))(check_files(verb))
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
    """Run the command line, and exit with its status.

    2 for bad input, with one message; 1 for output that cannot be written, 141 if its reader has gone; 130 if
    a person interrupted it.
    """
    # The matrices are many and small: threads within one product cost more than they gain.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_standard_streams()
    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        status = run_with_streams(app)
    raise SystemExit(status)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"stickslip-fit {__version__}")
        raise typer.Exit
