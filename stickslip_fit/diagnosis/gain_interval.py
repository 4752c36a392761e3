"""95 % interval of the gain that a repeated campaign would show, by approximate Bayesian computation.

Effect strengths are drawn from a range around their estimates. For each draw two campaigns are
simulated, linearized at the fit, each with its noise, its splits and a selection that may miss a cause
or choose another one. Among the draws whose first campaign resembles the log, the second campaigns give
the interval (D. B. Rubin, Ann. Stat. 12:1151, 1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.diagnosis.cross_validation import Split

N_DRAWS = 2400
STRENGTH_RANGE = 4.0  # strengths by which a cause may differ from what it seems
RIVAL_LOG_EVIDENCE_SD = 4.0  # nats; how much noise changes what other shapes of a rival explain
ACCEPTED_SHARE = 0.15  # share of the natures that come closest to what was seen
MAX_ELEMENTS = 2_000_000  # numbers
MAX_LEVERAGE = 0.8
CAUSE_FOUND, NONE_FOUND = 0, -1  # what a search makes of a cause; else the number of the rival that it names


@dataclass(frozen=True, eq=False)
class CompetingCauses:
    """What else a search could take for a cause; r rivals.

    Attributes
    ----------
    shapes : array, shape (n, r)
        What each makes of the log, in units of the noise.
    ahead : array, shape (r,)
        Nats by which a rival is likelier than the cause where both explain equally much.
    names : array of bool, shape (r,)
        Whether it is a cause that can be predicted with; structure without a name cannot.
    """

    shapes: Array
    ahead: Array
    names: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LinearizedCampaign:
    """A log linearised about its fit, in units of its noise; n rows, k causes.

    Attributes
    ----------
    basis : sparse array, shape (n, p)
        What recalibration of the baseline can do.
    scale : array, shape (n,)
        Size of the noise, relative.
    noise : array, shape (n,)
        What is left under the fit, freed of what the fit takes up.
    effects : array, shape (n, k)
        What each cause does.
    slopes : tuple of array, each shape (n, q)
        Change with each of a cause's parameters.
    thresholds : array, shape (k,)
        Length of an effect that makes the search find it.
    rivals : tuple of Rivals
        Of each cause.
    """

    basis: csr_array
    scale: Array
    noise: Array
    effects: Array
    slopes: tuple[Array, ...]
    thresholds: Array
    rivals: tuple[CompetingCauses, ...]


@dataclass(frozen=True, eq=False)
class _SimulatedReplicates:
    """What m replicates show.

    Attributes
    ----------
    rms : array, shape (m, k + 1)
        Rms error of the baseline, with the first cause, with the first two, and so on.
    lengths : array, shape (m, k)
        How long each cause's effect looks, in repeatabilities.
    """

    rms: Array
    lengths: Array

    def gains(self, first: int, last: int) -> Array:
        """What the causes from one step to another gain, shape (m,)."""
        return self.rms[:, first] - self.rms[:, last]


def simulate_gain_interval(
    campaign: LinearizedCampaign,
    splits: Sequence[Split],
    others: Sequence[Sequence[Split]],
    seen: Array,
    rng: np.random.Generator,
    n_draws: int = N_DRAWS,
) -> Array:
    """What a fresh replicate may gain beyond what was seen.

    Parameters
    ----------
    campaign : Campaign
    splits : sequence of Split
        As they were in this campaign.
    others : sequence of sequence of Split
        As they may be in a fresh replicate.
    seen : array, shape (k + 1,)
        Rms error under the baseline, with the first cause, with the first two, and so on.
    rng : Generator
    natures : int, optional

    Returns
    -------
    array, shape (2, k + 1)
        Quantiles 0.025 and 0.975 of the fresh gain, of each cause after those before it, then of all.
    """
    misfit = _effect_lengths(campaign, campaign.effects)
    parts = [
        _simulate_replicate_pairs(campaign, splits, other, misfit.diagonal(), n_draws // len(others), rng)
        for other in others
    ]
    first, second = (_concatenate([part[which] for part in parts]) for which in range(2))
    steps = [(k, k + 1) for k in range(len(seen) - 1)] + [(0, len(seen) - 1)]
    found = []
    for step in steps:
        one, other, value = first.gains(*step), second.gains(*step), seen[step[0]] - seen[step[1]]
        own = slice(*step)
        unlike = np.mean((first.lengths - misfit.diagonal())[:, own] ** 2, axis=1)
        unlike += ((one - value) / max(float(np.std(other - one)), 1e-12)) ** 2
        alike = np.argsort(unlike, kind="stable")[: int(ACCEPTED_SHARE * len(one)) + 1]
        found.append(value + np.quantile(other[alike] - one[alike], [0.025, 0.975]))
    return np.stack(found, axis=1)


def _concatenate(parts: Sequence[_SimulatedReplicates]) -> _SimulatedReplicates:
    return _SimulatedReplicates(
        np.concatenate([part.rms for part in parts]), np.concatenate([part.lengths for part in parts])
    )


def _simulate_replicate_pairs(
    campaign: LinearizedCampaign,
    splits: Sequence[Split],
    others: Sequence[Split],
    misfit: Array,
    n_draws: int,
    rng: np.random.Generator,
) -> tuple[_SimulatedReplicates, _SimulatedReplicates]:
    """Two replicates of each nature in which the search would have found anything, each with its splits."""
    n, k = campaign.effects.shape
    off = STRENGTH_RANGE / np.maximum(misfit, 1e-9)
    both, each = [], max(MAX_ELEMENTS // n, 1)
    for begin in range(0, n_draws, each):
        number = min(each, n_draws - begin)
        times = rng.uniform(np.maximum(1.0 - off, 0.0), 1.0 + off, (number, k))
        truth = campaign.effects @ times.T
        both.append(
            [
                _simulate_replicates(campaign, subset, truth + _draw_noise(campaign, number, rng), rng)
                for subset in (splits, others)
            ]
        )
    first, second = (_concatenate([pair[which] for pair in both]) for which in range(2))
    shown = np.any(np.abs(first.lengths) > campaign.thresholds, axis=1)
    kept = shown if shown.any() else ~shown
    return tuple(_SimulatedReplicates(one.rms[kept], one.lengths[kept]) for one in (first, second))  # type: ignore[return-value]


def _draw_noise(campaign: LinearizedCampaign, number: int, rng: np.random.Generator) -> Array:
    n = len(campaign.noise)
    return rng.choice(campaign.noise, (n, number)) * rng.choice([-1.0, 1.0], (n, number))


def _effect_lengths(campaign: LinearizedCampaign, responses: Array) -> Array:
    """How long each cause's effect looks in each log, (n, m) -> (m, k)."""
    everything = np.arange(len(campaign.scale))
    return _project_along(campaign, everything, campaign.effects, responses)


