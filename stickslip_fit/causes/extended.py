"""A law with causes in it: a law again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit.causes.cause import Cause, CountCause, FactorCause, StateCause, TermCause
from stickslip_fit.laws import Configuration, Parameter, Rows, State, StepLaw, state_at
from stickslip_fit.laws.law import Array, Counter, column
from stickslip_fit.laws.quadrature import integrate

Indices = npt.NDArray[np.intp]

# Of the scale of each parameter, for derivatives by central differences: good to some ten digits.
APART = 1e-5
ACCURATE = 1e-10


class ExtendedLaw(StepLaw):
    """A published law and the causes by which a joint departs from it.

    Its parameters are the law's own, then those of each cause under ``cause.parameter``.

    Parameters
    ----------
    law : StepLaw
    causes : sequence of Cause
        Bound to a log; see `Cause.bound`.
    """

    name = "extended"

    def __init__(self, law: StepLaw, causes: Sequence[Cause]) -> None:
        self.law = law
        self.causes = tuple(causes)
        self.joint = law.joint
        self.acting = tuple(cause for cause in causes if law.joint in cause.joints)
        self.parameters = (
            *law.parameters,
            *(_named(cause, each) for cause in causes for each in cause.parameters),
        )

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`."""
        needed = [*self.law.columns, *(name for cause in self.acting for name in cause.columns)]
        return tuple(dict.fromkeys(needed))

    @property
    def widest(self) -> float:  # type: ignore[override]
        """See `StepLaw.widest`."""
        return min([self.law.widest, *(cause.widest for cause in self.acting)])

    @property
    def absent(self) -> Array:
        """Values of the causes' parameters under which the law is the published one, shape (q,)."""
        return np.array([value for cause in self.causes for value in cause.absent], dtype=float)

    def gamma(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma`."""
        own, sizes = self._split(values)
        for cause in sorted(self._of(StateCause), key=lambda cause: not cause.turns):
            state = cause.change(state, sizes[cause])
        gamma = self.law.gamma(state, own)
        terms = self._of(TermCause)
        if terms:
            still = np.zeros_like(state.load)
            free = self.law.gamma(state.but(given_load=still, given_recoil=still), own)
            gamma = gamma + sum(cause.term(free, state, sizes[cause]) for cause in terms)
        for factor in self._of(FactorCause):
            gamma = gamma * factor.factor(state, sizes[factor])
        return gamma

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`; by central differences."""
        apart = self._apart(values)
        slopes = []
        for k, step in enumerate(apart):
            ahead, behind = values.copy(), values.copy()
            ahead[:, k] += step
            behind[:, k] -= step
            slopes.append((self.gamma(state, ahead) - self.gamma(state, behind)) / (2 * step))
        return np.stack(np.broadcast_arrays(*slopes), axis=-1)

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; derivatives by central differences."""
        count = self._steps(rows)

        def counted(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(column(rows, "start")), len(self.parameters)))
            slopes = np.empty(values.shape)
            for k, step in enumerate(self._apart(values)):
                ahead, behind = values.copy(), values.copy()
                ahead[:, k] += step
                behind[:, k] -= step
                slopes[:, k] = (count(ahead) - count(behind)) / (2 * step)
            return count(values), slopes

        return counted

    def predict(self, rows: Rows, values: Array) -> Array:
        """See `StepLaw.predict`; without the derivatives, which take most of the time."""
        shape = (len(column(rows, "start")), len(self.parameters))
        with np.errstate(invalid="ignore"):
            return np.log(self._steps(rows)(np.broadcast_to(values, shape)))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`: the law's own, with the causes absent."""
        absent = np.broadcast_to(self.absent, (len(mean_step), len(self.absent)))
        return np.concatenate([self.law.start_values(mean_step), absent], axis=1)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        sizes = np.array([size for cause in self.causes for size in cause.scale])
        return np.concatenate(
            [self.law.scales(mean_step), np.broadcast_to(sizes, (len(mean_step), len(sizes)))], axis=1
        )

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`."""
        return self.law.features(rows)

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: that of the law itself."""
        return self.law.calibration()

    def _of(self, kind: type[Any]) -> list[Any]:
        return [cause for cause in self.acting if isinstance(cause, kind)]

    def _split(self, values: Array) -> tuple[Array, dict[Cause, list[Array]]]:
        """The law's own values, and each cause's as arrays of shape (n, 1)."""
        first, sizes = len(self.law.parameters), {}
        for cause in self.causes:
            last = first + len(cause.parameters)
            sizes[cause] = [values[:, k, None] for k in range(first, last)]
            first = last
        return values[:, : len(self.law.parameters)], sizes

    def _apart(self, values: Array) -> Array:
        mean_step = np.abs(values[:1, 0])
        return APART * self.scales(mean_step)[0]

    def _steps(self, rows: Rows) -> Any:
        """Steps over each traverse as a function of values, shape (n, p) -> (n,)."""
        start, stop = column(rows, "start"), column(rows, "stop")
        arrays = {name: np.asarray(rows[name]) for name in self.columns} | {"start": start, "stop": stop}
        here = state_at(self.joint, arrays, start[:, None])
        whole = self._whole_traverses(rows)

        def steps(values: Array) -> Array:
            counts = whole(values) if whole else self._integrated(arrays, values)
            _, sizes = self._split(values)
            for cause in self._of(CountCause):
                counts = counts + cause.steps(here, sizes[cause])[:, 0]
            return counts

        return steps

    def _whole_traverses(self, rows: Rows) -> Any:
        """Where nothing but the law itself changes along a traverse, the law's own count over the factors."""
        if self._of(StateCause) or self._of(TermCause) or any(cause.along for cause in self.acting):
            return None
        own_count, start = self.law.counter(rows), column(rows, "start")
        arrays = {name: np.asarray(rows[name]) for name in self.columns} | {"start": start}
        here = state_at(self.joint, arrays | {"stop": column(rows, "stop")}, start[:, None])

        def count(values: Array) -> Array:
            own, sizes = self._split(values)
            counts, _ = own_count(own)
            for cause in self._of(FactorCause):
                counts = counts / cause.factor(here, sizes[cause])[:, 0]
            return counts

        return count

    def _integrated(self, arrays: dict[str, Any], values: Array) -> Array:
        start, stop = arrays["start"], arrays["stop"]

        def integrand(owner: Indices, position: Array) -> Array:
            taken = {name: array[owner] for name, array in arrays.items()}
            gamma = self.gamma(state_at(self.joint, taken, position), values[owner])
            with np.errstate(divide="ignore"):
                return np.broadcast_to(np.where(gamma > 0, 1.0 / gamma, np.nan), position.shape)

        return np.abs(integrate(integrand, start, stop, widest=self.widest, relative=ACCURATE))


def extend(law: StepLaw, cause: Cause) -> ExtendedLaw:
    """A law with one cause more.

    Parameters
    ----------
    law : StepLaw
        Published or already extended.
    cause : Cause
        Bound to a log.
    """
    if isinstance(law, ExtendedLaw):
        return ExtendedLaw(law.law, (*law.causes, cause))
    return ExtendedLaw(law, (cause,))


def _named(cause: Cause, parameter: Parameter) -> Parameter:
    return Parameter(
        f"{cause.name}.{parameter.name}", parameter.unit, parameter.meaning, parameter.lower, parameter.upper
    )
