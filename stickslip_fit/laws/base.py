"""StepLaw: step size, steps over a traverse and their derivatives as functions of a law's parameters.

A law gives the step size gamma at a position; the steps over a traverse are the integral of dq / gamma.
The response that is fitted is y = log(steps - check_every / 2): the end stop is checked every
`check_every` steps, so that a count is rounded up to the next multiple, and is on average half an interval
between checks too large.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, nan
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, Int64Array, IntArray
from stickslip_fit.laws.integration import State, integrate, state_at
from stickslip_fit.units import PRISMATIC


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law: its unit for display, a phrase for tables, and physical bounds in SI."""

    name: str
    unit: str
    meaning: str
    lower: float = -inf
    upper: float = inf


@dataclass(frozen=True)
class Configuration:
    """Joint positions and base orientation during a full traverse, rad and m; NaN for the moving joint."""

    label: str
    q1: float = 0.0
    q2: float = nan
    q3: float = nan
    theta: float = 0.0
    psi: float = 0.0


def observed_count(steps: npt.ArrayLike, check_every: npt.ArrayLike) -> Int64Array:
    """The count at which the end stop is detected.

    Examples
    --------
    >>> observed_count([12300.2, 12300.2], [5, 1])
    array([12305, 12300])
    """
    steps, check_every = np.asarray(steps, float), np.asarray(check_every)
    checks = np.where(check_every > 1, np.ceil(steps / check_every), np.round(steps))
    return np.maximum(checks, 1).astype(np.int64) * check_every


