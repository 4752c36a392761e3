"""Causes in position and counting: runout, guide gradient, worn spot, reversal loss, end-stop errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._format import format_percent
from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.causes._integration import PanelCounter
from stickslip_fit.causes.base import Cause, ExtendedLaw, extend
from stickslip_fit.causes.joint_ranges import NOMINAL_TRAVEL, JointRanges, Ranges
from stickslip_fit.causes.kinds import CountCause, FactorCause, OnSomeJoints, beside_steps_added
from stickslip_fit.causes.parameters import CauseParameter, Row, Sizes
from stickslip_fit.laws import Configuration, ConstantStep, State, StepLaw, state_at
from stickslip_fit.units import PRISMATIC

__all__ = [  # noqa: RUF022
    "BearingRunout",
    "GuideGradient",
    "WornSpot",
    "EndStopLatency",
    "ReversalLoss",
    "EndStopMisfire",
]


MIN_STRETCHES = 100  # of which those of all together are counted
CELLS_IN_PANEL, LEAST_PANELS = 40, 4


@dataclass(frozen=True)
class PositionCause(JointRanges, FactorCause):
    """gamma times a factor that depends on the joint's own position, and on the direction, alone."""

    varies_along_traverse = True
    special_case_of = "along-travel"


@dataclass(frozen=True)
class DirectionalCause(PositionCause):
    """A factor whose parameters are the same in both directions or, if the data ask for it, of each its own.

    Attributes
    ----------
    own_parameters : tuple of CauseParameter
        Those of one direction.
    own_scale : tuple of float
        See `Cause.scale`.
    own_trials : array_like, shape (m, q)
        See `Cause.trials`, of one direction.
    """

    by_direction: bool = False

    own_parameters: ClassVar[tuple[CauseParameter, ...]]
    own_scale: ClassVar[tuple[float, ...]]
    own_trials: ClassVar[npt.ArrayLike]
    combine_trials = True

    @property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        if not self.by_direction:
            return self.own_parameters
        return tuple(replace(one, direction=each) for each in "+-" for one in self.own_parameters)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return self.own_scale * (1 + self.by_direction)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: the same in both directions, and in each its own."""
        own = np.array(self.own_trials, dtype=float)
        each = np.asarray(np.kron(np.eye(2), own), dtype=float)
        tried: list[tuple[Cause, Array]] = []
        for version in self.together_and_alone():
            tried.append((replace(version, by_direction=False), own))
            if version.has_both_directions(rows):
                tried.append((replace(version, by_direction=True), each))
        return tried

    def by_row(self, state: State, values: list[Array]) -> list[Array]:
        """The parameters in the direction of each row, each shape (n, 1)."""
        if not self.by_direction:
            return values
        number, forwards = len(self.own_parameters), state.direction_sign > 0
        return [
            np.where(forwards, up, down) for up, down in zip(values[:number], values[number:], strict=True)
        ]


@dataclass(frozen=True)
class BearingRunout(DirectionalCause):
    """Rotary: gamma times 1 + A cos(q - phi), also without gravity."""

    name = "bearing-runout"
    phrase = "a bearing is eccentric"
    physics = (
        "An eccentric bearing presses its sliding surfaces together more on one side than on the other, so "
        "that friction and step size vary once per turn. It looks like gravity, but it turns with the joint "
        "and is there with the base on its side, too."
    )
    shows_best = "a rotary joint over stretches of 60 degrees with the base on its side"
    sentence = "{whose} steps vary by ± {A} over a turn: a bearing is eccentric"
    remedy = "calibrating over the stretch that is used"
    joints = (1, 2)
    kind = "rotary"
    own_parameters = (
        CauseParameter("A", "%", "amplitude of the step size over a turn"),
        CauseParameter("phi", "deg", "where the step size is greatest"),
    )
    own_scale = (0.01, 0.5)
    own_trials = ((0.01, 0.0), (0.01, np.pi / 2))  # a cosine and a sine
    largest_sizes = ((0.1, 0.0), (0.1, np.pi / 2))

    @property
    def start_values(self) -> tuple[float, ...]:
        """See `Cause.start_values`: without an amplitude no phase would matter."""
        return self.scale

    def combine(self, shares: Array, trials: Array) -> Array:
        """See `Cause.combine`: the amplitude and the phase of each direction's cosine and sine."""
        cosine, sine = shares[::2], shares[1::2]
        amplitude = trials[0, 0] * np.hypot(cosine, sine)
        return np.column_stack([amplitude, np.arctan2(sine, cosine)]).ravel()

    def factor(self, state: State, values: list[Array]) -> Array:
        size, phase = self.by_row(state, values)
        return 1.0 + size * np.cos(state.position - phase)


