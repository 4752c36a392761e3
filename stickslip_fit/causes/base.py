"""Cause: a systematic effect that a published law leaves out, and the laws with such in them.

The model of a traverse is evaluated in a fixed order: state (angles, then load and recoil), law, terms
added to the step size, factors on it, steps over the traverse, steps added to the count. A cause acts
at exactly one of these stages, see `kinds`; `ExtendedLaw` is a published law with causes in it.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial, reduce
from math import prod
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes._integration import AdaptiveCounter, chain
from stickslip_fit.causes.parameters import (
    CauseParameter,
    Row,
    SizedParameter,
    Sizes,
    collect_row_values,
    name_parameters,
    plain_description,
    sizes_by_name,
)
from stickslip_fit.laws import Configuration, Parameter, Rows, State, StepLaw, float_column
from stickslip_fit.laws.base import Counter
from stickslip_fit.laws.quantities import POSE
from stickslip_fit.machine import Machine

EVERY_JOINT = (1, 2, 3)
DIFFERENCE_STEP = 1e-5  # of each parameter's scale, in central differences: good to about ten digits


class Cause(ABC):
    """A cause holds no parameter values: they are handed to it, shape (q,) or (n, q), SI.

    Attributes
    ----------
    acts_at : str
        The stage at which it acts, as its kind says (`kinds`).
    name, phrase : str
        In code and reports; what is the matter, as part of a sentence.
    physics : str
        A paragraph on what happens, with its source.
    shows_best : str
        The traverse that would show it best.
    sentence : str
        Its effect in a log, with `quantities` in braces as in `SizedParameter`, without a full stop. Empty
        where the phrase and the parameters are enough.
    remedy : str
        What a lab can do about it, as the beginning of a sentence ("waiting until it is warm"); empty where
        only an extended law helps.
    joints : tuple of int
        On which it acts; `EVERY_JOINT` are all joints of any machine.
    kind : {"", "rotary", "prismatic"}
        If not empty, it acts on the joints of this kind, and `joints` are those of the published arm.
    needs_geometry : bool
        Whether it needs the gravity load or the published arm's dimensions.
    session : str
        The only session in which it acts; empty for all.
    columns : tuple of str
        Quantities of a traverse that it needs besides positions and angles.
    parameters : tuple of CauseParameter
    null_values, scale : tuple of float
        Of each parameter the value without effect, and a size or a change that matters.
    trial_values : array_like, shape (m, q)
        Values that `trials` has in place of `scale`.
    largest_sizes : tuple of tuple of float
        The largest plausible values, see `largest_plausible`.
    max_trial_factor : float
        Without `largest_sizes`: how many times its size in `trials` the first parameter may be.
    forms : tuple of str
        Values of its field `form`: equations between which it chooses.
    varies_along_traverse : bool
        Whether it varies along a traverse beyond what the law itself does.
    combine_trials : bool
        Whether the trials of a version act in any combination, not one at a time.
    affects_stop_only : bool
        Whether it concerns the detection of the stop, not the motion before it.
    max_panel : float
        Widest integration panel that resolves it along a traverse, rad or m.
    takes_functions : bool
        Whether a smooth function of its only column, whatever its form, is this cause, see `with_functions`.
    search_note : str
        What the search for it leaves out, as a sentence; empty where it leaves out nothing.
    special_case_of : str
        A cause whose form contains its own: no log tells such a cause from it, and the simpler one suffices.
    share_where_noise_persists : float
        How much of it counts as larger than noise whose autocorrelation is known within an error.
    """

    acts_at: ClassVar[Literal["", "state", "term", "factor", "count"]] = ""
    name: ClassVar[str]
    phrase: ClassVar[str]
    physics: ClassVar[str]
    shows_best: ClassVar[str]
    sentence: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    joints: ClassVar[tuple[int, ...]] = EVERY_JOINT
    kind: ClassVar[Literal["", "rotary", "prismatic"]] = ""
    needs_geometry: ClassVar[bool] = False
    session: str = ""
    columns: ClassVar[tuple[str, ...]] = ()
    parameters: tuple[CauseParameter, ...]
    scale: tuple[float, ...]
    trial_values: ClassVar[npt.ArrayLike | None] = None
    largest_sizes: ClassVar[tuple[tuple[float, ...], ...]] = ()
    forms: ClassVar[tuple[str, ...]] = ()
    varies_along_traverse: ClassVar[bool] = False
    combine_trials: ClassVar[bool] = False
    affects_stop_only: ClassVar[bool] = False
    max_trial_factor: ClassVar[float] = 10.0
    max_panel: float = np.inf
    takes_functions: ClassVar[bool] = True
    search_note: ClassVar[str] = ""
    special_case_of: ClassVar[str] = ""
    share_where_noise_persists: ClassVar[float] = 1.0

    @cached_property
    def null_values(self) -> tuple[float, ...]:
        """0 of each parameter, unless a cause says otherwise."""
        return (0.0,) * len(self.parameters)

    def trials(self, rows: pd.DataFrame) -> list[tuple[Cause, Array]]:
        """Shapes of the effect to look for in a log, of sizes that a lab may meet.

        Returns
        -------
        list of (Cause, array of shape (m, q))
            Versions of the cause that differ in a session or a form, each with values whose effects span
            what it may do: `trial_values` or `scale`, unless overridden.
        """
        return [(self, np.array([self.scale] if self.trial_values is None else self.trial_values))]

    def restricted(self, rows: pd.DataFrame) -> list[Cause]:
        """The cause on one joint or direction, or with a size for each joint; none if it has no such form.

        A search for causes tries them where the cause on all traverses does not suffice.
        """
        return []

    @property
    def is_restricted(self) -> bool:
        """Whether it is of the forms of `restricted`."""
        return False

    def finer_trials(self, rows: pd.DataFrame, values: Array) -> Array:
        """Values that lie between those of `trials`, about some of shape (q,); (m, q), none as a rule."""
        return np.empty((0, len(values)))

    def with_functions(self, term: Any) -> Cause | None:
        """The cause as a smooth function of its only column, a term; None if that is no form of it."""
        return self

    @property
    def start_values(self) -> tuple[float, ...]:
        """Where a fit starts that follows trials in combination: without effect, unless it is level there."""
        return self.null_values

    def combine(self, shares: Array, trials: Array) -> Array:
        """Values under which trials act in combination, each times its share; (m,) and (m, q) -> (q,)."""
        return shares @ trials

    def panel(self, values: Array, joint: int) -> float:
        """`max_panel` for given values, shape (n, q), on the traverses of a joint."""
        return self.max_panel

    def largest_plausible(self) -> tuple[Array, ...]:
        """The largest plausible sizes, each shape (q,); a cause that shows at none of them is untestable."""
        return tuple(map(np.array, self.largest_sizes))

    def describe(self, parameters: Sequence[SizedParameter]) -> str:
        """Its effect in a log: `sentence`, or the phrase and sizes where it needs more than is known."""
        try:
            quantities = self.quantities(sizes_by_name(parameters))
            sentence = self.sentence.format_map(quantities)
            return sentence or plain_description(self.phrase, parameters)
        except KeyError:
            return plain_description(self.phrase, parameters)

    def readable(self, parameters: Sequence[SizedParameter]) -> tuple[SizedParameter, ...]:
        """Its parameters in the units in which they are read most easily."""
        return tuple(parameters)

    def quantities(self, sizes: Sizes) -> Mapping[str, object]:
        """What `sentence` may have in braces; a KeyError says that a size is not known."""
        return {**sizes, "session": self.session}

    def extend(self, law: StepLaw) -> ExtendedLaw:
        """`law` with this cause in it."""
        return extend(law, self)

    def for_laws(self, laws: Iterable[StepLaw]) -> Cause:
        """The cause with all forms that it may have under a log's laws; itself unless they allow more."""
        return self

    def under(self, law: StepLaw) -> Cause:
        """The cause as it acts under a law; itself unless the law knows what the cause changes."""
        return self

    def changes(self, law: StepLaw, rows: Row, values: Array, trials: Array) -> Array:
        """Change of the response that each trial makes, shape (m, q) -> (n, m).

        Parameters
        ----------
        law : StepLaw
        rows : mapping of str to array, shape (n,)
        values : array, shape (n, p)
            The law's parameters.
        trials : array, shape (m, q)
        """
        steps, response = self.extend(law).steps(rows), law.predict(rows, values)
        extended = np.concatenate([values, np.empty((len(values), trials.shape[1]))], axis=1)
        concerned = [parameter.joint in (None, law.joint) for parameter in self.parameters]
        acts = np.any((trials != np.array(self.null_values)) & concerned, axis=1)
        changes = np.zeros((len(values), len(trials)))
        for k in np.flatnonzero(acts):
            extended[:, values.shape[1] :] = trials[k]
            changes[:, k] = np.log(steps(extended)) - response
        return changes

    def row_values(self, law: StepLaw, rows: Row) -> dict[str, Any]:
        """What a law with this cause needs of each traverse; see `collect_row_values`."""
        return collect_row_values(rows, self.extend(law).columns)

    def bind(self, rows: pd.DataFrame, machine: Machine) -> Cause:
        """The cause in a log: with the means and ranges of the log that its equation refers to."""
        return self

    def acts_on(self, law: StepLaw) -> bool:
        """Whether it acts on the joint of a law."""
        if self.kind:
            return law.prismatic == (self.kind == "prismatic")
        return self.joints == EVERY_JOINT or law.joint in self.joints

    def explain_missing(self, rows: pd.DataFrame) -> str | None:
        """Why the rows of a log cannot show it, or None where nothing is missing; see `explain_missing`."""
        if self.joints != EVERY_JOINT and not rows["joint"].isin(self.joints).any():
            return f"the log has no traverse of joint {' or '.join(map(str, self.joints))}"
        return None

    def misfire_deviations(self, values: Array, misfire_draws: Array) -> Array:
        """Log steps by which counts are off by chance, (n, q) and (n, 3) -> (n,); none unless overridden."""
        return np.zeros(len(values))


