"""The built-in strategies: least squares, hierarchical Bayes, and either of them with known causes.

The uncertainty of the causes' parameters is propagated by recalibrating with each of them shifted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.bayes import weak_prior
from stickslip_fit.bayes.marginal import ConditionalPosterior, linearize_at_mode
from stickslip_fit.bayes.priors import PRIOR_SPREAD, build_group_data
from stickslip_fit.causes import Cause
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.closed_form import MIN_DF
from stickslip_fit.estimation.noise import pool_residuals
from stickslip_fit.estimation.with_causes import DIFFERENCE_STEP, FixedCauseLaw, FixedCauses, fixed_causes
from stickslip_fit.logs import Log
from stickslip_fit.strategies.base import (
    CalibrationTask,
    NotApplicable,
    Predictor,
    SessionSelector,
    Strategy,
    make_least_squares_predictor,
    make_predictor,
    other_sessions,
    response_sd,
    solve_law,
)
from stickslip_fit.strategies.designs import (
    AtRandom,
    ClosedForm,
    ConstantStepStrategy,
    Design,
    DOptimal,
    IOptimal,
    Thesis,
)


@dataclass(frozen=True)
class LeastSquares:
    """Fit the law to as many traverses as it has parameters, and some more.

    Attributes
    ----------
    design : Design
        Which traverses.
    more : int
        How many beyond the number of parameters.
    """

    design: Design
    more: int = 0

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"least squares, {self.design.name}{f' +{self.more}' if self.more else ''}"

    def choose(self, task: CalibrationTask) -> IntArray:
        """See `Strategy.choose`."""
        return self.design.pick(task, len(task.law.parameters) + self.more)

    def calibrate(self, task: CalibrationTask, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        return make_least_squares_predictor(task, task.law, made)


@dataclass(frozen=True)
class Hierarchical:
    """Today's parameters, drawn from what the sessions looked back on have in common.

    The model and the priors are those of `fit.bayes`. Where that draws how far sessions spread and how well
    counts repeat, this takes their likeliest values (empirical Bayes): given those, sessions are Gaussian
    under the linearised law, so that a session costs milliseconds and no draws.

    Attributes
    ----------
    traverses : int
        How many to make today; fewer than the law's parameters will do.
    design : Design
    """

    traverses: int
    design: Design = IOptimal()  # noqa: RUF009 - frozen, and without state

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"Bayes, {self.traverses} {self.design.name}"

    def choose(self, task: CalibrationTask) -> IntArray:
        """See `Strategy.choose`."""
        return self.design.pick(task, self.traverses, PRIOR_SPREAD)

    def calibrate(self, task: CalibrationTask, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        if task.others.empty:
            raise NotApplicable("there is no other session to look back on")
        traverses = build_group_data(task.law, pd.concat([task.others, made]))
        prior = weak_prior(task.law, traverses.rows)
        marginal, mode, _ = linearize_at_mode(traverses, prior)
        today = list(traverses.groups.table["session"]).index(task.session)
        z, covariance = _session_posterior(marginal.conditional(mode[None]), today)
        values = prior.centre + prior.width * z
        return make_predictor(task.law, values, covariance * np.outer(prior.width, prior.width))


def _session_posterior(given: ConditionalPosterior, session: int) -> tuple[Array, Array]:
    """Mean, shape (p,), and covariance, shape (p, p), of a session's z given the levels."""
    mean, tau = given.sessions(given.centre)[:, session, 0], given.tau[:, 0]
    form, eye = given.form[:, :, session, 0], np.eye(len(tau))
    inside = np.linalg.inv(eye + form)
    # How z follows the campaign's mean, whose own uncertainty goes with it.
    follows = eye - tau[:, None] * (inside @ form) / tau
    campaign = np.linalg.inv(given.precision[:, :, 0])
    return mean, tau[:, None] * inside * tau + follows @ campaign @ follows.T


@dataclass(frozen=True, eq=False)
class PerturbedPredictors:
    """Predictions with one cause's size a little larger and a little smaller.

    Attributes
    ----------
    place : int
        Of the size among the causes' parameters.
    apart : float
        Between the two sizes, SI.
    ahead, lower : callable
    """

    place: int
    apart: float
    ahead: Predictor
    lower: Predictor


