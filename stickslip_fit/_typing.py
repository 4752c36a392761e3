"""Array types, by what they hold."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Int64Array = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


class JointKinds(Protocol):
    """What a text about joints needs of a `Machine`."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Numbers of the joints."""

    @property
    def has_published_geometry(self) -> bool:
        """See `Machine`."""

    def is_prismatic(self, joint: int) -> bool:
        """See `Machine`."""

    def describe_joint(self, joint: int) -> str:
        """See `Machine`."""

    def span(self, joint: int) -> float:
        """See `Machine`."""
