"""Joints, ranges and, where it has them, geometry and masses of a machine, read from a TOML file.

The nominal one is mm3a.toml. A file of `[[joint]]` tables alone defines any machine of rotary and prismatic
joints; what needs lengths, such as the gravity load or the tip, is then refused by `require_geometry`.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from importlib import resources
from math import isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from stickslip_fit.errors import InputError

if TYPE_CHECKING:
    from stickslip_fit.machine.machine_file import JointsFile

JointKind = Literal["rotary", "prismatic"]
ARM_KINDS: tuple[JointKind, ...] = ("rotary", "rotary", "prismatic")
PREDICT_DRIVES = (
    "the steps of its drives come from `stickslip-fit predict LAW DRIVES.csv`, in Python from predict(law, "
    "read_drives(file, law))"
)
_JOINT_TABLES = re.compile(rb"^\s*(?:\[\[\s*joint\s*\]\]|joint\s*=)", re.MULTILINE)


@dataclass(frozen=True)
class Link:
    """Mass in kg, centre of mass in m along the link, principal moments in kg m^2 (see mm3a.toml)."""

    mass: float
    com: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine with joints 1 to n, SI throughout.

    Attributes
    ----------
    name : str
    a1 : float
        Distance of joint 2's axis from joint 1's, m; NaN for a machine without the published geometry.
    l2 : float
        Distance of the tip from joint 2's axis with joint 3 at 0, m; NaN likewise.
    ranges : dict of int to (float, float)
        Lowest and highest position of each joint between its mechanical stops, rad or m.
    links : tuple of Link
        Three links, base to tip; empty likewise.
    sha256 : str
        Hash of the file's bytes; every result carries it.
    kinds : tuple of {"rotary", "prismatic"}
        Of joints 1 to n.
    joint_names : tuple of str
        The lab's own names of joints 1 to n; empty where it has none.
    """

    name: str
    a1: float = nan
    l2: float = nan
    ranges: dict[int, tuple[float, float]]
    links: tuple[Link, ...] = ()
    sha256: str
    kinds: tuple[JointKind, ...] = ARM_KINDS
    joint_names: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[int, ...]:
        """The joints' numbers, 1 to n."""
        return tuple(range(1, len(self.kinds) + 1))

    @property
    def has_published_geometry(self) -> bool:
        """Whether it is an arm of the published kind, rotary, rotary, prismatic, of known lengths."""
        return self.kinds == ARM_KINDS and isfinite(self.a1) and isfinite(self.l2)

    def require_geometry(self, what: str, instead: str = "") -> None:
        """Refuse `what`, which needs the arm's lengths, for a machine that does not have them.

        Parameters
        ----------
        what : str
        instead : str, optional
            What does the same for any machine.

        Raises
        ------
        InputError
            If the machine has no published geometry.
        """
        if self.has_published_geometry:
            return
        reason = (
            f"{what}: this is for an arm of two rotary joints and a prismatic one whose lengths are known, "
            f"and the machine {self.name} is none"
        )
        advice = "; give [geometry], [range] and [[link]] in its file, as mm3a.toml does"
        raise InputError(reason + (advice if self.kinds == ARM_KINDS else instead and f"; {instead}"))

    def is_prismatic(self, joint: int) -> bool:
        """Whether a joint, of 1 to n, slides rather than turns."""
        return self.kinds[joint - 1] == "prismatic"

    def describe_joint(self, joint: int) -> str:
        """A joint's kind, after the lab's own name for it if there is one."""
        name = self.joint_names[joint - 1] if self.joint_names else ""
        return f"{name}, {self.kinds[joint - 1]}" if name else self.kinds[joint - 1]

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
    from stickslip_fit.machine.machine_file import JointsFile, MachineFile

    nominal = resources.files("stickslip_fit.machine").joinpath("mm3a.toml")
    raw = nominal.read_bytes() if path is None else read_file(path, "machine file", MAX_BYTES)
    file = nominal.name if path is None else format_path(path)
    if _JOINT_TABLES.search(raw):
        return _build_joints(parse_toml(raw, file, JointsFile), file, raw)
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


def _build_joints(content: JointsFile, file: str, raw: bytes) -> Machine:
    return Machine(
        name=content.name or Path(file).stem,
        ranges={
            number: (joint.range[0], joint.range[1]) for number, joint in enumerate(content.joint, start=1)
        },
        sha256=hashlib.sha256(raw).hexdigest(),
        kinds=tuple(joint.kind for joint in content.joint),
        joint_names=tuple(joint.name for joint in content.joint),
    )
