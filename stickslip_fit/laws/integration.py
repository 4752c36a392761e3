"""Steps over traverses, the integrals of 1 / gamma: adaptive Gauss-Kronrod and a closed form.

The closed form is for rotary joints with gamma = gamma0 + A cos(q - phase). With e = A / gamma0 the
integral of dq / (1 + e cos q) is elementary in the eccentric anomaly E = q - 2 atan2(beta sin q, 1 +
beta cos q), beta = e / (1 + sqrt(1 - e^2)) (R. H. Battin, An Introduction to the Mathematics and
Methods of Astrodynamics, AIAA, 1999, Eqs. 4.29 to 4.32). `State` is the manipulator at the
nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.errors import InputError
from stickslip_fit.machine import full_load, published_load

# Gauss-Kronrod 7-15 on [-1, 1] (Piessens et al., QUADPACK, 1983): nodes and weights of the positive half.
_HALF_NODES = np.array(
    [
        0.991455371120812639206854697526329,
        0.949107912342758524526189684047851,
        0.864864423359769072789712788640926,
        0.741531185599394439863864773280788,
        0.586087235467691130294144838258730,
        0.405845151377397166906606412076961,
        0.207784955007898467600689403773245,
        0.0,
    ]
)
_HALF_KRONROD = np.array(
    [
        0.022935322010529224963732008058970,
        0.063092092629978553290700663189204,
        0.104790010322250183839876322541518,
        0.140653259715525918745189590510238,
        0.169004726639267902826583426598550,
        0.190350578064785409913256402421014,
        0.204432940075298892414161999234649,
        0.209482141084727828012999174891714,
    ]
)
_HALF_GAUSS = np.array(
    [
        0.129484966168869693270611432679082,
        0.279705391489276667901467771423780,
        0.381830050505118944950369775488975,
        0.417959183673469387755102040816327,
    ]
)
KRONROD_NODES = np.concatenate([-_HALF_NODES[:-1], _HALF_NODES[::-1]])
KRONROD_WEIGHTS = np.concatenate([_HALF_KRONROD[:-1], _HALF_KRONROD[::-1]])
GAUSS_WEIGHTS = np.zeros(15)
GAUSS_WEIGHTS[1::2] = np.concatenate([_HALF_GAUSS[:-1], _HALF_GAUSS[::-1]])

MAX_DEPTH = 48
MAX_PANELS = 2_000  # of one traverse at one depth; an integrand that needs more is not smooth


def integrate(
    integrand: Callable[[IntArray, Array], Array],
    start: npt.ArrayLike,
    stop: npt.ArrayLike,
    *,
    max_panel: float = np.inf,
    relative: float = 1e-11,
) -> Array:
    """Integrate over each traverse by Gauss-Kronrod panels, bisected until each is accurate.

    Parameters
    ----------
    integrand : callable
        ``integrand(owner, x)`` with the index of each panel's traverse, shape (m,), and the nodes,
        shape (m, 15); returns shape (m, 15) or (m, 15, k).
    start, stop : array_like, shape (n,)
        Ends of each traverse, in either order.
    max_panel : float, optional
        Widest panel: below it, 15 nodes resolve the narrowest feature (a worn spot 0.1 mm wide).
    relative : float, optional
        Accuracy of each integral relative to the integral of its absolute value.

    Returns
    -------
    array, shape (n,) or (n, k)

    Raises
    ------
    InputError
        If an integrand is not finite or does not converge, e.g. a step size that passes through zero.

    Examples
    --------
    >>> print(integrate(lambda owner, x: np.cos(x), [0.0, 0.0], [np.pi / 2, -np.pi / 6]).round(12))
    [ 1.  -0.5]
    """
    start, stop = np.asarray(start, float), np.asarray(stop, float)
    owner, low, high = _initial_panels(start, stop, max_panel)
    total: Array | None = None
    scale = np.zeros((len(start), 1))
    for _ in range(MAX_DEPTH):
        half = (high - low) / 2
        values = integrand(owner, (low + high)[:, None] / 2 + half[:, None] * KRONROD_NODES)
        if not np.all(np.isfinite(values)):
            raise InputError("the step size passes through zero or is not finite within a traverse")
        flat = values.reshape(*values.shape[:2], -1)
        fine = np.einsum("j,mjk,m->mk", KRONROD_WEIGHTS, flat, half)
        coarse = np.einsum("j,mjk,m->mk", GAUSS_WEIGHTS, flat, half)
        if total is None:
            total = np.zeros((len(start), flat.shape[2]))
            scale = np.zeros_like(total)
            np.add.at(scale, owner, np.einsum("j,mjk,m->mk", KRONROD_WEIGHTS, np.abs(flat), np.abs(half)))
        share = np.abs(high - low) / np.abs(stop - start)[owner]
        # Relative to each component, for they differ in unit; a component of rounding noise alone converges
        # by the rounding of the largest.
        allowed = relative * scale[owner] * np.sqrt(share)[:, None]
        allowed += np.finfo(float).eps * scale[owner].max(axis=1, keepdims=True)
        converged = np.all(np.abs(fine - coarse) <= allowed, axis=1)
        np.add.at(total, owner[converged], fine[converged])
        if np.all(converged):
            return total[:, 0] if values.ndim == 2 else total
        if np.bincount(owner[~converged]).max() > MAX_PANELS:
            break
        owner, low, high = owner[~converged], low[~converged], high[~converged]
        middle = (low + high) / 2
        owner, low, high = np.tile(owner, 2), np.append(low, middle), np.append(middle, high)
    raise InputError("the step size varies too sharply within a traverse to count its steps")


def _initial_panels(start: Array, stop: Array, max_panel: float) -> tuple[IntArray, Array, Array]:
    panels = np.maximum(np.ceil(np.abs(stop - start) / max_panel), 1).astype(int)
    owner = np.repeat(np.arange(len(start)), panels)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(panels) - panels, panels)
    width = ((stop - start) / panels)[owner]
    low = start[owner] + within * width
    return owner, low, low + width


def harmonic_counts(
    gamma0: Array, amplitude: Array, phase: Array, start: Array, stop: Array
) -> tuple[Array, Array, Array]:
    """Steps over a traverse whose step size is gamma0 + amplitude cos(q - phase), and their slopes.

    Parameters
    ----------
    gamma0, amplitude, phase : array, shape (n,)
        Of the step size, rad.
    start, stop : array, shape (n,)
        Ends of the traverse, rad.

    Returns
    -------
    counts, slope_gamma0, slope_amplitude : array, shape (n,)
        NaN where the step size reaches zero somewhere on the circle.

    Examples
    --------
    >>> half_turn = np.array([0.0]), np.array([np.pi])
    >>> counts, _, _ = harmonic_counts(np.array([1e-4]), np.array([0.0]), np.array([0.0]), *half_turn)
    >>> print(counts.round(3))
    [31415.927]
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        e = amplitude / gamma0
        root = np.sqrt(np.where(gamma0 > np.abs(amplitude), 1.0 - e**2, np.nan))
        first, last = _eccentric_anomaly(e, root, start - phase), _eccentric_anomaly(e, root, stop - phase)
        sign = np.sign(stop - start)
        swept = sign * (last - first)
        rise = sign * (np.sin(last) - np.sin(first))
        counts = swept / (gamma0 * root)
        slope_gamma0 = -(swept - e * rise) / (gamma0**2 * root**3)
        slope_amplitude = -(rise - e * swept) / (gamma0**2 * root**3)
    return counts, slope_gamma0, slope_amplitude


