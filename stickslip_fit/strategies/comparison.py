"""Strategies compared on a log: every number, and how it shows itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from stickslip_fit._summary import Summarized
from stickslip_fit.fit.provenance import Provenance
from stickslip_fit.fit.result import AxesOf
from stickslip_fit.machine import Machine
from stickslip_fit.strategies.accuracy import CONFIGURATIONS, SESSIONS, summarise


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Summarized):
    """What `compare` returns; SI.

    Attributes
    ----------
    strategies : tuple of str
        Their names, in the order given.
    errors : DataFrame
        See `trials.Outcomes`, with the errors absolute and relative, and shared: whether the traverse's
        session is one that all compared strategies share, and none of them calibrates from the traverse.
        Only those are summed up.
    spent : DataFrame
        strategy, session, joint, direction, traverses, steps, seconds (with what a traverse costs besides).
    left_out : DataFrame
        strategy, session, joint, direction, reason.
    pairs : DataFrame
        See `paired.pair_up`, for each joint.
    bounds : DataFrame
        See `bound.bounds`, for each joint.
    repeatability : dict of (int, str) to float
        By joint and direction.
    handling : float
        Seconds that a traverse costs beside its steps.
    looks_back : str
        On which sessions a strategy may look back, in words.
    machine : Machine
    provenance : Provenance
    """

    strategies: tuple[str, ...]
    errors: pd.DataFrame
    spent: pd.DataFrame
    left_out: pd.DataFrame
    pairs: pd.DataFrame
    bounds: pd.DataFrame
    repeatability: dict[tuple[int, str], float]
    handling: float
    looks_back: str
    machine: Machine
    provenance: Provenance

    def plot_pareto(self) -> AxesOf:
        """Calibration time against held-out error, with the Cramer-Rao bound and the repeatability floor.

        Raises
        ------
        InputError
            If no session is shared.
        """
        from stickslip_fit.report.figures.axes import panels
        from stickslip_fit.report.figures.pareto import plot_pareto

        return panels(plot_pareto(self))

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints of which there is anything to compare."""
        return tuple(int(joint) for joint in sorted(self.shared["joint"].unique()))

    @property
    def shared(self) -> pd.DataFrame:
        """The errors that are summed up."""
        return self.errors[self.errors["shared"]]

    def compared(self, joint: int) -> tuple[str, ...]:
        """Strategies compared on a joint: those that suit at least one of its sessions."""
        there = set(self.errors.loc[self.errors["joint"] == joint, "strategy"])
        return tuple(name for name in self.strategies if name in there)

    def sessions(self, joint: int) -> tuple[str, ...]:
        """Sessions that all compared strategies share."""
        return tuple(self.shared.loc[self.shared["joint"] == joint, "session"].unique())

    def unit(self, joint: int) -> tuple[str, ...]:
        """What intervals are over: sessions, or configurations where there is only one."""
        return SESSIONS if len(self.sessions(joint)) > 1 else CONFIGURATIONS

    def accuracy(self, *by: str) -> pd.DataFrame:
        """Errors summed up by joint and strategy, and by further columns.

        Parameters
        ----------
        *by : str
            None, ``"direction"``, or also the columns of a configuration, ``*WHERE``.

        Returns
        -------
        DataFrame
            See `accuracy.summarise`.
        """
        if by not in self._summed_up:
            parts = [
                summarise(mine, ["joint", "strategy", *by], self.unit(int(joint)))
                for joint, mine in self.shared.groupby("joint")
            ]
            self._summed_up[by] = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
        return self._summed_up[by].copy()

    @cached_property
    def _summed_up(self) -> dict[tuple[str, ...], pd.DataFrame]:
        """What `accuracy` has worked out; a page asks for the same table a dozen times."""
        return {}

    def cost(self) -> pd.DataFrame:
        """joint, strategy, traverses (each way) and seconds (both ways) of a shared session, on average."""
        parts = []
        for joint in self.joints:
            mine = self.spent[
                (self.spent["joint"] == joint) & self.spent["session"].isin(self.sessions(joint))
            ]
            each = mine.groupby("strategy", sort=False)
            seconds = each["seconds"].sum() / len(self.sessions(joint))
            table = pd.DataFrame({"traverses": each["traverses"].mean(), "seconds": seconds})
            parts.append(table.reset_index().assign(joint=joint))
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()