@dataclass(frozen=True)
class GuideProfileCause(PositionCause):
    """A factor along the guide of a prismatic joint."""

    ranges: Ranges = NOMINAL_TRAVEL[2:]

    joints = (PRISMATIC,)
    kind = "prismatic"

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        subset = rows[rows["joint"].isin(self.joints)]
        ends = np.sort(subset[["start", "stop"]].to_numpy(float), axis=1).round(7)
        if len(subset) and len(np.unique(ends, axis=0)) < 2:
            return "every prismatic traverse runs the whole guide"
        return super().explain_missing(rows)

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """See `Cause.changes`: where profiles alone vary along the guide, a stretch counts once."""
        before = extend(law)
        along = [(cause, columns) for cause, columns in before.active_causes if cause.varies_along_traverse]
        if not all(isinstance(cause, GuideProfileCause) for cause, _ in along):
            return super().changes(law, rows, values, trials)
        ends = [np.asarray(rows[end], dtype=float) for end in ("start", "stop")]
        changes = self._stretch_changes(law, ends, values, along, trials)
        row = self.row_values(law, rows)
        state = state_at(law.joint, row, np.stack([row["start"], row["stop"]], axis=-1))
        return beside_steps_added(before, rows, values, state, changes)

    def _stretch_changes(
        self, law: StepLaw, ends: list[Array], values: Array, along: Sequence[Any], trials: Array
    ) -> Array:
        """Changes of the logarithm of the steps by a profile where others, `along`, act on the joint."""
        profile = [values[:, columns.start : columns.stop] for _, columns in along]
        stretches, which = unique_rows(np.column_stack([*ends, np.ones(len(values)), *profile]))
        # What is constant along a traverse does not change by how much its steps differ.
        constant = extend(
            ConstantStep(law.joint, Configuration("anywhere"), prismatic=True), *(cause for cause, _ in along)
        )
        if len(stretches) > MIN_STRETCHES and not np.ptp(stretches[:, 2:], axis=0).any():
            changes = changes_by_travel(self, constant, stretches[:, :2], stretches[0, 2:], trials)
            if np.isfinite(changes).all():
                return changes[which]
        distinct = dict(zip(("start", "stop"), stretches.T, strict=False))
        return Cause.changes(self, constant, distinct, stretches[:, 2:], trials)[which]


