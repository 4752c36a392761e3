"""Which causes a design can detect, and which pairs of causes it can separate.

Two causes whose effects have the cosine rho are confused at strength delta with probability Phi(-delta
sqrt((1 - rho) / 2)). `assess_design` computes this for a plan before any data. `find_aliased_causes`
lists the pairs that no data of the design can separate, because the effects of one lie in the span of
the other's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr, ndtri

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.evidence import batch_hypotheses
from stickslip_fit.diagnosis.extension import assess_residuals
from stickslip_fit.diagnosis.hypotheses import (
    Hypothesis,
    build_candidates,
    compute_effects,
    compute_finite_effects,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import UNKNOWN, Misfit, classify_cause, detection_length
from stickslip_fit.diagnosis.problem import DiagnosisProblem, problem_from_log
from stickslip_fit.diagnosis.selection import allocate_alpha
from stickslip_fit.diagnosis.testability import explain_too_small, find_untestable
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Plan
from stickslip_fit.machine import Machine
from stickslip_fit.units import from_si

if TYPE_CHECKING:
    from stickslip_fit.simulation import LawValues

SCHEMA = "stickslip-fit/separability/1"
MAX_CONFUSION = 0.02  # rate below which a log separates two causes
MAX_CONFUSION_DESIGN = 0.05  # rate below which a design is said to
MAX_STRENGTH = 1e3  # a pair that needs more is not separable
Z_POWER_90 = float(ndtri(0.9))
ALIAS_TOL = 1e-3  # share of a shape's square outside a span; no log has the strength to show it
MAX_ALIAS_SHAPES = 4  # causes with more shapes resemble others by chance


def compute_cosines(ones: Sequence[Hypothesis | AR1], others: Sequence[Hypothesis | AR1]) -> Array:
    """Cosine of the smallest angle between the spans of each two hypotheses, 0 for AR(1).

    The result has shape (number of ones, number of others).
    """
    sizes = [
        np.array([len(one.prior_share) if isinstance(one, Hypothesis) else 0 for one in side], dtype=np.intp)
        for side in (ones, others)
    ]
    products = _multiply_directions(
        *([one for one in side if isinstance(one, Hypothesis)] for side in (ones, others))
    )
    rows, columns = (np.cumsum(size) - size for size in sizes)
    cosines = np.zeros((len(ones), len(others)))
    # The norm of a number needs no singular value decomposition.
    single = np.ix_(*(np.flatnonzero(size == 1) for size in sizes))
    cosines[single] = np.abs(products[np.ix_(rows[sizes[0] == 1], columns[sizes[1] == 1])])
    wide = (sizes[0][:, None] > 0) & (sizes[1] > 0) & (np.maximum.outer(*sizes) > 1)
    for row, column in np.argwhere(wide):
        block = products[rows[row] :, columns[column] :][: sizes[0][row], : sizes[1][column]]
        cosines[row, column] = np.linalg.norm(block, 2)
    return np.minimum(cosines, 1.0)


def _multiply_directions(ones: Sequence[Hypothesis], others: Sequence[Hypothesis]) -> Array:
    """Inner products of all directions, shape (directions of ones, of others)."""
    few, many = sorted((ones, others), key=lambda side: sum(len(one.prior_share) for one in side))
    if not few:
        return np.zeros([sum(len(one.prior_share) for one in side) for side in (ones, others)])
    batch = batch_hypotheses([replace(one, one_sided=False) for one in many], 1)
    products = batch.coefficients(np.concatenate([one.directions for one in few], axis=1))
    return products if many is ones else products.T


def confusion_rate(strength: float, cosine: float) -> float:
    """Probability that an effect of this strength is closer to the other cause.

    Examples
    --------
    >>> round(confusion_rate(6.0, 0.5), 4), round(confusion_rate(6.0, 0.99), 2)
    (0.0013, 0.34)
    """
    return float(ndtr(-strength * np.sqrt(max(1.0 - cosine, 0.0) / 2.0)))


def is_distinguishable(named: Hypothesis | AR1, misfit: Misfit, rival: str, strength: float) -> bool:
    """Whether the data separate a named shape from every shape of a rival, at this strength."""
    shapes = [shape for shape in misfit.hypotheses if classify_cause(shape) == rival]
    return confusion_rate(strength, float(compute_cosines([named], shapes).max())) < MAX_CONFUSION


@dataclass(frozen=True)
class Detectability:
    """The effect of one cause in a design.

    Attributes
    ----------
    cause : str
    unit : str
        For display of its size.
    per_size : float
        Strength of an effect of size 1 (SI), the median over its shapes.
    detection_strength : float
        Strength that is detected with a power of 0.9.
    largest_size : float
        Largest plausible size, SI.
    """

    cause: str
    unit: str
    per_size: float
    detection_strength: float
    largest_size: float

    @property
    def smallest_size(self) -> float:
        """Size that is detected with a power of 0.9, SI."""
        return self.size(self.detection_strength)

    def size(self, strength: float) -> float:
        """Size of an effect of this strength, SI."""
        return strength / self.per_size


@dataclass(frozen=True, eq=False)
class SeparabilityMatrix:
    """The causes that a design can detect and separate.

    Attributes
    ----------
    detectable : tuple of Detectability
    scatter_only : tuple of str
        Causes of outlying counts: single counts show them in any design.
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
        """The detectable causes."""
        return tuple(one.cause for one in self.detectable)

    def detectability(self, cause: str) -> Detectability:
        """One of the detectable causes."""
        return next(one for one in self.detectable if one.cause == cause)

    def confusion(self, truth: str, rival: str, strength: float) -> float:
        """Probability that an effect of `truth`, its shapes equally likely, is closer to `rival`."""
        return float(np.mean(ndtr(-strength * np.sqrt((1.0 - self.cosines[truth, rival]) / 2.0))))

    def pair_confusion(self, one: str, other: str, strength: float) -> float:
        """Confusion of a pair, the larger of the two."""
        return max(self.confusion(one, other, strength), self.confusion(other, one, strength))

    def strength_needed(self, one: str, other: str) -> float:
        """Strength above which a pair is confused in fewer than one log in twenty; infinite if none is."""
        from scipy.optimize import brentq

        def excess(strength: float) -> float:
            return self.pair_confusion(one, other, strength) - MAX_CONFUSION_DESIGN

        return float(brentq(excess, 0.0, MAX_STRENGTH, xtol=1e-2)) if excess(MAX_STRENGTH) < 0 else np.inf

    def pairs(self) -> list[tuple[str, str, float]]:
        """Every pair with the strength it needs, hardest first."""
        pairs = [
            (one, other, self.strength_needed(one, other)) for one, other in combinations(self.causes, 2)
        ]
        return sorted(pairs, key=lambda pair: -pair[2])

    def are_separable(self, one: str, other: str) -> bool:
        """Whether both causes are separated from each other at a plausible size."""
        needed = self.strength_needed(one, other)
        return all(
            self.detectability(cause).size(needed) <= self.detectability(cause).largest_size
            for cause in (one, other)
        )


