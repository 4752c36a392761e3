"""The extended law: what other sessions, or a diagnosis of another log, know of causes is taken for true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError
from stickslip_fit.fit import Result, least_squares
from stickslip_fit.fit.known_causes import HeldLaw, KnownCauses, known_causes
from stickslip_fit.logs import Log
from stickslip_fit.strategies.at_hand import AtHand, other_sessions
from stickslip_fit.strategies.task import Predictor, Strategy, Task, Unsuited

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class WithCauses:
    """Another strategy, with causes of known size in the law.

    Attributes
    ----------
    strategy : Strategy
        Calibrates what the law has of its own.
    known : mapping of str to KnownCauses or str
        By session, from what it was not part of; or why that could not be known. Its sizes are taken for
        true, also in the standard deviations of what is predicted.
    """

    strategy: Strategy
    known: Mapping[str, KnownCauses | str]

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"{self.strategy.name}, with causes"

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return self.strategy.choose(self._extended(task))

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        return self.strategy.calibrate(self._extended(task), made)

    def _extended(self, task: Task) -> Task:
        known = self.known[task.session]
        if isinstance(known, str):
            raise Unsuited(known)
        return replace(task, law=HeldLaw(task.law, known.causes, known.values))


def from_other_sessions(
    log: Log, causes: Sequence[Cause], at_hand: AtHand = other_sessions
) -> dict[str, KnownCauses | str]:
    """Fit causes on the sessions that each session may look back on.

    Parameters
    ----------
    log : Log
    causes : sequence of Cause
        Such as a diagnosis named.
    at_hand : callable, optional
        Which sessions these are.
    """
    known: dict[str, KnownCauses | str] = {}
    for session in log.sessions:
        others = at_hand(log.sessions, session)
        if not others:
            known[session] = "there is no other session to fit its causes on"
            continue
        try:
            fitted = least_squares(log.select(log.rows["session"].isin(others)), causes=causes)
            known[session] = known_causes(fitted)
        except InputError as error:
            known[session] = f"its causes cannot be fitted on the other sessions: {error}"
    return known


def from_result(log: Log, result: Result) -> dict[str, KnownCauses | str]:
    """Take the causes of a saved result for known in every session.

    Raises
    ------
    InputError
        If it was fitted to this very log, is of another machine, or knows no causes.
    """
    if result.provenance.log_sha256 == log.sha256:
        raise InputError(
            "the causes of this result were fitted to the traverses that they would be judged by; name them "
            "with --cause, so that they are fitted to the other sessions, or take a result of another log"
        )
    if result.machine.sha256 != log.machine.sha256:
        raise InputError("the causes were fitted for another machine; read the log with that one")
    return dict.fromkeys(log.sessions, known_causes(result))
