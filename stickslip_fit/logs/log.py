"""A campaign log: what was measured, with its history."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit.logs.configurations import configurations
from stickslip_fit.logs.write import write_log
from stickslip_fit.machine import Machine


@dataclass(frozen=True, eq=False, repr=False)
class Log(Summarized):
    """The traverses of a campaign, as `read_log` returns them.

    Attributes
    ----------
    rows : DataFrame
        One row per traverse, sorted by time and joint, SI throughout. ``session``, ``time``, ``joint``,
        ``direction`` ('+', '-'), ``steps``; ``q1``, ``q2``, ``q3`` (the moving joint's own is NaN),
        ``theta``, ``psi``; ``start``, ``stop`` (rad or m); ``check_every``; ``status`` ('ok',
        'interrupted', 'excluded'); ``temperature``, ``humidity``, ``supply``, ``step_period``,
        ``payload`` (NaN where not given); ``note``; the lab's own columns as ``covariate:<column>``
        and ``text:<column>``; and history, see `history.add_history`.
    sources : tuple of (str, str)
        Name and sha256 of each file.
    sha256 : str
        Hash over all of them; of a single file, its own.
    machine : Machine
        Whose ranges end the traverses.
    notes : tuple of str
        What a person should know about how the files were read.
    """

    rows: pd.DataFrame
    sources: tuple[tuple[str, str], ...]
    sha256: str
    machine: Machine
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def sessions(self) -> tuple[str, ...]:
        """Labels of the sessions, in the order in which they began."""
        return tuple(self.rows["session"].unique())

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints that were driven."""
        return tuple(int(joint) for joint in sorted(self.rows["joint"].unique()))

    @property
    def usable(self) -> pd.DataFrame:
        """The rows that may be fitted: those whose status is ok."""
        return self.rows[self.rows["status"] == "ok"].reset_index(drop=True)

    def select(self, mask: npt.ArrayLike) -> Log:
        """Only the rows where `mask` is true; their history stays that of the whole log."""
        return replace(self, rows=self.rows[mask].reset_index(drop=True))

    def configurations(self) -> pd.DataFrame:
        """Which configurations the usable rows cover; see `configurations.configurations`."""
        return configurations(self.usable)

    def plot_readings(self) -> npt.NDArray[np.object_]:
        """The mean step size of every usable traverse, in the order in which they were made.

        Returns
        -------
        array of Axes
            One for each joint; see `report.figures.axes.Panels`.

        Raises
        ------
        InputError
            If no traverse is usable.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.readings import plot_readings

        return panels(plot_readings(self))

    def to_csv(self, path: str | Path) -> None:
        """Write the log in its file format; see `write.write_log`."""
        write_log(self, path)