def assess_design(
    problem: DiagnosisProblem,
    untestable: Mapping[str, str],
    alpha: float,
    n_bootstrap: int,
    rng: np.random.Generator,
) -> SeparabilityMatrix:
    """Assess a design by its rows and repeatability.

    The responses of `problem` only give the point of linearization; its causes are assessed. `alpha` is the
    false-alarm rate of the future diagnosis, `n_bootstrap` the number of samples for the critical value.
    """
    linearized = problem.linearize()
    critical = assess_residuals(linearized, problem, n_bootstrap, rng).critical_value(allocate_alpha(alpha))
    shapes = {
        cause: build_candidates(linearized, compute_finite_effects(linearized, [cause])).hypotheses
        for cause in problem.causes
    }
    scatter_only = tuple(cause.name for cause, own in shapes.items() if not own)
    shapes = {cause: own for cause, own in shapes.items() if own}
    detectable = tuple(_assess_cause(cause, own, linearized, critical) for cause, own in shapes.items())
    cosines = {
        (one.name, other.name): compute_cosines(shapes[one], shapes[other]).max(axis=1)
        for one, other in permutations(shapes, 2)
    }
    return SeparabilityMatrix(detectable, scatter_only, untestable, cosines, alpha)


def _assess_cause(
    cause: Any, shapes: list[Hypothesis], linearized: LinearizedFit, critical: float
) -> Detectability:
    per_size, versions = [], cause.trials(linearized.rows)
    for version, trials in versions:
        lengths = np.linalg.norm(compute_effects(linearized, version, trials), axis=0)
        same_unit = [one.unit == version.parameters[0].unit for one in version.parameters]
        sizes = (
            np.abs(trials[:, same_unit]).max(axis=1)
            if version.combine_trials
            else np.abs(trials[:, 0] - version.null_values[0])
        )
        ratios = lengths / sizes
        per_size += [float(np.linalg.norm(ratios))] if version.combine_trials else list(ratios)
    largest = [abs(values[0] - cause.null_values[0]) for values in cause.largest_plausible()]
    return Detectability(
        cause=cause.name,
        unit=versions[0][0].parameters[0].unit,
        per_size=float(np.median(per_size)),
        detection_strength=detection_length(critical, len(shapes), linearized.df) + Z_POWER_90,
        largest_size=float(
            max(largest or [cause.max_trial_factor * np.abs(values[:, 0]).max() for _, values in versions])
        ),
    )