def changes_by_travel(cause: Cause, law: ExtendedLaw, ends: Array, values: Array, trials: Array) -> Array:
    """As `Cause.changes` over many stretches of one guide on which only its own position matters.

    Steps since the end of the guide, of all stretches together: from cells much narrower than what the law
    resolves, in each of which they are a cubic of the position (Hermite's).

    Parameters
    ----------
    cause : Cause
    law : ExtendedLaw
    ends : array, shape (n, 2)
        Start and stop, m.
    values : array, shape (p,)
    trials : array, shape (m, q)

    Returns
    -------
    array, shape (n, m)
        NaN where the joint stalls somewhere.
    """
    extended, all_values = cause.extend(law), np.hstack([np.tile(values, (len(trials), 1)), trials])
    lowest, highest = float(ends.min()), float(ends.max())
    panel = min(extended.panel(all_values), (highest - lowest) / LEAST_PANELS)
    edges = np.linspace(lowest, highest, int(np.ceil(CELLS_IN_PANEL * (highest - lowest) / panel)) + 1)
    cell = np.clip(np.searchsorted(edges, ends, side="right") - 1, 0, len(edges) - 2)
    width = np.diff(edges)[cell]
    x = (ends - edges[cell]) / width
    changes = np.empty((len(ends), len(trials)))
    for forwards in (True, False):
        rows = np.flatnonzero((ends[:, 1] >= ends[:, 0]) == forwards)
        first, last = (edges[:-1], edges[1:]) if forwards else (edges[1:], edges[:-1])
        counter = PanelCounter(first, last, 1, np.inf)
        places = np.column_stack([counter.positions, edges[:-1], edges[1:]])
        state = state_at(law.joint, {"start": first, "stop": last}, places)
        steps = []
        for one in (np.append(values, cause.null_values), *all_values):
            gamma = np.broadcast_to(extended.gamma(state, np.tile(one, (len(first), 1))), places.shape)
            within = counter.counts(gamma[:, :-2])
            at = cell[rows], x[rows], width[rows]
            steps.append(np.ptp(_interpolate(within, 1.0 / gamma[:, -2:], *at), axis=1))
        before, *after = steps
        changes[rows] = np.log(np.column_stack(after) / before[:, None])
    return changes


def _interpolate(within: Array, rates: Array, cell: IntArray, x: Array, width: Array) -> Array:
    """Steps to places `x` of cells, by the steps in all cells and their rates at the edges of each."""
    before = np.append(0.0, np.cumsum(within))
    smooth = within[cell] * x * x * (3.0 - 2.0 * x)
    bend = rates[cell, 0] * (1.0 - x) - rates[cell, 1] * x
    return np.asarray(before[cell] + smooth + width * x * (1.0 - x) * bend)


@dataclass(frozen=True)
class GuideGradient(GuideProfileCause, DirectionalCause):
    """Prismatic: gamma times 1 + k (q3 - 6 mm), or less the middle of another guide."""

    name = "guide-gradient"
    phrase = "the guide's preload varies along its length"
    physics = (
        "Two guide rails that are not parallel press on the slider more at one end than at the other, so "
        "that friction and step size change along the guide."
    )
    shows_best = "a prismatic joint over the first and over the last third of its range"
    sentence = "{whose} steps {k:grow|shrink} by {k} along the guide"
    remedy = "calibrating over the stretch that is used"
    own_parameters = (CauseParameter("k", "%/mm", "change of the step size per millimetre"),)

    @property
    def own_scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """A change by 2.4 % over the longest guide."""
        return (0.024 / max(high - low for _, low, high in self.ranges),)

    @property
    def own_trials(self) -> Array:  # type: ignore[override]
        return np.array([self.own_scale])

    def largest_plausible(self) -> tuple[Array, ...]:
        return (10.0 * np.array(self.scale),)

    def factor(self, state: State, values: list[Array]) -> Array:
        middle = sum(self.ends(state.joint)) / 2.0
        return 1.0 + self.by_row(state, values)[0] * (state.position - middle)


SPOT_WIDTHS = (0.025, 1.0 / 12.0, 2.5 / 12.0)  # of the guide: 0.3, 1 and 2.5 mm of one of 12 mm
NARROWEST_SPOT, WIDEST_SPOT = 0.1 / 12.0, 0.5
WIDTHS_IN_PANEL = 4
SPOT_SIZE = CauseParameter("A", "%", "change of the step size at its middle", lower=-0.95)