def _eccentric_anomaly(e: Array, root: Array, q: Array) -> Array:
    beta = e / (1.0 + root)
    return q - 2.0 * np.arctan2(beta * np.sin(q), 1.0 + beta * np.cos(q))


@dataclass(frozen=True, eq=False)
class DriveChange:
    """What a change of the stage multiplies, under a law that knows the stage (`laws.physical`).

    Arrays of a shape as of `State`.

    Attributes
    ----------
    unit, share, ratio : array
        On a_f T1^2, on r and on lambda.
    before : array
        lambda before the change.
    """

    unit: Array
    share: Array
    ratio: Array
    before: Array

    def after(self, other: DriveChange | None) -> DriveChange:
        """Both changes; lambda before them is that of this one."""
        if other is None:
            return self
        return replace(
            self,
            **{name: getattr(self, name) * getattr(other, name) for name in ("unit", "share", "ratio")},
        )


@dataclass(frozen=True, eq=False)
class State:
    """The manipulator at k positions of each of n traverses of one joint.

    Arrays have shape (n, k), or (n, 1) where they do not change along a traverse.

    Attributes
    ----------
    joint : int
    position : array
        Of the moving joint, rad or m.
    q1, q2, q3 : array
        Positions of joints 1 to 3, the moving joint's own included; NaN where unknown. Those of further
        joints are columns of `row`.
    theta, psi : array
        Orientation of the base; NaN where unknown.
    row : mapping of str to array, shape (n,)
        Other quantities of each traverse, e.g. ``session_seconds``.
    override_load, override_recoil : array or None
        In place of those that follow from the angles.
    drive_change : DriveChange or None
        None where the stage is as it was calibrated.
    """

    joint: int
    position: Array
    q1: Array
    q2: Array
    q3: Array
    theta: Array
    psi: Array
    row: Mapping[str, Any]
    override_load: Array | None = None
    override_recoil: Array | None = None
    drive_change: DriveChange | None = None

    @cached_property
    def load(self) -> Array:
        """The published gravity load on the joint, or `override_load`."""
        if self.override_load is not None:
            return self.override_load
        return published_load(self.joint, self.q1, self.q2, self.theta, self.psi)

    @cached_property
    def transverse_load(self) -> Array:
        """What the published load would be a quarter turn on: the part of gravity that acts across it."""
        turn = 0.5 * np.pi
        own = (self.q1 + turn, self.q2) if self.joint == 1 else (self.q1, self.q2 - turn)
        return published_load(self.joint, *own, self.theta, self.psi)

    @property
    def direction_sign(self) -> Array:
        """1 where the joint moves in `+`, -1 where in `-`, shape (n, 1)."""
        return np.sign(self.column("stop") - self.column("start"))

    @cached_property
    def full_load(self) -> Array:
        """The gravity load with q1 taken into account."""
        return full_load(self.joint, self.q1, self.q2, self.theta, self.psi)

    @cached_property
    def recoil(self) -> Array:
        """The recoil factor |cos q2|, or `override_recoil`."""
        return np.abs(np.cos(self.q2)) if self.override_recoil is None else self.override_recoil

    @cached_property
    def functions(self) -> dict[int, tuple[Any, Array, Array]]:
        """What causes compute here without their parameters, each with its cause, by the id of that."""
        return {}

    def column(self, name: str) -> Array:
        """A quantity of each traverse, shape (n, 1)."""
        return np.asarray(self.row[name], dtype=float)[:, None]

    def with_changes(self, **changes: Any) -> State:
        """Another state; its load and recoil follow from its angles unless overridden."""
        return replace(self, **changes)


def state_at(joint: int, row: Mapping[str, Any], position: Array) -> State:
    """The state with a joint at `position`, shape (n, k); columns that `row` lacks are NaN."""
    unknown = np.full(1, np.nan)

    def column(name: str) -> Array:
        return np.asarray(row.get(name, unknown), dtype=float)[:, None]

    pose: dict[str, Any] = {name: column(name) for name in ("q1", "q2", "q3", "theta", "psi")}
    if f"q{joint}" in pose:
        pose[f"q{joint}"] = position
    return State(joint, position, **pose, row=row)
