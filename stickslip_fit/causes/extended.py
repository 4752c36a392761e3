"""A law with causes in it: a law again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from stickslip_fit.causes.cause import Cause, CountCause
from stickslip_fit.causes.composition import Composition
from stickslip_fit.causes.conditions import known_of
from stickslip_fit.causes.end_stop_misfire import EndStopMisfire
from stickslip_fit.causes.traverses import Traverses
from stickslip_fit.laws import Configuration, Rows, StepLaw
from stickslip_fit.laws.law import Array, Counter, column

POSE = ("q1", "q2", "q3", "theta", "psi")
AT_ONCE = 4096  # rows; with all the positions that a worn spot takes, arrays stay small


class ExtendedLaw(Composition):
    """A published law and the causes by which a joint departs from it.

    Its parameters are the law's own, then those of each cause under ``cause.parameter``, followed by the
    joint, direction or session in brackets where it is that of one only.
    """

    name = "extended"

    @property
    def columns(self) -> tuple[str, ...]:  # type: ignore[override]
        """See `StepLaw.columns`; rows may lack those for which `known_of` has something to stand in."""
        needed = [*POSE, *self.law.columns, *(name for cause, _ in self.acting for name in cause.columns)]
        return tuple(dict.fromkeys(needed))

    @property
    def widest(self) -> float:  # type: ignore[override]
        """See `StepLaw.widest`."""
        return min([self.law.widest, *(cause.widest for cause, _ in self.acting)])

    def panel(self, values: Array) -> float:
        """As `widest`, for given values, shape (n, p)."""
        seen = (cause.panel(values[:, places.start : places.stop]) for cause, places in self.acting)
        return min([self.law.widest, *seen])

    @cached_property
    def along(self) -> bool:
        """Whether a cause makes the step size change along a traverse otherwise than the law itself does."""
        return any(cause.along for cause, _ in self.acting)

    @property
    def absent(self) -> Array:
        """Values of the causes' parameters under which the law is the published one, shape (q,)."""
        return np.array([value for cause in self.causes for value in cause.absent], dtype=float)

    def counter(self, rows: Rows) -> Counter:
        """See `StepLaw.counter`; NaN where the step size is not above 0."""
        parts = self.parts(rows)

        def count(values: Array) -> tuple[Array, Array]:
            values = np.broadcast_to(values, (len(column(rows, "start")), len(self.parameters)))
            found = [self._counted(part, values[mine]) for mine, part in parts]
            counts, slopes = zip(*found, strict=True)
            return np.concatenate(counts), np.concatenate(slopes)

        return count

    def predict(self, rows: Rows, values: Array) -> Array:
        """See `StepLaw.predict`; without the derivatives, which take most of the time."""
        values = np.broadcast_to(values, (len(column(rows, "start")), len(self.parameters)))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.log(self.steps(rows)(values))

    def steps(self, rows: Rows) -> Callable[[Array], Array]:
        """Steps over each traverse as a function of the values, shape (n, p) -> (n,)."""
        parts = self.parts(rows)

        def count(values: Array) -> Array:
            return np.concatenate(
                [
                    part.counts(values[mine]) + self.steps_added(part.here, values[mine])
                    for mine, part in parts
                ]
            )

        return count

    def parts(self, rows: Rows) -> list[tuple[slice, Traverses]]:
        """The traverses, so many at once as keep memory small."""
        known = known_of(rows, self.columns)
        ends = range(0, max(len(known["start"]), 1), AT_ONCE)
        slices = [slice(first, first + AT_ONCE) for first in ends]
        return [(mine, Traverses(self, {name: of[mine] for name, of in known.items()})) for mine in slices]

    def step_size(self, rows: Rows, position: Array, values: Array) -> Array:
        """See `StepLaw.step_size`."""
        return super().step_size(known_of(rows, self.columns), position, values)

    def in_motion(self, values: Array) -> Array:
        """Values with all that is in hearing the stop left out, shape (p,) or (n, p)."""
        moving = np.array(values, dtype=float)
        for cause, places in self.acting:
            if cause.of_stop:
                moving[..., places.start : places.stop] = cause.absent
        return moving

    def added(self, rows: Rows, values: Array) -> Array:
        """Steps that count causes add to each traverse, shape (n,)."""
        return np.concatenate([self.steps_added(part.here, values[mine]) for mine, part in self.parts(rows)])

    def misfires(self, values: Array, luck: Array) -> Array:
        """Log steps by which counts are off, (n, p) and (n, 3) -> (n,); see `EndStopMisfire.departures`."""
        off = [
            cause.departures(values[:, places.start : places.stop], luck)
            for cause, places in self.acting
            if isinstance(cause, EndStopMisfire)
        ]
        return np.sum(off, axis=0) if off else np.zeros(len(values))

    def start_values(self, mean_step: Array) -> Array:
        """See `StepLaw.start_values`: the law's own, with the causes absent."""
        return _beside(self.law.start_values(mean_step), self.absent)

    def scales(self, mean_step: Array) -> Array:
        """See `StepLaw.scales`."""
        return _beside(self.law.scales(mean_step), self.sizes)

    def features(self, rows: Rows) -> Array:
        """See `StepLaw.features`: those of the law, and every number that a cause looks at."""
        known = known_of(rows, self.columns)
        seen = [values.astype(float) for values in known.values() if values.dtype.kind in "fiu"]
        return np.column_stack([self.law.features(rows), *seen])

    def calibration(self) -> tuple[Configuration, ...]:
        """See `StepLaw.calibration`: that of the law itself."""
        return self.law.calibration()

    def _counted(self, part: Traverses, values: Array) -> tuple[Array, Array]:
        counts, slopes = part.counts_and_slopes(values)
        for _, places in self.by_station[CountCause]:
            for k in places:
                slopes[:, k] += self.difference(lambda there: self.steps_added(part.here, there), values, k)
        return counts + self.steps_added(part.here, values), slopes


def extend(law: StepLaw, cause: Cause) -> ExtendedLaw:
    """A law with one cause more.

    Parameters
    ----------
    law : StepLaw
        Published or already extended.
    cause : Cause
        Bound to a log.
    """
    return extend_by(law, (cause,))


def extend_by(law: StepLaw, causes: Sequence[Cause]) -> ExtendedLaw:
    """A law with any number of causes more, none included."""
    if isinstance(law, ExtendedLaw):
        return ExtendedLaw(law.law, (*law.causes, *causes))
    return ExtendedLaw(law, causes)


def _beside(own: Array, same: Array) -> Array:
    """Columns of the law's own and, the same for every group, those of the causes."""
    return np.concatenate([own, np.broadcast_to(same, (len(own), len(same)))], axis=1)
