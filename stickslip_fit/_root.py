"""Roots of functions of one number."""

from __future__ import annotations

from collections.abc import Callable


def find_root(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where a function changes its sign between two numbers, by bisection, to within a tolerance.

    To import `scipy.optimize` takes longer than all the roots of a diagnosis.

    Examples
    --------
    >>> round(find_root(lambda x: x**2 - 2.0, 0.0, 2.0, 1e-6), 5)
    1.41421
    """
    rises = function(high) > 0
    while high - low > tolerance:
        middle = (low + high) / 2.0
        low, high = (low, middle) if (function(middle) > 0) == rises else (middle, high)
    return (low + high) / 2.0
