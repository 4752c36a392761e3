"""What computes the numbers: versions and code, so that those of another do not mix in."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import stickslip_fit
from stickslip_fit.fit.provenance import versions

ROOMS = ("_toml", "units", "machine", "logs", "laws", "causes", "simulate", "fit", "moves", "strategies")


@dataclass(frozen=True)
class MadeBy:
    """Versions, by name, and the hash of the code that numbers come from."""

    versions: tuple[tuple[str, str], ...]
    code: str

    @property
    def sha256(self) -> str:
        """Of all of it."""
        return hashlib.sha256(repr(self).encode()).hexdigest()

    def unlike(self, other: MadeBy) -> list[str]:
        """What differs from another, in words."""
        theirs = dict(other.versions)
        found = [
            f"{name} {version} here, {theirs.get(name, 'none')} there"
            for name, version in self.versions
            if theirs.get(name) != version
        ]
        return found or ["the code of stickslip_fit is not the same"] * (self.code != other.code)


@cache
def this_process() -> MadeBy:
    """What computes numbers in this process."""
    package, code = Path(stickslip_fit.__file__).parent, hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        if path.relative_to(package).parts[0].removesuffix(".py") in ROOMS:
            code.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes())
    return MadeBy(tuple(versions().items()), code.hexdigest())
