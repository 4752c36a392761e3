"""Geometry, ranges and masses of the manipulator, read from a TOML file (nominal: mm3a.toml)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path


@dataclass(frozen=True)
class Link:
    """Mass in kg, centre of mass in m along the link, principal moments in kg m^2 (see mm3a.toml)."""

    mass: float
    com: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True)
class Machine:
    """A three-joint manipulator, SI throughout.

    Attributes
    ----------
    name : str
    a1 : float
        Distance of joint 2's axis from joint 1's, m.
    l2 : float
        Distance of the tip from joint 2's axis with joint 3 at 0, m.
    ranges : dict of int to (float, float)
        Lowest and highest position of each joint between its mechanical stops, rad or m.
    links : tuple of Link
        Three links, base to tip.
    sha256 : str
        Hash of the file's bytes; every result carries it.
    """

    name: str
    a1: float
    l2: float
    ranges: dict[int, tuple[float, float]]
    links: tuple[Link, Link, Link]
    sha256: str

    def span(self, joint: int) -> float:
        """Full travel of a joint, rad or m."""
        low, high = self.ranges[joint]
        return high - low


def load_machine(path: str | Path | None = None) -> Machine:
    """Read a machine file; without a path, the nominal MM3A that comes with the package.

    Raises
    ------
    InputError
        With every fault: an unreadable file, missing or unknown keys, impossible values.

    Examples
    --------
    >>> load_machine().ranges[3]
    (0.0, 0.012)
    """
    from stickslip_fit._input import format_path, read_file
    from stickslip_fit._toml import MAX_BYTES, parse_toml
    from stickslip_fit.machine.machine_file import MachineFile

    nominal = resources.files("stickslip_fit.machine").joinpath("mm3a.toml")
    raw = nominal.read_bytes() if path is None else read_file(path, "machine file", MAX_BYTES)
    file = nominal.name if path is None else format_path(path)
    content = parse_toml(raw, file, MachineFile)
    ranges = content.range.q1, content.range.q2, content.range.q3
    base, middle, tip = (Link(link.mass, link.com, (*link.inertia,)) for link in content.link)  # type: ignore[arg-type]
    return Machine(
        name=content.name or Path(file).stem,
        a1=content.geometry.a1,
        l2=content.geometry.l2,
        ranges={joint: (low, high) for joint, (low, high) in enumerate(ranges, start=1)},
        links=(base, middle, tip),
        sha256=hashlib.sha256(raw).hexdigest(),
    )
