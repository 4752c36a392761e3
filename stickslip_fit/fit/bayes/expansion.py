"""Where to linearise each session: at the mode of its parameters under the campaign's likeliest levels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stickslip_fit.errors import InputError
from stickslip_fit.fit.bayes.laplace import find_mode
from stickslip_fit.fit.bayes.marginal import Marginal, linearise
from stickslip_fit.fit.bayes.priors import Prior
from stickslip_fit.fit.bayes.traverses import Traverses
from stickslip_fit.fit.groups import Groups
from stickslip_fit.fit.levenberg_marquardt import minimise

Array = npt.NDArray[np.float64]

# The first round starts from the prior alone and the second from what it finds; then little is left to gain.
ROUNDS = 3


def expand(traverses: Traverses, prior: Prior) -> tuple[Marginal, Array, Array]:
    """Linearise a joint and direction.

    Returns
    -------
    marginal : Marginal
    mode : array, shape (p + 1,)
        Of its density.
    covariance : array, shape (p + 1, p + 1)
        There.

    Raises
    ------
    InputError
        If the joint stalls under the prior's own centre.
    """
    if not np.all(np.isfinite(traverses.law.predict(traverses.rows, prior.centre))):
        raise InputError(
            f"joint {traverses.law.joint} would stall with the parameters at the centre of its prior; "
            "give a centre with step sizes above 0 in every traverse"
        )
    p, sessions = len(prior.centre), len(traverses.groups)
    z, mean, x = np.zeros((sessions, p)), np.zeros(p), np.zeros(p + 1)
    spread, repeatability = prior.width, np.array(prior.repeatability)
    for _ in range(ROUNDS):
        z = _session_modes(traverses, prior, z, mean, spread / prior.width, repeatability)
        marginal = linearise(traverses, prior, z)
        x, covariance = find_mode(marginal.log_density, x)
        mean = marginal.conditional(x[None]).centre[:, 0]
        spread, repeatability = prior.levels(x)
    return marginal, x, covariance


def _session_modes(
    traverses: Traverses, prior: Prior, start: Array, mean: Array, tau: Array, repeatability: Array
) -> Array:
    """Each session's likeliest z, shape (S, p): least squares with the campaign as p more readings."""
    sessions, p = start.shape
    model = traverses.law.model(traverses.rows)
    owner = np.repeat(np.arange(sessions), p)
    n = len(traverses.y)

    def with_campaign(z: Array) -> tuple[Array, Array]:
        predicted, slopes = model(prior.centre + prior.width * z[:n])
        own = np.tile(np.arange(p), sessions)
        return (
            np.append(predicted, z[np.arange(n, len(z)), own]),
            np.concatenate([slopes * prior.width, np.eye(p)[own]]),
        )

    weight = np.append(1.0 / (repeatability**2 + traverses.rounding), np.tile(tau**-2, sessions))
    groups = Groups(traverses.groups.table, np.append(traverses.groups.of_row, owner))
    y = np.append(traverses.y, np.tile(mean, sessions))
    return minimise(with_campaign, y, weight, groups, start, np.ones_like(start)).values
