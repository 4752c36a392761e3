"""A law for unknown structure: a short expression where one does, else a smooth function.

`propose_term` searches a dictionary of short expressions (one direction of effects each) over the carriers of
`smooth_alternatives`. The best is proposed where it would gain nearly as much on a replicate as the best
smooth function, and explains more than the best expression of noise alone does; otherwise the smooth function
takes its place. It is part of `select_causes`, so that each fold searches anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import combinations

import numpy as np

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.causes.proposed import (
    ANGLES,
    BEFORE_DIRECTION,
    LOAD,
    POSITION,
    CarrierFunction,
    Mode,
    PeriodicTerm,
    ProposedTerm,
)
from stickslip_fit.diagnosis.extension import SelectedCause, estimate_strength
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, Hypothesis, compute_effects, make_hypothesis
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.misfit import (
    UNKNOWN,
    Misfit,
    batch_hypotheses,
    classify_cause,
    remove_structure,
)
from stickslip_fit.diagnosis.smooth_alternatives import (
    MIN_SHARE,
    Carrier,
    find_carriers,
    traverse_average,
)
from stickslip_fit.logs.history import FURTHER_HISTORY

MIN_STAND_IN_LOG_BAYES_FACTOR = 2.0  # nats of a smooth function, below which the law stays as it is
COMMON_IN_LAW = 0.5  # share of a function of sessions that is the same in all, in the law
MEMORY_MARGIN = 3.0  # nats by which an autoregression is likelier, whose noise looks like many a function
FACTOR_COST = 2.0  # of the squared residuals that a second factor has to explain
N_PERIODS = 21  # between the two neighbours of a period that was tried
MIN_GAIN_SHARE = 0.95  # of the smooth function's gain, with which a short expression is preferred
N_NULL_LOGS, NULL_LEVEL = 200, 0.01
OF_ANGLES = ("sin(x)", "cos(x)", "sin(2 x)", "cos(2 x)", "sin(3 x)", "cos(3 x)")


def propose_term(
    linearized: LinearizedFit, selected: Sequence[SelectedCause], rng: np.random.Generator
) -> list[SelectedCause]:
    """The selected causes, the last of which is unknown structure, with a law for it where there is one."""
    *others, unknown = selected
    misfit = unknown.misfit
    if unknown.cause != UNKNOWN or unknown.version is not None or misfit is None:
        return list(selected)
    smooth = [
        (float(evidence), one)
        for evidence, one in zip(misfit.log_evidence, misfit.hypotheses, strict=True)
        if classify_cause(one) == UNKNOWN and one.version is not None
    ]
    if not smooth:
        return list(selected)
    evidence, shape = max(smooth, key=lambda pair: pair[0])
    memory = [
        own for own, one in zip(misfit.log_evidence, misfit.hypotheses, strict=True) if isinstance(one, AR1)
    ]
    if evidence < max([MIN_STAND_IN_LOG_BAYES_FACTOR, *(own - MEMORY_MARGIN for own in memory)]):
        return list(selected)
    term = _find_term(linearized, misfit, rng)
    assert isinstance(shape, Hypothesis)
    if term is not None and term.expected_gain >= MIN_GAIN_SHARE * _expected_gain(shape, misfit.residual):
        return [*others, replace(unknown, version=term.version, start=np.array([term.size]))]
    if isinstance(shape.version, PeriodicTerm):
        shape = _with_harmonics(shape, linearized, misfit.residual)
    version = shape.version.with_amplitude(estimate_strength(shape, misfit.residual) / shape.length)
    if version.sessions and not version.common and not isinstance(version, PeriodicTerm):
        # Where a session has no traverse of its own nearby, the others say more than nothing.
        version = replace(version, common=COMMON_IN_LAW)
    return [*others, replace(unknown, version=version, start=np.array(version.null_values))]


def _with_harmonics(shape: Hypothesis, linearized: LinearizedFit, residual: Array) -> Hypothesis:
    """A wave with its harmonics, at the period under which residuals, shape (n,), are likeliest."""
    term, longest = shape.version, shape.version.limits[0][1]
    shapes = [shape]
    for rate in 1.0 / term.period + np.linspace(-0.5, 0.5, N_PERIODS) / longest:
        version = replace(term, period=float(1.0 / rate)).with_harmonics()
        sizes = np.diag([parameter.prior_sd for parameter in version.parameters])
        effects = compute_effects(linearized, version, sizes)
        shapes += [one for one in [make_hypothesis(shape.cause, version, None, effects)] if one is not None]
    evidence = batch_hypotheses(shapes, linearized.df).log_evidence(residual[:, None])[:, 0]
    return shapes[int(np.argmax(evidence[1:])) + 1] if len(shapes) > 1 else shape


@dataclass(frozen=True, eq=False)
class _Term:
    """A short expression, its estimated size, and what it would gain on a replicate.

    The gain is that of the squared whitened residuals: what is explained less twice the number of parameters
    (Mallows' C_p).
    """

    version: ProposedTerm
    size: float
    expected_gain: float


def _expected_gain(shape: Hypothesis, residual: Array) -> float:
    """The same of a smooth function, whose parameters are shrunk."""
    signal = estimate_strength(shape, residual) ** 2 * shape.prior_share
    kept = signal / (1.0 + signal)
    return float(np.sum(kept * (2.0 - kept) * shape.coefficients(residual) ** 2) - 2.0 * np.sum(kept))


def _find_term(linearized: LinearizedFit, misfit: Misfit, rng: np.random.Generator) -> _Term | None:
    """The likeliest short expression; None where noise alone has one as likely."""
    products, columns = _build_dictionary(linearized)
    if not products:
        return None
    of_position = np.array([any(factor.carrier == POSITION for factor in product) for product in products])
    dictionary = _Dictionary(linearized, columns, of_position)
    along = dictionary.along(misfit.residual[:, None])[..., 0]
    squares = along**2 / dictionary.squares
    factors = np.array([len(product) for product in products])
    place, best = np.unravel_index(int(np.argmax(squares - FACTOR_COST * factors)), squares.shape)
    left = remove_structure(misfit.residual, misfit.hypotheses, misfit.log_evidence).residual
    noise = linearized.project(rng.choice([-1.0, 1.0], (len(left), N_NULL_LOGS)) * left[:, None])
    null = np.max(dictionary.along(noise) ** 2 / dictionary.squares[..., None], axis=(0, 1))
    if squares[place, best] <= np.quantile(null, 1.0 - NULL_LEVEL):
        return None
    on, mode = dictionary.places[place]
    version = ProposedTerm(tuple(astuple(factor) for factor in products[best]), on, mode)
    size = -float(along[place, best] / dictionary.squares[place, best])  # a larger step makes fewer
    return _Term(version, size, float(squares[place, best]) - 2.0)


def _build_dictionary(linearized: LinearizedFit) -> tuple[list[tuple[CarrierFunction, ...]], Array]:
    """Products of one or two functions, of at most three symbols, and their averages; shape (n, m)."""
    single = [
        (factor, factor.values(carrier.values))
        for carrier in find_carriers(linearized)
        if carrier.name not in FURTHER_HISTORY
        for factor in _functions(carrier)
    ]
    products: list[tuple[CarrierFunction, ...]] = [(factor,) for factor, _ in single]
    columns = [values for _, values in single]
    for (one, values), (other, others) in combinations(single, 2):
        if one.carrier != other.carrier and "x" in (one.expression, other.expression):
            products.append((one, other))
            columns.append(values * others)
    averages = [traverse_average(column)[:, None] for column in columns]
    return products, np.concatenate([np.zeros((len(linearized), 0)), *averages], axis=1)


def _functions(carrier: Carrier) -> Iterator[CarrierFunction]:
    """Functions of one carrier; of an angle also its harmonics."""
    largest = max(abs(carrier.low), abs(carrier.high))
    if carrier.name in (LOAD, BEFORE_DIRECTION, "before_load"):
        expressions, middle, unit = ["x", "x^2", "|x|"], 0.0, 1.0
    elif carrier.name in (POSITION, *ANGLES):
        expressions = ["x", "x^2", "|x|", *(OF_ANGLES if carrier.name != "q3" else ())]
        middle, unit = 0.0, largest if carrier.name == "q3" else 1.0
    elif carrier.name in ("session_seconds", "steps_before"):
        expressions, middle, unit = ["x", "x^2", "log(1 + x)"], 0.0, float(np.median(carrier.values)) or 1.0
    else:
        expressions = ["x", "x^2", "|x|"]
        middle, unit = float(np.nanmean(carrier.values)), (carrier.high - carrier.low) / 2
    return (CarrierFunction(expression, carrier.name, middle, unit) for expression in expressions)


class _Dictionary:
    """Effects of m expressions, on every set of joints and directions: their squares and inner products.

    Expressions `of_position`, shape (m,), are tried on one joint at a time: a rotary and a prismatic joint
    have no unit in common.
    """

    def __init__(self, linearized: LinearizedFit, columns: Array, of_position: BoolArray) -> None:
        n_own = sum(block.shape[1] for _, block in linearized.blocks)
        own_basis = linearized.basis[:, :n_own]
        whitened = linearized.whiten(columns)
        self.columns = whitened - own_basis @ (own_basis.T @ whitened)
        forward = (linearized.rows["direction"] == "+").to_numpy()
        joint = linearized.rows["joint"].to_numpy()
        joints = [int(number) for number in np.unique(joint)]
        groups = [(number, way) for number in joints for way in "+-"]
        self.rows = [np.flatnonzero((joint == number) & (forward == (way == "+"))) for number, way in groups]
        signs = np.array([1.0 if way == "+" else -1.0 for _, way in groups])
        self.places: list[tuple[tuple[tuple[int, str], ...], Mode]] = [((), "same"), ((), "opposite")]
        combine = [np.ones(len(groups)), signs]
        for number in joints:
            own = np.array([float(number == other) for other, _ in groups])
            both = ((number, "+"), (number, "-"))
            self.places += [(both, "same"), (both, "opposite")]
            combine += [own, own * signs]
        self.places += [((group,), "same") for group in groups]
        self.combine = np.concatenate([combine, np.eye(len(groups))])  # places by groups
        each = np.stack([np.sum(self.columns[rows] ** 2, axis=0) for rows in self.rows])
        shared = np.stack([linearized.shared_basis[rows].T @ self.columns[rows] for rows in self.rows])
        absorbed = np.sum(np.tensordot(self.combine, shared, axes=1) ** 2, axis=1)
        squares = self.combine**2 @ each - absorbed
        plain = np.stack([np.sum(whitened[rows] ** 2, axis=0) for rows in self.rows])
        too_small = squares < np.maximum(MIN_SHARE * (self.combine**2 @ plain), EFFECT_TOL**2)
        together = np.array([len({one for one, _ in on or groups}) > 1 for on, _ in self.places])
        self.squares = np.where(too_small | (together[:, None] & of_position), np.inf, squares)

    def along(self, residuals: Array) -> Array:
        """Inner products with residuals, (n, k) -> (places, m, k)."""
        each = np.stack([self.columns[rows].T @ residuals[rows] for rows in self.rows])
        return np.tensordot(self.combine, each, axes=1)
