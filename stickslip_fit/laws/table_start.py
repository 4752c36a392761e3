"""Where the fit of a table's law begins: a search over the parameters in which the law is not linear.

At every place that is tried the linear parameters follow by least squares (G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10:413, 1973), so that only the others are searched: on a grid within bounds; without bounds at
random, at sizes that the columns and the response suggest: a width of a column's range or less, a rate of
one over it or more, a place within it. Where a law swings, frequencies are scanned as closely as the record
tells them apart. The best places are refined by nonlinear least squares.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, product
from math import isfinite
from typing import Any

import numpy as np

from stickslip_fit._expression import Expression
from stickslip_fit._typing import Array
from stickslip_fit.laws.base import Model, Parameter, Rows

MAX_STARTS = 125  # places on a grid within bounds
MAX_EVALUATIONS = 50  # of a refinement
BAD_FIT = 1e6  # standard deviations, in place of what is no number
MAX_LINEAR = 16  # parameters that are looked at
LINEAR_TOL = 1e-9  # share of the response's change
SEED, MAX_ROWS = 1, 200  # rows, at random, on which places are compared
N_DRAWS, N_REFINED, N_PLACES = 600, 8, 12
MAX_FREQUENCIES, STEPS_PER_CYCLE, N_SCANS = 400, 4, 4  # a quarter of a cycle more in the record each
RIDGE = 1e-10
WAVE = re.compile(r"\b(sin|cos)\s*\(")


def choose_start(law: Any, rows: Rows, y: Array, near: Sequence[Array] | None = None) -> Array:
    """Values of a `TableLaw` near the least sum of squares of its residuals, shape (p,).

    Parameters
    ----------
    law : TableLaw
    rows : Rows
    y : array, shape (n,)
        Responses.
    near : sequence of array, optional
        Places to begin, each of shape (p,), the best of which takes the place of a search.
    """
    parameters: tuple[Parameter, ...] = law.parameters
    given = {name: float(value) for name, value in law.source.start.items()}
    model = law.model(rows)
    first = np.array([given.get(one.name, _middle(one)) for one in parameters])
    free = [k for k, one in enumerate(parameters) if one.name not in given]
    free.sort(key=lambda k: _is_bounded(parameters[k]))
    columns = {name: values for name, values in law.quantities(rows).items() if np.ptp(values) > 0}
    if isinstance(law.right, Expression):
        moves = law.right.slopes_that_move(law.parameter_names)
        linear = _find_largest(lambda some: not moves[np.ix_(some, some)].any(), free)
    else:
        linear = _find_linear_everywhere(model, first, free, columns, y, parameters)
    others = [k for k in free if k not in linear]
    bounded = [k for k in others if _is_bounded(parameters[k])]
    starts = []
    for place in _grid([parameters[k] for k in bounded]):
        values = first.copy()
        values[bounded] = place
        starts.append(solve_linear(model, values, linear, y, parameters))
    best = _best_of(model, starts, y)
    if not others:
        return first if best is None else best
    starts = [] if best is None else [best]
    if near is not None:
        best = _best_of(model, [solve_linear(model, place, linear, y, parameters) for place in near], y)
        starts += [] if best is None else [best]
    elif len(bounded) < len(others) and columns:
        starts += _search(law, law.quantities(rows), y, first, linear, others)
    refined = [_refine(model, one, free, y, parameters) for one in starts]
    best = _best_of(model, refined, y)
    return first if best is None else best


def _find_linear_everywhere(
    model: Model,
    first: Array,
    free: Sequence[int],
    columns: Mapping[str, Array],
    y: Array,
    parameters: Sequence[Parameter],
) -> list[int]:
    """As `find_linear`, also at other places: where exp(-k x) is 0, anything is linear in k."""
    linear, rng = find_linear(model, first, free), np.random.default_rng(SEED)
    if not columns:
        return linear
    places = np.tile(first, (N_PLACES, 1))
    for k in free:
        places[:, k] = _draw(rng, N_PLACES, columns, y, parameters[k])
    with np.errstate(all="ignore"):
        for place in places:
            if all(np.isfinite(part).all() for part in model(place)):
                linear = find_linear(model, place, linear)
    return linear


def _best_of(model: Model, places: Sequence[Array], y: Array) -> Array | None:
    """The place of the least sum of squares; None where there is none."""
    with np.errstate(all="ignore"):
        squares = [float(np.sum((y - model(place)[0]) ** 2)) for place in places]
    found = [(one, k) for k, one in enumerate(squares) if isfinite(one)]
    return places[min(found)[1]] if found else None


def _search(
    law: Any,
    columns: Mapping[str, Array],
    y: Array,
    first: Array,
    linear: Sequence[int],
    others: Sequence[int],
) -> list[Array]:
    """Places to begin, the best of many; `others` are searched, and `linear` follow by least squares."""
    rng, n, parameters = np.random.default_rng(SEED), len(y), law.parameters
    some = np.sort(rng.choice(n, min(n, MAX_ROWS), replace=False))
    few = {name: values[some] for name, values in columns.items()}
    places = np.tile(first, (N_DRAWS, 1))
    for k in others:
        places[:, k] = _draw(rng, N_DRAWS, few, y, parameters[k])
    found = [_solve_places(law, few, y[some], places, linear)]
    if WAVE.search(str(law.right.text)):
        order = np.argsort(found[0][1])[: N_DRAWS // 4]
        for k in others:
            grid = np.concatenate([_frequencies(values) for values in few.values()])
            scan = np.repeat(found[0][0][rng.choice(order, N_SCANS)], len(grid), axis=0)
            scan[:, k] = np.clip(np.tile(grid, N_SCANS), parameters[k].lower, parameters[k].upper)
            found.append(_solve_places(law, few, y[some], scan, linear))
    model, starts = law.model(few), []
    for solved, squares in found:
        leading = [k for k in np.argsort(squares)[:N_REFINED].tolist() if isfinite(squares[k])]
        starts += [_refine(model, solved[k], [*linear, *others], y[some], parameters) for k in leading]
    with np.errstate(all="ignore"):
        squares = np.array([float(np.sum((y[some] - model(one)[0]) ** 2)) for one in starts])
    return [starts[k] for k in np.argsort(squares)[:2].tolist()]


def _draw(
    rng: np.random.Generator, number: int, columns: Mapping[str, Array], y: Array, parameter: Parameter
) -> Array:
    """Values that a parameter may have, shape (number,)."""
    if _is_bounded(parameter):
        return rng.permutation(spread(parameter.lower, parameter.upper, number))
    low, high = np.array([[np.min(values), np.max(values)] for values in columns.values()]).T
    which = rng.integers(len(low), size=number)
    middle, width = ((high + low) / 2)[which], np.where(high > low, high - low, 1.0)[which]
    largest = np.maximum(np.maximum(-low, high), np.finfo(float).tiny)[which]
    response = float(np.sqrt(np.mean(y**2))) or 1.0
    ratio = 10.0 ** rng.uniform(-1.0, 1.0, number)
    kinds = np.stack(
        [
            middle + 0.7 * width * rng.uniform(-1.0, 1.0, number),
            width * 10.0 ** rng.uniform(-2.0, 0.5, number),
            10.0 ** rng.uniform(-0.5, 2.0, number) / width,
            *(ratio, ratio * largest, ratio / largest, ratio / largest**2, ratio / largest**3),
            *(ratio / response, ratio / (response * largest)),
        ]
    )
    values = kinds[rng.integers(len(kinds), size=number), np.arange(number)]
    values *= np.where(rng.uniform(size=number) < 0.25, -1.0, 1.0)
    inside = (values >= parameter.lower) & (values <= parameter.upper)
    return np.clip(np.where(inside, values, -values), parameter.lower, parameter.upper)


def _frequencies(values: Array) -> Array:
    """Frequencies, angular frequencies and periods of waves along a column."""
    cycles = np.arange(1, min(2 * len(values), MAX_FREQUENCIES) + 1) / STEPS_PER_CYCLE
    rates = cycles / max(float(np.ptp(values)), np.finfo(float).tiny)
    return np.concatenate([rates, 2.0 * np.pi * rates, 1.0 / rates])


def _solve_places(
    law: Any, columns: Mapping[str, Array], y: Array, places: Array, linear: Sequence[int]
) -> tuple[Array, Array]:
    """Places, shape (m, p), with the linear parameters by least squares; sums of squares, shape (m,)."""
    m, n, places = len(places), len(y), places.copy()
    with np.errstate(all="ignore"):
        model = law.model({name: np.tile(values, m) for name, values in columns.items()})
        predicted, slopes = model(np.repeat(places, n, axis=0))
        residual = y - predicted.reshape(m, n)
        some = slopes.reshape(m, n, -1)[:, :, list(linear)]
        usable = np.isfinite(residual).all(axis=1) & np.isfinite(some).all(axis=(1, 2))
        residual, some = np.where(usable[:, None], residual, 0.0), np.where(usable[:, None, None], some, 0.0)
        length = np.maximum(np.linalg.norm(some, axis=1), np.finfo(float).tiny ** 0.25)
        some /= length[:, None]
        products = some.swapaxes(1, 2) @ some + RIDGE * np.eye(len(linear))
        change = np.linalg.solve(products, some.swapaxes(1, 2) @ residual[:, :, None])[:, :, 0]
        low, high = (
            np.array([(law.parameters[k].lower, law.parameters[k].upper) for k in linear]).reshape(-1, 2).T
        )
        before = places[:, list(linear)]
        places[:, list(linear)] = np.clip(before + change / length, low, high)
        residual -= np.einsum("mnk,mk->mn", some, (places[:, list(linear)] - before) * length)
        return places, np.where(usable, np.sum(residual**2, axis=1), np.inf)


def find_linear(model: Model, values: Array, among: Sequence[int]) -> list[int]:
    """The largest set of some parameters in which, all together, the prediction is linear at some values.

    Of two sets as large that which has the first parameters of `among`.
    """
    return _find_largest(lambda some: is_linear(model, values, some), among)


def _find_largest(is_linear: Callable[[Sequence[int]], bool], among: Sequence[int]) -> list[int]:
    """See `find_linear`."""
    singles = [k for k in list(among)[:MAX_LINEAR] if is_linear([k])]
    pairs = {pair for pair in combinations(singles, 2) if is_linear(pair)}
    for size in range(len(singles), 0, -1):
        for some in combinations(singles, size):
            if all(pair in pairs for pair in combinations(some, 2)) and is_linear(some):
                return sorted(some)
    return []


def is_linear(model: Model, values: Array, together: Sequence[int]) -> bool:
    """Whether the prediction is linear in some parameters together, the others at `values`."""
    base, slopes = model(values)
    moved = values.copy()
    moved[list(together)] += 1.0 + 0.37 * np.arange(1, len(together) + 1)
    change = slopes @ (moved - values)
    size = np.abs(change).max(initial=0.0) + np.abs(base).max(initial=0.0)
    error = np.abs(model(moved)[0] - base - change)
    return bool(np.isfinite(error).all() and error.max(initial=0.0) <= LINEAR_TOL * size)


def solve_linear(
    model: Model, values: Array, linear: Sequence[int], y: Array, parameters: Sequence[Parameter]
) -> Array:
    """Values with those of the linear parameters by least squares, within their bounds."""
    predicted, slopes = model(values)
    columns = slopes[:, linear]
    known = np.isfinite(predicted) & np.isfinite(columns).all(axis=1) & np.isfinite(y)
    if not linear or not known.any():
        return values
    length = np.linalg.norm(columns[known], axis=0)
    length = np.where(length > 0, length, 1.0)
    change = np.linalg.lstsq(columns[known] / length, (y - predicted)[known], rcond=None)[0] / length
    solved = values.copy()
    low = [parameters[k].lower for k in linear]
    high = [parameters[k].upper for k in linear]
    solved[list(linear)] = np.clip(values[list(linear)] + change, low, high)
    return solved


def _refine(
    model: Model, values: Array, free: Sequence[int], y: Array, parameters: Sequence[Parameter]
) -> Array:
    """Values with some of them by nonlinear least squares, roughly."""
    from scipy.optimize import least_squares

    size, places = float(np.std(y)) or 1.0, list(free)

    def evaluate(some: Array) -> tuple[Array, Array]:
        moved = values.copy()
        moved[places] = some
        predicted, jacobian = model(moved)
        return np.nan_to_num((predicted - y) / size, nan=BAD_FIT), np.nan_to_num(jacobian[:, places] / size)

    def residual(some: Array) -> Array:
        return evaluate(some)[0]

    def slopes(some: Array) -> Array:
        return evaluate(some)[1]

    low = np.array([parameters[k].lower for k in places])
    high = np.array([parameters[k].upper for k in places])
    length = np.sqrt(np.sum(slopes(values[places]) ** 2, axis=0))
    with np.errstate(all="ignore"):
        solved = least_squares(
            residual,
            np.clip(values[places], low, high),
            jac=slopes,
            bounds=(low, high),
            x_scale=np.sqrt(len(y)) / np.where(length > 0, length, np.sqrt(len(y))),
            gtol=None,
            max_nfev=MAX_EVALUATIONS,
        )
    refined = values.copy()
    refined[places] = solved.x
    return refined if np.isfinite(model(refined)[0]).all() else values


def _middle(parameter: Parameter) -> float:
    low, high = parameter.lower, parameter.upper
    if isfinite(low) and isfinite(high):
        return float(np.sqrt(low * high)) if low > 0 else (low + high) / 2
    if low <= 1.0 <= high:
        return 1.0
    return low + max(1.0, abs(low)) if isfinite(low) else high - max(1.0, abs(high))


def _is_bounded(parameter: Parameter) -> bool:
    return isfinite(parameter.upper - parameter.lower)


def _grid(parameters: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """Places within bounds, by ratio where these are above 0."""
    if not parameters:
        return [()]
    number = max(2, min(7, int(MAX_STARTS ** (1 / len(parameters)))))
    return list(product(*(spread(one.lower, one.upper, number) for one in parameters)))[:MAX_STARTS]


def spread(low: float, high: float, number: int) -> Array:
    """Numbers within bounds, half a spacing away from them: by ratio where these are above 0."""
    shares = (np.arange(number) + 0.5) / number
    return low * (high / low) ** shares if low > 0 else low + (high - low) * shares
