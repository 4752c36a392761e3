"""Causes in a joint's own bearing, guide or cable: on all joints of a kind together, and on each alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians
from typing import Self

import pandas as pd

from stickslip_fit._format import capitalize_first, join_words
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.parameters import Sizes
from stickslip_fit.laws import StepLaw
from stickslip_fit.machine import Machine

Ranges = tuple[tuple[int, float, float], ...]
"""Joints with the ends of their ranges or travels, rad or m."""

# Of the published arm.
NOMINAL_TRAVEL: Ranges = (
    (1, radians(-120.0), radians(120.0)),
    (2, radians(-210.0), radians(30.0)),
    (3, 0.0, 12e-3),
)


@dataclass(frozen=True)
class JointRanges(Cause):
    """A cause that acts on some joints of its kind, over the ranges that they have.

    Attributes
    ----------
    ranges : tuple of (int, float, float)
        Joints that it acts on, with the ends of their ranges, rad or m; those given stay in any log.
        Empty for all of its kind.
    """

    ranges: Ranges = ()

    def acts_on(self, law: StepLaw) -> bool:
        own = not self.ranges or any(joint == law.joint for joint, _, _ in self.ranges)
        return own and super().acts_on(law)

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bind`: the joints of its kind that the log has."""
        joints = sorted({int(joint) for joint in rows["joint"]})
        own = [joint for joint in joints if machine.kinds[joint - 1] == self.kind]
        if self.ranges != type(self).ranges or not own:
            return self
        return replace(self, ranges=tuple((joint, *machine.ranges[joint]) for joint in own))

    def ends(self, joint: int) -> tuple[float, float]:
        """The ends of a joint's range, rad or m."""
        return next((low, high) for own, low, high in self.ranges if own == joint)

    def together_and_alone(self) -> list[Self]:
        """On all its joints with the same parameters, and on each alone."""
        alone = [replace(self, ranges=(one,)) for one in self.ranges] if len(self.ranges) > 1 else []
        return [self, *alone]

    def has_both_directions(self, rows: pd.DataFrame) -> bool:
        """Whether its joints were driven in both directions."""
        own = rows["joint"].isin([joint for joint, _, _ in self.ranges] or rows["joint"])
        return rows.loc[own, "direction"].nunique() > 1

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """See `Cause.quantities`: whose steps they are, as the beginning of a sentence."""
        whose = join_words([f"joint {joint}'s" for joint, _, _ in self.ranges]) or "the"
        return {**super().quantities(sizes), "whose": capitalize_first(whose)}
