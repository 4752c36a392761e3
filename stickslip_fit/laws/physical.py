"""The physical laws of the three joints: a slider driven by Coulomb friction, in two regimes.

The foot moves by D within the ramp time T1 and flies back; friction accelerates the slider by at most a_f.
With the load r against the motion, as a share of friction, and lambda = D / (a_f T1^2)
(`stickslip_fit.step`):

- lambda < 1 - r, velocity-limited, the slider catches up: gamma = D [1 - lambda r / (1 - r^2)];
- lambda > 1 - r, friction-limited: gamma = a_f T1^2 (1 - r) / (1 + r), whatever D.

Far from 1 not all of a_f, T1 and D can be known from counts. Parameters are what counts show: the step size
without load, min(D, a_f T1^2), and r at full load. lambda is one number for each direction, `ratios`, and
part of the law: the sum of squares has a kink in it wherever a traverse changes regime, and none is worse for
it once it is above 1 + r. `estimation.physical_law` finds it by its profile likelihood.

The load of joint 3 is its weight, so that r = g / a_f. Of a rotary joint a_f falls as 1 / J, with the inertia
J quadratic in q3 (joint 2) or in the reach (joint 1), and the torque of gravity grows linearly in it. The
recoil is as in thesis Eq. 4.5; see `laws.published` for the thesis.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.laws.base import (
    Configuration,
    Counter,
    Parameter,
    Rows,
    StepLaw,
    float_column,
    traverse_length,
)
from stickslip_fit.laws.integration import DriveChange, State
from stickslip_fit.laws.published import Base, BaseAtOneReach, Elbow, Prismatic, Rotary, published_law
from stickslip_fit.machine import Machine
from stickslip_fit.step import relative_size, relative_step
from stickslip_fit.units import PRISMATIC

MAX_SHARE = 0.9  # of friction, by which the load may act
FRICTION_LIMITED = 10.0  # lambda that no load within MAX_SHARE tells from a greater one
START_SHARE = 0.15
DEEP = 2.0  # lambda above which no load changes the regime; the response to load is that of lambda r there
INERTIA = (-0.1, 0.3)  # gained from one end of the arm's range to the other, as a share
VELOCITY_LIMITED = 0.75  # lambda below which a few per cent of inertia leave no trace
PANELS, NODES = 3, 10  # of each smooth stretch of a rotary traverse, at most
MODERATE, NEAREST_ZERO, QUADRATURE = 0.4, 0.6, 1e-10  # shares of friction; error of a stretch

POWERS: Mapping[str, tuple[int, int, int]] = MappingProxyType(
    {"friction": (1, -1, -1), "voltage": (0, 0, 1), "ramp time": (2, 0, -2)}
)
"""To which a_f T1^2, r and lambda are multiplied, by the quantity of the stage that is multiplied."""
Ratios = tuple[float, float]
"""lambda in `+` and in `-`."""
RatioCounter = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class UnitStep:
    """Step sizes and their derivatives; arrays of one shape."""

    gamma: Array
    by_unloaded: Array
    by_share: Array
    by_inertia: Array


def evaluate_step(unloaded: Array, share: Array, inertia: Array | float, ratio: Array) -> UnitStep:
    """Step size from what parameters stand for.

    Parameters
    ----------
    unloaded : array
        min(D, a_f T1^2) at inertia 1, m or rad.
    share : array
        The load against the motion as a share of friction, r; NaN comes out where it does not lie within 1.
    inertia : array or float
        By which a_f is divided.
    ratio : array
        lambda at inertia 1.
    """
    by_unloaded = 1.0 / np.minimum(ratio, 1.0) / inertia
    unit, ratio = unloaded * by_unloaded, ratio * inertia  # a_f T1^2 and lambda at this inertia
    relative = relative_step(ratio, share)
    return UnitStep(
        gamma=unit * relative.step,
        by_unloaded=by_unloaded * relative.step,
        by_share=unit * relative.by_share,
        by_inertia=unit * (relative.by_ratio * ratio - relative.step) / inertia,
    )


def change_step(
    step: UnitStep, share: Array, inertia: Array | float, ratio: Array, change: DriveChange | None
) -> UnitStep:
    """The step of `evaluate_step` after a change of the stage.

    With another lambda before the change than the law's, r is what makes the same response to load of it, and
    the step is multiplied by what the change makes of one at that lambda.
    """
    if change is None:
        return step
    scale, own = _share_before(share, ratio, change)
    before = relative_step(change.before * inertia, own)
    after = relative_step(change.before * change.ratio * inertia, own * change.share)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = change.unit * after.step / before.step
        by_share = scale * (change.share * after.by_share / after.step - before.by_share / before.step)
        by_ratio = change.before * (
            change.ratio * after.by_ratio / after.step - before.by_ratio / before.step
        )
    gamma = factor * step.gamma
    return UnitStep(
        gamma=gamma,
        by_unloaded=factor * step.by_unloaded,
        by_share=factor * step.by_share + gamma * by_share,
        by_inertia=factor * step.by_inertia + gamma * by_ratio,
    )


def _share_before(share: Array, ratio: Array, change: DriveChange) -> tuple[Array, Array]:
    """By how much r is to be scaled for the same response to load before a change, and r there."""
    scale = np.minimum(ratio, DEEP) / np.minimum(change.before, DEEP)
    return scale, np.clip(scale * share, -MAX_SHARE, MAX_SHARE)


def find_gamma(
    unloaded: Array, share: Array, inertia: Array | float, ratio: Array, change: DriveChange | None
) -> Array:
    """The step size of `evaluate_step` and `change_step` without derivatives, which take most of the time."""
    gamma = unloaded * (1.0 / np.minimum(ratio, 1.0) / inertia) * relative_size(ratio * inertia, share)
    if change is None:
        return gamma
    _, own = _share_before(share, ratio, change)
    before = relative_size(change.before * inertia, own)
    after = relative_size(change.before * change.ratio * inertia, own * change.share)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(change.unit * after / before * gamma)


class Physical(StepLaw):
    """A slider driven by Coulomb friction; `ratios` is lambda in `+` and in `-`.

    Attributes
    ----------
    plausible : tuple of tuple of float
        In `+` and in `-`, other lambdas that the log from which they were chosen does not rule out.
    regimes : mapping of str to tuple of float
        Of each regime that such a log leaves open beside `ratios`, lambda in `+` and `-` well within it.
    """

    ratios: Ratios
    plausible: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    regimes: Mapping[str, Ratios] = MappingProxyType({})

    @property
    def has_kinks(self) -> bool:  # type: ignore[override]
        return min(min(ratios) for ratios in (self.ratios, *self.regimes.values())) < DEEP

    def describe(self) -> dict[str, Any]:
        """What `restore_physical` needs to build the law again, as plain JSON types."""
        return {"name": self.name, "joint": self.joint, "lambda": list(self.ratios)}

    def ratio(self, sign: Array) -> Array:
        """The lambda of traverses whose direction has this sign."""
        return np.where(sign > 0, *self.ratios)

    def allows(self, ratios: Ratios) -> bool:
        """Whether the log from which lambda was chosen leaves these open, one in each direction."""
        known = [(own, *others) for own, others in zip(self.ratios, self.plausible, strict=True)]
        return all(min(own) <= ratio <= max(own) for ratio, own in zip(ratios, known, strict=True))

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; NaN where the slider does not move forward."""
        count, ratio = self.ratio_counter(rows), self.ratio(_direction_sign(rows))
        return lambda values: count(values, ratio)

    @abstractmethod
    def ratio_counter(self, rows: Rows) -> RatioCounter:
        """As `counter`, with the lambda of each traverse, shape (n,), as a second argument.

        Both arguments may have the same axes in front: many laws of the same traverses at once.
        """


