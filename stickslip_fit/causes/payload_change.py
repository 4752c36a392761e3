"""A mass at the tip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import (
    Array,
    Cause,
    CauseParameter,
    Row,
    StateCause,
    filled,
    missing_column,
)
from stickslip_fit.causes.moments import changes_since, moment_of, moments, since
from stickslip_fit.laws import State, StepLaw
from stickslip_fit.machine import Machine


@dataclass(frozen=True)
class PayloadChange(StateCause):
    """The load coefficient times 1 + k after one moment of the campaign, or times 1 + k payload.

    Attributes
    ----------
    session : str
        In which the mass was put on or taken off; empty where the log records the payload.
    mean : float
        Payload over the log, kg.
    """

    session: str = ""
    mean: float = 0.0

    name = "payload-change"
    phrase = "the arm carries another mass"
    physics = (
        "A mass at the tip adds its weight to the arm's, so that all loads grow by the same factor, "
        "whatever the configuration, while the step size without load stays what it was. After a session's "
        "end it is part of the next session's calibration."
    )
    most = 5.0
    shows_best = "joint 3 upright before and after, in both directions"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `Cause`."""
        return ("session", "session_seconds") if self.session else ("payload",)

    @property
    def absent(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.0, 0.0) if self.session else (0.0,)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (0.1, 600.0) if self.session else (10.0,)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
        if self.session == "":
            return (CauseParameter("k", "%/g", "change of the load coefficient per gram"),)
        return (
            CauseParameter("k", "%", "change of the load coefficient", session=self.session),
            moment_of(self.session),
        )

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        found: list[tuple[Cause, Array]] = [
            (replace(self, session=session), np.column_stack([np.full(len(when), 0.1), when]))
            for session, when in moments(rows)
            if self.session in ("", session)
        ]
        if self.session == "" and missing_column(rows, "payload", "payload") is None:
            found += super().trials(rows)
        return found

    def bound(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bound`."""
        return replace(self, mean=float(rows["payload"].mean()) if rows["payload"].notna().any() else 0.0)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: a traverse is changed by the whole or not at all."""
        if self.session == "":
            return super().changes(law, rows, values, trials)
        return changes_since(
            lambda *known: super(PayloadChange, self).changes(law, *known),
            self.known(law, rows), values, self.session, trials,
        )  # fmt: skip

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        if self.session == "":
            payload = filled(state.column("payload"), self.mean)
            return state.but(given_load=state.load * (1.0 + values[0] * payload))
        size, moment = values
        return state.but(given_load=state.load * (1.0 + size * since(state, self.session, moment)))
