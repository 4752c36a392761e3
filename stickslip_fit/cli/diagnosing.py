"""What the verb `diagnose` does between reading a log and printing: look, tell how far it is, save."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stickslip_fit.cli.arguments import command
from stickslip_fit.errors import InputError
from stickslip_fit.files import check_folder, write_atomically

if TYPE_CHECKING:
    from stickslip_fit.diagnose import Diagnosis
    from stickslip_fit.fit import Result
    from stickslip_fit.logs import Log

CLEAR = "\r\x1b[K"


def refuse(json_path: Path | None, report: Path | None, law: Path | None = None) -> None:
    """Refuse files that could not be written, before any work.

    Raises
    ------
    InputError
    """
    given = {"--json": json_path, "--report": report, "--save-law": law}
    for option, path in given.items():
        if path is None:
            continue
        check_folder(path)
        for other, taken in given.items():
            if other < option and taken == path:
                raise InputError(f"{other} and {option} both name {path}: give two files")


def diagnosed(log: Log, alpha: float = 0.01, seed: int = 0) -> Diagnosis:
    """Diagnose a log, telling how far that is where somebody watches."""
    from stickslip_fit.diagnose import diagnose
    from stickslip_fit.diagnose.progress import shown

    with shown() as tell:
        return diagnose(log, alpha=alpha, seed=seed, progress=tell)


def law_found(log: Log, diagnosis: Diagnosis) -> Result:
    """The published laws extended by the causes that a diagnosis named, fitted to its log.

    Of causes that the log cannot tell apart it is the likeliest. Traverses in which the stop was misheard
    take no part; what is unknown has no place in a law.
    """
    from dataclasses import replace

    from stickslip_fit.fit import least_squares

    rows, usable = log.rows.copy(), log.rows.index[log.rows["status"] == "ok"]
    for each in diagnosis.findings:
        if each.traverses is not None:
            rows.loc[usable[each.traverses.index], "status"] = "excluded"
    versions = [each.version for each in diagnosis.findings if each.version is not None]
    return least_squares(replace(log, rows=rows), causes=versions, command=command())


def save_law(law: Result, path: Path) -> str:
    """Write a law; a line on what is in it."""
    from stickslip_fit.causes import ExtendedLaw
    from stickslip_fit.fit import save_result

    save_result(law, path)
    extended = next(iter(law.joints.values())).law
    causes = extended.causes if isinstance(extended, ExtendedLaw) else ()
    names = ", ".join(cause.name for cause in causes)
    what = f"extended by {names}" if names else "published, since no cause was named"
    return f"law ({what}) saved to {path}"


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
