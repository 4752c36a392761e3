"""Before any data: which causes a design could show, from what size on, and which it could tell apart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.sparse import csc_array, hstack
from scipy.special import ndtr, ndtri

from stickslip_fit.diagnose.experiments.separability import likeness
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.searching.evidence import STRENGTHS
from stickslip_fit.diagnose.searching.search import look, others_level
from stickslip_fit.diagnose.shapes.candidates import candidates, effects
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.sizes.amplitude import threshold_length

Array = npt.NDArray[np.float64]

NINE_IN_TEN = float(ndtri(0.9))
CONFUSED = 0.05
STRONGEST = 1e3  # a pair that takes more is one and the same


@dataclass(frozen=True)
class Showing:
    """One cause in a design.

    Attributes
    ----------
    cause : str
    unit : str
        In which people read its size.
    per_size : float
        Strength of an effect of size 1 (SI), the median over its shapes.
    found : float
        Strength at which nine in ten logs raise the alarm.
    largest : float
        Largest plausible size, SI.
    """

    cause: str
    unit: str
    per_size: float
    found: float
    largest: float

    @property
    def smallest(self) -> float:
        """Size at which nine in ten logs raise the alarm, SI."""
        return self.size(self.found)

    def size(self, strength: float) -> float:
        """Size of an effect of this strength, SI."""
        return strength / self.per_size


@dataclass(frozen=True, eq=False)
class Matrix:
    """What a design can tell.

    Attributes
    ----------
    showing : tuple of Showing
        The causes that it can show.
    by_scatter : tuple of str
        Causes without a direction in which counts depart together: single counts show them in any design.
    untestable : mapping of str to str
        The others, with the reason.
    likeness : dict of (str, str) to array
        For each shape of the first cause, the largest cosine with a shape of the second.
    alpha : float
        False-alarm rate.
    """

    showing: tuple[Showing, ...]
    by_scatter: tuple[str, ...]
    untestable: Mapping[str, str]
    likeness: dict[tuple[str, str], Array]
    alpha: float

    @property
    def causes(self) -> tuple[str, ...]:
        """That can be shown."""
        return tuple(each.cause for each in self.showing)

    def of(self, cause: str) -> Showing:
        """How a cause shows."""
        return next(each for each in self.showing if each.cause == cause)

    def confusion(self, truth: str, rival: str, strength: float) -> float:
        """How often an effect of `truth`, its shapes being equally likely, looks more like `rival`."""
        apart = strength * np.sqrt((1.0 - self.likeness[truth, rival]) / 2.0)
        return float(np.mean(ndtr(-apart)))

    def rate(self, one: str, other: str, strength: float) -> float:
        """Confusion of a pair, whichever of the two is at work."""
        return max(self.confusion(one, other, strength), self.confusion(other, one, strength))

    def needed(self, one: str, other: str) -> float:
        """Strength from which a pair is confused in fewer than one log in twenty; infinite if from none."""

        def excess(strength: float) -> float:
            return self.rate(one, other, strength) - CONFUSED

        return float(brentq(excess, 0.0, STRONGEST, xtol=1e-2)) if excess(STRONGEST) < 0 else np.inf

    def pairs(self) -> list[tuple[str, str, float]]:
        """Every pair with the strength it needs, hardest first."""
        found = [(one, other, self.needed(one, other)) for one, other in combinations(self.causes, 2)]
        return sorted(found, key=lambda each: -each[2])

    def apart(self, one: str, other: str) -> bool:
        """Whether both causes have a plausible size from which on they are told from each other."""
        needed = self.needed(one, other)
        return all(self.of(cause).size(needed) <= self.of(cause).largest for cause in (one, other))


def matrix(
    bench: Bench, untestable: Mapping[str, str], alpha: float, flips: int, rng: np.random.Generator
) -> Matrix:
    """Judge a design by what nothing but its rows and repeatability say.

    Parameters
    ----------
    bench : Bench
        Its causes are those that are to be judged. Responses only say where laws are linearised.
    untestable : mapping of str to str
    alpha : float
        False-alarm rate of the diagnosis to come; its two looks share it.
    flips : int
        Logs in which nothing is wrong, by which the alarm is set.
    rng : Generator
    """
    study = bench.study()
    critical = look(study, bench, flips, rng).critical(others_level(alpha))
    shapes = {cause: candidates(study, [cause]) for cause in bench.causes}
    by_scatter = tuple(cause.name for cause, mine in shapes.items() if not mine)
    shapes = {cause: mine for cause, mine in shapes.items() if mine}
    showing = tuple(_showing(cause, mine, study, critical) for cause, mine in shapes.items())
    alike = {
        (one.name, other.name): _alike(mine, theirs)
        for one, mine in shapes.items()
        for other, theirs in shapes.items()
        if one is not other
    }
    return Matrix(showing, by_scatter, untestable, alike, alpha)


def _showing(cause: Any, shapes: list[Hypothesis], study: Study, critical: float) -> Showing:
    per_size = []
    for version, trials in cause.trials(study.rows):
        lengths = np.linalg.norm(effects(study, version, trials), axis=0)
        sizes = np.abs(trials).max(axis=1) if version.joined else np.abs(trials[:, 0] - version.absent[0])
        each = lengths / sizes
        per_size += [float(np.linalg.norm(each))] if version.joined else list(each)
    threshold = threshold_length(critical, len(shapes), study.freedom, STRENGTHS)
    return Showing(
        cause.name, cause.trials(study.rows)[0][0].parameters[0].unit, float(np.median(per_size)),
        threshold + NINE_IN_TEN, _largest(cause, study),
    )  # fmt: skip


def _largest(cause: Any, study: Study) -> float:
    if cause.largest():
        return float(max(abs(values[0] - cause.absent[0]) for values in cause.largest()))
    return float(max(cause.most * np.abs(values[:, 0]).max() for _, values in cause.trials(study.rows)))


def _alike(shapes: list[Hypothesis], rivals: list[Hypothesis]) -> Array:
    """For each shape, its largest cosine with one of the rival's."""
    if all(len(each.share) == 1 for each in [*shapes, *rivals]):
        cosines = abs(_side_by_side(shapes).T @ _side_by_side(rivals))
        return np.minimum(np.asarray(cosines.max(axis=1).todense()).ravel(), 1.0)
    return np.array([min(max(likeness(one, other) for other in rivals), 1.0) for one in shapes])


def _side_by_side(shapes: list[Hypothesis]) -> csc_array:
    return csc_array(hstack([csc_array(each.stored) for each in shapes]))
