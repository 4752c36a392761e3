"""Predictions from draws: of sessions that were fitted, and of sessions yet to come."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtri

from stickslip_fit.errors import InputError
from stickslip_fit.fit.bayes.means import BOUNDS
from stickslip_fit.fit.bayes.posterior import Posterior
from stickslip_fit.fit.bayes.traverses import predict_draws
from stickslip_fit.laws import travel

Array = npt.NDArray[np.float64]
COLUMNS = ("steps", "step_size", "relative_error", "low", "high")


def predict(posterior: Posterior, rows: pd.DataFrame, *, seed: int = 0) -> pd.DataFrame:
    """Steps and step size for traverses of any session.

    A session that was not fitted, such as today's, is predicted from what the campaign's sessions have in
    common and how far they spread.

    Parameters
    ----------
    posterior : Posterior
    rows : DataFrame
        A log's columns; steps are not needed.
    seed : int, optional

    Returns
    -------
    DataFrame, indexed as `rows`
        steps, step_size (rad or m), relative_error (of the law, from its parameters), and low, high: 95 %
        interval of the steps that a new traverse takes, repeatability included. NaN where the fit has
        not converged or a parameter is not identified, see `Posterior.result.remarks`.

    Raises
    ------
    InputError
        For a joint or direction that was not fitted, or where the joint may well stall.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for (joint, direction), mine in rows.groupby(["joint", "direction"], observed=True, sort=False):
        group = (int(joint), str(direction))
        if group not in posterior.groups:
            fitted = ", ".join(f"{joint} {way}" for joint, way in posterior.groups)
            raise InputError(f"joint {joint}, direction {direction} was not fitted; fitted were {fitted}")
        parts.append(_predict(posterior, group, mine, rng))
    if not parts:
        return pd.DataFrame(columns=list(COLUMNS), dtype=float)
    return pd.concat(parts).loc[rows.index]


def _predict(
    posterior: Posterior, group: tuple[int, str], rows: pd.DataFrame, rng: np.random.Generator
) -> pd.DataFrame:
    values, repeatability = _parameters(posterior, group, rows, rng), posterior.draws(*group, "repeatability")
    response = predict_draws(posterior.result.joints[group[0]].law, rows, values)
    if np.any(np.mean(np.isnan(response), axis=0) > BOUNDS[0]):
        raise InputError(
            f"joint {group[0]}, direction {group[1]} may stall in a traverse that is to be predicted; "
            "log more traverses, or leave this one out"
        )
    # A draw that stalls takes steps without end.
    response = np.where(np.isnan(response), np.inf, response)
    seen = response + repeatability[:, None] * _even_noise(response.shape, rng)
    steps = np.exp(np.median(response, axis=0))
    low, high = np.exp(np.quantile(seen, BOUNDS, axis=0))
    spread = np.nanstd(np.where(np.isinf(response), np.nan, response), axis=0)
    columns = (steps, travel(rows) / steps, spread, low, high)
    known = _known(posterior, group)
    found = {name: column if known else np.nan for name, column in zip(COLUMNS, columns, strict=True)}
    return pd.DataFrame(found, index=rows.index)


def _even_noise(shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Standard normal noise, (d, n), its d numbers as even as can be: few give good quantiles."""
    steps = ndtri((np.arange(shape[0]) + 0.5) / shape[0])
    return rng.permuted(np.broadcast_to(steps[:, None], shape), axis=0)


def _parameters(
    posterior: Posterior, group: tuple[int, str], rows: pd.DataFrame, rng: np.random.Generator
) -> Array:
    """Draws of each row's parameters, shape (d, n, p)."""
    fitted, mean, spread = (posterior.draws(*group, name) for name in ("parameters", "mean", "spread"))
    sessions = posterior.sessions(*group)
    fresh = [each for each in rows["session"].astype(str).unique() if each not in sessions]
    noise = rng.standard_normal((len(mean), len(fresh), mean.shape[1]))
    to_come = mean[:, None] + spread[:, None] * noise
    index = pd.Index([*sessions, *fresh]).get_indexer(rows["session"].astype(str))
    return np.concatenate([fitted, to_come], axis=1)[:, index]


def _known(posterior: Posterior, group: tuple[int, str]) -> bool:
    fit = posterior.result.joints[group[0]]
    return bool(fit.known[(fit.groups["direction"] == group[1]).to_numpy()].all())
