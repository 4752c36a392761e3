"""along-travel: the step size follows a joint's own position, by a smooth function learned from the log.

The logarithm of the step size has a sum of cosines over the travel that the log covers, whose coefficients
have a Gaussian-process prior (`smooth`). It is campaign-wide, so that overlapping partial traverses teach it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pandas as pd
from scipy.special import gammaincinv

from stickslip_fit._format import format_direction, join_words
from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause, extend
from stickslip_fit.causes.joint_ranges import NOMINAL_TRAVEL, Ranges
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.parameters import CauseParameter, Row, SizedParameter, collect_row_values
from stickslip_fit.causes.smooth import LENGTHS, LogLinearFactor, cosines, prior_sds, rough_prior_sds
from stickslip_fit.laws import State, StepLaw, state_at
from stickslip_fit.machine import Machine
from stickslip_fit.units import Interval

__all__ = ["AlongTravel"]

TRIAL_SIZE = 0.01  # rms
LARGEST_SIZE = 0.5  # of a single cosine: 35 % rms
N_PIECES = 8  # of a traverse along which the law itself varies, each with one step size, in trials
N_PLACES = 500  # of a travel, at which a function's size is computed
RMS = "rms"


@dataclass(frozen=True)
class AlongTravel(LogLinearFactor):
    """gamma times 1 + f(q), f smooth with mean 0 over the travel of each joint, constant beyond.

    1 + f is the exponential of a sum of cosines, less a quarter of the sum of their coefficients' squares for
    the mean; a sum itself where it is small. A motor's steps may be several times larger in one place than in
    another, where a sum could be negative.

    Attributes
    ----------
    travel : tuple of (int, float, float)
        Joints that it acts on, with the lowest and the highest position of their traverses.
    directions : tuple of str
        Those with a function of their own: both, or the one in which it acts. Empty for one that both share.
    sds : tuple of float
        Prior standard deviations of the cosines' coefficients for a function of rms 1.
    amplitude : float or None
        Rms of the function under the prior with which it is fitted, in units of `TRIAL_SIZE`; None for no
        prior.
    """

    travel: Ranges = NOMINAL_TRAVEL
    directions: tuple[str, ...] = ()
    sds: tuple[float, ...] = tuple(prior_sds(LENGTHS[1]).tolist())
    amplitude: float | None = None

    name = "along-travel"
    phrase = "steps differ from place to place along a joint's own travel"
    physics = (
        "Friction, preload and wear of a guide or a bearing are not the same everywhere, so that one pulse "
        "moves the joint farther in some places than in others. The profile belongs to the motor: it is the "
        "same in every session, and may differ between the two directions."
    )
    shows_best = "a joint over short stretches, one after the other or overlapping, along its travel"
    remedy = "calibrating over the stretch that is used"
    varies_along_traverse = True
    max_trial_factor = LARGEST_SIZE / TRIAL_SIZE

    @cached_property
    def groups(self) -> tuple[tuple[int, str | None], ...]:
        """Joint and direction of each function; None for both directions."""
        return tuple((joint, way) for joint, _, _ in self.travel for way in self.directions or (None,))

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        amplitude = np.inf if self.amplitude is None else TRIAL_SIZE * self.amplitude
        return tuple(
            CauseParameter(
                f"f{k}",
                "%",
                f"coefficient of cosine {k} over the travel",
                joint=joint,
                direction=direction,
                prior_sd=amplitude * sd,
            )
            for joint, direction in self.groups
            for k, sd in enumerate(self.sds, start=1)
        )

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return tuple(TRIAL_SIZE * sd for _ in self.groups for sd in self.sds)

    def with_amplitude(self, amplitude: float) -> Self:
        """The same with the prior under which each coefficient is as large as its trial times `amplitude`."""
        return replace(self, amplitude=float(amplitude))

    def acts_on(self, law: StepLaw) -> bool:
        return any(joint == law.joint for joint, _, _ in self.travel)

    def panel(self, values: Array, joint: int) -> float:
        """See `Cause.panel`: two periods of the narrowest cosine."""
        longest = max(high - low for own, low, high in self.travel if own == joint)
        return 4.0 * longest / len(self.sds)

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Self:
        """See `Cause.bind`: the travel of each joint whose traverses have different ends."""
        return self if self.amplitude is not None else replace(self, travel=_find_travel(rows))

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        return None if _find_travel(rows) else "every traverse of a joint runs the same range"

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: each length and all, joint by joint and all together, by direction or not."""
        versions = [self]
        if self.amplitude is None:
            joints = [(one,) for one in self.travel] + ([self.travel] if len(self.travel) > 1 else [])
            ways = [(), ("+", "-")] if rows["direction"].nunique() > 1 else [()]
            priors = [*(prior_sds(length) for length in LENGTHS), rough_prior_sds()]
            versions = [
                replace(self, travel=travel, directions=each, sds=tuple(sds.tolist()))
                for sds in priors
                for travel in joints
                for each in ([self.directions] if self.is_restricted else ways)
            ]
        return [(version, np.diag(version.scale)) for version in versions]

    def restricted(self, rows: pd.DataFrame) -> list[Cause]:
        """See `Cause.restricted`: one direction, of joints whose traverses there have different ends."""
        by_direction = dict(list(rows.groupby("direction")))
        if self.amplitude is not None or len(by_direction) < 2:
            return []
        found: list[Cause] = []
        for way, own in by_direction.items():
            shown = {joint for joint, _, _ in _find_travel(own)}
            if travel := tuple(one for one in self.travel if one[0] in shown):
                found.append(replace(self, travel=travel, directions=(str(way),)))
        return found

    @property
    def is_restricted(self) -> bool:
        return len(self.directions) == 1

    def largest_plausible(self) -> tuple[Array, ...]:
        """See `Cause.largest_plausible`: each cosine alone."""
        return tuple(LARGEST_SIZE * np.eye(len(self.parameters)))

    def functions(self, state: State) -> Array:
        low, high = next((low, high) for joint, low, high in self.travel if joint == state.joint)
        return cosines(state.position, low, high, len(self.sds))

    def sum_of(self, functions: Array, coefficients: Array) -> Array:
        squares = np.sum(coefficients**2, axis=1)[:, None]
        return super().sum_of(functions, coefficients) - squares / 4.0

    def slopes_of(self, functions: Array, coefficients: Array) -> Array:
        return functions - coefficients[:, None, :] / 2.0

    def acts(self, state: State) -> Array:
        return self._acts_on(state.joint, state.direction_sign)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: of small single cosines by the derivative without effect."""
        if not self.acts_on(law):
            return np.zeros((len(values), len(trials)))
        single = np.count_nonzero(trials, axis=1).max(initial=0) <= 1
        if single and np.all(np.abs(trials) <= self.scale):
            return np.asarray(self._mean_functions(law, rows, values) @ trials.T)
        return FactorCause.changes(self, law, rows, values, trials)

    def summarize(self, values: Array, covariance: Array) -> tuple[SizedParameter, ...]:
        """Rms of each function over its travel, by its coefficients (q,) and their covariance (q, q)."""
        number = len(self.sds)
        return tuple(
            SizedParameter(RMS, "%", rms_of_factor(values[own], covariance[own, own]), joint, direction)
            for place, (joint, direction) in enumerate(self.groups)
            for own in [slice(place * number, (place + 1) * number)]
        )

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        """See `Cause.describe`: by the rms of each function, or by their coefficients."""
        sizes = {(one.joint, one.direction): f"{one}" for one in parameters if one.name == RMS}
        if not sizes:
            return super().describe(())
        joints = list(dict.fromkeys(joint for joint, _ in sizes))
        parts = [_describe_joint(joint, sizes) for joint in joints]
        if len(parts) == 1:
            return f"The steps of joint {joints[0]} vary by {parts[0]} rms along its travel" + self._ending
        each = join_words([f"{part} for joint {joint}" for joint, part in zip(joints, parts, strict=True)])
        return f"Steps vary along the joints' travel, by {each} (rms)" + self._ending

    @property
    def _ending(self) -> str:
        if self.is_restricted:
            return f", in direction {format_direction(self.directions[0])} only"
        return ", differently in the two directions" if self.directions else ""

    def _acts_on(self, joint: int, sign: Array) -> Array:
        """1 for the traverses of a joint in a group's direction, whose sign has shape (n, 1); (n, groups)."""
        signs: dict[str | None, Any] = {None: 1.0 + 0.0 * sign, "+": 1.0 * (sign > 0), "-": 1.0 * (sign < 0)}
        return np.concatenate([(own == joint) * signs[way] for own, way in self.groups], axis=1)

    def _mean_functions(self, law: StepLaw, rows: Row, values: Array) -> Array:
        """Derivative of each response by each parameter, all 0: a mean along the traverse, less; (n, q)."""
        before = extend(law)
        row = collect_row_values(rows, before.columns)
        start, stop = row["start"][:, None], row["stop"][:, None]
        places = (np.arange(N_PIECES) + 0.5) / N_PIECES
        gamma = before.gamma(state_at(law.joint, row, start + (stop - start) * places), values)
        low, high = next((low, high) for joint, low, high in self.travel if joint == law.joint)
        stretches, which = unique_rows(np.concatenate([start, stop], axis=1))
        shares = np.linspace(stretches[:, 0], stretches[:, 1], gamma.shape[1] + 1, axis=1)
        integrals = _cosine_integrals((shares - low) / (high - low), len(self.sds))
        means = np.diff(integrals, axis=1) / np.diff(shares, axis=1)[:, :, None] * (high - low)
        weights = (1.0 / gamma) / np.sum(1.0 / gamma, axis=1, keepdims=True)
        mean = np.einsum("np,npk->nk", weights, means[which])
        acts = self._acts_on(law.joint, np.sign(stop - start))
        return -(acts[:, :, None] * mean[:, None, :]).reshape(len(mean), -1)


