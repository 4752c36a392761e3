"""What the verb `plan` does: traverses worth making after a log, or what a plan could tell before any."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder, write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from stickslip_fit.logs import Log
    from stickslip_fit.logs.plan import Plan
    from stickslip_fit.machine import Machine
    from stickslip_fit.simulate import LawValues

NEXT_SCHEMA = "stickslip-fit/next/1"


@dataclass(frozen=True, eq=False)
class Outlook:
    """What is printed, what is saved, and how to draw it where there is anything to draw."""

    text: str
    content: dict[str, Any]
    draw: Callable[[], Figure] | None = None


def is_plan(paths: list[Path]) -> bool:
    """Whether a plan is named, and not a log."""
    return len(paths) == 1 and paths[0].suffix.lower() == ".toml"


def refuse(paths: list[Path], of_plan: dict[str, object], of_log: dict[str, object]) -> None:
    """Refuse options that belong to the other kind of file.

    Parameters
    ----------
    paths : list of Path
    of_plan, of_log : dict of str to object
        Options and their values; None where they were not given.

    Raises
    ------
    InputError
    """
    other, kind = (of_log, "a log") if is_plan(paths) else (of_plan, "a plan")
    for option, value in other.items():
        if value is not None:
            raise InputError(f"{option} belongs to {kind}; leave it out here")


def refuse_outputs(json_path: Path | None, chart: Path | None) -> None:
    """Refuse files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    for path in (json_path, chart):
        if path is not None:
            check_folder(path)
    if chart is not None:
        from stickslip_fit.report.chart import check_suffix

        check_suffix(chart)


def after_log(log: Log, alpha: float, seed: int) -> Outlook:
    """The traverses worth making next."""
    from stickslip_fit.causes import covariates, library
    from stickslip_fit.diagnose.diagnose import decide
    from stickslip_fit.diagnose.experiments.ahead import ahead
    from stickslip_fit.diagnose.experiments.next_experiment import next_experiment, out_of_reach
    from stickslip_fit.diagnose.experiments.summary import summarize_next
    from stickslip_fit.diagnose.experiments.unseen import unseen, written_down
    from stickslip_fit.diagnose.telling.diagnosis_json import traverse_json

    diagnosis = decide(log, alpha=alpha, seed=seed)
    bench = diagnosis.search.bench
    choices = ahead(bench, log.machine)
    traverses = next_experiment(diagnosis.search, diagnosis.findings, choices)
    beyond = out_of_reach(diagnosis.findings, traverses)
    causes = [
        cause.bound(bench.rows, log.machine) if written_down(cause, bench.rows) else cause
        for cause in (*library(), *covariates(bench.rows))
    ]
    missed = unseen(diagnosis.untestable, causes, bench.rows, choices)
    content = {
        "schema": NEXT_SCHEMA,
        "log": {"file": Path(diagnosis.log_file).name, "sha256": diagnosis.log_sha256},
        "verdict": diagnosis.verdict,
        "next_experiment": [traverse_json(each) for each in traverses],
        "out_of_reach": [list(pair) for pair in beyond],
        "untestable": [
            {
                "cause": each.cause,
                "reason": each.reason,
                "shows_best": each.shows_best,
                "traverse": each.traverse and traverse_json(each.traverse),
            }
            for each in missed
        ],
    }
    return Outlook(str(summarize_next(diagnosis, traverses, beyond, missed)), content)


def before_data(plan: Plan, truth: LawValues, machine: Machine, alpha: float, seed: int) -> Outlook:
    """What a plan could tell."""
    import numpy as np

    from stickslip_fit.diagnose.diagnose import flips
    from stickslip_fit.diagnose.experiments.matrix import matrix
    from stickslip_fit.diagnose.experiments.matrix_json import matrix_json
    from stickslip_fit.diagnose.experiments.of_plan import bench_of_plan
    from stickslip_fit.diagnose.experiments.summary import SHOWN_AT, summarize_plan

    bench, untestable = bench_of_plan(plan, truth, machine)
    found = matrix(bench, untestable, alpha, flips(alpha), np.random.default_rng(seed))

    def draw() -> Figure:
        from stickslip_fit.report.figures.separability import plot_separability

        return plot_separability(found, SHOWN_AT)

    summary = summarize_plan(found, plan.name, len(bench), len(plan.sessions))
    return Outlook(str(summary), {"plan": plan.name} | matrix_json(found, SHOWN_AT), draw)


def save(found: Outlook, json_path: Path | None, chart: Path | None) -> list[str]:
    """Write the files that were asked for; a line for each."""
    lines = []
    if json_path is not None:
        write_atomically(
            json_path, json.dumps(found.content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
        )
        lines.append(f"saved to {json_path}")
    if chart is not None and found.draw is not None:
        from stickslip_fit.report.chart import write_figure

        write_figure(found.draw(), chart, "separability")
        lines.append(f"chart written to {chart}")
    return lines
