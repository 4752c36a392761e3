"""Each session's parameters where sessions inform each other, without sampling.

A session with few traverses borrows from the campaign what its own counts leave open: its parameters are
drawn to the campaign's mean by as much as the covariance between sessions allows (partial pooling; B. Efron
and C. Morris, Journal of the American Statistical Association 70:311, 1975). What changes from day to day,
such as friction, moves several parameters together and leaves others alone, so that a covariance says more
than a variance of each. It is estimated by the EM algorithm, the law linearized about each session's
parameters (N. Laird and J. Ware, Biometrics 38:963, 1982).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from stickslip_fit._typing import Array
from stickslip_fit.bayes.priors import PRIOR_REPEATABILITY, PRIOR_SPREAD, PRIOR_WIDTH
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import Groups, group_rows, mean_step_sizes
from stickslip_fit.estimation._optimize import minimize, normal_equations
from stickslip_fit.laws import StepLaw

EXPANSIONS = 3  # about each session's parameters; more change next to nothing
ITERATIONS = 12  # of the EM algorithm, in each; a hundred predict no better
# As if in one more session every parameter had been found to depart from the mean by so much of a step:
# without it a few sessions would leave the covariance singular.
PRIOR_DEPARTURE = 0.001
LEAST_REPEATABILITY = 1e-6  # of counts that a law passes through


@dataclass(frozen=True, eq=False)
class SessionMoments:
    """What counts say of the p parameters of S sessions; in units of `StepLaw.scales`, from start values.

    Attributes
    ----------
    values, departures : array, shape (S, p)
        Expected parameters of each session, and these less the campaign's mean.
    value_covariance, departure_covariance : array, shape (S, p, p)
    """

    values: Array
    departures: Array
    value_covariance: Array
    departure_covariance: Array


def pool_sessions(law: StepLaw, rows: pd.DataFrame) -> pd.DataFrame:
    """Expected parameters of the sessions of a joint and direction, SI, one row for each.

    Raises
    ------
    InputError
        If the joint would stall in one of them with the parameters that fit all sessions together.
    """
    groups, campaign = group_rows(rows), Groups(pd.DataFrame(index=[0]), np.zeros(len(rows), dtype=np.intp))
    y, rounding = law.response(rows)
    model, step = law.model(rows), mean_step_sizes(campaign, rows, y)
    centre, scales = law.start_values(step), law.scales(step)
    covariance, repeatability = PRIOR_SPREAD**2 * np.eye(len(law.parameters)), PRIOR_REPEATABILITY
    lower, upper = (np.array([getattr(one, end) for one in law.parameters]) for end in ("lower", "upper"))
    weight = 1.0 / (repeatability**2 + rounding)
    together = minimize(model, y, weight, campaign, centre, scales, lower=lower, upper=upper)
    values = np.repeat((together.values - centre) / scales, len(groups), axis=0)
    for _ in range(EXPANSIONS):
        weight, units = 1.0 / (repeatability**2 + rounding), np.repeat(scales, len(groups), axis=0)
        normal = normal_equations(model, y, weight, groups, centre + scales * values, units)
        products = _shift(normal.products, values)
        if not np.isfinite(products).all():
            raise InputError(f"joint {law.joint} would stall with the parameters that its sessions share")
        for _ in range(ITERATIONS):
            moments = _expect(products, covariance)
            # All noise, the small part of rounding included, is taken to change by one factor.
            least = (LEAST_REPEATABILITY / repeatability) ** 2
            factor = max(_noise_factor(products, moments, len(rows)), least)
            products, repeatability = products / factor, repeatability * np.sqrt(factor)
            covariance = _likeliest_covariance(moments)
        values = moments.values
    names = [parameter.name for parameter in law.parameters]
    return pd.DataFrame(centre + scales * values, groups.table["session"].to_numpy(), names)


def _shift(products: Array, values: Array) -> Array:
    """Products of [J, r] as those of [J, e], of each session, shape (S, p + 1, p + 1).

    J are the slopes, r the residuals, and e what the responses would be if the law were J times the values.
    """
    sessions, p = values.shape
    shift = np.broadcast_to(np.eye(p + 1), (sessions, p + 1, p + 1)).copy()
    shift[:, :p, p] = values
    return shift.swapaxes(1, 2) @ products @ shift


def _expect(products: Array, covariance: Array) -> SessionMoments:
    """Posterior of sessions and campaign's mean, which is known to `PRIOR_WIDTH` beforehand."""
    p = len(covariance)
    between, own = np.linalg.inv(covariance), products[:, :p, :p]
    alone = np.linalg.inv(own + between)
    drawn = alone @ between  # by how much a session follows the campaign's mean
    mean_covariance = np.linalg.inv(np.sum(own @ drawn, axis=0) + np.eye(p) / PRIOR_WIDTH**2)
    pull = (alone @ products[:, :p, p:])[..., 0]
    mean = mean_covariance @ np.sum(pull @ between, axis=0)
    values, apart = pull + drawn @ mean, drawn - np.eye(p)
    return SessionMoments(
        values,
        values - mean,
        alone + drawn @ mean_covariance @ drawn.swapaxes(1, 2),
        alone + apart @ mean_covariance @ apart.swapaxes(1, 2),
    )


def _noise_factor(products: Array, moments: SessionMoments, n: int) -> float:
    """Expected mean square of n residuals in units of the noise."""
    p, values = moments.values.shape[1], np.c_[moments.values, -np.ones(len(moments.values))]
    squares = np.einsum("si,sij,sj->", values, products, values)
    return float(squares + np.sum(products[:, :p, :p] * moments.value_covariance)) / n


def _likeliest_covariance(moments: SessionMoments) -> Array:
    departures = moments.departures
    squares = departures.T @ departures + moments.departure_covariance.sum(axis=0)
    return (squares + PRIOR_DEPARTURE**2 * np.eye(len(squares))) / (len(departures) + 1)