def _project_along(
    campaign: LinearizedCampaign, training: IntArray, columns: Array, responses: Array
) -> Array:
    """Responses of some rows along columns, recalibration taken out of them; (n, c), (n, m) -> (m, c)."""
    direction = subtract_calibration(campaign.basis, training, training, columns)
    return responses[training].T @ (direction / np.maximum(np.linalg.norm(direction, axis=0), 1e-12))


def _simulate_replicates(
    campaign: LinearizedCampaign, splits: Sequence[Split], responses: Array, rng: np.random.Generator
) -> _SimulatedReplicates:
    m, k = responses.shape[1], len(campaign.slopes)
    squares, count = np.zeros((m, k + 1)), 0
    for split in splits:
        doubts = [
            RIVAL_LOG_EVIDENCE_SD * rng.standard_normal((m, len(each.ahead))) for each in campaign.rivals
        ]
        made = np.stack(
            [simulate_selection(campaign, j, split.train, responses, doubts[j]) for j in range(k)], axis=1
        )
        for what in np.unique(made, axis=0):
            subset = np.flatnonzero(np.all(made == what, axis=1))
            for step in range(k + 1):
                columns = _extension_columns(campaign, what[:step])
                off = predict_held_out_errors(campaign.basis, split, columns, responses[:, subset])
                squares[subset, step] += np.sum((off * campaign.scale[split.held, None]) ** 2, axis=0)
        count += len(split.held)
    return _SimulatedReplicates(np.sqrt(squares / count), _effect_lengths(campaign, responses))


