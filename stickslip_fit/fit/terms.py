"""Options of a fit: the shape of the noise, which parameters sessions share, bounds, known repeatability."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.likelihood import Likelihood
from stickslip_fit.fit.repeatability import GAUSSIAN, GIVEN, Repeatability
from stickslip_fit.laws import StepLaw

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FitOptions:
    """Options of a least-squares fit.

    Attributes
    ----------
    likelihood : Likelihood
    shared : tuple of str
        Parameters that have one value in each direction for the whole campaign.
    bounds : dict of str to (float, float)
        Lowest and highest value of parameters, SI, within those of the law itself.
    repeatability : dict of (int, str) to float
        By joint and direction, relative, where it is known and not to be estimated.
    """

    likelihood: Likelihood = GAUSSIAN
    shared: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    repeatability: Mapping[tuple[int, str], float] = field(default_factory=dict)

    def check(self, laws: Iterable[StepLaw]) -> None:
        """Refuse what cannot be meant for these laws.

        Raises
        ------
        InputError
            For a parameter that no law has, bounds the wrong way round, or a repeatability not above 0.
        """
        known = list(dict.fromkeys(parameter.name for law in laws for parameter in law.parameters))
        for name in (*self.shared, *self.bounds):
            if name not in known:
                raise InputError(f"no law of this log has a parameter {name!r}; there are {', '.join(known)}")
        for name, (low, high) in self.bounds.items():
            if not low < high:
                raise InputError(f"bounds of {name}: the lower one must lie below the upper one")
        for (joint, direction), value in self.repeatability.items():
            if not 0 < value < np.inf:
                raise InputError(
                    f"repeatability of joint {joint} {direction}: must be above 0, not {value!r}"
                )

    def bounds_of(self, law: StepLaw, groups: Groups) -> tuple[Array, Array]:
        """Lower and upper bounds of a law's parameters, each shape (g, p)."""
        pairs = [
            (
                max(parameter.lower, self.bounds.get(parameter.name, (-np.inf, np.inf))[0]),
                min(parameter.upper, self.bounds.get(parameter.name, (-np.inf, np.inf))[1]),
            )
            for parameter in law.parameters
        ]
        lower, upper = np.array(pairs).T
        shape = (len(groups), len(pairs))
        return np.broadcast_to(lower, shape).copy(), np.broadcast_to(upper, shape).copy()

    def given(self, joint: int) -> dict[str, Repeatability]:
        """A joint's repeatability by direction, as far as it is known beforehand."""
        return {
            way: Repeatability(value, GIVEN, "given")
            for (of, way), value in self.repeatability.items()
            if of == joint
        }


DEFAULT_OPTIONS = FitOptions()
