"""A script of velocities from a file, as an input device.

A CSV file with the columns time_s, vx_um_s, vy_um_s, vz_um_s: from each time on the tip is to have that
velocity in the base's frame; the last line's time ends the drive. A joint in the optional column `home` is
brought to its nearest stop at that time, before the script goes on.
"""

from __future__ import annotations

import csv
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.drive.state import InputDevice, VelocityInput
from stickslip_fit.errors import InputError, InputIssue
from stickslip_fit.units import JOINTS, to_si

COLUMNS = ("time_s", "vx_um_s", "vy_um_s", "vz_um_s")
HOME = "home"
EXAMPLE = "time_s,vx_um_s,vy_um_s,vz_um_s\n0,20,0,0\n5,0,0,-30\n8,0,0,0"
MAX_TICK = 0.050  # s of the script that pass between two readings at most, whatever has stalled
SLACK = 1e-9  # s, for rounding


@dataclass(frozen=True, eq=False)
class VelocityScript:
    """Velocities of the tip over time.

    Attributes
    ----------
    times : tuple of float
        s, increasing from 0 or more; the last one is the end.
    velocities : array, shape (n, 3)
        From each time on, base frame, m/s.
    homes : tuple of int
        The joint to bring to its stop at each time; 0 for none.
    """

    times: tuple[float, ...]
    velocities: Array
    homes: tuple[int, ...]


class ScriptDevice(InputDevice):
    """An `InputDevice` that plays a script; time in which nobody reads it is not made up for."""

    def __init__(self, script: VelocityScript) -> None:
        self.script = script
        self._elapsed = 0.0
        self._last: float | None = None
        self._homed = -1
        self._last_home = max((line for line, joint in enumerate(script.homes) if joint), default=-1)

    def read(self, now: float) -> VelocityInput:
        script = self.script
        if self._last is not None:
            self._elapsed += min(now - self._last, MAX_TICK)
        self._last = now
        if self._elapsed >= script.times[-1] - SLACK and self._homed >= self._last_home:
            return VelocityInput(ends=True)
        line = bisect_right(script.times, self._elapsed + SLACK) - 1
        for number in range(self._homed + 1, line + 1):
            self._homed = number
            if script.homes[number]:
                return VelocityInput(home=script.homes[number], valid_until=now + MAX_TICK)
        if line < 0 or line == len(script.times) - 1 or not script.velocities[line].any():
            return VelocityInput()
        return VelocityInput(tip_velocity=script.velocities[line], valid_until=now + MAX_TICK)


def read_script(path: Path) -> VelocityScript:
    """Read a script.

    Raises
    ------
    InputError
        With every fault: file, line, column, value and what to do.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            records = [(reader.line_num, record) for reader in [csv.reader(file)] for record in reader]
    except OSError as error:
        message = f"cannot be read ({error.strerror}); name an existing script"
        raise InputError(InputIssue(message, str(path))) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(InputIssue(f"is no CSV file ({error})", str(path))) from None
    records = [(line, [cell.strip() for cell in cells]) for line, cells in records if any(cells)]
    header = records[0][1] if records else []
    if not set(COLUMNS) <= set(header) <= {*COLUMNS, HOME} or len(set(header)) < len(header):
        message = f"begins with the columns {','.join(COLUMNS)}, and {HOME} if wanted, each once"
        raise InputError(InputIssue(message, str(path), 1, value=",".join(header)))
    return _check_script(str(path), header, records[1:])


def check_rows(rows: Iterable[Iterable[float]]) -> VelocityScript:
    """A script from rows of its numbers, in the file's units; raises InputError with every fault."""
    return _check_script("script", [*COLUMNS], [(line, [*map(str, row)]) for line, row in enumerate(rows, 1)])


def _check_script(source: str, header: list[str], records: list[tuple[int, list[str]]]) -> VelocityScript:
    issues: list[InputIssue] = []
    rows: list[tuple[float, ...]] = []
    for line, cells in records:
        if len(cells) != len(header):
            issues.append(InputIssue(f"has {len(cells)} cells, not {len(header)}", source, line))
            continue
        row = dict(zip(header, cells, strict=True))
        numbers = [_parse(source, line, name, row[name], issues) for name in COLUMNS]
        least = rows[-1][0] if rows else -1.0
        if numbers[0] <= least or numbers[0] < 0:
            message = "times increase from 0 on; correct it, or sort the lines"
            issues.append(InputIssue(message, source, line, "time_s", row["time_s"]))
        home = row.get(HOME, "")
        if home not in ("", *map(str, JOINTS)):
            message = "give a joint, 1, 2 or 3, or leave it empty"
            issues.append(InputIssue(message, source, line, HOME, home))
            home = ""
        rows.append((*numbers, float(home or 0)))
    if len(rows) < 2 and not issues:
        message = "has fewer than two lines of velocities; the last one's time ends the drive"
        issues.append(InputIssue(message, source))
    if issues:
        raise InputError(issues)
    table = np.array(rows)
    homes = tuple(int(joint) for joint in table[:, -1])
    return VelocityScript(tuple(table[:, 0].tolist()), to_si(table[:, 1:4], "µm"), homes)


def _parse(source: str, line: int, name: str, text: str, issues: list[InputIssue]) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not isfinite(number):
        issues.append(InputIssue("give a number", source, line, name, text))
        return 0.0
    return number