MAX_ROWS = 4096  # at once; keeps arrays small with all the positions that a worn spot needs


class ExtendedLaw(StepLaw):
    """A published law and the causes by which a joint departs from it.

    Its parameters are the law's own, then those of each cause under ``cause.parameter``, followed by the
    joint, direction or session in brackets where it is that of one only.

    Parameters
    ----------
    law : StepLaw
    causes : sequence of Cause
        Bound to a log, see `Cause.bind`.
    """

    name = "extended"

    def __init__(self, law: StepLaw, causes: Sequence[Cause]) -> None:
        self.law = law
        self.causes = tuple(causes)
        self.joint, self.has_kinks = law.joint, law.has_kinks
        self._number = len(law.parameters) + sum(len(cause.parameters) for cause in causes)

    @cached_property
    def cause_parameters(self) -> tuple[CauseParameter, ...]:
        """The causes' parameters, which follow the law's own: one number each for the whole campaign."""
        return name_parameters(self.causes)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:  # type: ignore[override]
        return (*self.law.parameters, *self.cause_parameters)

    @cached_property
    def active_causes(self) -> tuple[tuple[Cause, range], ...]:
        """The causes that act on the joint, each with the columns of its parameters."""
        active, first = [], len(self.law.parameters)
        for cause in self.causes:
            columns = range(first, first + len(cause.parameters))
            first = columns.stop
            if cause.acts_on(self.law):
                active.append((cause.under(self.law), columns))
        return tuple(active)

    @cached_property
    def by_stage(self) -> dict[str, list[tuple[Any, range]]]:
        """The active causes by kind; state causes in the order of their stages."""
        causes: dict[str, list[tuple[Any, range]]] = {
            stage: [(cause, columns) for cause, columns in self.active_causes if cause.acts_at == stage]
            for stage in ("state", "term", "factor", "count")
        }
        causes["state"].sort(key=lambda active: active[0].stage)
        return causes

    @property
    def prismatic(self) -> bool:
        return self.law.prismatic

    @cached_property
    def affects_joint(self) -> BoolArray:
        """Which parameters have an effect on this joint, shape (p,)."""
        affects = np.arange(self._number) < len(self.law.parameters)
        for _, columns in self.active_causes:
            affects[columns] = [self.parameters[k].joint in (None, self.joint) for k in columns]  # type: ignore[attr-defined]
        return affects

    def gamma(self, state: State, values: Array) -> Array:
        true = self.true_state(state, values)
        return prod(self._factors(true, values), start=self._before_factors(true, values))

    def gamma_slopes(self, state: State, values: Array) -> Array:
        """See `StepLaw.gamma_slopes`; by the causes' parameters from central differences."""
        blocks = [(first, spread(own)) for first, own, spread in self._slope_blocks(state, values)]
        together = np.zeros((len(values), max(own.shape[1] for _, own in blocks), values.shape[1]))
        for first, own in blocks:
            together[..., first : first + own.shape[2]] = own
        return together

    def chained_slopes(self, state: State, values: Array, by_place: Array) -> Array:
        """Derivatives of the steps by the values, (n, p), from those by the step size, (n, k)."""
        together = np.zeros(values.shape)
        for first, slopes, spread in self._slope_blocks(state, values):
            own = spread(chain(by_place, slopes)[:, None])[:, 0]
            together[:, first : first + own.shape[1]] = own
        return together

    def chained_slopes_by_last(self, state: State, values: Array, by_place: Array) -> Array:
        """As `chained_slopes`, by the parameters of the last cause, a factor, (n, q)."""
        true = self.true_state(state, values)
        slopes = self._factor_slopes(-1, true, values, self._factors(true, values))
        slopes = np.multiply(self._before_factors(true, values)[..., None], slopes, order="C")
        last, _ = self.by_stage["factor"][-1]
        return np.asarray(last.spread(true, chain(by_place, slopes)[:, None])[:, 0])

    def _slope_blocks(
        self, state: State, values: Array
    ) -> Iterator[tuple[int, Array, Callable[[Array], Array]]]:
        """First column, derivatives, and what makes of these those by the values that begin there."""
        true, law_values = self.true_state(state, values), values[:, : len(self.law.parameters)]
        before, factors = self._before_factors(true, values), self._factors(true, values)
        factor = prod(factors, start=np.ones((len(values), 1)))
        by_law = self.law.gamma_slopes(true, law_values)
        for (cause, columns), free in zip(self.by_stage["term"], self._free(true, values), strict=True):
            by_free, by_own = cause.term_slopes(free, true, _split(values, columns))
            by_law = by_law + by_free[..., None] * self.law.gamma_slopes(cause.unload(true), law_values)
            for k, own in zip(columns, by_own, strict=True):
                yield k, (own * factor)[..., None], np.asarray
        yield 0, by_law * factor[..., None], np.asarray
        for place, (cause, columns) in enumerate(self.by_stage["factor"]):
            slopes = before[..., None] * self._factor_slopes(place, true, values, factors)
            yield columns.start, slopes, partial(cause.spread, true)
        for k in (k for _, columns in self.by_stage["state"] for k in columns if self._has_slope(k)):
            slopes = self.difference(lambda shifted: self.gamma(state, shifted), values, k)
            yield k, slopes[..., None], np.asarray

    def true_state(self, state: State, values: Array) -> State:
        """The state under the causes, stage by stage."""
        for cause, columns in self.by_stage["state"]:
            state = cause.change(state, _split(values, columns))
        return state

    def steps_added(self, state: State, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,); `state` where it begins."""
        active = self.by_stage["count"]
        added = (cause.steps(state, _split(values, columns))[:, 0] for cause, columns in active)
        return sum(added, start=np.zeros(len(values)))

    def _before_factors(self, true: State, values: Array) -> Array:
        """The law and the terms added to it."""
        active = zip(self.by_stage["term"], self._free(true, values), strict=True)
        terms = [cause.term(free, true, _split(values, columns)) for (cause, columns), free in active]
        return sum(terms, start=self.law.gamma(true, values[:, : len(self.law.parameters)]))

    def _free(self, true: State, values: Array) -> list[Array]:
        """What each term has as the law's step size without load."""
        law_values = values[:, : len(self.law.parameters)]
        return [self.law.gamma(cause.unload(true), law_values) for cause, _ in self.by_stage["term"]]

    def _has_slope(self, k: int) -> bool:
        """Whether cause parameter `k` acts on this joint, and not as the moment of a sudden change."""
        return bool(self.affects_joint[k]) and not self.cause_parameters[k - len(self.law.parameters)].sudden

    def _factors(self, true: State, values: Array) -> list[Array]:
        active = ((cause, values[:, own.start : own.stop]) for cause, own in self.by_stage["factor"])
        return [cause.factor_of(true, own) for cause, own in active]

    def _factor_slopes(self, place: int, true: State, values: Array, factors: list[Array]) -> Array:
        """Local derivatives of all factors together, by those of one of them, (n, k or 1, m)."""
        cause, columns = self.by_stage["factor"][place]
        own = cause.local_slopes(true, values[:, columns.start : columns.stop])
        if own is None:
            factor = lambda shifted: cause.factor_of(true, shifted[:, columns.start : columns.stop])  # noqa: E731
            own = np.stack([self.difference(factor, values, k) for k in columns], axis=-1)
        others = [one for one in factors if one is not factors[place]]
        return np.asarray(reduce(lambda slopes, other: slopes * other[..., None], others, own))

    def difference(self, function: Callable[[Array], Array], values: Array, k: int) -> Array:
        """Derivative of a function of the values by cause parameter `k`, by central differences."""
        step = DIFFERENCE_STEP * self.sizes[k - len(self.law.parameters)]
        upper, lower = values.copy(), values.copy()
        upper[:, k] += step
        lower[:, k] -= step
        return (function(upper) - function(lower)) / (2 * step)

    @cached_property
    def sizes(self) -> Array:
        """A size of each of the causes' parameters that matters, shape (q,)."""
        return np.array([size for cause in self.causes for size in cause.scale], dtype=float)

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`; `collect_row_values` fills in some that rows may lack."""
        by_causes = [name for cause, _ in self.active_causes for name in cause.columns]
        return tuple(dict.fromkeys([*POSE, *self.law.columns, *by_causes]))

    @property
    def max_panel(self) -> float:  # type: ignore[override]
        return min([self.law.max_panel, *(cause.max_panel for cause, _ in self.active_causes)])

    def panel(self, values: Array) -> float:
        """`max_panel` for given values, shape (n, p)."""
        own = ((cause, values[:, columns.start : columns.stop]) for cause, columns in self.active_causes)
        return min([self.law.max_panel, *(cause.panel(some, self.joint) for cause, some in own)])

    @cached_property
    def varies_along_traverse(self) -> bool:
        """Whether a cause varies along a traverse beyond what the law itself does."""
        return any(cause.varies_along_traverse for cause, _ in self.active_causes)

    @property
    def null_values(self) -> Array:
        """Values of the causes' parameters under which the law is the published one, shape (q,)."""
        return np.array([value for cause in self.causes for value in cause.null_values], dtype=float)

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; NaN where the step size is not above 0."""
        parts, shape = self.parts(rows), (len(rows["start"]), self._number)

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, shape)
            counts, slopes = zip(*(self._count(part, values[subset]) for subset, part in parts), strict=True)
            return np.concatenate(counts), np.concatenate(slopes)

        return count

    def predict(self, rows: Rows, values: Array) -> Array:
        """See `StepLaw.predict`; without the derivatives, which take most of the time."""
        values = np.broadcast_to(values, (len(float_column(rows, "start")), self._number))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(self.steps(rows)(values))

    def steps(self, rows: Rows) -> Callable[[Array], Array]:
        """Steps over each traverse as a function of the values, shape (n, p) -> (n,)."""
        parts = self.parts(rows)

        def count(values: Array) -> Array:
            counts = [part.counts(values[subset]) for subset, part in parts]
            return np.concatenate(counts) + self._steps_added(parts, values)

        return count

    def parts(self, rows: Rows) -> list[tuple[slice, AdaptiveCounter]]:
        """The traverses in parts of at most `MAX_ROWS`."""
        row = collect_row_values(rows, self.columns)
        starts = range(0, max(len(row["start"]), 1), MAX_ROWS)
        slices = [slice(first, first + MAX_ROWS) for first in starts]
        return [(part, AdaptiveCounter(self, {name: x[part] for name, x in row.items()})) for part in slices]

    def step_size(self, rows: Rows, position: Array, values: Array) -> Array:
        return super().step_size(collect_row_values(rows, self.columns), position, values)

    def without_stop_effects(self, values: Array) -> Array:
        """Values without the causes that affect the stop only, shape (p,) or (n, p)."""
        moving = np.array(values, dtype=float)
        for cause, columns in self.active_causes:
            if cause.affects_stop_only:
                moving[..., columns.start : columns.stop] = cause.null_values
        return moving

    def steps_added_by_causes(self, rows: Rows, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,)."""
        return self._steps_added(self.parts(rows), values)

    def _steps_added(self, parts: list[tuple[slice, AdaptiveCounter]], values: Array) -> Array:
        return np.concatenate([self.steps_added(part.start_state, values[subset]) for subset, part in parts])

    def misfire_deviations(self, values: Array, misfire_draws: Array) -> Array:
        """Log steps by which counts are off, (n, p) and (n, 3) -> (n,); see `EndStopMisfire.departures`."""
        own = ((cause, values[:, columns.start : columns.stop]) for cause, columns in self.active_causes)
        deviations = (cause.misfire_deviations(some, misfire_draws) for cause, some in own)
        return sum(deviations, start=np.zeros(len(values)))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`: the law's own, with the causes absent."""
        return _append(self.law.start_values(mean_step), self.null_values)

    def scales(self, mean_step: Array) -> Array:
        return _append(self.law.scales(mean_step), self.sizes)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of the law, and every number that a cause uses."""
        row = collect_row_values(rows, self.columns)
        numbers = [values.astype(float) for values in row.values() if values.dtype.kind in "fiu"]
        return np.column_stack([self.law.features(rows), *numbers])

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: that of the law itself."""
        return self.law.calibration()

    def _count(self, part: AdaptiveCounter, values: Array) -> tuple[Array, Array]:
        counts, slopes = part.counts_and_slopes(values)
        added = partial(self.steps_added, part.start_state)
        for _, columns in self.by_stage["count"]:
            for k in columns:
                slopes[:, k] += self.difference(added, values, k)
        return counts + added(values), slopes


def _split(values: Array, columns: range) -> list[Array]:
    """A cause's own values, each of shape (n, 1)."""
    return list(values[:, columns.start : columns.stop].T[:, :, None])


def extend(law: StepLaw, *causes: Cause) -> ExtendedLaw:
    """A law, published or extended, with further causes, which are bound to a log."""
    if isinstance(law, ExtendedLaw):
        return ExtendedLaw(law.law, (*law.causes, *causes))
    return ExtendedLaw(law, causes)


def _append(law_columns: Array, cause_columns: Array) -> Array:
    """The law's columns, (g, p), followed by those of the causes, (q,), equal for every group."""
    return np.concatenate([law_columns, np.tile(cause_columns, (len(law_columns), 1))], axis=1)