def separability_to_json(matrix: SeparabilityMatrix, strength: float) -> dict[str, Any]:
    """A matrix in plain JSON types, with the rates of confusion at a strength; infinity is None."""
    return {
        "schema": SCHEMA,
        "alpha": matrix.alpha,
        "strength": strength,
        "causes": [
            {
                "cause": one.cause,
                "unit": one.unit,
                "strength_of_size_1": 1.0 / float(from_si(1.0 / one.per_size, one.unit)),
                "strength_found": one.detection_strength,
                "smallest_found": float(from_si(one.smallest_size, one.unit)),
                "largest_plausible": float(from_si(one.largest_size, one.unit)),
            }
            for one in matrix.detectable
        ],
        "pairs": [
            {
                "causes": [one, other],
                "confusion": matrix.pair_confusion(one, other, strength),
                "strength_needed": needed if np.isfinite(needed) else None,
                "told_apart": matrix.are_separable(one, other),
            }
            for one, other, needed in matrix.pairs()
        ],
        "shown_by_scatter": list(matrix.scatter_only),
        "untestable": [{"cause": cause, "reason": why} for cause, why in matrix.untestable.items()],
    }


def problem_from_plan(
    plan: Plan, truth: LawValues, machine: Machine
) -> tuple[DiagnosisProblem, dict[str, str]]:
    """A plan as a problem: its traverses, with their history, as a simulation makes them.

    Returns
    -------
    problem : DiagnosisProblem
        With the causes that are testable.
    untestable : dict of str to str
        The others, with the reason.

    Raises
    ------
    InputError
        If the plan cannot be simulated, or has too few traverses for a test.
    """
    from stickslip_fit.simulation import simulate

    log = simulate(plan, truth, machine)
    assert plan.noise is not None
    problem, missing = problem_from_log(log)
    drives = [(part.law.joint, direction) for part in problem.parts for direction in "+-"]
    repeatability = [plan.noise.repeatability.get(drive, np.nan) for drive in drives]
    problem = replace(problem, repeatability=np.array(repeatability))
    linearized = problem.linearize()
    if why := explain_too_small(linearized):
        raise InputError(f"the plan has {why}")
    untestable = missing | find_untestable(problem, linearized)
    testable = tuple(cause for cause in problem.causes if cause.name not in untestable)
    return replace(problem, causes=testable), untestable


def find_aliased_causes(misfit: Misfit) -> tuple[tuple[str, str], ...]:
    """Pairs of causes of which the second can produce in this log every effect of the first.

    Each pair stands once, also where this holds in both directions.
    """
    shapes: dict[str, list[Hypothesis]] = {}
    for shape in misfit.hypotheses:
        if isinstance(shape, Hypothesis) and classify_cause(shape) != UNKNOWN:
            shapes.setdefault(shape.cause, []).append(shape)
    few = [cause for cause, own in shapes.items() if len(own) <= MAX_ALIAS_SHAPES]
    pairs: dict[frozenset[str], tuple[str, str]] = {}
    for one, other in permutations(few, 2):
        if all(any(_is_in_span(shape, wider) for wider in shapes[other]) for shape in shapes[one]):
            pairs.setdefault(frozenset((one, other)), (one, other))
    return tuple(pairs.values())


def _is_in_span(shape: Hypothesis, wider: Hypothesis) -> bool:
    outside = shape.directions - wider.directions @ (wider.directions.T @ shape.directions)
    return bool(np.all(np.sum(outside**2, axis=0) < ALIAS_TOL))
