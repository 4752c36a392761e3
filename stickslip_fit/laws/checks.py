"""check_law: whether a law of one's own can be fitted to these rows; one message for each fault.

The law is evaluated at its start values and near them: what it returns has to be finite, of the right shape,
and depend on each parameter as its derivatives say.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words, pluralize
from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.laws.base import Rows, StepLaw, expected_steps, traverse_length

SHARES = (0.0, 0.02, -0.03)  # of the scales, at which the law is evaluated
SPREADS = (0.003, 0.3)  # rad or m, by which the columns are moved
MAX_ROWS = 100  # of which derivatives are compared with differences
STEP = 1e-5  # of a difference, in scales
SLOPE_TOL = 0.02  # of a slope, and of the greatest slope
DIFFERENCE_TOL = 1e-6  # of log(steps) for a change by one scale: what rounding may leave


def check_law(law: StepLaw, rows: pd.DataFrame) -> None:
    """Check a joint's law on the rows that it is to be fitted to.

    Raises
    ------
    InputError
        If the law names an unknown column, raises an exception, gives no number or no step size at its start
        values, has a parameter that changes no count, or derivatives that are not those of its step size.
    """
    _check_columns(law, rows)
    p, where = len(law.parameters), f"joint {law.joint}, law {law.name!r}"
    if not p:
        raise InputError(f"{where}: it has no parameters, so that there is nothing to fit; give it one")
    if repeated := sorted(
        {a.name for a in law.parameters if [b.name for b in law.parameters].count(a.name) > 1}
    ):
        raise InputError(f"{where}: two of its parameters are called {join_words(repeated)}; rename one")
    mean_step = _mean_step(rows)
    start, scales = _own_numbers(law, law.start_values, mean_step), _own_numbers(law, law.scales, mean_step)
    scales, used = np.abs(scales), np.zeros(p, dtype=bool)
    for share in SHARES:
        response, jacobian = _evaluate(law, rows, start + share * scales)
        if share == 0.0:
            _check_finite(law, rows, response, start)
        used |= np.any(np.isfinite(jacobian) & (jacobian != 0.0), axis=0)
    # Where the log never changes what a parameter needs, the fit says so itself.
    for spread in () if used.all() else SPREADS:
        jacobian = _evaluate(
            law, _vary_columns(law, rows.iloc[:MAX_ROWS], spread), start + SHARES[1] * scales
        )[1]
        used |= np.any(np.isfinite(jacobian) & (jacobian != 0.0), axis=0)
    if unused := [
        parameter.name for parameter, is_used in zip(law.parameters, used, strict=True) if not is_used
    ]:
        verb, them = ("changes", "it") if len(unused) == 1 else ("change", "them")
        raise InputError(
            f"{where}: {join_words(unused)} {verb} no count; use {them} in the step size, or take {them} out "
            "of the law's parameters"
        )
    _check_slopes(law, rows.iloc[:MAX_ROWS], start + SHARES[1] * scales, scales)


def call_own(what: str, function: Callable[[], Any]) -> Any:
    """What a function of the user's returns; InputError with the place for whatever it raises."""
    try:
        with np.errstate(all="ignore"):
            return function()
    except InputError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(frame.filename).name}, line {frame.lineno}"
        text = f": {error}" if str(error) else ""
        raise InputError(f"{what} raises {type(error).__name__}{text} ({place})") from error


def _own_numbers(law: StepLaw, method: Callable[[Array], Array], mean_step: Array) -> Array:
    """Start values or scales for one mean step, shape (p,)."""
    where, shape = f"joint {law.joint}, law {law.name!r}: {method.__name__}", (1, len(law.parameters))
    values: Array = call_own(where, lambda: np.asarray(method(mean_step), dtype=float))
    if values.shape != shape:
        raise InputError(f"{where} gives shape {values.shape} for one mean step, not {shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{where} gives {values[0].tolist()}; each has to be a finite number")
    return values[0]


def _evaluate(law: StepLaw, rows: pd.DataFrame, values: Array) -> tuple[Array, Array]:
    """Response and derivatives, shapes checked."""
    where, n, p = f"joint {law.joint}, law {law.name!r}", len(rows), len(law.parameters)
    response, jacobian = call_own(f"{where}: its step size", lambda: law.model(rows)(values))
    for name, result, shape in (("counts", response, (n,)), ("derivatives", jacobian, (n, p))):
        if np.shape(result) != shape:
            raise InputError(f"{where}: its {name} have shape {np.shape(result)}, not {shape}")
    return response, jacobian


def _vary_columns(law: StepLaw, rows: pd.DataFrame, spread: float) -> pd.DataFrame:
    """The rows with the law's numeric columns moved at random, by up to `spread` in SI."""
    rng = np.random.default_rng(0)
    numeric = [name for name in law.columns if pd.api.types.is_float_dtype(rows[name])]
    return rows.assign(**{name: rows[name] + rng.uniform(-spread, spread, len(rows)) for name in numeric})


def _mean_step(rows: pd.DataFrame) -> Array:
    steps = expected_steps(rows["steps"], rows["check_every"])
    return np.exp(np.mean(np.log(traverse_length(rows) / steps), keepdims=True))


def _check_columns(law: StepLaw, rows: Rows) -> None:
    unknown = [name for name in law.columns if name not in rows]
    if unknown:
        close = [match for name in unknown for match in get_close_matches(name, list(rows), 2, 0.6)]
        advice = f"did you mean {join_words(close, 'or')}?" if close else f"there are {', '.join(rows)}"
        raise InputError(
            f"joint {law.joint}, law {law.name!r}: the log has no column {join_words(unknown)}; {advice}"
        )


def _check_finite(law: StepLaw, rows: pd.DataFrame, response: Array, start: Array) -> None:
    bad = np.flatnonzero(~np.isfinite(response))
    if len(bad):
        where = f"joint {law.joint}, law {law.name!r}"
        at = ", ".join(
            f"{parameter.name} = {value:.4g}" for parameter, value in zip(law.parameters, start, strict=True)
        )
        row = rows.iloc[bad[0]]
        names = dict.fromkeys([*law.columns, "start", "stop"])
        place = ", ".join(f"{name} = {row[name]}" for name in names)
        raise InputError(
            f"{where}: at its start values ({at}; SI) it gives no step size above 0 in "
            f"{pluralize(len(bad), 'traverse')} of {len(rows)}, first with {place}; give others"
        )


def _check_slopes(law: StepLaw, rows: pd.DataFrame, values: Array, scales: Array) -> None:
    """Compare derivatives with central differences, as far as both are finite."""
    slopes = law.model(rows)(values)[1] * scales
    for k, parameter in enumerate(law.parameters):
        change = STEP * scales * (np.arange(len(scales)) == k)
        difference = (law.predict(rows, values + change) - law.predict(rows, values - change)) / (2 * STEP)
        off = np.abs(slopes[:, k] - difference)
        size = np.maximum(np.abs(difference), np.abs(slopes[:, k]))
        # At a kink the two may differ in a few rows.
        if np.nanmedian(off - SLOPE_TOL * np.fmax(size, SLOPE_TOL * np.nanmax(size))) > DIFFERENCE_TOL:
            worst = int(np.nanargmax(off))
            raise InputError(
                f"joint {law.joint}, law {law.name!r}: the derivative by {parameter.name} is not that of its "
                f"step size: log(steps) changes by {slopes[worst, k] / scales[k]:.4g} for each unit (SI) by "
                f"gamma_slopes, by {difference[worst] / scales[k]:.4g} by differences; correct gamma_slopes"
            )