def simulate_selection(
    campaign: LinearizedCampaign, cause: int, training: IntArray, responses: Array, doubt: Array | float = 0.0
) -> IntArray:
    """What a search of some rows makes of a cause in each log.

    Parameters
    ----------
    campaign : Campaign
    cause : int
    training : array of int
        Rows that are searched.
    responses : array, shape (n, m)
    doubt : array, shape (m, r), optional
        Nats by which each rival is likelier than that.

    Returns
    -------
    array of int, shape (m,)
        `NAMED`, the number of the rival that is taken for it, counted from 1, or `NOTHING`.
    """
    rivals = campaign.rivals[cause]
    columns = np.column_stack([campaign.effects[:, cause], rivals.shapes])
    length = np.abs(_project_along(campaign, training, columns, responses))
    left = subtract_calibration(campaign.basis, training, training, responses)
    df = len(training) - len(np.unique(campaign.basis[training].indices))
    explained = length**2 / np.sum(left**2, axis=0)[:, None]
    likely = log_likelihood_ratio(explained, df)
    likely[:, 1:] += rivals.ahead + doubt
    best = np.argmax(likely, axis=1)
    alarm = np.take_along_axis(length, best[:, None], axis=1)[:, 0] > campaign.thresholds[cause]
    return np.where(alarm & np.append(True, rivals.names)[best], best, NONE_FOUND)


def log_likelihood_ratio(explained: npt.ArrayLike, df: int) -> Array:
    """Of what explains a share of the squared residuals, at its best, the noise's size being unknown."""
    return -0.5 * df * np.log1p(-np.minimum(explained, 1.0 - 1e-12))


def _extension_columns(campaign: LinearizedCampaign, made: IntArray) -> list[Array]:
    """What the laws can do with what a search made of the first causes."""
    return [
        campaign.slopes[cause] if what == CAUSE_FOUND else campaign.rivals[cause].shapes[:, what - 1 : what]
        for cause, what in enumerate(made)
        if what != NONE_FOUND
    ]


def predict_held_out_errors(
    basis: csr_array, split: Split, slopes: Sequence[Array], responses: Array
) -> Array:
    """Errors on the rows held out, in units of the noise, with causes in the laws.

    Parameters
    ----------
    basis : sparse array, shape (n, p)
        What recalibration of the baseline can do.
    split : Split
    slopes : sequence of array, each shape (n, q)
        What each cause can do.
    responses : array, shape (n, m)

    Returns
    -------
    array, shape (number held out, m)
    """
    plain = subtract_calibration(basis, split.calibration, split.held, responses)
    if not slopes:
        return plain
    columns = np.concatenate(slopes, axis=1)
    trained = subtract_calibration(basis, split.train, split.train, columns)
    sizes = np.linalg.lstsq(trained, responses[split.train], rcond=1e-6)[0]
    return plain - subtract_calibration(basis, split.calibration, split.held, columns) @ sizes


def subtract_calibration(basis: csr_array, calibration: IntArray, held: IntArray, columns: Array) -> Array:
    """What some rows show beyond a recalibration by others, (n, m) -> (number held, m).

    Parameters
    ----------
    basis : sparse array, shape (n, p)
    calibrating, held : array of int
        Every parameter that acts on the rows held is known from the calibrating ones.
    columns : array, shape (n, m)
    """
    acting = np.unique(basis[held].indices)
    known, wanted = basis[calibration][:, acting], basis[held][:, acting]
    normal = splu((known.T @ known).tocsc())
    return columns[held] - wanted @ normal.solve(known.T @ columns[calibration])
