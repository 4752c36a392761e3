"""Hysteresis of the piezo between voltage and travel: play operators, and Maxwell's elements.

A Prandtl-Ishlinskii model is made of play operators. Each follows its input v at a distance of at most r, its
threshold: P(v) = max(v - r, min(v + r, P)). The travel is gain (w_0 v + sum w_i P_i(v)), w_0 = 1 - sum w_i
(J. W. Macki, P. Nistri and P. Zecca, SIAM Review 35:94, 1993; K. Kuhnen, European J. Control 9:407, 2003).
After each reversal the slope is gain w_0; play i joins once the voltage has changed by 2 r_i, and in the end
the slope is the gain. A reversed branch is the first one at twice the size (Masing), and a loop that closes
leaves no trace (return-point memory).

M. Goldfarb and N. Celanovic (IEEE Control Systems 17(3):69, 1997) put the hysteresis between charge and
voltage: a spring beside elasto-slide elements, each a spring that slides at a force of its own. Unloaded, the
travel is proportional to the charge. With u = travel / gain, v = u + sum F_i(u), for elements of stiffness
k_i (over that of the spring) and break force b_i (in volts). An element is k_i times the stop u - P(u) of
threshold b_i / k_i. A sum of stops has a sum of plays for its inverse: between reversals both are straight
lines, of slope 1 + sum k_i, over the elements that hold, and of its reciprocal. `MaxwellCapacitor.plays` is
this inverse.

Both models are rate independent and piecewise linear, so that pieces of constant acceleration remain such
pieces. In use a stage repeats its voltage: `apply` gives the settled loop, not the first rise of a relaxed
piezo. One period settles it, since highest and lowest voltage have then set every play.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from stickslip_fit._typing import Array
from stickslip_fit.errors import InputError
from stickslip_fit.step.motion import FootMotion

MAX_OPERATORS = 50
ROUNDING = 1e-12  # of the travel


class Hysteresis(ABC):
    """What both models have. A travel over the gain, in volts, is called a response."""

    @property
    @abstractmethod
    def plays(self) -> tuple[Array, Array]:
        """Weights w_i and thresholds r_i, V, of the play operators; each of shape (n,)."""

    def respond(self, voltage: npt.ArrayLike) -> Array:
        """Compute the response of a relaxed piezo, which has been at 0 V.

        Parameters
        ----------
        voltage : array_like, shape (n,)
            One after the other, V; monotone in between.

        Returns
        -------
        ndarray, shape (n,)
            V.

        Examples
        --------
        >>> PrandtlIshlinskii((0.25,), (4.0,)).respond([20.0, 16.0, 0.0, 20.0])
        array([19., 16.,  1., 19.])
        """
        weights, thresholds = self.plays
        play, responses = np.zeros(len(weights)), []
        for value in np.asarray(voltage, dtype=float):
            play = _follow(play, value, thresholds)
            responses.append((1 - weights.sum()) * value + weights @ play)
        return np.array(responses)

    def span(self, swing: float) -> float:
        """Height of the settled loop, V: swing - sum w_i min(2 r_i, swing), for a peak-to-peak voltage, V."""
        weights, thresholds = self.plays
        return float(swing - weights @ np.minimum(2 * thresholds, swing))

    def opening(self, swing: float) -> float:
        """Compute how far the settled loop is open at the middle of the voltage, V.

        It is sum w_i min(2 r_i, swing - 2 r_i) over the plays that move: those of 2 r_i below `swing`, the
        peak-to-peak voltage, V.
        """
        weights, thresholds = self.plays
        return float(weights @ np.clip(np.minimum(2 * thresholds, swing - 2 * thresholds), 0, None))

    def apply(self, motion: FootMotion, gain: float) -> FootMotion:
        """Make the foot's motion over one period of the settled loop; it begins where `motion` does.

        Parameters
        ----------
        motion : FootMotion
            Of a piezo without hysteresis, one parameter set.
        gain : float
            Travel for each volt of a large change, m/V.

        Raises
        ------
        InputError
            For more than one parameter set.

        Examples
        --------
        >>> from stickslip_fit.step import make_motion
        >>> model = PrandtlIshlinskii((0.25,), (4.0,))
        >>> model.apply(make_motion("ramp", 20e-9, 1e-4), 1e-9).velocity.round(9)
        array([0.00015, 0.0002 , 0.     , 0.     ])
        """
        if motion.duration.ndim != 1:
            raise InputError("hysteresis is computed for one motion at a time")
        weights, thresholds = self.plays
        reach, play = gain * thresholds, np.full(len(weights), motion.position[0])
        scales = (np.abs(values * motion.duration**i) for i, values in enumerate(motion.arrays[1:]))
        slack = ROUNDING * max(float(scale.max()) for scale in scales)
        pieces: list[tuple[float, ...]] = []
        for _ in range(2):
            pieces = []
            for duration, start, speed, change in zip(*motion.arrays, strict=True):
                play = _follow(play, start, reach)
                for begin, end in _monotone(duration, speed, change):
                    x, v = start + (speed + change * begin / 2) * begin, speed + change * begin
                    sign = np.sign(v + change * (end - begin) / 2)
                    ahead = sign * (play - x) + reach  # left until each play joins
                    joins = np.unique(ahead[(sign != 0) & (ahead > slack)])
                    times = _times_of(joins, sign * v, sign * change)
                    edges = np.concatenate([[0.0], times[times < end - begin], [end - begin]])
                    for passed, stop in pairwise(edges):
                        place = x + (v + change * passed / 2) * passed
                        moves = sign * (play - x) + reach <= sign * (place - x) + slack
                        slope = 1 - weights[~moves].sum()
                        settled = (1 - weights.sum()) * place + weights @ _follow(play, place, reach)
                        pieces.append((stop - passed, settled, slope * (v + change * passed), slope * change))
                    play = _follow(play, x + (v + change * (end - begin) / 2) * (end - begin), reach)
        duration, position, velocity, acceleration = np.array(pieces).T
        return FootMotion(duration, position - position[0] + motion.position[0], velocity, acceleration)


@dataclass(frozen=True)
class PrandtlIshlinskii(Hysteresis):
    """Play operators side by side.

    Attributes
    ----------
    weights : tuple of float
        w_i: of the travel of a large voltage, the share that lags behind; below 1 together.
    thresholds : tuple of float
        r_i, V: half the change of voltage after which a play joins.

    Raises
    ------
    InputError
        For values outside their domain.
    """

    weights: tuple[float, ...]
    thresholds: tuple[float, ...]

    def __post_init__(self) -> None:
        _check_pairs("play operators", "weight", self.weights, "threshold", self.thresholds)
        if sum(self.weights) >= 1:
            raise InputError(
                f"the weights of play operators must be below 1 together, not {sum(self.weights):g}"
            )

    @property
    def plays(self) -> tuple[Array, Array]:
        return np.array(self.weights), np.array(self.thresholds)


@dataclass(frozen=True)
class MaxwellCapacitor(Hysteresis):
    """Elasto-slide elements beside a spring: Goldfarb and Celanovic's Maxwell resistive capacitor.

    Attributes
    ----------
    stiffnesses : tuple of float
        k_i, over the stiffness of the spring, which is 1 / gain.
    break_voltages : tuple of float
        b_i, V: what an element holds until it slides.

    Raises
    ------
    InputError
        For values outside their domain.
    """

    stiffnesses: tuple[float, ...]
    break_voltages: tuple[float, ...]

    def __post_init__(self) -> None:
        _check_pairs("elements", "stiffness", self.stiffnesses, "break voltage", self.break_voltages)

    @property
    def plays(self) -> tuple[Array, Array]:
        """The inverse: plays that join where elements slide, with what the slope gains; see `Hysteresis`."""
        stiffness, limit = np.array(self.stiffnesses), np.array(self.break_voltages)
        slides = np.unique(limit / stiffness)
        thresholds = slides + np.minimum(np.outer(slides, stiffness), limit).sum(axis=1)
        held = np.where(limit / stiffness > slides[:, None], stiffness, 0.0).sum(axis=1)
        slopes = 1 / (1 + np.concatenate([[stiffness.sum()], held]))
        return np.diff(slopes), thresholds


def _check_pairs(
    what: str, first: str, values: tuple[float, ...], second: str, limits: tuple[float, ...]
) -> None:
    if not 1 <= len(values) <= MAX_OPERATORS or len(values) != len(limits):
        raise InputError(f"give 1 to {MAX_OPERATORS} {what}, each with {first} and {second}")
    if not all(0 < value < np.inf for value in (*values, *limits)):
        raise InputError(f"each {first} and {second} of {what} must be above 0 and finite")


def _follow(play: Array, value: float, threshold: Array) -> Array:
    return np.maximum(value - threshold, np.minimum(value + threshold, play))


def _monotone(duration: float, speed: float, change: float) -> Iterator[tuple[float, float]]:
    """Begin and end of the parts of a piece between which it does not reverse."""
    turn = -speed / change if change else 0.0
    if 0 < turn < duration:
        yield 0.0, turn
        yield turn, duration
    else:
        yield 0.0, duration


def _times_of(distances: Array, speed: float, change: float) -> Array:
    """When each distance is covered, from a speed of 0 or more on; infinite for those that are not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        times = 2 * distances / (speed + np.sqrt(speed**2 + 2 * change * distances))
    return np.where(np.isnan(times), np.inf, times)
