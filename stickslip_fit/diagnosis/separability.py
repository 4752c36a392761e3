"""Which causes a design can detect, and which pairs of causes it can separate.

Two causes whose effects have the cosine rho are confused at strength delta with probability Phi(-delta
sqrt((1 - rho) / 2)). `assess_design` computes this for a plan before any data. `find_aliased_causes`
lists the pairs that no data of the design can separate, because the effects of one lie in the span of
the other's.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import csc_array, hstack
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from stickslip_fit._typing import Array
from stickslip_fit.causes import Cause
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis, build_candidates, compute_effects
from stickslip_fit.diagnosis.intervals import threshold_length
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.misfit import STRENGTHS, UNKNOWN, Misfit, classify_cause
from stickslip_fit.diagnosis.problem import DiagnosisProblem, problem_from_log
from stickslip_fit.diagnosis.selection import (
    allocate_alpha,
    assess_residuals,
    explain_too_small,
    find_untestable,
)
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine
from stickslip_fit.simulation import LawValues, simulate
from stickslip_fit.units import from_si

MAX_CONFUSION = 0.02  # a rate below which two causes are told apart


def largest_cosine(one: Hypothesis | AR1, other: Hypothesis | AR1) -> float:
    """Largest cosine between a shape that two hypotheses can have; between 0 and 1."""
    if isinstance(one, AR1) or isinstance(other, AR1):
        return 0.0
    return float(np.linalg.svd(one.directions.T @ other.directions, compute_uv=False).max(initial=0.0))


def confusion_rate(strength: float, cosine: float) -> float:
    """How often an effect of this strength would look more like the other cause.

    Examples
    --------
    >>> round(confusion_rate(6.0, 0.5), 4), round(confusion_rate(6.0, 0.99), 2)
    (0.0013, 0.34)
    """
    return float(norm.sf(strength * np.sqrt(max(1.0 - cosine, 0.0) / 2.0)))


def is_distinguishable(named: Hypothesis | AR1, misfit: Misfit, rival: str, strength: float) -> bool:
    """Whether a design separates a named shape from every shape of a rival, at this strength."""
    shapes = [each for each in misfit.hypotheses if classify_cause(each) == rival]
    return confusion_rate(strength, max(largest_cosine(named, each) for each in shapes)) < MAX_CONFUSION


Z_POWER_90 = float(ndtri(0.9))
MAX_CONFUSION_DESIGN = 0.05
MAX_STRENGTH = 1e3  # a pair that takes more is one and the same


@dataclass(frozen=True)
class Detectability:
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
class SeparabilityMatrix:
    """What a design can tell.

    Attributes
    ----------
    detectable : tuple of Showing
        The causes that it can show.
    by_scatter : tuple of str
        Causes without a direction in which counts depart together: single counts show them in any design.
    untestable : mapping of str to str
        The others, with the reason.
    cosines : dict of (str, str) to array
        For each shape of the first cause, the largest cosine with a shape of the second.
    alpha : float
        False-alarm rate.
    """

    detectable: tuple[Detectability, ...]
    scatter_only: tuple[str, ...]
    untestable: Mapping[str, str]
    cosines: dict[tuple[str, str], Array]
    alpha: float

    @property
    def causes(self) -> tuple[str, ...]:
        """That can be shown."""
        return tuple(each.cause for each in self.detectable)

    def of(self, cause: str) -> Detectability:
        """How a cause shows."""
        return next(each for each in self.detectable if each.cause == cause)

    def confusion(self, truth: str, rival: str, strength: float) -> float:
        """How often an effect of `truth`, its shapes being equally likely, looks more like `rival`."""
        apart = strength * np.sqrt((1.0 - self.cosines[truth, rival]) / 2.0)
        return float(np.mean(ndtr(-apart)))

    def rate(self, one: str, other: str, strength: float) -> float:
        """Confusion of a pair, whichever of the two is at work."""
        return max(self.confusion(one, other, strength), self.confusion(other, one, strength))

    def needed(self, one: str, other: str) -> float:
        """Strength from which a pair is confused in fewer than one log in twenty; infinite if from none."""

        def excess(strength: float) -> float:
            return self.rate(one, other, strength) - MAX_CONFUSION_DESIGN

        return float(brentq(excess, 0.0, MAX_STRENGTH, xtol=1e-2)) if excess(MAX_STRENGTH) < 0 else np.inf

    def pairs(self) -> list[tuple[str, str, float]]:
        """Every pair with the strength it needs, hardest first."""
        found = [(one, other, self.needed(one, other)) for one, other in combinations(self.causes, 2)]
        return sorted(found, key=lambda each: -each[2])

    def apart(self, one: str, other: str) -> bool:
        """Whether both causes have a plausible size from which on they are told from each other."""
        needed = self.needed(one, other)
        return all(self.of(cause).size(needed) <= self.of(cause).largest for cause in (one, other))


def assess_design(
    problem: DiagnosisProblem,
    untestable: Mapping[str, str],
    alpha: float,
    n_bootstrap: int,
    rng: np.random.Generator,
) -> SeparabilityMatrix:
    """Judge a design by what nothing but its rows and repeatability say.

    Parameters
    ----------
    bench : Bench
        Its causes are those that are to be judged. Responses only say where laws are linearised.
    untestable : mapping of str to str
    alpha : float
        False-alarm rate of the diagnosis to come; its two looks share it.
    n_bootstrap : int
        Logs in which nothing is wrong, by which the alarm is set.
    rng : Generator
    """
    linearized = problem.study()
    critical = assess_residuals(linearized, problem, n_bootstrap, rng).critical_value(allocate_alpha(alpha))
    shapes = {cause: build_candidates(linearized, [cause]) for cause in problem.causes}
    scatter_only = tuple(cause.name for cause, subset in shapes.items() if not subset)
    shapes = {cause: subset for cause, subset in shapes.items() if subset}
    showing = tuple(_assess_cause(cause, subset, linearized, critical) for cause, subset in shapes.items())
    alike = {
        (one.name, other.name): _largest_cosines(subset, theirs)
        for one, subset in shapes.items()
        for other, theirs in shapes.items()
        if one is not other
    }
    return SeparabilityMatrix(showing, scatter_only, untestable, alike, alpha)


def _assess_cause(
    cause: Any, shapes: list[Hypothesis], linearized: LinearizedFit, critical: float
) -> Detectability:
    per_size = []
    for version, trials in cause.trials(linearized.rows):
        lengths = np.linalg.norm(compute_effects(linearized, version, trials), axis=0)
        sizes = np.abs(trials).max(axis=1) if version.joined else np.abs(trials[:, 0] - version.absent[0])
        each = lengths / sizes
        per_size += [float(np.linalg.norm(each))] if version.joined else list(each)
    threshold = threshold_length(critical, len(shapes), linearized.df, STRENGTHS)
    return Detectability(
        cause.name, cause.trials(linearized.rows)[0][0].parameters[0].unit, float(np.median(per_size)),
        threshold + Z_POWER_90, _largest_size(cause, linearized),
    )  # fmt: skip


def _largest_size(cause: Any, linearized: LinearizedFit) -> float:
    if cause.largest():
        return float(max(abs(values[0] - cause.absent[0]) for values in cause.largest()))
    return float(max(cause.most * np.abs(values[:, 0]).max() for _, values in cause.trials(linearized.rows)))


def _largest_cosines(shapes: list[Hypothesis], rivals: list[Hypothesis]) -> Array:
    """For each shape, its largest cosine with one of the rival's."""
    if all(len(each.share) == 1 for each in [*shapes, *rivals]):
        cosines = abs(_stack_directions(shapes).T @ _stack_directions(rivals))
        return np.minimum(np.asarray(cosines.max(axis=1).todense()).ravel(), 1.0)
    return np.array([min(max(largest_cosine(one, other) for other in rivals), 1.0) for one in shapes])


