"""What several verbs of the command line ask for, in the same words."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

LogPath = Annotated[
    list[Path],
    typer.Argument(metavar="LOG", help="Campaign log: CSV or Parquet files, or a folder of them."),
]
MachinePath = Annotated[
    Path | None, typer.Option("--machine", help="Machine file (TOML); the nominal MM3A without it.")
]
Since = Annotated[str | None, typer.Option(help="Only sessions that began at or after this date.")]
Until = Annotated[str | None, typer.Option(help="Only sessions that began before this date.")]
Json = Annotated[Path | None, typer.Option("--json", help="Also save the result here.")]
Chart = Annotated[
    Path | None, typer.Option("--chart", help="Also draw the control chart here: .png, .svg or .pdf.")
]
PlanPath = Annotated[Path, typer.Argument(metavar="PLAN", help="Plan of a campaign (TOML).")]
Calibration = Annotated[
    list[Path],
    typer.Argument(metavar="LOG|RESULT", help="A campaign log to fit, or a result saved with `fit --json`."),
]
Session = Annotated[str | None, typer.Option(help="Whose calibration to use; the latest without it.")]
Theta = Annotated[float, typer.Option(help="Base turned about x, degrees.")]
Psi = Annotated[float, typer.Option(help="Base turned about y, degrees.")]
At = Annotated[str, typer.Option("--at", metavar="Q1,Q2,Q3", help="Where the joints stand: deg,deg,mm.")]
Condition = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        metavar="NAME=VALUE",
        help="What a law with causes looks at, e.g. session_min=30 or temperature_C=23; repeatable.",
    ),
]
CauseNames = Annotated[
    list[str] | None,
    typer.Option(
        "--cause", metavar="NAME", help="Fit this cause with the laws, e.g. thermal-warm-up; repeatable."
    ),
]
CausesFrom = Annotated[
    Path | None,
    typer.Option(
        "--causes-from",
        metavar="RESULT",
        help="Closed form: take the causes of this saved result for known, with its error bars.",
    ),
]


class Method(StrEnum):
    """How to fit."""

    closed_form = "closed-form"
    least_squares = "least-squares"
    bayes = "bayes"
