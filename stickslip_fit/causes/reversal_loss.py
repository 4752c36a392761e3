"""Steps are lost after each reversal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, CauseParameter, CountCause
from stickslip_fit.laws import State


@dataclass(frozen=True)
class ReversalLoss(CountCause):
    """N plus L where the traverse before went the other way; a session's first did not."""

    name = "reversal-loss"
    phrase = "steps are lost after each reversal"
    physics = (
        "After a reversal the elastic deflection of the contact has to be wound up the other way before the "
        "joint moves, which takes a few steps (backlash of the preloaded contact)."
    )
    shows_best = "one configuration after a traverse in the same and in the other direction"
    columns = ("before_direction",)
    parameters = (CauseParameter("L", "steps", "steps lost at a reversal"),)
    absent = (0.0,)
    scale = (20.0,)

    def missing(self, rows: pd.DataFrame) -> str | None:
        """See `Cause.missing`."""
        turned = reversed_before(rows["before_direction"], rows["direction"])
        if not turned.any():
            return "no traverse follows one in the other direction"
        return "every traverse follows one in the other direction" if turned.all() else None

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return (np.array([300.0]),)

    def steps(self, state: State, values: list[Array]) -> Array:
        """See `CountCause.steps`."""
        before = np.asarray(state.row["before_direction"], dtype=object)
        own = np.where(state.way[:, 0] > 0, "+", "-")
        return values[0] * reversed_before(before, own)[:, None]


def reversed_before(before: object, own: object) -> np.ndarray:
    """Whether each traverse follows one in the other direction."""
    before, own = np.asarray(before, dtype=object), np.asarray(own, dtype=object)
    return (before != "") & (before != own)
