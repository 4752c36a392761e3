"""A mass at the tip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, Row, StateCause, missing_column
from stickslip_fit.causes.moments import moments
from stickslip_fit.laws import State, StepLaw


@dataclass(frozen=True)
class PayloadChange(StateCause):
    """The load coefficient times 1 + k after one moment of the campaign, or times 1 + k payload.

    Attributes
    ----------
    session : str
        In which the mass was put on or taken off; empty where the log records the payload.
    """

    session: str = ""

    name = "payload-change"
    phrase = "the arm carries another mass"
    physics = (
        "A mass at the tip adds its weight to the arm's, so that all loads grow by the same factor, "
        "whatever the configuration, while the step size without load stays what it was. After a session's "
        "end it is part of the next session's calibration."
    )
    most = 5.0
    shows_best = "joint 3 upright before and after, in both directions"
    columns = ("q1", "q2", "q3", "theta", "psi", "session", "session_seconds", "payload")

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
            CauseParameter(
                "moment", "min", "when, from the session's first traverse", lower=0.0, session=self.session
            ),
        )

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        found: list[tuple[Cause, Array]] = [
            (replace(self, session=session), np.column_stack([np.full(len(when), 0.1), when]))
            for session, when in moments(rows)
        ]
        if missing_column(rows, "payload", "payload") is None:
            found += super().trials(rows)
        return found

    def largest(self) -> tuple[Array, ...]:
        """See `Cause.largest`."""
        return ()

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: a traverse is changed by the whole or not at all."""
        if self.session == "":
            return super().changes(law, rows, values, trials)
        mine = np.asarray(rows["session"], dtype=object) == self.session
        seconds = np.asarray(rows["session_seconds"], dtype=float)
        after = mine[:, None] & (seconds[:, None] >= trials[:, 1])
        sizes, which = np.unique(trials[:, 0], return_inverse=True)
        whole = super().changes(law, rows, values, np.column_stack([sizes, np.full(len(sizes), -np.inf)]))
        return whole[:, which] * after

    def change(self, state: State, values: list[Array]) -> State:
        """See `StateCause.change`."""
        if self.session == "":
            return state.but(
                given_load=state.load * (1.0 + values[0] * np.nan_to_num(state.column("payload")))
            )
        size, moment = values
        mine = (np.asarray(state.row["session"], dtype=object) == self.session)[:, None]
        after = mine & (state.column("session_seconds") >= moment)
        return state.but(given_load=state.load * (1.0 + size * after))