def _stack_directions(shapes: list[Hypothesis]) -> csc_array:
    return csc_array(hstack([csc_array(each.columns) for each in shapes]))


SCHEMA = "stickslip-fit/separability/1"


def separability_to_json(found: SeparabilityMatrix, strength: float) -> dict[str, Any]:
    """A matrix in plain JSON types; what no strength reaches is None.

    Parameters
    ----------
    found : Matrix
    strength : float
        At which the rates of confusion are given.
    """
    return {
        "schema": SCHEMA,
        "alpha": found.alpha,
        "strength": strength,
        "causes": [_detectability_to_json(each) for each in found.detectable],
        "pairs": [
            {
                "causes": [one, other],
                "confusion": found.rate(one, other, strength),
                "strength_needed": needed if np.isfinite(needed) else None,
                "told_apart": found.apart(one, other),
            }
            for one, other, needed in found.pairs()
        ],
        "shown_by_scatter": list(found.scatter_only),
        "untestable": [{"cause": cause, "reason": why} for cause, why in found.untestable.items()],
    }


def _detectability_to_json(showing: Detectability) -> dict[str, Any]:
    return {
        "cause": showing.cause,
        "unit": showing.unit,
        "strength_of_size_1": 1.0 / float(from_si(1.0 / showing.per_size, showing.unit)),
        "strength_found": showing.found,
        "smallest_found": float(from_si(showing.smallest, showing.unit)),
        "largest_plausible": float(from_si(showing.largest, showing.unit)),
    }


