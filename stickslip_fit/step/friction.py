"""Friction models with bristle states z: LuGre, Dahl, elastoplastic and Maxwell-slip, as one interface.

With the sliding velocity w, the resistance to sliding is F = sigma0 z + sigma1 dz/dt + sigma2 w, in all but
Maxwell-slip, and dz/dt = w (1 - share of plastic deflection):

- LuGre (C. Canudas de Wit, H. Olsson, K. J. Astrom and P. Lischinsky, IEEE Trans. Automatic Control 40:419,
  1995): dz/dt = w - sigma0 |w| z / g(w), with the Stribeck curve g = Fc + (Fs - Fc) exp(-(w / vs)^2).
- Dahl (P. R. Dahl, Aerospace Corporation TOR-0158, 1968): F = sigma0 z with dz/dt = w |1 - u|^i sgn(1 - u),
  u = sigma0 z sgn(w) / Fc; i = 1 is LuGre without damping, viscosity and Stribeck effect.
- Elastoplastic (P. Dupont, V. Hayward, B. Armstrong and F. Altpeter, IEEE Trans. Automatic Control 47:787,
  2002): dz/dt = w (1 - alpha z / z_ss), z_ss = sgn(w) g(w) / sigma0. alpha is 0 for deflections below the
  break-away deflection z_ba, and where they are being relieved; 1 from |z_ss| on; half a sine wave between.
  Below z_ba all motion is elastic, so that small oscillations do not make the slider drift.
- Maxwell-slip (B. J. Lazan, 1968): springs side by side, each of which slips at a force of its own.

A model is the scalar kernels in `stickslip_fit.step._kernels`, by its `kind`, and its `parameters`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import isfinite
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError

MAX_ELEMENTS = 50


class BristleModel(ABC):
    """What all models have.

    The resistance is viscosity times w, and for each bristle stiffness times z and damping times dz/dt.
    """

    kind: ClassVar[int]

    @property
    @abstractmethod
    def parameters(self) -> Array:
        """What the kernels need: viscosity; stiffness, then damping of each bristle; the model's own."""

    @property
    @abstractmethod
    def limit(self) -> float:
        """Kinetic friction, N."""

    @property
    @abstractmethod
    def deflections(self) -> Array:
        """Of each bristle in steady sliding, m; shape (states,)."""

    @property
    def states(self) -> int:
        """Number of bristle states."""
        return len(self.deflections)

    def evaluate(self, deflection: npt.ArrayLike, velocity: float) -> tuple[float, Array]:
        """Compute the resistance to sliding, N, and the rates of the bristle states.

        Parameters
        ----------
        deflection : array_like, shape (states,)
            Bristle states, m.
        velocity : float
            Sliding velocity, m/s.

        Returns
        -------
        float, ndarray of shape (states,)
            N and m/s.

        Examples
        --------
        >>> LuGre(1.0, 1.5, 1e-3, 1e5, 0.0, 0.0).evaluate([1e-5], 0.0)
        (1.0, array([0.]))
        """
        from stickslip_fit.step._kernels import resist

        z = np.array(deflection, dtype=float).reshape(self.states)
        rates = np.zeros(self.states)
        return float(resist(self.kind, self.parameters, z, float(velocity), rates, 0, 0.0)), rates


class OneBristle(BristleModel):
    """A model with one bristle: `kinetic` friction, N, and `stiffness`, N/m, are among its attributes."""

    kinetic: float
    stiffness: float

    @property
    def limit(self) -> float:
        return self.kinetic

    @property
    def deflections(self) -> Array:
        return np.array([self.kinetic / self.stiffness])


@dataclass(frozen=True)
class LuGre(OneBristle):
    """The LuGre model.

    Attributes
    ----------
    kinetic, static : float
        Fc and Fs, N, with Fs >= Fc > 0.
    stribeck_speed : float
        vs, m/s.
    stiffness : float
        sigma0, N/m.
    damping : float
        sigma1, N s/m.
    viscosity : float
        sigma2, N s/m.

    Raises
    ------
    InputError
        For values outside their domain, as in all models.
    """

    kind: ClassVar[int] = 0
    kinetic: float
    static: float
    stribeck_speed: float
    stiffness: float
    damping: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        _check_above_zero(self, "kinetic", "stribeck_speed", "stiffness")
        if not (isfinite(self.static) and self.static >= self.kinetic):
            raise InputError("static friction must be no smaller than kinetic friction")
        if not all(isfinite(value) and value >= 0 for value in (self.damping, self.viscosity)):
            raise InputError("damping and viscosity must be 0 or more")

    @property
    def parameters(self) -> Array:
        """See `BristleModel`; its own are steady deflection, what static friction adds to it, and speed."""
        more = (self.static - self.kinetic) / self.stiffness
        own = (*self.deflections, more, self.stribeck_speed)
        return np.array([self.viscosity, self.stiffness, self.damping, *own])


