"""How the joints truly step, where that is known: in simulated sessions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.causes import ExtendedLaw
from stickslip_fit.laws import StepLaw

Array = npt.NDArray[np.float64]
Group = tuple[int, str]
"""Joint and direction."""


@dataclass(frozen=True, eq=False)
class Truth:
    """How the joints truly step in c sessions.

    Attributes
    ----------
    sessions : sequence of str, length c
        Labels, as a cause may look at them; those of several campaigns may be alike.
    laws : mapping of int to StepLaw
        Of each joint; a law may have causes in it.
    values : mapping of (int, str) to array, shape (p,) or (c, p)
        Parameters of each joint and direction, SI.
    factor : mapping of (int, str) to array, shape (c,)
        By which each session's step sizes differ from these; 1 where nothing is said.
    repeatability : mapping of (int, str) to float
        Standard deviation of log(steps); none where nothing is said.
    conditions : mapping of str to array_like that goes with (c, m)
        What a law looks at besides, by a log's columns, SI: ``session_seconds``, ``temperature``, ...
    """

    sessions: Sequence[str]
    laws: Mapping[int, StepLaw]
    values: Mapping[Group, Array]
    factor: Mapping[Group, Array] = field(default_factory=dict)
    repeatability: Mapping[Group, float] = field(default_factory=dict)
    conditions: Mapping[str, npt.ArrayLike] = field(default_factory=dict)

    def of_sessions(self, group: Group) -> Array:
        """Each session's parameters of a joint and direction in motion, shape (c, p)."""
        law, values = self.laws[group[0]], np.asarray(self.values[group], float)
        moving = law.in_motion(values) if isinstance(law, ExtendedLaw) else values
        return np.broadcast_to(moving, (len(self.sessions), len(law.parameters)))

    def factors(self, group: Group) -> Array:
        """Each session's factor of a joint and direction, shape (c,)."""
        return np.broadcast_to(self.factor.get(group, 1.0), len(self.sessions))

    def added(self, group: Group, rows: Any, values: Array) -> Array | float:
        """Steps that causes add to drives, shape (n,); a session's factor changes none of them."""
        law = self.laws[group[0]]
        return law.added(rows, values) if isinstance(law, ExtendedLaw) else 0.0