@dataclass(frozen=True)
class WornSpot(GuideProfileCause):
    """Prismatic: gamma times 1 + A exp(-((q3 - x0) / w)^2 / 2).

    Attributes
    ----------
    place : tuple of float
        Where a fit with an amplitude for each direction starts: middle and width, m. Empty for one amplitude.
    """

    place: tuple[float, ...] = ()

    name = "worn-spot"
    phrase = "the guide has a worn spot"
    physics = (
        "Where a joint is used most, over a short stretch, its guide wears first, and the step size is "
        "another there. A traverse of the whole guide always crosses it and cannot tell."
    )
    shows_best = "a prismatic joint over short stretches, one after the other, along the guide"
    sentence = "{whose} steps {A:grow|shrink} by {A} around {q} = {x0} ({w} wide): the guide has a worn spot"
    remedy = "staying off that stretch"

    @property
    def combine_trials(self) -> bool:  # type: ignore[override]
        """See `Cause`: the amplitudes of the two directions are independent."""
        return bool(self.place)

    @cached_property
    def guide(self) -> tuple[float, float]:
        """Ends of the guide, of several those of all together, m."""
        return min(low for _, low, _ in self.ranges), max(high for _, _, high in self.ranges)

    @cached_property
    def length(self) -> float:
        """Length of the guide, m."""
        return self.guide[1] - self.guide[0]

    @cached_property
    def parameters(self) -> tuple[CauseParameter, ...]:  # type: ignore[override]
        each = tuple(replace(SPOT_SIZE, direction=one) for one in "+-") if self.place else (SPOT_SIZE,)
        (low, high), length = self.guide, self.length
        middle = CauseParameter("x0", "mm", "its middle", lower=low, upper=high)
        narrowest, widest = NARROWEST_SPOT * length, WIDEST_SPOT * length
        return (*each, middle, CauseParameter("w", "mm", "its width", lower=narrowest, upper=widest))

    @cached_property
    def null_values(self) -> tuple[float, ...]:
        return (0.0, 0.0, *self.place) if self.place else (0.0, sum(self.guide) / 2.0, self.length / 12.0)

    @property
    def start_values(self) -> tuple[float, ...]:
        """See `Cause.start_values`: without an amplitude no place would matter."""
        return (*self.scale[:-2], *self.null_values[-2:])

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        return (*(0.05,) * (len(self.parameters) - 2), self.length / 12.0, self.length / 12.0)

    def largest_plausible(self) -> tuple[Array, ...]:
        """See `Cause.largest_plausible`: in five places; of several guides those of `trials`."""
        if len(self.ranges) > 1:
            return ()
        places = self.guide[0] + self.length * np.arange(1, 6) / 6.0
        return tuple(np.array([0.5, x0, self.length / 12.0]) for x0 in places)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: spots of three widths side by side along each guide; wide ones by direction."""
        return [
            tried
            for version in self.together_and_alone()[-len(self.ranges) :]
            for tried in version._trials(rows)
        ]

    def _trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        joint, widths = self.ranges[0][0], [share * self.length for share in SPOT_WIDTHS]
        own = rows[rows["joint"] == joint]
        ends = own[["start", "stop"]].to_numpy(float)
        middles = [np.arange(ends.min() + width / 2, ends.max(), width) for width in widths]
        spots = [(x0, width) for width, places in zip(widths, middles, strict=True) for x0 in places]
        versions: list[tuple[Cause, Array]] = [
            (replace(self, place=()), np.array([(0.05, *spot) for spot in spots]))
        ]
        if self.has_both_directions(rows):
            versions += [
                (replace(self, place=spot), np.array([(0.05, 0.0, *spot), (0.0, 0.05, *spot)]))
                for spot in spots
                if spot[1] > widths[0]
            ]
        return versions

    def combine(self, shares: Array, trials: Array) -> Array:
        return np.append(shares @ trials[:, :2], trials[0, 2:])

    def panel(self, values: Array, joint: int) -> float:
        return WIDTHS_IN_PANEL * max(float(values[:, -1].min()), NARROWEST_SPOT * self.length)

    @property
    def max_panel(self) -> float:  # type: ignore[override]
        """See `Cause.max_panel`: of the narrowest spot."""
        return WIDTHS_IN_PANEL * NARROWEST_SPOT * self.length

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        return {**super().quantities(sizes), "q": f"q{self.ranges[0][0]}"}

    def factor(self, state: State, values: list[Array]) -> Array:
        *sizes, middle, width = values
        size = np.where(state.direction_sign > 0, sizes[0], sizes[-1])
        return 1.0 + size * np.exp(-0.5 * ((state.position - middle) / width) ** 2)


@dataclass(frozen=True)
class EndStopLatency(OnSomeJoints, CountCause):
    """N plus L, whatever the traverse's length."""

    name = "end-stop-latency"
    phrase = "the end stop is heard a fixed number of steps late or early"
    physics = (
        "The sound of the stop has to rise above the motion's own before it is heard, and whoever listens "
        "takes time, while the drive goes on stepping. The steps lost so are the same for a short and a "
        "long traverse."
    )
    shows_best = "short partial traverses beside full ones"
    sentence = "The end stop is heard {L} {L:late|early}"
    remedy = "taking those steps off every count"
    parameters = (CauseParameter("L", "steps", "steps counted after the stop was reached"),)
    scale = (20.0,)
    largest_sizes = ((300.0,),)
    affects_stop_only = True

    def steps(self, state: State, values: list[Array]) -> Array:
        return values[0]


