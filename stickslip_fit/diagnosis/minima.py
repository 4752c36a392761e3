"""Roots and minima of functions of one to three numbers.

As those of `scipy.optimize`, the import of which takes longer than all that a diagnosis asks for.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stickslip_fit._typing import Array

GOLDEN = float((np.sqrt(5.0) - 1.0) / 2.0)


def find_root(function: Callable[[float], float], low: float, high: float, tolerance: float = 1e-12) -> float:
    """Where a function changes its sign between two numbers (T. Chandrupatla, Adv. Eng. Softw. 28:145, 1997).

    Inverse quadratic interpolation where that is safe, else bisection.

    Examples
    --------
    >>> round(find_root(lambda x: x**2 - 2.0, 0.0, 2.0), 12)
    1.414213562373
    """
    a, b, share = high, low, 0.5
    at_a, at_b = function(a), function(b)
    while True:
        x = a + share * (b - a)
        at_x = function(x)
        if (at_x > 0) == (at_a > 0):
            c, at_c = a, at_a
        else:
            c, at_c, b, at_b = b, at_b, a, at_a
        a, at_a = x, at_x
        best, at_best = (a, at_a) if abs(at_a) < abs(at_b) else (b, at_b)
        least = tolerance / abs(b - a) + np.finfo(float).eps
        if at_best == 0 or least > 0.5:
            return float(best)
        place, rise = (a - b) / (c - b), (at_a - at_b) / (at_c - at_b)
        share = 0.5
        if rise**2 < place and (1.0 - rise) ** 2 < 1.0 - place:
            share = at_a / (at_b - at_a) * at_c / (at_b - at_c)
            share += (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
        share = min(max(share, least), 1.0 - least)


def minimize_between(
    function: Callable[[float], float], low: float, high: float, tolerance: float = 1e-6
) -> float:
    """Where a function of one number is least, by golden sections.

    Examples
    --------
    >>> round(minimize_between(lambda x: (x - 0.3) ** 2, -1.0, 2.0), 5)
    0.3
    """
    first, last = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_first, at_last = function(first), function(last)
    while high - low > tolerance:
        if at_first < at_last:
            high, last, at_last = last, first, at_first
            first = high - GOLDEN * (high - low)
            at_first = function(first)
        else:
            low, first, at_first = first, last, at_last
            last = low + GOLDEN * (high - low)
            at_last = function(last)
    return (low + high) / 2.0


def minimize_simplex(
    function: Callable[[Array], float], start: Array, near: float, flat: float, most: int
) -> tuple[Array, float]:
    """Where a function of q numbers is least, and its value there.

    J. Nelder and R. Mead, Comput. J. 7:308, 1965.

    Parameters
    ----------
    start : array, shape (q + 1, q)
        Corners of the first simplex.
    near, flat : float
        The search ends where corners are so near the best one, and their values as near its value.
    most : int
        Steps.
    """
    corners, values = start, np.array([function(corner) for corner in start])
    for _ in range(most):
        order = np.argsort(values, kind="stable")
        corners, values = corners[order], values[order]
        if np.abs(corners[1:] - corners[0]).max() <= near and values[-1] - values[0] <= flat:
            break
        middle, worst = corners[:-1].mean(axis=0), corners[-1]

        def move(factor: float, middle: Array = middle, worst: Array = worst) -> tuple[Array, float]:
            corner = (1.0 + factor) * middle - factor * worst
            return corner, function(corner)

        moved = move(1.0)
        if moved[1] < values[0]:
            moved = min(move(2.0), moved, key=lambda one: one[1])
        elif moved[1] >= values[-2]:
            limit = min(moved[1], values[-1])
            moved = move(0.5 if moved[1] < values[-1] else -0.5)
            if moved[1] > limit:
                corners = corners[0] + 0.5 * (corners - corners[0])
                values[1:] = [function(corner) for corner in corners[1:]]
                continue
        corners[-1], values[-1] = moved
    best = int(np.argmin(values))
    return corners[best], float(values[best])