class PhysicalPrismatic(Physical):
    """Joint 3: the step of a slider that carries its own weight, less the recoil of Eq. 4.5."""

    name = "physical-prismatic"
    joint = PRISMATIC
    columns = ("q2", "theta", "psi", "start", "stop")
    parameters = (
        Parameter("a", "nm", "step size without gravity and recoil", lower=0.0),
        Parameter("b", "1", "share lost to recoil with the arm upright", lower=-1.0, upper=1.0),
        Parameter("r", "1", "weight over friction", -MAX_SHARE, MAX_SHARE),
    )

    def __init__(self, ratios: Ratios = (FRICTION_LIMITED, FRICTION_LIMITED)) -> None:
        self.ratios = ratios

    def gamma(self, state: State, values: Array) -> Array:
        a, b, r = np.moveaxis(values[:, None, :], -1, 0)
        sign, kept = state.direction_sign, 1.0 - b * state.recoil
        gamma = find_gamma(a, r * sign * state.load, 1.0, self.ratio(sign), state.drive_change)
        return np.where(kept > 0, kept * gamma, np.nan)

    def gamma_slopes(self, state: State, values: Array) -> Array:
        sign = state.direction_sign
        place = state.recoil, state.load, sign, values[:, None, :], self.ratio(sign)
        return self._evaluate(*place, state.drive_change)[1]

    def start_values(self, mean_step: Array) -> Array:
        others = np.broadcast_to([0.2, START_SHARE], (len(mean_step), 2))
        return np.column_stack([1.2 * mean_step, others])

    def scales(self, mean_step: Array) -> Array:
        return np.column_stack([mean_step, np.ones((len(mean_step), 2))])

    def features(self, rows: Rows) -> Array:
        """Recoil |cos q2| and load, of a direction; see `StepLaw.features`."""
        return Prismatic().features(rows)

    def calibration(self) -> tuple[Configuration, ...]:
        """The published law's: one load gives r, and its curve follows."""
        return Prismatic().calibration()

    def ratio_counter(self, rows: Rows) -> RatioCounter:
        """Closed form of `Physical.ratio_counter`."""
        length, sign = traverse_length(rows), _direction_sign(rows)
        recoil, load = self.features(rows).T

        def count(values: Array, ratio: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (*ratio.shape, len(self.parameters)))
            gamma, slopes = self._evaluate(recoil, load, sign, values, ratio)
            with np.errstate(divide="ignore", invalid="ignore"):
                counts = np.where(gamma > 0, length / gamma, np.nan)
                return counts, -slopes * (counts / gamma)[..., None]

        return count

    def _evaluate(
        self,
        recoil: Array,
        load: Array,
        sign: Array,
        values: Array,
        ratio: Array,
        change: DriveChange | None = None,
    ) -> tuple[Array, Array]:
        """Step size, and its derivatives on a last axis."""
        a, b, r = np.moveaxis(values, -1, 0)
        kept, against = 1.0 - b * recoil, sign * load
        step = change_step(evaluate_step(a, r * against, 1.0, ratio), r * against, 1.0, ratio, change)
        slopes = (kept * step.by_unloaded, -recoil * step.gamma, kept * step.by_share * against)
        # Far from any minimum both factors may be below 0.
        gamma = np.where(kept > 0, kept * step.gamma, np.nan)
        return gamma, np.stack(np.broadcast_arrays(*slopes), axis=-1)


