"""ZeroLimit: the effect of a formula that has no value where its parameters are 0, though it has a limit.

``+ (velocity + g/r)*(1 - exp(-r*seconds))/r - g/r*seconds - ...`` is how a textbook writes drag: without drag
it is 0 / 0. There its limit counts, by extrapolation from near 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stickslip_fit._expression import Expression
from stickslip_fit._function import NumericFunction
from stickslip_fit._typing import Array, BoolArray

NEAR_ZERO = 1e-4  # of a parameter's scale: there its effect is hardly curved, and no rounding yet


@dataclass(frozen=True)
class ZeroLimit:
    """An effect with its limit where all its parameters are 0.

    Attributes
    ----------
    effect : Expression or NumericFunction
    scale : dict of str to float
        Usual sizes of the parameters, by name.
    """

    effect: Expression | NumericFunction
    scale: Mapping[str, float]

    def evaluate(self, quantities: Mapping[str, Any]) -> Array:
        """The effect's value, as of an `Expression`."""
        return self.function()(quantities)[0]

    def function(self, by: Sequence[str] = ()) -> Callable[[Mapping[str, Any]], tuple[Array, Array]]:
        """From quantities by name to the value and its derivatives, as of an `Expression`."""
        function = self.effect.function(by)

        def evaluate(quantities: Mapping[str, Any]) -> tuple[Array, Array]:
            with np.errstate(all="ignore"):
                value, slopes = function(quantities)
            undefined = ~np.isfinite(value)
            if not undefined.any():
                return value, slopes
            undefined = undefined & self._are_zero(quantities)
            if not undefined.any():
                return value, slopes
            (near, near_slopes), (farther, _) = (
                function({**quantities, **self._shift(quantities, undefined, times)}) for times in (1.0, 2.0)
            )
            limit = np.where(undefined, 2.0 * near - farther, value)
            return limit, np.where(undefined[..., None], near_slopes, slopes)

        return evaluate

    def _are_zero(self, quantities: Mapping[str, Any]) -> BoolArray:
        zero = [np.asarray(quantities[name]) == 0 for name in self.scale]
        return np.logical_and.reduce(np.broadcast_arrays(*zero))

    def _shift(self, quantities: Mapping[str, Any], where: BoolArray, times: float) -> dict[str, Array]:
        """The parameters, so many times `NEAR_ZERO` of their scale in the chosen rows."""
        return {
            name: np.where(where, times * NEAR_ZERO * size, np.asarray(quantities[name], float))
            for name, size in self.scale.items()
        }