def expected_steps(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """The expected steps given an observed count: half an interval between checks less.

    Examples
    --------
    >>> expected_steps([12305, 12300], [5, 1])
    array([12302.5, 12300. ])
    """
    count, check_every = np.asarray(count, float), np.asarray(check_every)
    return count - np.where(check_every > 1, check_every / 2, 0.0)


def rounding_variance(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """Variance of log(steps) due to rounding: uniform over one interval between checks."""
    spread = np.asarray(check_every, float) / np.sqrt(12.0)
    return (spread / expected_steps(count, check_every)) ** 2


Rows = Mapping[str, Any]
"""Columns by name: a DataFrame of a log's rows, or a dictionary of arrays."""
Counter = Callable[[Array], tuple[Array, Array]]
"""Parameter values, (p,) or (n, p), to steps, (n,), and derivatives, (n, p)."""
Model = Callable[[Array], tuple[Array, Array]]
"""Parameter values, (p,) or (n, p), to responses, (n,), and derivatives, (n, p)."""


def float_column(rows: Rows, name: str) -> Array:
    """A column as floats, shape (n,)."""
    return np.asarray(rows[name], dtype=float)


class StepLaw(ABC):
    """The step size of one joint as a function of where everything stands.

    A law holds no parameter values: `values` is passed to every method, shape (p,) for all rows or (n, p)
    for each row. The response that estimators fit is log(steps).

    Attributes
    ----------
    name : str
        In reports and saved results.
    joint : int
    parameters : tuple of Parameter
        p of them; one set for each session and direction.
    columns : tuple of str
        Columns of a row, besides start and stop, on which the step size depends.
    max_panel : float
        Widest integration panel that resolves the step size along a traverse, rad or m.
    has_kinks : bool
        Whether the step size, though continuous, may change its slope suddenly along a traverse.
    outlier_cause : str
        The cause of the few counts that are far off: steps are counted until a stop is heard. ``outliers``
        for a law whose counts end otherwise.
    """

    name: ClassVar[str]
    joint: int
    parameters: tuple[Parameter, ...]
    columns: ClassVar[tuple[str, ...]] = ()
    max_panel: float = np.inf
    has_kinks: bool = False
    outlier_cause: str = "end-stop-misfire"

    @property
    def prismatic(self) -> bool:
        """Whether the joint slides rather than turns; as on the published arm unless a law says otherwise."""
        return self.joint == PRISMATIC

    @abstractmethod
    def gamma(self, state: State, values: Array) -> Array:
        """Step size in a state, rad or m, shape (n, k) or (n, 1); `values` has shape (n, p)."""

    @abstractmethod
    def gamma_slopes(self, state: State, values: Array) -> Array:
        """Derivatives of `gamma` by each parameter, shape (n, k or 1, p)."""

    @abstractmethod
    def start_values(self, mean_step: Array) -> Array:
        """Start values for an estimator, given mean step sizes, shape (g,) -> (g, p)."""

    @abstractmethod
    def scales(self, mean_step: Array) -> Array:
        """The magnitude of each parameter relative to the step size, (g,) -> (g, p)."""

    @abstractmethod
    def features(self, rows: Rows) -> Array:
        """All that the step size depends on, shape (n, s): equal features, equal step size."""

    @abstractmethod
    def calibration(self) -> tuple[Configuration, ...]:
        """The configurations whose full traverses determine every parameter."""

    def step_size(self, rows: Rows, position: Array, values: Array) -> Array:
        """Step size with the joint at `position` (rad or m), both of shape (n, k)."""
        values = np.broadcast_to(values, (len(position), len(self.parameters)))
        return np.broadcast_to(self.gamma(state_at(self.joint, rows, position), values), position.shape)

    def counter(self, rows: Rows) -> Counter:
        """How the steps over these traverses follow from parameter values.

        What does not depend on the values is computed once. This general form is a quadrature of 1 / step
        size; a law with a closed form overrides it.

        Returns
        -------
        callable
            From values, shape (p,) or (n, p), to the steps over each traverse, shape (n,), and their
            derivatives, shape (n, p); NaN where the step size is not above 0.
        """
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        arrays = {name: float_column(rows, name) for name in self.columns}

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(start), len(self.parameters)))
            stalls = np.zeros(len(start), dtype=bool)

            def integrand(owner: IntArray, position: Array) -> Array:
                row = {name: array[owner] for name, array in arrays.items()}
                state = state_at(self.joint, row, position)
                gamma = np.broadcast_to(self.gamma(state, values[owner]), position.shape)
                slopes = self.gamma_slopes(state, values[owner])
                with np.errstate(divide="ignore", invalid="ignore"):
                    rate = np.where(gamma > 0, 1.0 / gamma, np.nan)[..., None]
                    both = np.concatenate([rate, -slopes * rate**2], axis=-1)
                stalls[owner[~np.isfinite(both).all(axis=(1, 2))]] = True
                return np.where(stalls[owner, None, None], 0.0, both)

            integrals = integrate(integrand, start, stop, max_panel=self.max_panel)
            integrals = integrals * np.sign(stop - start)[:, None]
            integrals[stalls] = np.nan
            return integrals[:, 0], integrals[:, 1:]

        return count

    def counts(self, rows: Rows, values: Array) -> tuple[Array, Array]:
        """Steps over each traverse, shape (n,), and their derivatives, shape (n, p)."""
        return self.counter(rows)(values)

    def model(self, rows: Rows) -> Model:
        """The response log(steps) and its derivatives as a function of the values alone."""
        count = self.counter(rows)

        def predict(values: Array) -> tuple[Array, Array]:
            counts, slopes = count(values)
            with np.errstate(invalid="ignore"):
                return np.log(counts), slopes / counts[:, None]

        return predict

    def predict(self, rows: Rows, values: Array) -> Array:
        """The response log(steps), shape (n,)."""
        return self.model(rows)(values)[0]

    def jacobian(self, rows: Rows, values: Array) -> Array:
        """Derivatives of the response by each row's own parameters, shape (n, p)."""
        return self.model(rows)(values)[1]

    def response(self, rows: Rows) -> tuple[Array, Array]:
        """The measured response, the mean of log(steps), and its variance due to rounding, shape (n,)."""
        steps, check_every = float_column(rows, "steps"), float_column(rows, "check_every")
        return np.log(expected_steps(steps, check_every)), rounding_variance(steps, check_every)


def traverse_length(rows: Rows) -> Array:
    """Length of each traverse, rad or m, shape (n,)."""
    return np.abs(float_column(rows, "stop") - float_column(rows, "start"))