class PhysicalRotary(Physical):
    """Joints 1 and 2: inertia and load depend on the arm, and the load also on the angle along a traverse.

    A subclass has the published law of its joint, from which come the load and the weights that make r linear
    between its values, and says how inertia grows. Parameters are gamma0, then the inertia gained, if there
    is one, then the values of r.

    Attributes
    ----------
    published : Rotary
    """

    max_panel = 0.6

    def __init__(self, machine: Machine, ratios: Ratios, published: Rotary) -> None:
        self.machine = machine
        self.ratios = ratios
        self.parameters = _with_trace(self.parameters, ratios)
        self.published = published

    def share_weights(self, q2: Array, q3: Array) -> list[Array]:
        """How much of each of its values r has with joints 2 and 3 there, arrays of one shape."""
        return self.published.weights(q2, q3)

    @abstractmethod
    def inertia_weight(self, q2: Array, q3: Array) -> Array | None:
        """Share of the inertia to be gained that the arm has there; None without such a parameter."""

    def gamma(self, state: State, values: Array) -> Array:
        sign, values = state.direction_sign, values[:, None, :]
        share, inertia, *_ = self._share_and_inertia(state.q2, state.q3, sign, values)
        load, ratio = sign * state.load, self.ratio(sign)
        return find_gamma(values[..., 0], share * load, inertia, ratio, state.drive_change)

    def gamma_slopes(self, state: State, values: Array) -> Array:
        sign = state.direction_sign
        place = state.q2, state.q3, state.load, sign, values[:, None, :], self.ratio(sign)
        return self._evaluate(*place, state.drive_change)[1]

    def start_values(self, mean_step: Array) -> Array:
        shares = len(self.parameters) - 1 - self._gains
        others = np.r_[[0.05] * self._gains, [START_SHARE] * shares]
        return np.column_stack([mean_step, np.broadcast_to(others, (len(mean_step), len(others)))])

    def scales(self, mean_step: Array) -> Array:
        return np.column_stack([mean_step, np.ones((len(mean_step), len(self.parameters) - 1))])

    @property
    def _gains(self) -> int:
        return sum(parameter.name == "inertia" for parameter in self.parameters)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of a direction."""
        return self.published.features(rows)

    def calibration(self) -> tuple[Configuration, ...]:
        """The published law's: each traverse passes through loads of many sizes."""
        return self.published.calibration()

    def ratio_counter(self, rows: Rows) -> RatioCounter:
        """Gauss-Legendre quadrature between the angles at which the regime changes."""
        start, stop = float_column(rows, "start"), float_column(rows, "stop")
        (amplitude, phase), sign = self.published.swing(rows), _direction_sign(rows)
        q2 = float_column(rows, "q2") if "q2" in self.columns else np.zeros(len(start))
        q3, turn = float_column(rows, "q3"), float(np.abs(stop - start).max(initial=0.0))

        def count(values: Array, ratio: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (*ratio.shape, len(self.parameters)))
            share, inertia = self._share_and_inertia(q2, q3, sign, values)[:2]
            edge = np.broadcast_to(1.0 - ratio * inertia, ratio.shape)
            x, w = _composite_rule(float(np.abs(share * amplitude).max(initial=0.0)), turn)
            ends = _regime_changes(sign * share * amplitude, phase, edge, start, stop)
            *law, own, stretch = np.nonzero(ends[..., 1:] != ends[..., :-1])
            owner = (*law, own)
            low, width = ends[*owner, stretch][:, None], np.diff(ends)[*owner, stretch][:, None]
            load = amplitude[own, None] * np.cos(low + width * x - phase[own, None])
            place = q2[own, None], q3[own, None], load, sign[own, None], values[*owner, None, :]
            gamma, slopes = self._evaluate(*place, ratio[*owner, None])
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(gamma > 0, 1.0 / gamma, np.nan)
            weight = np.abs(width) * w * rate
            parts = np.column_stack([np.sum(weight, axis=1), -np.einsum("nk,nkp->np", weight * rate, slopes)])
            number = np.ravel_multi_index(owner, ratio.shape)
            total = np.stack([np.bincount(number, part, ratio.size) for part in parts.T], axis=-1)
            total = total.reshape(*ratio.shape, parts.shape[1])
            return total[..., 0], total[..., 1:]

        return count

    def _share_and_inertia(
        self, q2: Array, q3: Array, sign: Array, values: Array
    ) -> tuple[Array, Array | float, list[Array], Array | None]:
        """Share r and inertia J, with the weights of their parameters."""
        weights, gain = self.share_weights(q2, q3), self.inertia_weight(q2, q3) if self._gains else None
        if gain is not None:
            gain = np.where(self.ratio(sign) < VELOCITY_LIMITED, 0.0, gain)
        shares = np.moveaxis(values[..., 1 + self._gains :], -1, 0)
        share: Array = sum(weight * value for weight, value in zip(weights, shares, strict=True))
        return share, 1.0 if gain is None else 1.0 + values[..., 1] * gain, weights, gain

    def _evaluate(
        self,
        q2: Array,
        q3: Array,
        load: Array,
        sign: Array,
        values: Array,
        ratio: Array,
        change: DriveChange | None = None,
    ) -> tuple[Array, Array]:
        """Step size, shape (n, k), and derivatives, (n, k, p)."""
        share, inertia, weights, gain = self._share_and_inertia(q2, q3, sign, values)
        against = sign * load
        step = evaluate_step(values[..., 0], share * against, inertia, ratio)
        step = change_step(step, share * against, inertia, ratio, change)
        slopes = [step.by_unloaded]
        if gain is not None:
            slopes.append(step.by_inertia * gain)
        slopes += [step.by_share * against * weight for weight in weights]
        return step.gamma, np.stack(np.broadcast_arrays(*slopes), axis=-1)


