"""A knock or a re-clamping: one sudden lasting change within a session."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from stickslip_fit.causes.cause import Array, Cause, CauseParameter, FactorCause, Row
from stickslip_fit.causes.moments import changes_since, moment_of, moments, since
from stickslip_fit.laws import State, StepLaw


@dataclass(frozen=True)
class SessionJump(FactorCause):
    """gamma times 1 + A from one moment of one session on.

    Attributes
    ----------
    session : str
    """

    session: str = ""

    name = "session-jump"
    phrase = "something jumped within a session"
    physics = (
        "A knock against the table, a cable that is moved or a screw that gives changes the preload of the "
        "sliding surfaces from one traverse to the next, and it stays changed until the session's end."
    )
    shows_best = "the configurations of before the jump once more, after it"
    columns = ("session", "session_seconds")
    absent = (0.0, 0.0)
    scale = (0.01, 600.0)

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
        return (
            CauseParameter("A", "%", "change of the step size", session=self.session),
            moment_of(self.session),
        )

    def within(self, session: str) -> Self:
        """The jump of one session."""
        return replace(self, session=session)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`."""
        return [
            (self.within(session), np.column_stack([np.full(len(when), 0.01), when]))
            for session, when in moments(rows)
            if self.session in ("", session)
        ]

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`."""
        return changes_since(
            lambda *known: super(SessionJump, self).changes(law, *known),
            self.known(law, rows), values, self.session, trials,
        )  # fmt: skip

    def factor(self, state: State, values: list[Array]) -> Array:
        """See `FactorCause.factor`."""
        size, moment = values
        return 1.0 + size * since(state, self.session, moment)
