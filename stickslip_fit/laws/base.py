"""StepLaw: step size, steps over a traverse and their derivatives as functions of a law's parameters.

A law gives the step size gamma at a position; the steps over a traverse are the integral of dq / gamma.
The response that is fitted is y = log(steps - check_every / 2): the end stop is checked every
`check_every` steps, so that a count is rounded up to the next multiple and is half a check too large on
average. Order of reading: Parameter, Configuration, StepLaw, the count model.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, nan
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.laws.integration import State, integrate, state_at


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law.

    Attributes
    ----------
    name : str
    unit : str
        Symbol of the unit in which people see it; inside it is SI.
    lower, upper : float
        Bounds of what is physically possible, SI.
    meaning : str
        A phrase for tables and reports.
    """

    name: str
    unit: str
    meaning: str
    lower: float = -inf
    upper: float = inf


@dataclass(frozen=True)
class Configuration:
    """Where the joints and the base stand while one joint makes its full traverse; rad and m.

    Attributes
    ----------
    label : str
        What is special about it, in words.
    q1, q2, q3 : float
        Joint positions; NaN for the joint that moves.
    theta, psi : float
        Orientation of the base.
    """

    label: str
    q1: float = 0.0
    q2: float = nan
    q3: float = nan
    theta: float = 0.0
    psi: float = 0.0


def observed_count(steps: npt.ArrayLike, check_every: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """The count at which the end stop is noticed.

    Examples
    --------
    >>> observed_count([12300.2, 12300.2], [5, 1])
    array([12305, 12300])
    """
    steps, check_every = np.asarray(steps, float), np.asarray(check_every)
    checks = np.where(check_every > 1, np.ceil(steps / check_every), np.round(steps))
    return np.maximum(checks, 1).astype(np.int64) * check_every


def expected_steps(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """The steps that a seen count stands for on average: half a check earlier.

    Examples
    --------
    >>> expected_steps([12305, 12300], [5, 1])
    array([12302.5, 12300. ])
    """
    count, check_every = np.asarray(count, float), np.asarray(check_every)
    return count - np.where(check_every > 1, check_every / 2, 0.0)


def rounding_variance(count: npt.ArrayLike, check_every: npt.ArrayLike) -> Array:
    """Variance of log(steps) that the rounding adds: a uniform spread of one check."""
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

    A law holds no parameter values: `values` is handed to every method, either shape (p,) for all
    rows or shape (n, p), a row's own. The response that estimators fit is log(steps).

    Attributes
    ----------
    name : str
        As reports and saved results call it.
    joint : {1, 2, 3}
    parameters : tuple of Parameter
        p of them; one set for each session and direction.
    columns : tuple of str
        Columns of a row, beside start and stop, on which the step size depends.
    max_panel : float
        Widest panel that still sees every feature of the step size along a traverse, rad or m.
    """

    name: ClassVar[str]
    joint: int
    parameters: tuple[Parameter, ...]
    columns: ClassVar[tuple[str, ...]] = ()
    max_panel: float = np.inf

    @abstractmethod
    def gamma(self, state: State, values: Array) -> Array:
        """Step size in a state.

        Parameters
        ----------
        state : State
            n traverses at k positions each.
        values : array, shape (n, p)

        Returns
        -------
        array, shape (n, k) or (n, 1)
            rad or m per step.
        """

    @abstractmethod
    def gamma_slopes(self, state: State, values: Array) -> Array:
        """Derivatives of `gamma` by each parameter, shape (n, k or 1, p)."""

    @abstractmethod
    def start_values(self, mean_step: Array) -> Array:
        """Where an estimator may begin, given the mean step sizes seen, shape (g,) -> (g, p)."""

    @abstractmethod
    def scales(self, mean_step: Array) -> Array:
        """A change of each parameter that matters as much as the step size itself, (g,) -> (g, p)."""

    @abstractmethod
    def features(self, rows: Rows) -> Array:
        """All that the step size depends on, shape (n, s): equal features, equal step size."""

    @abstractmethod
    def calibration(self) -> tuple[Configuration, ...]:
        """The configurations whose full traverses make every parameter known."""

    def step_size(self, rows: Rows, position: Array, values: Array) -> Array:
        """Step size with the joint at `position`.

        Parameters
        ----------
        rows : mapping of str to array, shape (n,)
        position : array, shape (n, k)
            Positions of the moving joint, rad or m.
        values : array, shape (p,) or (n, p)

        Returns
        -------
        array, shape (n, k)
            rad or m per step.
        """
        values = np.broadcast_to(values, (len(position), len(self.parameters)))
        return np.broadcast_to(self.gamma(state_at(self.joint, rows, position), values), position.shape)

    def counter(self, rows: Rows) -> Counter:
        """How the steps over these traverses follow from parameter values.

        Whatever does not depend on the values is worked out once, here. This general form is a
        quadrature of 1 / step size; a law with a closed form overrides it.

        Returns
        -------
        callable
            From values, shape (p,) or (n, p), to the steps over each traverse, shape (n,), and their
            derivatives, shape (n, p). It raises InputError if the step size passes through zero; closed
            forms give NaN there.
        """
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        arrays = {name: float_column(rows, name) for name in self.columns}

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(start), len(self.parameters)))

            def integrand(owner: npt.NDArray[np.intp], position: Array) -> Array:
                taken = {name: array[owner] for name, array in arrays.items()}
                state = state_at(self.joint, taken, position)
                gamma = np.broadcast_to(self.gamma(state, values[owner]), position.shape)
                slopes = self.gamma_slopes(state, values[owner])
                with np.errstate(divide="ignore", invalid="ignore"):
                    rate = np.where(gamma > 0, 1.0 / gamma, np.nan)[..., None]
                    return np.concatenate([rate, -slopes * rate**2], axis=-1)

            both = integrate(integrand, start, stop, widest=self.max_panel) * np.sign(stop - start)[:, None]
            return both[:, 0], both[:, 1:]

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
        """What was measured: log(steps) as if never rounded, and the variance the rounding adds.

        Returns
        -------
        y, extra_variance : array, shape (n,)
        """
        steps, check_every = float_column(rows, "steps"), float_column(rows, "check_every")
        return np.log(expected_steps(steps, check_every)), rounding_variance(steps, check_every)


def traverse_length(rows: Rows) -> Array:
    """Length of each traverse, rad or m, shape (n,)."""
    return np.abs(float_column(rows, "stop") - float_column(rows, "start"))
