"""A cause as a smooth function of its only column, where its equation is far from what the data show.

A resonance between steps or a threshold of the humidity is still `step-rate` or `humidity`; but a law with a
straight line in its place would say next to nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

from stickslip_fit._format import capitalize_first
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.parameters import SizedParameter
from stickslip_fit.causes.profile import RMS, rms_of_factor
from stickslip_fit.causes.proposed import SmoothTerm


@dataclass(frozen=True)
class FunctionOfCause(SmoothTerm):
    """gamma times exp of a smooth function of a cause's column, under the cause's name.

    Attributes
    ----------
    of : str
        Name of the cause.
    phrase, physics, shows_best, remedy : str
        Those of the cause.
    """

    of: str = ""
    phrase: str = SmoothTerm.phrase  # type: ignore[misc]
    physics: str = SmoothTerm.physics  # type: ignore[misc]
    shows_best: str = SmoothTerm.shows_best  # type: ignore[misc]
    remedy: str = ""  # type: ignore[misc]

    combine_trials = False  # it is a shape that the data may bend

    @property
    def name(self) -> str:  # type: ignore[override]
        return self.of

    @classmethod
    def of_term(cls, cause: Cause, term: SmoothTerm) -> Self:
        """A cause as the smooth function of a term."""
        shared = {one.name: getattr(term, one.name) for one in fields(SmoothTerm)}
        words = {name: getattr(cause, name) for name in ("phrase", "physics", "shows_best", "remedy")}
        return cls(**shared, of=cause.name, **words)

    def summarize(self, values: Array, covariance: Array) -> tuple[SizedParameter, ...]:
        """The rms of the factor over the column's range, by coefficients (q,) and their covariance (q, q)."""
        return (SizedParameter(RMS, "%", rms_of_factor(values, covariance)),)

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        """See `Cause.describe`: the phrase, and the rms where it is known."""
        by = "".join(f", by {one} rms" for one in parameters if one.name == RMS)
        return (
            capitalize_first(self.phrase) + by + ", along a curve that the cause's equation does not describe"
        )
