"""What shall be measured: the traverses to make, in their order, and how they are timed."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

Order = Literal["as-written", "random"]
NoiseKind = Literal["gaussian", "t5"]


@dataclass(frozen=True)
class PlannedSession:
    """A session to come.

    Attributes
    ----------
    label : str
    begins : datetime
        When its first traverse is to begin.
    """

    label: str
    begins: datetime


@dataclass(frozen=True)
class Timing:
    """How long things take, all in seconds.

    Attributes
    ----------
    step_period : float
    pause : (float, float)
        Shortest and longest time that a person takes to set the next configuration.
    turn : (float, float)
        The same before a traverse for which nothing needs to be set.
    """

    step_period: float = 0.010
    pause: tuple[float, float] = (60.0, 240.0)
    turn: tuple[float, float] = (5.0, 15.0)


@dataclass(frozen=True)
class Noise:
    """How well a count repeats.

    Attributes
    ----------
    repeatability : dict of (int, str) to float
        Standard deviation of log(steps) for each joint and direction.
    kind : {'gaussian', 't5'}
        Its distribution; ``t5`` is Student's t with 5 degrees of freedom, scaled to the same spread.
    """

    repeatability: dict[tuple[int, str], float]
    kind: NoiseKind = "gaussian"


@dataclass(frozen=True, eq=False)
class Plan:
    """The traverses to make, session by session; at least one of each.

    Attributes
    ----------
    name : str
    sessions : tuple of PlannedSession
        In order of time.
    traverses : DataFrame
        One pass through the list, in order: visit (int; equal for neighbours between which nobody needs
        to set anything), sweep (text), joint, direction, q1, q2, q3, theta, psi, start, stop, SI; the
        moving joint's own position is NaN.
    replicates : int
        How often a session goes through that list.
    order : {'as-written', 'random'}
        ``random`` shuffles the visits within each session, and each visit's traverses stay together.
    check_every : int
        The end stop is looked for after so many steps.
    timing : Timing
    noise : Noise or None
        Only needed where the plan is simulated.
    seed : int
        Settles the random order, and the simulation unless that is given a seed of its own.
    """

    name: str
    sessions: tuple[PlannedSession, ...]
    traverses: pd.DataFrame
    replicates: int = 1
    order: Order = "as-written"
    check_every: int = 5
    timing: Timing = field(default_factory=Timing)
    noise: Noise | None = None
    seed: int = 0

    def rows(self) -> pd.DataFrame:
        """Every traverse of every session, in the order in which they are to be made.

        Returns
        -------
        DataFrame
            The log's columns session (categorical), joint, direction, q1 to psi, start, stop,
            check_every and step_period, SI, besides sweep, and visit counted through all sessions.
            Adding a session changes the order in no other.
        """
        count = self.traverses_per_session
        taken = np.concatenate([self._order(number) for number in range(len(self.sessions))])
        rows = self.traverses.iloc[taken % len(self.traverses)].reset_index(drop=True)
        labels = [session.label for session in self.sessions]
        rows.insert(0, "session", pd.Categorical.from_codes(np.repeat(np.arange(len(labels)), count), labels))
        visits = self._visits()[taken]
        anew = np.diff(visits, prepend=visits[0]) != 0
        anew[::count] = True
        rows["visit"] = np.cumsum(anew)
        rows["check_every"] = self.check_every
        rows["step_period"] = self.timing.step_period
        return rows

    @property
    def traverses_per_session(self) -> int:
        """Number of traverses in each session."""
        return self.replicates * len(self.traverses)

    def _visits(self) -> npt.NDArray[np.int64]:
        """The visit of each traverse of a session in the order of the list, every pass with its own."""
        once = self.traverses["visit"].to_numpy(np.int64)
        passes = np.arange(self.replicates) * (once.max() + 1)
        return (passes[:, None] + once).ravel()

    def _order(self, number: int) -> npt.NDArray[np.intp]:
        """Which traverse of the list, pass after pass, comes when in a session."""
        if self.order == "as-written":
            return np.arange(self.traverses_per_session)
        visits = self._visits()
        shuffled = np.random.default_rng([self.seed, number]).permutation(visits.max() + 1)
        return np.argsort(shuffled[visits], kind="stable")
