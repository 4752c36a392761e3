"""What the verb `diagnose` does between reading a log and printing: look, tell how far it is, save."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from stickslip_fit.arguments import command
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder, write_atomically

if TYPE_CHECKING:
    from stickslip_fit.diagnose import Diagnosis
    from stickslip_fit.logs import Log

CLEAR = "\r\x1b[K"


def refuse(json_path: Path | None, report: Path | None) -> None:
    """Refuse files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    for path in (json_path, report):
        if path is not None:
            check_folder(path)
    if report is not None and report == json_path:
        raise InputError(f"--json and --report both name {report}: give two files")


def diagnosed(log: Log, alpha: float = 0.01, seed: int = 0) -> Diagnosis:
    """Diagnose a log, telling how far that is where somebody watches."""
    from stickslip_fit.diagnose import diagnose

    if not sys.stderr.isatty():
        return diagnose(log, alpha=alpha, seed=seed)
    try:
        return diagnose(log, alpha=alpha, seed=seed, progress=_tell)
    finally:
        print(CLEAR, end="", file=sys.stderr, flush=True)


def save(diagnosis: Diagnosis, json_path: Path | None, report: Path | None) -> list[str]:
    """Write what was asked for; a line for each file."""
    saved = []
    if json_path is not None:
        from stickslip_fit.diagnose import save_diagnosis

        save_diagnosis(diagnosis, json_path)
        saved.append(f"saved to {json_path}")
    if report is not None:
        from stickslip_fit.report.diagnosis import diagnosis_page

        write_atomically(report, diagnosis_page(diagnosis, command=command()))
        saved.append(f"report written to {report}")
    return saved


def _tell(step: str, done: float) -> None:
    print(f"{CLEAR}{step} ({done:.0%})", end="", file=sys.stderr, flush=True)