def _with_trace(parameters: tuple[Parameter, ...], ratios: Ratios) -> tuple[Parameter, ...]:
    """Without the inertia where both directions are velocity-limited: no count depends on it."""
    if max(ratios) >= VELOCITY_LIMITED:
        return parameters
    return tuple(parameter for parameter in parameters if parameter.name != "inertia")


def _direction_sign(rows: Rows) -> Array:
    return np.sign(float_column(rows, "stop") - float_column(rows, "start"))


def _composite_rule(share: float, turn: float) -> tuple[Array, Array]:
    """Nodes and weights on 0 to 1, for up to `turn` rad under loads of up to `share` of friction.

    Gauss's rule of n nodes errs by about rho^-2n, with rho the sum of the half axes of the ellipse about a
    stretch within which the step size has no zero (L. Trefethen, Approximation Theory and Approximation
    Practice, SIAM, 2013, Theorem 19.3). Zeros are where |r cos q| is above 0.6, whatever the regime.
    """
    if 0.0 <= share < MODERATE:
        distance = 2.0 * np.arccosh(NEAREST_ZERO / max(share, 1e-3)) / max(turn, 1e-3)
        nodes = int(np.ceil(np.log(1.0 / QUADRATURE) / (2 * np.log(distance + np.hypot(1.0, distance))))) + 1
        if nodes < PANELS * NODES:
            x, w = _gauss(nodes)
            return (x + 1) / 2, w / 2
    x, w = _gauss(NODES)
    return ((np.arange(PANELS)[:, None] + (x + 1) / 2) / PANELS).ravel(), np.tile(w / (2 * PANELS), PANELS)


