"""The built-in strategies: least squares, hierarchical Bayes, and either of them with known causes.

The uncertainty of the causes' parameters is propagated by recalibrating with each of them changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.bayes.marginal import ConditionalPosterior, linearize_at_mode
from stickslip_fit.bayes.priors import PRIOR_SPREAD, ROWS_PER_CHUNK, build_campaigns, prior_from_steps
from stickslip_fit.causes import Cause, ExtendedLaw
from stickslip_fit.errors import InputError, check_count
from stickslip_fit.estimation import Result, fit_least_squares
from stickslip_fit.estimation.closed_form import MIN_DF
from stickslip_fit.estimation.noise import pool_residuals
from stickslip_fit.estimation.with_causes import DIFFERENCE_STEP, FixedCauseLaw, FixedCauses, fixed_causes
from stickslip_fit.laws import Laws, StepLaw, traverse_length
from stickslip_fit.logs import Log
from stickslip_fit.strategies.base import (
    CalibrationPlan,
    CalibrationTask,
    CombinedPredictor,
    LawEstimate,
    NotApplicable,
    PlannedStrategy,
    Predictor,
    SessionSelector,
    Strategy,
    UncertainLaw,
    join_family,
    other_sessions,
    plan_calibration,
    plan_law,
    repeat_numbers,
    response_sd,
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
class LeastSquares(PlannedStrategy):
    """Fit the law to traverses chosen by a design, `more` beyond the number of parameters."""

    design: Design
    more: int = 0

    @property
    def name(self) -> str:
        return f"least squares, {self.design.name}{f' +{self.more}' if self.more else ''}"

    def choose(self, task: CalibrationTask) -> IntArray:
        return self.design.pick(task, len(task.law.parameters) + self.more)

    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        return plan_law(task.law, task, measured)


@dataclass(frozen=True, eq=False)
class CampaignFit:
    """The parameters of one session and direction by the hierarchical model of all sessions.

    Attributes
    ----------
    others, measured : DataFrame
        Traverses of the other sessions, and those that were measured in this one.
    """

    law: StepLaw
    others: pd.DataFrame
    measured: pd.DataFrame

    @classmethod
    def solve(cls, fits: Sequence[CampaignFit]) -> list[LawEstimate]:
        """See `Fit.solve`; those that would stall at the centre of the prior know nothing."""
        sizes = np.cumsum([len(fit.others) + len(fit.measured) for fit in fits])
        ends = np.flatnonzero(np.diff(sizes // ROWS_PER_CHUNK)) + 1
        parts = [fits[low:high] for low, high in pairwise([0, *ends, len(fits)])]
        return [estimate for part in parts for estimate in cls._solve_part(part)]

    @classmethod
    def _solve_part(cls, fits: Sequence[CampaignFit]) -> list[LawEstimate]:
        campaigns = [pd.concat([fit.others, fit.measured]) for fit in fits]
        number = repeat_numbers(campaigns)
        data = build_campaigns(join_family([fit.law for fit in fits], number), campaigns)
        log_steps = np.log(traverse_length(data.rows)) - data.y
        prior = prior_from_steps(
            data.law, np.exp(np.bincount(number, log_steps) / np.bincount(number))[:, None]
        )
        try:
            marginal, mode, _ = linearize_at_mode(data, prior)
        except InputError:
            if len(fits) > 1:
                return [estimate for fit in fits for estimate in cls._solve_part([fit])]
            p = len(prior.names)
            return [LawEstimate(np.full(p, np.nan), np.zeros(p, dtype=bool), np.full((p, p), np.nan))]
        posterior, estimates = marginal.conditional(mode[:, None]), []
        assert data.campaign is not None
        for k, fit in enumerate(fits):
            sessions = list(data.groups.table["session"][data.campaign == k])
            z, covariance = _session_posterior(posterior, sessions.index(fit.measured["session"].iloc[0]), k)
            centre, width = prior.centre[k, 0], prior.width[k, 0]
            known = np.ones(len(z), dtype=bool)
            estimates.append(LawEstimate(centre + width * z, known, covariance * np.outer(width, width)))
        return estimates


@dataclass(frozen=True)
class Hierarchical(PlannedStrategy):
    """Empirical Bayes: a session's parameters with the other sessions' distribution as their prior.

    Model and priors are those of `bayes`, with the hyperparameters (spread of the sessions, repeatability)
    at their posterior mode; under the linearized law a session's posterior is then Gaussian.

    Attributes
    ----------
    traverses : int
        Measured in the session; may be fewer than the law's parameters.
    """

    traverses: int
    design: Design = IOptimal()  # noqa: RUF009 - frozen, and without state

    @property
    def name(self) -> str:
        return f"Bayes, {self.traverses} {self.design.name}"

    def choose(self, task: CalibrationTask) -> IntArray:
        return self.design.pick(task, self.traverses, PRIOR_SPREAD)

    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        if task.others.empty:
            raise NotApplicable("there is no other session to look back on")

        def finish(estimates: Sequence[LawEstimate]) -> Predictor:
            (estimate,) = estimates
            if not estimate.known.all():
                raise NotApplicable(f"joint {task.law.joint} would stall at the centre of the prior")
            return UncertainLaw(task.law, estimate.values, estimate.covariance)

        return CalibrationPlan((CampaignFit(task.law, task.others, measured),), finish)


def _session_posterior(posterior: ConditionalPosterior, session: int, k: int) -> tuple[Array, Array]:
    """Mean, shape (p,), and covariance, shape (p, p), of a session's z given the k-th hyperparameters."""
    mean, tau = posterior.sessions(posterior.centre)[:, session, k], posterior.tau[:, k]
    form, eye = posterior.form[:, :, session, k], np.eye(len(tau))
    shrinkage = np.linalg.inv(eye + form)
    # Derivative of z by the campaign's mean, whose uncertainty is propagated.
    response = eye - tau[:, None] * (shrinkage @ form) / tau
    campaign = np.linalg.inv(posterior.precision[:, :, k])
    return mean, tau[:, None] * shrinkage * tau + response @ campaign @ response.T