@dataclass(frozen=True)
class Elastoplastic(LuGre):
    """The elastoplastic model; attributes as of `LuGre`, and one more.

    Attributes
    ----------
    breakaway_deflection : float
        z_ba, m: up to it deflections are elastic. It must be below the smallest steady deflection
        z_ss = Fc / sigma0: beyond that, no steady sliding exists.

    Examples
    --------
    >>> Elastoplastic(1.0, 1.0, 1e-3, 1e6, breakaway_deflection=2e-6)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    stickslip_fit.errors.InputError: the break-away deflection 2e-06 m must be ...
    """

    kind: ClassVar[int] = 1
    breakaway_deflection: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        steady = self.kinetic / self.stiffness
        if not 0 < self.breakaway_deflection < steady:
            raise InputError(
                f"the break-away deflection {self.breakaway_deflection:g} m must be above 0 and below "
                f"kinetic friction / stiffness = {steady:g} m, the steady deflection of sliding"
            )

    @property
    def parameters(self) -> Array:
        """See `LuGre`; and the break-away deflection."""
        return np.append(super().parameters, self.breakaway_deflection)


@dataclass(frozen=True)
class Dahl(OneBristle):
    """Dahl's model.

    Attributes
    ----------
    kinetic : float
        Fc, N.
    stiffness : float
        sigma0, N/m.
    exponent : float
        i, 0.5 to 5; ductile materials have 1 and more, brittle ones less.
    """

    kind: ClassVar[int] = 2
    kinetic: float
    stiffness: float
    exponent: float = 1.0

    def __post_init__(self) -> None:
        _check_above_zero(self, "kinetic", "stiffness")
        if not 0.5 <= self.exponent <= 5:
            raise InputError(f"Dahl's exponent must lie from 0.5 to 5, not {self.exponent:g}")

    @property
    def parameters(self) -> Array:
        """See `BristleModel`; its own are steady deflection and exponent."""
        return np.array([0.0, self.stiffness, 0.0, *self.deflections, self.exponent])


@dataclass(frozen=True)
class MaxwellSlip(BristleModel):
    """Springs side by side that slip one after the other.

    Attributes
    ----------
    stiffnesses : tuple of float
        Of each element, N/m.
    limits : tuple of float
        Force at which each slips, N; their sum is the kinetic friction.
    damping : float
        Of the elements that hold, N s/m, shared by their stiffness.
    """

    kind: ClassVar[int] = 3
    stiffnesses: tuple[float, ...]
    limits: tuple[float, ...]
    damping: float = 0.0

    def __post_init__(self) -> None:
        values = (*self.stiffnesses, *self.limits)
        if not 1 <= len(self.limits) <= MAX_ELEMENTS or len(self.limits) != len(self.stiffnesses):
            raise InputError(f"Maxwell-slip needs 1 to {MAX_ELEMENTS} elements, with stiffness and limit")
        if not all(isfinite(value) and value > 0 for value in values) or not 0 <= self.damping < np.inf:
            raise InputError("stiffnesses and limits must be above 0, the damping 0 or more")

    @property
    def limit(self) -> float:
        return sum(self.limits)

    @property
    def deflections(self) -> Array:
        return np.array(self.limits) / np.array(self.stiffnesses)

    @property
    def parameters(self) -> Array:
        """See `BristleModel`; its own are the deflections at which elements slip."""
        stiffness = np.array(self.stiffnesses)
        return np.array([0.0, *stiffness, *(self.damping * stiffness / stiffness.sum()), *self.deflections])


def spread_maxwell_slip(
    kinetic: float, stiffness: float, elements: int = 8, damping: float = 0.0
) -> MaxwellSlip:
    """Make a Maxwell-slip model whose elements slip one after the other, evenly over the deflection.

    Parameters
    ----------
    kinetic, stiffness : float
        Of all elements together, N and N/m: friction in steady sliding, and slope of the first deflection.
    elements : int
        Of equal stiffness; element i slips at a deflection of 2 i / (n + 1) times kinetic / stiffness.

    Examples
    --------
    >>> spread_maxwell_slip(3.0, 1e6, 2).limits
    (1.0, 2.0)
    """
    if not 1 <= elements <= MAX_ELEMENTS:
        raise InputError(f"Maxwell-slip needs 1 to {MAX_ELEMENTS} elements, not {elements}")
    shares = 2 * np.arange(1, elements + 1) / (elements * (elements + 1))
    return MaxwellSlip((stiffness / elements,) * elements, tuple(map(float, kinetic * shares)), damping)


def _check_above_zero(model: object, *names: str) -> None:
    for name in names:
        value = getattr(model, name)
        if not (isfinite(value) and value > 0):
            raise InputError(f"{name.replace('_', ' ')} must be above 0, not {value:g}")
