"""Hierarchical Bayes: a few traverses today, and all that other sessions have in common with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from stickslip_fit.fit.bayes.expansion import expand
from stickslip_fit.fit.bayes.marginal import Conditional
from stickslip_fit.fit.bayes.priors import SPREAD, weak_prior
from stickslip_fit.fit.bayes.traverses import lay_out
from stickslip_fit.strategies.calibrated import from_parameters
from stickslip_fit.strategies.designs import Design, IOptimal
from stickslip_fit.strategies.task import Predictor, Task, Unsuited

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


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

    def choose(self, task: Task) -> Indices:
        """See `Strategy.choose`."""
        return self.design.pick(task, self.traverses, SPREAD)

    def calibrate(self, task: Task, made: pd.DataFrame) -> Predictor:
        """See `Strategy.calibrate`."""
        if task.others.empty:
            raise Unsuited("there is no other session to look back on")
        traverses = lay_out(task.law, pd.concat([task.others, made]))
        prior = weak_prior(task.law, traverses.rows)
        marginal, mode, _ = expand(traverses, prior)
        today = list(traverses.groups.table["session"]).index(task.session)
        z, covariance = _session(marginal.conditional(mode[None]), today)
        values = prior.centre + prior.width * z
        return from_parameters(task.law, values, covariance * np.outer(prior.width, prior.width))


def _session(given: Conditional, session: int) -> tuple[Array, Array]:
    """Mean, shape (p,), and covariance, shape (p, p), of a session's z given the levels."""
    mean, tau = given.sessions(given.centre)[:, session, 0], given.tau[:, 0]
    form, eye = given.form[:, :, session, 0], np.eye(len(tau))
    inside = np.linalg.inv(eye + form)
    # How z follows the campaign's mean, whose own uncertainty goes with it.
    follows = eye - tau[:, None] * (inside @ form) / tau
    campaign = np.linalg.inv(given.precision[:, :, 0])
    return mean, tau[:, None] * inside * tau + follows @ campaign @ follows.T
