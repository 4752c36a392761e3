"""Where a result came from, so that it can be had again."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import version

from stickslip_fit import __version__
from stickslip_fit._format import join_words
from stickslip_fit.logs import Log


@dataclass(frozen=True)
class Provenance:
    """Hashes, versions and command behind a result.

    Attributes
    ----------
    log_files : tuple of str
        Names of the log's files.
    log_sha256, machine_sha256 : str
    machine_name : str
    versions : dict of str to str
    command : str
        As typed; empty where the result was made in a notebook.
    seed : int or None
        None where nothing random took part.
    """

    log_files: tuple[str, ...]
    log_sha256: str
    machine_name: str
    machine_sha256: str
    versions: dict[str, str]
    command: str = ""
    seed: int | None = None

    def lines(self) -> tuple[tuple[str, str], ...]:
        """Name and value of each, for people."""
        seed = (("seed", str(self.seed)),) if self.seed is not None else ()
        return (
            ("log", f"{join_words(self.log_files or ['no file'])}; sha256 {self.log_sha256}"),
            (f"machine {self.machine_name}", f"sha256 {self.machine_sha256}"),
            ("versions", ", ".join(f"{name} {version}" for name, version in self.versions.items())),
            ("command", self.command or "none: made from Python"),
            *seed,
        )


def versions() -> dict[str, str]:
    """Versions of what computes the numbers."""
    return {
        "stickslip_fit": __version__,
        "python": ".".join(str(part) for part in sys.version_info[:3]),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "pandas": version("pandas"),
    }


def provenance(log: Log, command: str) -> Provenance:
    """Where a fit of `log` comes from."""
    return Provenance(
        log_files=tuple(name for name, _ in log.sources),
        log_sha256=log.sha256,
        machine_name=log.machine.name,
        machine_sha256=log.machine.sha256,
        versions=versions(),
        command=command,
    )