@dataclass(frozen=True)
class ReversalLoss(OnSomeJoints, CountCause):
    """N plus L where the traverse before went the other way; a session's first did not."""

    name = "reversal-loss"
    phrase = "steps are lost after each reversal"
    physics = (
        "After a reversal the elastic deflection of the contact has to be wound up the other way before the "
        "joint moves, which takes a few steps (backlash of the preloaded contact)."
    )
    shows_best = "one configuration after a traverse in the same and in the other direction"
    sentence = "At each reversal {L} are {L:lost|gained}"
    remedy = "adding those steps after each reversal"
    columns = ("before_direction",)
    parameters = (CauseParameter("L", "steps", "steps lost at a reversal"),)
    scale = (20.0,)
    largest_sizes = ((300.0,),)

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        reversals = is_reversed(rows["before_direction"], rows["direction"])
        if not reversals.any():
            return "no traverse follows one in the other direction"
        return "every traverse follows one in the other direction" if reversals.all() else None

    def steps(self, state: State, values: list[Array]) -> Array:
        direction = np.where(state.direction_sign[:, 0] > 0, "+", "-")
        return values[0] * is_reversed(state.row["before_direction"], direction)[:, None]


def is_reversed(before: npt.ArrayLike, direction: npt.ArrayLike) -> BoolArray:
    """Whether each traverse follows one in the other direction, shape (n,)."""
    before, direction = np.asarray(before, dtype=object), np.asarray(direction, dtype=object)
    return (before != "") & (before != direction)


@dataclass(frozen=True)
class EndStopMisfire(Cause):
    """A few counts are off by a lot, up or down; the rest are right."""

    name = "end-stop-misfire"
    phrase = "now and then the end stop is missed or imagined"
    physics = (
        "A noise from elsewhere passes for the stop and ends a traverse early, or the stop's own sound is "
        "missed and the joint goes on stepping against it. Such counts say nothing about step sizes."
    )
    shows_best = "replicates: a misfire does not come back"
    sentence = "About one count in {one_in} is off by {size}: the end stop is missed or imagined"
    remedy = "repeating those traverses (the Student-t fit needs none excluded)"
    parameters = (
        CauseParameter("share", "%", "of the counts", lower=0.0, upper=1.0),
        CauseParameter("size", "%", "typical departure of such a count", lower=0.0),
    )
    scale = (0.01, 0.05)
    affects_stop_only = True

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """See `Cause.trials`: none, as such counts deviate independently."""
        return []

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        one_in = round(1 / sizes["share"].size.estimate)
        size = sizes["size"].size.estimate
        about = f"{format_percent(size)} or so" if np.isfinite(size) else "an unknown amount"
        return {"one_in": f"{one_in:,}", "size": about}

    def misfire_deviations(self, values: Array, misfire_draws: Array) -> Array:
        """Log steps that misfires add to counts, (n, 2) -> (n,).

        `misfire_draws`, shape (n, 3), are uniform in [0, 1]: for its occurrence, its size and its sign.
        """
        occurrence, spread, sign_draw = misfire_draws.T
        size = values[:, 1] * (0.7 + 0.6 * spread) * np.where(sign_draw < 0.5, -1.0, 1.0)
        return np.where(occurrence < values[:, 0], size, 0.0)