def _find_travel(rows: pd.DataFrame) -> Ranges:
    """Joint, lowest and highest position, of the joints whose traverses have different ends."""
    travel = []
    for joint, ends in rows[["start", "stop"]].groupby(rows["joint"].to_numpy(int)):
        stretches = np.sort(ends.to_numpy(float), axis=1)
        if len(np.unique(stretches.round(7), axis=0)) > 1:
            travel.append((int(str(joint)), float(stretches.min()), float(stretches.max())))
    return tuple(travel)


def _cosine_integrals(share: Array, number: int) -> Array:
    """Integrals of `cosines` from 0 to each share of the travel, (n, m) -> (n, m, number)."""
    turns, inside = np.pi * np.arange(1, number + 1), np.clip(share, 0.0, 1.0)
    integrals = np.sin(inside[:, :, None] * turns) / turns
    if np.any(inside != share):
        integrals += np.cos(inside[:, :, None] * turns) * (share - inside)[:, :, None]
    return np.asarray(integrals)


def rms_of_factor(values: Array, covariance: Array) -> Interval:
    """Rms of the factor relative to its mean over the travel, from that of its logarithm."""
    logarithm = cosines(np.linspace(0.0, 1.0, N_PLACES), 0.0, 1.0, len(values)) @ values
    factor = np.exp(logarithm - logarithm.max())
    size = _rms_interval(values, covariance)
    return size.times(float(factor.std() / factor.mean() / max(logarithm.std(), np.finfo(float).tiny)))


def _rms_interval(values: Array, covariance: Array) -> Interval:
    """Rms of a sum of cosines: half the sum of the coefficients' squares, as a gamma distribution."""
    spread = np.nan_to_num(covariance)
    mean = float(values @ values + np.trace(spread)) / 2.0
    variance = float(np.trace(spread @ spread) / 2.0 + values @ spread @ values)
    if not variance > 0.0:
        return Interval(float(np.sqrt(mean)), np.nan, np.nan)
    low, high = gammaincinv(mean**2 / variance, (0.025, 0.975)) * variance / mean
    return Interval(float(np.sqrt(mean)), float(np.sqrt(low)), float(np.sqrt(high)))


def _describe_joint(joint: int | None, sizes: dict[tuple[int | None, str | None], str]) -> str:
    own = [(direction, size) for (of, direction), size in sizes.items() if of == joint]
    if len(own) == 1:
        return own[0][1]
    return join_words([f"{size} ({format_direction(str(one))})" for one, size in own])
