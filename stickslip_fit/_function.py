"""NumericFunction: a Python function of columns and parameters by name, with numerical derivatives.

Derivatives are by complex step (W. Squire and G. Trapp, SIAM Review 40:110, 1998) where it agrees with
central differences, which it does for functions that are analytic in the parameter; else by the differences.
About 0 many functions switch to a limit that does not depend on the parameter, so that a fit that reaches 0
would stay there: where a derivative vanishes so near to 0, it is that of a wider difference.
"""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError

COMPLEX_STEP = 1e-100
DIFFERENCE_STEP = float(np.cbrt(np.finfo(float).eps))  # of each value, or of its typical size
NO_FUNCTIONS: Mapping[str, Callable[..., Any]] = MappingProxyType({})
NEAR_ZERO = 1e-3  # of a parameter's typical size; also the wider difference
AGREEMENT = 1e-5  # of the complex step with the differences, relative to the largest derivative


@dataclass(frozen=True)
class NumericFunction:
    """A Python function in place of an `Expression`: the same methods.

    Attributes
    ----------
    function : callable
        Of arrays, by name; returns one array of their shape.
    """

    python: Callable[..., Any]

    @property
    def text(self) -> str:
        """The function's name."""
        return getattr(self.python, "__name__", repr(self.python))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Its arguments' names."""
        try:
            arguments = inspect.signature(self.python).parameters.values()
        except (TypeError, ValueError) as error:
            raise InputError(f"the arguments of {self.text} are not known ({error})") from None
        by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
        if not all(argument.kind in by_name for argument in arguments):
            raise InputError(
                f"the function {self.text} must take columns and parameters by name, without * or /"
            )
        return tuple(argument.name for argument in arguments)

    @property
    def active_names(self) -> frozenset[str]:
        """The names of all arguments: which of them cancel out is not known."""
        return frozenset(self.names)

    def evaluate(self, quantities: Mapping[str, Any]) -> Array:
        """The function's value at quantities by name, of shapes that broadcast.

        Raises
        ------
        InputError
            Where the function raises, with its own message, or does not return an array of the right shape.
        """
        return self._call({name: np.asarray(quantities[name], dtype=float) for name in self.names})

    def function(self, by: Sequence[str] = ()) -> Callable[[Mapping[str, Any]], tuple[Array, Array]]:
        """From quantities by name to the value and its derivatives by the names of `by`, (..., len(by))."""
        is_analytic: dict[str, bool] = {}

        def evaluate(quantities: Mapping[str, Any]) -> tuple[Array, Array]:
            arguments = {name: np.asarray(quantities[name], dtype=float) for name in self.names}
            value, slopes = self._call(arguments), list[Array]()
            for name in by:
                slope = self._complex_step(arguments, name) if is_analytic.get(name, True) else None
                if slope is None or name not in is_analytic:
                    difference = self._difference(arguments, name)
                    is_analytic[name] = slope is not None and _agree(slope, difference)
                    slope = slope if slope is not None and is_analytic[name] else difference
                slopes.append(self._steepen(arguments, name, value, slope))
            stacked = np.stack(slopes, axis=-1) if slopes else np.zeros((*value.shape, 0))
            return value, stacked

        return evaluate

    def importable_name(self) -> str:
        """``module:name``, by which it can be imported elsewhere.

        Raises
        ------
        InputError
            For a function of a notebook or a script, or one within another function.
        """
        module, name = self.python.__module__, getattr(self.python, "__qualname__", "")
        if module != "__main__" and getattr(sys.modules.get(module), name, None) is self.python:
            return f"{module}:{name}"
        raise InputError(
            f"the function {self.text} cannot be saved: it is not in a module that can be imported. Move it "
            "into a file of its own and import it from there, or write it as a formula"
        )

    def _steepen(self, arguments: Mapping[str, Array], name: str, value: Array, slope: Array) -> Array:
        """Derivatives, those that vanish near 0 by a wider difference, to the side where there is one."""
        x = arguments[name]
        step = NEAR_ZERO * float(np.sqrt(np.mean(x**2)))
        flat = (np.abs(x) < step) & ((slope == 0) | ~np.isfinite(slope))
        for shift in (step, -step) if flat.any() else ():
            wider = (self._call({**arguments, name: x + shift}) - value) / shift
            better = flat & np.isfinite(wider) & (wider != 0)
            slope, flat = np.where(better, wider, slope), flat & ~better
        return slope

    def _difference(self, arguments: Mapping[str, Array], name: str) -> Array:
        x = arguments[name]
        step = DIFFERENCE_STEP * np.maximum(np.abs(x), np.sqrt(np.mean(x**2)) or 1.0)
        upper, lower = x + step, x - step
        rise = self._call({**arguments, name: upper}) - self._call({**arguments, name: lower})
        with np.errstate(all="ignore"):
            return rise / (upper - lower)

    def _complex_step(self, arguments: Mapping[str, Array], name: str) -> Array | None:
        """None where the function does not take complex numbers."""
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                value = self.python(**{**arguments, name: arguments[name] + 1j * COMPLEX_STEP})
            value = np.asarray(value, dtype=complex)
            return np.broadcast_to(value.imag / COMPLEX_STEP, _shape(arguments)).copy()
        except Exception:  # whatever it raises, differences are left
            return None

    def _call(self, arguments: Mapping[str, Array]) -> Array:
        try:
            with np.errstate(all="ignore"):
                value = np.asarray(self.python(**arguments), dtype=float)
        except InputError:
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            place = _line_of(error, self.python)
            raise InputError(f"the function {self.text} raised{place} {reason}") from error
        shape = _shape(arguments)
        if value.shape not in (shape, ()):
            raise InputError(
                f"the function {self.text} returned shape {value.shape} for arguments of shape {shape}; it "
                "must work on whole columns and return one number for each row"
            )
        return np.broadcast_to(value, shape).copy()


def find_function(name: str, functions: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    """The function that a file names, among those that are given: a file never makes code run.

    Raises
    ------
    InputError
        If it is not among them.
    """
    if name in functions:
        return functions[name]
    raise InputError(
        f"a function of someone's own, {name}, is needed, and no code is run because a file names it; if you "
        "trust it, import it and give it again"
    )


def _shape(arguments: Mapping[str, Array]) -> tuple[int, ...]:
    return np.broadcast_shapes(*(array.shape for array in arguments.values()))


def _agree(slope: Array, difference: Array) -> bool:
    size = np.abs(difference).max(initial=0.0)
    return bool(np.all(np.abs(slope - difference) <= AGREEMENT * (np.abs(difference) + size)))


def _line_of(error: BaseException, function: Callable[..., Any]) -> str:
    """The line of the function's own file on which it raised."""
    code, trace, line = getattr(function, "__code__", None), error.__traceback__, None
    while trace is not None:
        if trace.tb_frame.f_code is code:
            line = trace.tb_lineno
        trace = trace.tb_next
    return f" on line {line} of {function.__module__}" if line else ""