@dataclass(frozen=True, eq=False)
class WithCauses:
    """Another strategy, with causes of known size in the law.

    Attributes
    ----------
    strategy : Strategy
        Calibrates what the law has of its own.
    known : mapping of str to KnownCauses or str
        By session, from what it was not part of; or why that could not be known. What is not sure of them
        goes into the standard deviations of what is predicted, and what they explain leaves the scatter.
    """

    strategy: Strategy
    known: Mapping[str, FixedCauses | str]

    @property
    def name(self) -> str:
        """See `Strategy.name`."""
        return f"{self.strategy.name}, with causes"

    def choose(self, task: CalibrationTask) -> IntArray:
        """See `Strategy.choose`."""
        return self.strategy.choose(replace(task, law=_fix_causes(task, self._known(task))))

    def calibrate(self, task: CalibrationTask, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        known = self._known(task)
        repeatability = _estimate_repeatability(_fix_causes(task, known), task)

        def calibrated(sizes: Array) -> Predictor:
            law = FixedCauseLaw(task.law, known.causes, sizes)
            return self.strategy.calibrate(replace(task, law=law, repeatability=repeatability), made)

        return _propagate_uncertainty(
            known, calibrated(known.values), _perturb_sizes(task, known, calibrated)
        )

    def _known(self, task: CalibrationTask) -> FixedCauses:
        known = self.known[task.session]
        if isinstance(known, str):
            raise NotApplicable(known)
        return known


def _fix_causes(task: CalibrationTask, known: FixedCauses) -> FixedCauseLaw:
    return FixedCauseLaw(task.law, known.causes, known.values)


def _estimate_repeatability(law: FixedCauseLaw, task: CalibrationTask) -> float:
    """What is left of the scatter with the causes in the law.

    Replicates hours apart also hold what the causes did between them, and what the law leaves over of the
    other sessions also holds what it lacks: the scatter is no larger than either.
    """
    if task.others.empty:
        return task.repeatability
    found = solve_law(law, task.others, task.repeatability)
    y, rounding = law.response(task.others)
    residual = y - law.predict(task.others, found.values[found.groups.of_row])
    df = int(len(y) - found.known.sum())
    left_over = pool_residuals(residual, rounding, df, "residuals")
    return min(task.repeatability, left_over.value) if left_over.df >= MIN_DF else task.repeatability


def _perturb_sizes(
    task: CalibrationTask, known: FixedCauses, calibrated: Callable[[Array], Predictor]
) -> list[PerturbedPredictors]:
    """What would be predicted if each size that has an error bar were a little different.

    The calibration is made again: what a wrong size does to the traverses to predict, it did to those that
    were calibrated from, too.
    """
    scales = _fix_causes(task, known).extended.sizes
    found = []
    for k in np.flatnonzero(np.diagonal(known.covariance) != 0):
        step = DIFFERENCE_STEP * scales[k]
        aside = step * (np.arange(len(scales)) == k)
        ahead, behind = (calibrated(known.values + direction * aside) for direction in (1, -1))
        found.append(PerturbedPredictors(int(k), 2 * step, ahead, behind))
    return found


def _propagate_uncertainty(
    known: FixedCauses, middle: Predictor, neighbours: Sequence[PerturbedPredictors]
) -> Predictor:
    def predict(rows: pd.DataFrame) -> tuple[Array, Array]:
        mean, sd = middle(rows)
        slopes = np.zeros((len(rows), len(known.values)))
        for near in neighbours:
            slopes[:, near.place] = (near.ahead(rows)[0] - near.lower(rows)[0]) / near.apart
        return mean, np.hypot(sd, response_sd(slopes, known.covariance))

    return predict


def causes_from_other_sessions(
    log: Log, causes: Sequence[Cause], session_selector: SessionSelector = other_sessions
) -> dict[str, FixedCauses | str]:
    """Fit causes on the sessions that each session may look back on.

    Parameters
    ----------
    log : Log
    causes : sequence of Cause
        Such as a diagnosis named.
    at_hand : callable, optional
        Which sessions these are.
    """
    known: dict[str, FixedCauses | str] = {}
    for session in log.sessions:
        others = session_selector(log.sessions, session)
        if not others:
            known[session] = "there is no other session to fit its causes on"
            continue
        try:
            fitted = fit_least_squares(log.select(log.rows["session"].isin(others)), causes=causes)
            known[session] = fixed_causes(fitted)
        except InputError as error:
            known[session] = f"its causes cannot be fitted on the other sessions: {error}"
    return known


def causes_from_result(log: Log, result: Result) -> dict[str, FixedCauses | str]:
    """Take the causes of a saved result for known in every session.

    Raises
    ------
    InputError
        If it was fitted to this very log, is of another machine, or knows no causes.
    """
    if result.provenance.log_sha256 == log.sha256:
        raise InputError(
            "the causes of this result were fitted to the traverses that they would be judged by; name them "
            "with --cause, so that they are fitted to the other sessions, or take a result of another log"
        )
    if result.machine.sha256 != log.machine.sha256:
        raise InputError("the causes were fitted for another machine; read the log with that one")
    return dict.fromkeys(log.sessions, fixed_causes(result))


EXTRA_TRAVERSES = 4


def default_strategies_with_causes(
    known: Mapping[str, FixedCauses | str], more: int = EXTRA_TRAVERSES
) -> tuple[Strategy, ...]:
    """Two of the usual ones with causes of known size in the law; see `WithCauses`."""
    return (WithCauses(ClosedForm(), known), WithCauses(LeastSquares(IOptimal(), more), known))


def default_strategies(more: int = EXTRA_TRAVERSES, seed: int = 0) -> tuple[Strategy, ...]:
    """The thesis's two, then least squares and Bayes on traverses chosen in several ways.

    Parameters
    ----------
    more : int, optional
        Traverses beyond the number of parameters, where least squares takes more.
    seed : int, optional
        Of those chosen at random.

    Examples
    --------
    >>> [strategy.name for strategy in default_strategies()][:3]
    ['constant step', 'closed form', 'least squares, thesis +4']
    """
    return (
        ConstantStepStrategy(),
        ClosedForm(),
        LeastSquares(Thesis(), more),
        LeastSquares(AtRandom(seed), more),
        LeastSquares(DOptimal()),
        LeastSquares(DOptimal(), more),
        LeastSquares(IOptimal()),
        LeastSquares(IOptimal(), more),
        Hierarchical(1),
        Hierarchical(2),
    )