@lru_cache(maxsize=PANELS * NODES)
def _gauss(nodes: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(nodes)


def _regime_changes(amplitude: Array, phase: Array, edge: Array, start: Array, stop: Array) -> Array:
    """Ends of each traverse, and where between them amplitude cos(q - phase) is `edge`, shape (..., n, 6).

    A traverse of less than a turn passes it in no more than four places, counted with what lies a turn away.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(np.clip(np.where(amplitude == 0, 1.0, edge / amplitude), -1.0, 1.0))
    low, high = (
        np.broadcast_to(each, half.shape) for each in (np.minimum(start, stop), np.maximum(start, stop))
    )
    turns = 2 * np.pi * np.floor((low - phase + np.pi) / (2 * np.pi))
    centre = phase + turns
    places = np.stack(
        [centre - half, centre + half, centre + 2 * np.pi - half, centre + 2 * np.pi + half], axis=-1
    )
    inside = np.sort(np.clip(places, low[..., None], high[..., None]), axis=-1)
    ordered = np.concatenate([low[..., None], inside, high[..., None]], axis=-1)
    return np.where((start <= stop)[:, None], ordered, ordered[..., ::-1])


class PhysicalElbow(PhysicalRotary):
    """Joint 2: inertia quadratic and torque linear in q3, between the ends of the machine's range of q3."""

    name = "physical-elbow"
    joint = 2
    columns = ("q3", "theta", "psi", "start", "stop")
    parameters: tuple[Parameter, ...] = (
        Parameter("gamma0", "µrad", "step size without load, arm in", lower=0.0),
        Parameter("inertia", "1", "inertia gained with the arm out, as a share", *INERTIA),
        Parameter("r_q3_0", "1", "full load over friction, arm in", -MAX_SHARE, MAX_SHARE),
        Parameter("r_q3_12", "1", "full load over friction, arm out", -MAX_SHARE, MAX_SHARE),
    )

    def __init__(self, machine: Machine, ratios: Ratios = (FRICTION_LIMITED, FRICTION_LIMITED)) -> None:
        super().__init__(machine, ratios, Elbow(machine))

    def inertia_weight(self, q2: Array, q3: Array) -> Array:
        """See `PhysicalRotary.inertia_weight`: of link 3, by the distance of its centre of mass."""
        low, high = self.machine.ranges[3]
        arm = self.machine.l2 - (self.machine.links[2].com if self.machine.links else 0.0)
        return ((arm + q3) ** 2 - (arm + low) ** 2) / ((arm + high) ** 2 - (arm + low) ** 2)


class PhysicalBase(PhysicalRotary):
    """Joint 1: inertia quadratic and torque linear in the arm's reach rho = -(l2 + q3) sin q2."""

    name = "physical-base"
    joint = 1
    columns = ("q2", "q3", "theta", "psi", "start", "stop")
    parameters: tuple[Parameter, ...] = (
        Parameter("gamma0", "µrad", "step size without load at no reach", lower=0.0),
        Parameter("inertia", "1", "inertia gained with the arm level and out, as a share", *INERTIA),
        Parameter("r_reach_0", "1", "full load over friction at no reach", -MAX_SHARE, MAX_SHARE),
        Parameter("r_reach_full", "1", "full load over friction, arm level and out", -MAX_SHARE, MAX_SHARE),
    )

    def __init__(self, machine: Machine, ratios: Ratios = (FRICTION_LIMITED, FRICTION_LIMITED)) -> None:
        super().__init__(machine, ratios, Base(machine))

    def _relative_reach(self, q2: Array, q3: Array) -> Array:
        _, rho = self.published.weights(q2, q3)
        return rho / (self.machine.l2 + self.machine.ranges[3][1])

    def share_weights(self, q2: Array, q3: Array) -> list[Array]:
        reach = self._relative_reach(q2, q3)
        return [1.0 - reach, reach]

    def inertia_weight(self, q2: Array, q3: Array) -> Array | None:
        return self._relative_reach(q2, q3) ** 2


class PhysicalBaseAtOneReach(PhysicalRotary):
    """Joint 1 in a log that has one reach, at q2 and q3 (rad, m)."""

    name = "physical-base-one-reach"
    joint = 1
    columns = PhysicalBase.columns
    parameters: tuple[Parameter, ...] = (
        Parameter("gamma0", "µrad", "step size without load at the log's one reach", lower=0.0),
        Parameter("r", "1", "full load over friction at the log's one reach", -MAX_SHARE, MAX_SHARE),
    )

    def __init__(
        self,
        machine: Machine,
        q2: float,
        q3: float,
        ratios: Ratios = (FRICTION_LIMITED, FRICTION_LIMITED),
    ) -> None:
        super().__init__(machine, ratios, BaseAtOneReach(machine, q2, q3))
        self.q2 = q2
        self.q3 = q3

    def describe(self) -> dict[str, Any]:
        return super().describe() | {"q2_rad": self.q2, "q3_m": self.q3}

    def inertia_weight(self, q2: Array, q3: Array) -> None:
        """See `PhysicalRotary.inertia_weight`: none of its own."""
        return None


def physical_law_with(joint: int, rows: Rows, machine: Machine, ratios: Ratios) -> Physical:
    """The physical law of `joint` with this lambda in `+` and `-`; as `published_law`.

    Examples
    --------
    >>> from stickslip_fit.machine import load_machine
    >>> physical_law_with(3, {}, load_machine(), (FRICTION_LIMITED, 0.5)).name
    'physical-prismatic'
    """
    published = published_law(joint, rows, machine)
    if isinstance(published, Prismatic):
        return PhysicalPrismatic(ratios)
    if isinstance(published, Elbow):
        return PhysicalElbow(machine, ratios)
    if isinstance(published, BaseAtOneReach):
        return PhysicalBaseAtOneReach(machine, published.q2, published.q3, ratios)
    return PhysicalBase(machine, ratios)


def restore_physical(description: Mapping[str, Any], machine: Machine) -> Physical | None:
    """The law that `Physical.describe` described; None for another kind of law."""
    name = description.get("name")
    if name == PhysicalPrismatic.name:
        return PhysicalPrismatic(_ratios(description))
    if name == PhysicalElbow.name:
        return PhysicalElbow(machine, _ratios(description))
    if name == PhysicalBase.name:
        return PhysicalBase(machine, _ratios(description))
    if name == PhysicalBaseAtOneReach.name:
        place = float(description["q2_rad"]), float(description["q3_m"])
        return PhysicalBaseAtOneReach(machine, *place, _ratios(description))
    return None


def _ratios(description: Mapping[str, Any]) -> Ratios:
    up, down = map(float, description["lambda"])
    return up, down