def problem_from_plan(
    plan: Plan, truth: LawValues, machine: Machine, causes: Iterable[Cause] | None = None
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """The traverses of a plan as a simulation of it makes them, with their history.

    Parameters
    ----------
    plan : Plan
        With its noise.
    truth : LawValues
    machine : Machine
    causes : iterable of Cause, optional
        The library without it.

    Returns
    -------
    bench : Bench
        With the causes that the plan could show.
    untestable : dict of str to str
        The others, and why.

    Raises
    ------
    InputError
        If the plan cannot be simulated, or has too few traverses to show anything.
    """
    log = simulate(plan, truth, machine)
    assert plan.noise is not None
    given, missing = problem_from_log(log, causes)
    drives = [(part.law.joint, direction) for part in given.parts for direction in "+-"]
    repeatability = [plan.noise.repeatability.get(drive, np.nan) for drive in drives]
    problem = replace(given, repeatability=np.array(repeatability))
    linearized = problem.study()
    if why := explain_too_small(linearized):
        raise InputError(f"the plan has {why}")
    unable = missing | find_untestable(problem, linearized)
    return replace(problem, causes=tuple(each for each in problem.causes if each.name not in unable)), unable


ALIAS_TOL = 1e-3  # what a shape may lack, as a share of its square; no log has the strength to show that
MAX_ALIAS_SHAPES = 4  # shapes; with many to choose from a cause may look like another by chance


def find_aliased_causes(misfit: Misfit) -> tuple[tuple[str, str], ...]:
    """Pairs of causes of which the second can do in this log all that the first does.

    Each pair stands once, also where either can do all that the other does.

    Parameters
    ----------
    looked : Misfit
    """
    shapes: dict[str, list[Hypothesis]] = {}
    for each in misfit.hypotheses:
        if isinstance(each, Hypothesis) and classify_cause(each) != UNKNOWN:
            shapes.setdefault(each.cause, []).append(each)
    few = [cause for cause, subset in shapes.items() if len(subset) <= MAX_ALIAS_SHAPES]
    found: dict[frozenset[str], tuple[str, str]] = {}
    for one, other in permutations(few, 2):
        if all(any(_is_in_span(shape, wider) for wider in shapes[other]) for shape in shapes[one]):
            found.setdefault(frozenset((one, other)), (one, other))
    return tuple(found.values())


def _is_in_span(shape: Hypothesis, wider: Hypothesis) -> bool:
    lacking = shape.directions - wider.directions @ (wider.directions.T @ shape.directions)
    return bool(np.all(np.sum(lacking**2, axis=0) < ALIAS_TOL))
