"""How far the gain of a fresh replicate of a campaign may be from the gain that this one showed.

Both have their own noise, and in both the search may fail in some folds where a cause is weak. Natures are
drawn in which the causes are stronger or weaker than they seem, and for each two replicates of the campaign,
linearised about its fit. Of the natures whose first replicate gains about what the log did, the second ones
say what a fresh replicate would gain (D. B. Rubin, Ann. Stat. 12:1151, 1984, on simulating what is given).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from stickslip_fit.diagnose.folds import Split

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Mask = npt.NDArray[np.bool_]

NATURES = 2000
RANGE = 4.0  # strengths by which a cause may differ from what it seems
ALIKE = 0.15  # share of the natures that come closest to what was seen
AT_A_TIME = 2_000_000  # numbers
LARGEST_LEVERAGE = 0.8


@dataclass(frozen=True, eq=False)
class Campaign:
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
    """

    basis: csr_array
    scale: Array
    noise: Array
    effects: Array
    slopes: tuple[Array, ...]
    thresholds: Array


def spread(
    campaign: Campaign, splits: Sequence[Split], seen: Array, rng: np.random.Generator, natures: int = NATURES
) -> Array:
    """What a fresh replicate may gain beyond what was seen.

    Parameters
    ----------
    campaign : Campaign
    splits : sequence of Split
    seen : array, shape (k + 1,)
        Rms error under the baseline, with the first cause, with the first two, and so on.
    rng : Generator
    natures : int, optional

    Returns
    -------
    array, shape (2, k + 1)
        Quantiles 0.025 and 0.975 of the fresh gain, of each cause after those before it, then of all.
    """
    first, second = _two_replicates(campaign, splits, natures, rng)
    gained = [(_gains(first[:, k : k + 2]), _gains(second[:, k : k + 2])) for k in range(len(seen) - 1)]
    gained.append((_gains(first), _gains(second)))
    shown = np.append(seen[:-1] - seen[1:], seen[0] - seen[-1])
    found = []
    for (one, other), value in zip(gained, shown, strict=True):
        alike = np.argsort(np.abs(one - value), kind="stable")[: int(ALIKE * len(one)) + 1]
        found.append(value + np.quantile(other[alike] - one[alike], [0.025, 0.975]))
    return np.stack(found, axis=1)


def _gains(rms: Array) -> Array:
    return rms[:, 0] - rms[:, -1]


def _two_replicates(
    campaign: Campaign, splits: Sequence[Split], natures: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Rms errors of two replicates of each nature in which the search would have found anything."""
    n, k = campaign.effects.shape
    everything = np.arange(n)
    strength = np.linalg.norm(left_over(campaign.basis, everything, everything, campaign.effects), axis=0)
    off = RANGE / np.maximum(strength, 1e-9)
    both, each = [], max(AT_A_TIME // n, 1)
    for begin in range(0, natures, each):
        number = min(each, natures - begin)
        times = rng.uniform(np.maximum(1.0 - off, 0.0), 1.0 + off, (number, k))
        truth = campaign.effects @ times.T
        both.append([_rms(campaign, splits, truth + _noise(campaign, number, rng)) for _ in range(2)])
    first, second = (np.concatenate([pair[which] for pair in both]) for which in range(2))
    shown = np.isfinite(first[:, 0])
    kept = shown if shown.any() else ~shown
    return np.nan_to_num(first[kept]), np.nan_to_num(second[kept])


def _noise(campaign: Campaign, number: int, rng: np.random.Generator) -> Array:
    n = len(campaign.noise)
    return rng.choice(campaign.noise, (n, number)) * rng.choice([-1.0, 1.0], (n, number))


def _rms(campaign: Campaign, splits: Sequence[Split], responses: Array) -> Array:
    """Rms errors of each log, (n, m) -> (m, k + 1); NaN for logs in which the search finds nothing."""
    n, m = responses.shape
    k = len(campaign.slopes)
    squares, count = np.zeros((m, k + 1)), 0
    for split in splits:
        found = _found(campaign, split.training, responses)
        for mask in np.unique(found, axis=0):
            mine = np.flatnonzero(np.all(found == mask, axis=1))
            for step in range(k + 1):
                chosen = mask & (np.arange(k) < step)
                off = predicted_off(campaign, split, chosen, responses[:, mine])
                squares[mine, step] += np.sum((off * campaign.scale[split.held, None]) ** 2, axis=0)
        count += len(split.held)
    rms = np.sqrt(squares / count)
    rms[~_found(campaign, np.arange(n), responses).any(axis=1)] = np.nan
    return rms


def _found(campaign: Campaign, training: Indices, responses: Array) -> Mask:
    """Which causes the search finds in some rows of each log, (n, m) -> (m, k)."""
    direction = left_over(campaign.basis, training, training, campaign.effects)
    length = np.maximum(np.linalg.norm(direction, axis=0), 1e-12)
    return np.abs(responses[training].T @ direction / length) > campaign.thresholds


def predicted_off(campaign: Campaign, split: Split, chosen: Mask, responses: Array) -> Array:
    """Errors on the rows held out, in units of the noise, with some causes in the laws.

    Parameters
    ----------
    campaign : Campaign
    split : Split
    chosen : array of bool, shape (k,)
    responses : array, shape (n, m)

    Returns
    -------
    array, shape (number held out, m)
    """
    plain = left_over(campaign.basis, split.calibrating, split.held, responses)
    slopes = [each for each, taken in zip(campaign.slopes, chosen, strict=True) if taken]
    if not slopes:
        return plain
    columns = np.concatenate(slopes, axis=1)
    trained = left_over(campaign.basis, split.training, split.training, columns)
    sizes = np.linalg.lstsq(trained, responses[split.training], rcond=1e-6)[0]
    return plain - left_over(campaign.basis, split.calibrating, split.held, columns) @ sizes


def left_over(basis: csr_array, calibrating: Indices, held: Indices, columns: Array) -> Array:
    """What some rows show beyond a recalibration by others, (n, m) -> (number held, m).

    Parameters
    ----------
    basis : sparse array, shape (n, p)
    calibrating, held : array of int
        Every parameter that acts on the rows held is known from the calibrating ones.
    columns : array, shape (n, m)
    """
    acting = np.unique(basis[held].indices)
    known, wanted = basis[calibrating][:, acting], basis[held][:, acting]
    normal = splu((known.T @ known).tocsc())
    return columns[held] - wanted @ normal.solve(known.T @ columns[calibrating])
