"""Steps that a count has more or less, following something that no cause describes.

A stop that is heard late, or a backlash, adds steps whatever the length of the traverse. Where it depends on
a pose, a column of the log or what was driven before, no function of these in the step size describes it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.parameters import CauseParameter, Row
from stickslip_fit.causes.proposed import SMOOTH_SCALE, SmoothTerm
from stickslip_fit.laws import State, StepLaw, state_at

STEPS_SCALE = 10.0  # of the coefficients, steps


@dataclass(frozen=True)
class AddedSteps(SmoothTerm):
    """N plus a smooth function of a carrier that is constant along a traverse, in steps.

    Attributes
    ----------
    sds : tuple of float
        Prior standard deviation of each function's coefficient, steps.
    """

    sds: tuple[float, ...] = (STEPS_SCALE,)

    acts_at = "count"  # type: ignore[assignment]
    name = "smooth-function-of-steps"
    phrase = "counts have steps more or less that follow something smoothly"
    physics = (
        "Whatever the carrier stands for: the log alone shows that steps are added to each count or missing "
        "from it, as many for a short traverse as for a long one, as by a stop heard late or a backlash."
    )
    shows_best = "short traverses beside long ones, at the lowest and the highest values of the carrier"

    @classmethod
    def of(cls, term: SmoothTerm) -> AddedSteps:
        """The same function, of steps that are added in place of the step size's logarithm."""
        sds = tuple(STEPS_SCALE / SMOOTH_SCALE * sd for sd in term.sds)
        return cls(term.carriers, term.limits, term.orders, sds)

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        """See `Cause`."""
        what = f"of a smooth function of {' and '.join(self.carriers)}, added to the count"
        own = super().parameters
        return tuple(replace(one, unit="steps", meaning=f"coefficient {one.name[1:]} {what}") for one in own)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (STEPS_SCALE,) * len(self.parameters)

    def steps(self, state: State, values: list[Array]) -> Array:
        """Steps added, shape (n, 1); see `CountCause.steps`."""
        return self.linear_sum(state, np.concatenate(values, axis=1))

    def null_slopes(self, law: StepLaw, rows: Row, values: Array) -> Array:
        """See `LinearFactor.null_slopes`: what is added is a share of the count."""
        row = self.row_values(law, rows)
        state = state_at(law.joint, row, row["start"][:, None])
        functions, acts = self.functions(state)[:, 0], self.acts(state)
        slopes = (acts[:, :, None] * functions[:, None, :]).reshape(len(acts), -1)
        return np.asarray(slopes / np.exp(law.predict(rows, values))[:, None])
