"""What every step law is: a step size at each position, and from it the steps over a traverse."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stickslip_fit.laws.count import expected_steps, rounding_variance
from stickslip_fit.laws.parameter import Configuration, Parameter
from stickslip_fit.laws.quadrature import integrate
from stickslip_fit.laws.state import State, state_at

Array = npt.NDArray[np.float64]
Rows = Mapping[str, Any]
"""Columns by name: a DataFrame of a log's rows, or a dictionary of arrays."""
Counter = Callable[[Array], tuple[Array, Array]]
"""Parameter values, (p,) or (n, p), to steps, (n,), and derivatives, (n, p)."""
Model = Callable[[Array], tuple[Array, Array]]
"""Parameter values, (p,) or (n, p), to responses, (n,), and derivatives, (n, p)."""


def column(rows: Rows, name: str) -> Array:
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
    widest : float
        Widest panel that still sees every feature of the step size along a traverse, rad or m.
    """

    name: ClassVar[str]
    joint: int
    parameters: tuple[Parameter, ...]
    columns: ClassVar[tuple[str, ...]] = ()
    widest: float = np.inf

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
        start, stop = column(rows, "start"), column(rows, "stop")
        arrays = {name: column(rows, name) for name in self.columns}

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

            both = integrate(integrand, start, stop, widest=self.widest) * np.sign(stop - start)[:, None]
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
        steps, check_every = column(rows, "steps"), column(rows, "check_every")
        return np.log(expected_steps(steps, check_every)), rounding_variance(steps, check_every)


def travel(rows: Rows) -> Array:
    """Length of each traverse, rad or m, shape (n,)."""
    return np.abs(column(rows, "stop") - column(rows, "start"))
