"""A law for unknown structure: a short expression where one does, else a smooth function.

`propose_term` searches a dictionary of short expressions (`expressions`). The best is proposed where it would
gain nearly as much on a replicate as the best smooth function, and explains more than the best expression of
noise alone does; otherwise the smooth function takes its place, of sessions the average over its forms
(`averaged_forms`). Where memory is likelier than any of these, what carries over from the traverse before is
proposed. It is part of `select_causes`, so that each fold searches anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.causes.added_steps import AddedSteps
from stickslip_fit.causes.proposed import SMOOTH_SCALE, PeriodicTerm, SmoothTerm
from stickslip_fit.causes.smooth import N_HARMONICS, prior_sds
from stickslip_fit.causes.table_terms import PeriodicTableTerm
from stickslip_fit.diagnosis.averaged_forms import average_forms
from stickslip_fit.diagnosis.evidence import LikeliestStrength, find_strength
from stickslip_fit.diagnosis.expressions import Dictionary
from stickslip_fit.diagnosis.extension import SelectedCause, estimate_strength
from stickslip_fit.diagnosis.hypotheses import Hypothesis, compute_effects, make_hypothesis
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import (
    UNKNOWN,
    Misfit,
    classify_cause,
    remove_structure,
    weigh_hypotheses,
)
from stickslip_fit.diagnosis.time_functions import find_time_function

MIN_STAND_IN_LOG_BAYES_FACTOR = 2.0  # nats of a smooth function, below which the law stays as it is
MEMORY_MARGIN = 3.0  # nats by which an autoregression is likelier, whose noise looks like many a function
MAX_CLOSER = 5  # functions that are looked at more closely, where memory is likelier or of two carriers
FACTOR_COST = 2.0  # of the squared residuals that a second factor has to explain
FINE_LENGTHS = (0.05, 0.03)  # of functions of one carrier, of the range of their cosines
CLEARLY_LIKELIER = 5.0  # nats, by which another function is likelier than the usual one
SURFACE_LENGTHS = (1.0, 0.6, 0.4)  # of functions of two carriers, of their ranges
NUMBERS_OF_HARMONICS = (1, 2, 4, 8)  # of a wave: the likeliest, from a pure one to one with a jump
CHANGE_LENGTHS = (1.0, 0.4, 0.15)  # correlation lengths of a wave's size and phase, of a session
N_PERIODS = 21  # between the two neighbours of a period that was tried
MIN_GAIN_SHARE = 0.95  # of the smooth function's gain, with which a short expression is preferred
N_NULL_LOGS, NULL_LEVEL = 200, 0.01
EQUAL = 1e-6  # share of the squares, by which rounding may differ
EVIDENCE_DECIMALS = 6  # of nats, of which the rest is rounding


def propose_term(
    linearized: LinearizedFit,
    selected: Sequence[SelectedCause],
    expressions: Callable[[LinearizedFit], Dictionary | None],
    rng: np.random.Generator,
) -> list[SelectedCause]:
    """The selected causes, the last of which is unknown structure, with a law for it where there is one."""
    *others, unknown = selected
    misfit = unknown.misfit
    if unknown.cause != UNKNOWN or unknown.version is not None or misfit is None:
        return list(selected)
    smooth, memory = rank_forms(misfit, linearized.rows)
    (evidence, shape), (to_beat, ar1) = (
        (misfit.log_evidence[places[0]], misfit.hypotheses[places[0]]) if places else (-np.inf, None)
        for places in (smooth, memory)
    )
    if max(evidence, to_beat) < MIN_STAND_IN_LOG_BAYES_FACTOR:
        return list(selected)
    least = max(MIN_STAND_IN_LOG_BAYES_FACTOR, to_beat - MEMORY_MARGIN)
    carriers: Sequence[str] = shape.version.carriers if isinstance(shape, Hypothesis) else ()
    term = _find_term(linearized, misfit, expressions(linearized), carriers, rng)
    fine = None
    if evidence < least:
        closer = [(evidence, shape), *_look_closer(linearized, misfit, smooth, term)]
        evidence, shape = max(closer, key=lambda one: one[0])
        # Unlike memory, which has an exponential covariance itself, it says when something came and went.
        fine = find_time_function(linearized, misfit.residual)
        if fine is not None and fine[0] > max(evidence, to_beat):
            evidence, shape = fine
    if evidence < least:
        if not isinstance(ar1, AR1) or ar1.term is None:
            return list(selected)
        start = np.array([ar1.coefficient])
        return [*others, replace(unknown, version=ar1.term, start=start, tested=linearized)]
    assert isinstance(shape, Hypothesis)
    if to_beat > evidence or all(shape is not one for one in misfit.hypotheses):
        unknown = replace(unknown, misfit=misfit.with_likeliest(shape))
    least_gain = MIN_GAIN_SHARE * _expected_gain(shape, misfit.residual)
    if term is not None and (shape.version is term.version or term.expected_gain >= least_gain):
        return [*others, replace(unknown, version=term.version, start=term.start, tested=linearized)]
    if isinstance(shape.version, PeriodicTerm | PeriodicTableTerm):
        shape = _likeliest(_periods_about(shape.version), shape, linearized, misfit.residual)
        if isinstance(shape.version, PeriodicTerm) and not shape.version.on:
            shape = _clearly_likelier(_of_single_joints(shape.version, linearized), shape, linearized, misfit)
        wave: Any = shape.version
        versions = [_with_harmonics(wave, number) for number in NUMBERS_OF_HARMONICS]
        shape = _likeliest(versions, shape, linearized, misfit.residual)
        if isinstance(wave, PeriodicTerm):
            changing = [_with_changes(wave, length) for length in CHANGE_LENGTHS]
            shape = _clearly_likelier(changing, shape, linearized, misfit)
    elif isinstance(shape.version, SmoothTerm) and len(shape.version.carriers) == 2:
        shapes = [shape, *(misfit.hypotheses[place] for place in smooth)]
        surface = _find_surface(shapes, linearized, misfit.residual)
        if surface.cause != shape.cause:
            unknown = replace(unknown, misfit=misfit.with_likeliest(surface))
        shape = surface
    elif isinstance(shape.version, SmoothTerm) and shape.version.sessions:
        if fine is None and shape.version.carriers == ("session_seconds",):
            fine = find_time_function(linearized, misfit.residual)
        if fine is None or (shape is not fine[1] and fine[0] < evidence + CLEARLY_LIKELIER):
            version: Any = average_forms(shape.version, linearized, misfit.residual)
            return [*others, _without_start(unknown, version, linearized)]
        shape = fine[1]
    elif isinstance(shape.version, SmoothTerm) and not isinstance(shape.version, AddedSteps):
        shape = _clearly_likelier(_with_details(shape.version), shape, linearized, misfit)
    size = _fit_strength(shape, misfit.residual, linearized.df)
    version = shape.version.with_amplitude(size.strength * np.sqrt(size.noise) / shape.length)
    return [*others, _without_start(unknown, version, linearized)]


def _look_closer(
    linearized: LinearizedFit, misfit: Misfit, smooth: Sequence[int], term: _Term | None
) -> list[tuple[float, Hypothesis]]:
    """Functions of one carrier with details, and a short expression, each with its evidence in nats.

    What comes and goes as noise with memory does may be a function too fine to be looked for, or follow two
    columns that have memory themselves.
    """
    found, shapes = list[tuple[float, Hypothesis]](), [misfit.hypotheses[place] for place in smooth]
    for shape in list(filter(_is_plain, shapes))[:MAX_CLOSER]:
        assert isinstance(shape, Hypothesis)
        fine = _likeliest(_with_details(shape.version), shape, linearized, misfit.residual)
        found.append((_fit_strength(fine, misfit.residual, linearized.df).evidence, fine))
    if term is not None:
        effects = compute_effects(linearized, term.version, np.diag(term.start))
        name = f"{UNKNOWN}:{' and '.join(term.version.carriers)}"
        own = make_hypothesis(name, term.version, None, effects)
        if own is not None:
            evidence = _fit_strength(own, misfit.residual, linearized.df).evidence
            found.append((evidence - np.log(term.n_tried), own))
    return found


def _is_plain(shape: Hypothesis | AR1) -> bool:
    """Whether it is a smooth function of one carrier, the same in all sessions."""
    term: Any = shape.version
    return type(term) is SmoothTerm and len(term.carriers) == 1 and not term.sessions


def _without_start(unknown: SelectedCause, version: Any, linearized: LinearizedFit) -> SelectedCause:
    """Unknown structure with a law, whose fit starts where that has no effect."""
    return replace(unknown, version=version, start=np.array(version.null_values), tested=linearized)


def rank_forms(misfit: Misfit, rows: pd.DataFrame) -> tuple[list[int], list[int]]:
    """Places of what may follow unknown structure, the likeliest first: smooth functions, autoregressions.

    A short expression, which took the place of one of these, is looked for anew.
    Of equally likely ones that of fewest joints: what no traverse of a joint shows is not said of it. One of
    many shapes, as a product is, has to be likelier in proportion to their number.
    """
    shapes = misfit.hypotheses
    joints = _count_joints([shape.version for shape in shapes], rows)
    likely = misfit.log_evidence + weigh_hypotheses(shapes, list(map(classify_cause, shapes)))
    places = np.lexsort((np.array(joints), -np.round(likely, EVIDENCE_DECIMALS))).tolist()
    memory = [k for k in places if isinstance(shapes[k], AR1)]
    unknown = [k for k in places if shapes[k].version is not None and classify_cause(shapes[k]) == UNKNOWN]
    smooth = [k for k in unknown if not hasattr(shapes[k].version, "formula")]
    return smooth, memory


def _count_joints(versions: Sequence[Any], rows: pd.DataFrame) -> list[int]:
    """How many joints each acts on; one that names none acts on all."""
    number = rows["joint"].nunique() if "joint" in rows else 1
    return [len({joint for joint, _ in getattr(one, "on", ())}) or number for one in versions]


def _periods_about(wave: Any) -> Iterable[Any]:
    """A wave with its harmonics, at periods about its own."""
    rates = 1.0 / wave.period + np.linspace(-0.5, 0.5, N_PERIODS) / wave.limits[0][1]
    return (_with_harmonics(replace(wave, period=float(1.0 / rate)), N_HARMONICS) for rate in rates)


def _with_harmonics(wave: Any, number: int) -> Any:
    """A wave with so many harmonics, each expected to be smaller in proportion to its order."""
    sds = tuple(sd / k for k in range(1, number + 1) for sd in wave.sds[:2])
    return _with_functions(wave, sds)


def _with_functions(wave: Any, sds: tuple[float, ...]) -> Any:
    """A wave with so many functions of its clock, of prior standard deviations `sds`."""
    orders = tuple((k, *wave.orders[0][1:]) for k in range(1, len(sds) + 1))
    return replace(wave, orders=orders, sds=sds)


def _with_changes(wave: PeriodicTerm, length: float) -> PeriodicTerm:
    """A pure wave whose size and phase change as a smooth function of the time in the session does."""
    slow = prior_sds(length)
    sds = tuple(sd * times for times in (1.0, *map(float, slow)) for sd in wave.sds[:2])
    return replace(_with_functions(wave, sds), n_slow=len(slow))


def _find_surface(shapes: Sequence[Any], linearized: LinearizedFit, residual: Array) -> Hypothesis:
    """The likeliest smooth function of the carriers of the first of some shapes, the likeliest first.

    On the joints and directions of that or of another shape: those of the product alone need not be those of
    the function.
    """
    first = shapes[0].version
    same = [
        one for one in shapes if (type(one.version), one.version.carriers) == (type(first), first.carriers)
    ]
    alike = {one.cause: one for one in same}
    surfaces = [
        _likeliest(_as_surfaces(one.version), one, linearized, residual)
        for one in list(alike.values())[:MAX_CLOSER]
    ]
    return max(surfaces, key=lambda one: _fit_strength(one, residual, linearized.df).evidence)


def _as_surfaces(term: SmoothTerm) -> Iterable[SmoothTerm]:
    """A product of the lowest functions of two carriers, and smooth functions of both that are no product.

    Without and with functions of each alone: an effect of both is rarely none on the average over one of them
    (P. McCullagh and J. A. Nelder, Generalized Linear Models, 2nd ed., 1989, sect. 3.5).
    """
    for length, lowest in product(SURFACE_LENGTHS, (1, 0)):
        sds = np.r_[1.0, prior_sds(length) / prior_sds(length)[0]]
        orders = [one for one in product(range(lowest, len(sds)), repeat=2) if any(one)]
        sizes = (SMOOTH_SCALE * float(sds[one] * sds[other]) for one, other in orders)
        yield replace(term, orders=tuple(orders), sds=tuple(sizes))


def _of_single_joints(wave: PeriodicTerm, linearized: LinearizedFit) -> Iterable[PeriodicTerm]:
    """A wave of each joint alone, and of each in one direction."""
    for joint in map(int, linearized.rows["joint"].unique()):
        for ways in ("+-", "+", "-"):
            yield replace(wave, on=tuple((joint, way) for way in ways))


def _clearly_likelier(
    versions: Iterable[Any], shape: Hypothesis, linearized: LinearizedFit, misfit: Misfit
) -> Hypothesis:
    """A shape in another version, such as one with details, where residuals clearly say that it has them."""
    residual = misfit.residual
    best = _likeliest(versions, shape, linearized, residual)
    evidence, usual = (_fit_strength(one, residual, linearized.df).evidence for one in (best, shape))
    return best if evidence > usual + CLEARLY_LIKELIER else shape


def _with_details(term: SmoothTerm) -> Iterable[SmoothTerm]:
    """Functions of one carrier with details that are too fine to be looked for."""
    for length in FINE_LENGTHS:
        sds = SMOOTH_SCALE * prior_sds(length)
        yield replace(term, orders=tuple((k,) for k in range(1, len(sds) + 1)), sds=tuple(map(float, sds)))


def _likeliest(
    versions: Iterable[Any], shape: Hypothesis, linearized: LinearizedFit, residual: Array
) -> Hypothesis:
    """A shape in the version under which residuals, shape (n,), are likeliest."""
    shapes = []
    for version in versions:
        sizes = np.diag([parameter.prior_sd for parameter in version.parameters])
        effects = compute_effects(linearized, version, sizes)
        shapes += [one for one in [make_hypothesis(shape.cause, version, None, effects)] if one is not None]
    if not shapes:
        return shape
    return max(shapes, key=lambda one: _fit_strength(one, residual, linearized.df).evidence)


def _fit_strength(shape: Hypothesis, residual: Array, df: int) -> LikeliestStrength:
    return find_strength(shape.coefficients(residual), shape.prior_share, residual, df)


@dataclass(frozen=True, eq=False)
class _Term:
    """A short expression, its start values, and what it would gain on a replicate.

    The gain is that of the squared whitened residuals: what is explained less twice the number of parameters
    (Mallows' C_p). It is the best of `n_tried`.
    """

    version: Any
    start: Array
    expected_gain: float
    n_tried: int


def _expected_gain(shape: Hypothesis, residual: Array) -> float:
    """The same of a smooth function, whose parameters are shrunk."""
    signal = estimate_strength(shape, residual) ** 2 * shape.prior_share
    kept = signal / (1.0 + signal)
    return float(np.sum(kept * (2.0 - kept) * shape.coefficients(residual) ** 2) - 2.0 * np.sum(kept))


def _find_term(
    linearized: LinearizedFit,
    misfit: Misfit,
    dictionary: Dictionary | None,
    carriers: Sequence[str],
    rng: np.random.Generator,
) -> _Term | None:
    """The likeliest short expression, best of some carriers; None where noise alone has one as likely."""
    if dictionary is None:
        return None
    # Each further coefficient pays as in the Bayesian information criterion: the simpler term where it does.
    cost = np.log(len(misfit.residual)) * (dictionary.n_coefficients[:, None] - 1)
    squares = dictionary.explained(misfit.residual[:, None])[..., 0]
    criterion = squares - cost - FACTOR_COST * dictionary.n_factors
    # Of expressions that are the same in all rows, one of what the likeliest smooth function follows.
    same = [(int(k), int(m)) for k, m in np.argwhere(criterion >= criterion.max() - EQUAL * squares.max())]
    versions = [dictionary.make(*one, np.ones(1))[0] for one in same]
    others = [{*one.carriers} != {*carriers} for one in versions]
    place, best = min(zip(others, _count_joints(versions, linearized.rows), same, strict=True))[2]
    left = remove_structure(misfit.residual, misfit.hypotheses, misfit.log_evidence, linearized.df).residual
    noise = linearized.project(rng.choice([-1.0, 1.0], (len(left), N_NULL_LOGS)) * left[:, None])
    null = np.max(dictionary.explained(noise) - cost[..., None], axis=(0, 1))
    if squares[place, best] - cost[place, 0] <= np.quantile(null, 1.0 - NULL_LEVEL):
        return None
    version, start = dictionary.make(place, best, dictionary.coefficients(place, best, misfit.residual))
    n_tried = int(np.isfinite(dictionary.squares).sum())
    return _Term(version, start, float(squares[place, best]) - 2.0 * len(start), n_tried)