WITH_CAUSES = ", with causes"  # ends the names of these


@dataclass(frozen=True, eq=False)
class WithCauses(PlannedStrategy):
    """Another strategy, with causes of known size in the law.

    The uncertainty of the sizes adds to the predictions' standard deviations, and what the causes explain
    reduces the repeatability.

    Attributes
    ----------
    strategy : Strategy
        Calibrates the law's own parameters.
    known : mapping of str to FixedCauses or str
        By session, from other sessions; or why that was not possible.
    """

    strategy: Strategy
    known: Mapping[str, FixedCauses | str]

    @property
    def name(self) -> str:
        return f"{self.strategy.name}{WITH_CAUSES}"

    def choose(self, task: CalibrationTask) -> IntArray:
        return self.strategy.choose(task.with_causes(self._known(task)))

    def plan(self, task: CalibrationTask, measured: pd.DataFrame) -> CalibrationPlan:
        known = self._known(task)
        repeatability = _estimate_repeatability(task.with_causes(known))
        uncertain = np.flatnonzero(np.diagonal(known.covariance) != 0)
        steps = np.diag(DIFFERENCE_STEP * ExtendedLaw(task.law, known.causes).sizes)[uncertain]
        # Recalibrated with each uncertain size changed: a wrong size changes the calibration traverses too.
        plans = [
            plan_calibration(
                self.strategy,
                replace(task, law=FixedCauseLaw(task.law, known.causes, sizes), repeatability=repeatability),
                measured,
            )
            for sizes in known.values + np.concatenate([np.zeros((1, len(known.values))), steps, -steps])
        ]
        ends = np.cumsum([len(plan.fits) for plan in plans])
        covariance = known.covariance[np.ix_(uncertain, uncertain)]

        def combine(predicted: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
            (mean, sd), *changed = predicted
            responses = np.array([response for response, _ in changed])
            upper, lower = responses.reshape(2, len(uncertain), len(mean))
            jacobian = (upper - lower).T / (2 * steps.sum(axis=1))
            return mean, np.hypot(sd, response_sd(jacobian, covariance))

        def finish(estimates: Sequence[LawEstimate]) -> Predictor:
            parts = [
                plan.finish(estimates[end - len(plan.fits) : end])
                for plan, end in zip(plans, ends, strict=True)
            ]
            laws = [part for part in parts if isinstance(part, UncertainLaw)]
            if len(laws) == len(parts):
                return CombinedPredictor(laws, combine)
            return lambda rows: combine([part(rows) for part in parts])

        return CalibrationPlan([fit for plan in plans for fit in plan.fits], finish)

    def _known(self, task: CalibrationTask) -> FixedCauses:
        known = self.known[task.session]
        if isinstance(known, str):
            raise NotApplicable(known)
        return known


def _estimate_repeatability(task: CalibrationTask) -> float:
    """Repeatability with the causes in the law: the smaller of the task's and of the residuals' deviation.

    Both are upper limits: replicates hours apart contain effects of the causes, and residuals of the other
    sessions those of what the law lacks.
    """
    if task.others.empty:
        return task.repeatability
    solution = task.solution_of_others
    y, rounding = task.law.response(task.others)
    residual = y - task.law.predict(task.others, solution.values[solution.groups.of_row])
    df = int(len(y) - solution.known.sum())
    residual_sd = pool_residuals(residual, rounding, df, "residuals")
    return min(task.repeatability, residual_sd.value) if residual_sd.df >= MIN_DF else task.repeatability


def causes_from_other_sessions(
    log: Log,
    causes: Sequence[Cause],
    session_selector: SessionSelector = other_sessions,
    laws: Laws | None = None,
) -> dict[str, FixedCauses | str]:
    """Causes by session, fitted to the other sessions that it may use; the reason where they cannot be."""
    known: dict[str, FixedCauses | str] = {}
    for session in log.sessions:
        others = session_selector(log.sessions, session)
        if not others:
            known[session] = "there is no other session to fit its causes on"
            continue
        try:
            result = fit_least_squares(log.select(log.rows["session"].isin(others)), laws=laws, causes=causes)
            known[session] = fixed_causes(result)
        except InputError as error:
            known[session] = f"its causes cannot be fitted on the other sessions: {error}"
    return known


def causes_from_result(log: Log, result: Result) -> dict[str, FixedCauses | str]:
    """The causes of a saved result, as fixed causes of every session.

    Raises
    ------
    InputError
        If the result was fitted to this log, is of another machine, or has no causes.
    """
    if result.provenance.log_sha256 == log.sha256:
        raise InputError(
            "the causes of this result were fitted to the traverses that they would be judged by; name them "
            "with --cause, so that they are fitted to the other sessions, or take a result of another log"
        )
    return dict.fromkeys(log.sessions, fixed_causes(result, log.machine))


EXTRA_TRAVERSES = 4


def default_strategies_with_causes(
    known: Mapping[str, FixedCauses | str], extra: int = EXTRA_TRAVERSES
) -> tuple[Strategy, ...]:
    """Closed form and least squares, with causes of known size in the law; see `WithCauses`."""
    return (WithCauses(ClosedForm(), known), WithCauses(LeastSquares(IOptimal(), extra), known))


def default_strategies(extra: int = EXTRA_TRAVERSES, seed: int = 0) -> tuple[Strategy, ...]:
    """The thesis's two, then least squares and empirical Bayes with several designs.

    Parameters
    ----------
    extra : int, optional
        Traverses beyond the number of parameters, where least squares takes more.
    seed : int, optional
        Of those chosen at random.

    Examples
    --------
    >>> [strategy.name for strategy in default_strategies()][:3]
    ['constant step', 'closed form', 'least squares, thesis +4']
    """
    check_count("extra", extra, least=0)
    check_count("seed", seed, least=0)
    return (
        ConstantStepStrategy(),
        ClosedForm(),
        LeastSquares(Thesis(), extra),
        LeastSquares(AtRandom(seed), extra),
        LeastSquares(DOptimal()),
        LeastSquares(DOptimal(), extra),
        LeastSquares(IOptimal()),
        LeastSquares(IOptimal(), extra),
        Hierarchical(1),
        Hierarchical(2),
    )
