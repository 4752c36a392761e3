"""How far the gain of a fresh replicate of a campaign may be from the gain that this one showed.

Both have their own noise and hold other configurations out together, and in both the search may fail in some
folds where a cause is weak, or take another cause for it. Natures are drawn in which the causes are stronger
or weaker than they seem, and for each two replicates of the campaign, linearised about its fit. Of the
natures whose first replicate looks about as the log did, the second ones say what a fresh replicate would
gain (D. B. Rubin, Ann. Stat. 12:1151, 1984, on simulating what is given).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu

from stickslip_fit.diagnose.worth.folds import Split

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

NATURES = 2400
RANGE = 4.0  # strengths by which a cause may differ from what it seems
DOUBT = 4.0  # nats; how much noise changes what other shapes of a rival explain
ALIKE = 0.15  # share of the natures that come closest to what was seen
AT_A_TIME = 2_000_000  # numbers
LARGEST_LEVERAGE = 0.8
NAMED, NOTHING = 0, -1  # what a search makes of a cause; else the number of the rival that it names


@dataclass(frozen=True, eq=False)
class Rivals:
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
    rivals : tuple of Rivals
        Of each cause.
    """

    basis: csr_array
    scale: Array
    noise: Array
    effects: Array
    slopes: tuple[Array, ...]
    thresholds: Array
    rivals: tuple[Rivals, ...]


@dataclass(frozen=True, eq=False)
class _Shown:
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


def spread(
    campaign: Campaign,
    splits: Sequence[Split],
    others: Sequence[Sequence[Split]],
    seen: Array,
    rng: np.random.Generator,
    natures: int = NATURES,
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
    looked = _lengths(campaign, campaign.effects)
    parts = [
        _two_replicates(campaign, splits, other, looked.diagonal(), natures // len(others), rng)
        for other in others
    ]
    first, second = (_joined([part[which] for part in parts]) for which in range(2))
    steps = [(k, k + 1) for k in range(len(seen) - 1)] + [(0, len(seen) - 1)]
    found = []
    for step in steps:
        one, other, value = first.gains(*step), second.gains(*step), seen[step[0]] - seen[step[1]]
        own = slice(*step)
        unlike = np.mean((first.lengths - looked.diagonal())[:, own] ** 2, axis=1)
        unlike += ((one - value) / max(float(np.std(other - one)), 1e-12)) ** 2
        alike = np.argsort(unlike, kind="stable")[: int(ALIKE * len(one)) + 1]
        found.append(value + np.quantile(other[alike] - one[alike], [0.025, 0.975]))
    return np.stack(found, axis=1)


def _joined(parts: Sequence[_Shown]) -> _Shown:
    return _Shown(
        np.concatenate([part.rms for part in parts]), np.concatenate([part.lengths for part in parts])
    )


def _two_replicates(
    campaign: Campaign,
    splits: Sequence[Split],
    others: Sequence[Split],
    looked: Array,
    natures: int,
    rng: np.random.Generator,
) -> tuple[_Shown, _Shown]:
    """Two replicates of each nature in which the search would have found anything, each with its splits."""
    n, k = campaign.effects.shape
    off = RANGE / np.maximum(looked, 1e-9)
    both, each = [], max(AT_A_TIME // n, 1)
    for begin in range(0, natures, each):
        number = min(each, natures - begin)
        times = rng.uniform(np.maximum(1.0 - off, 0.0), 1.0 + off, (number, k))
        truth = campaign.effects @ times.T
        both.append(
            [_shown(campaign, mine, truth + _noise(campaign, number, rng), rng) for mine in (splits, others)]
        )
    first, second = (_joined([pair[which] for pair in both]) for which in range(2))
    shown = np.any(np.abs(first.lengths) > campaign.thresholds, axis=1)
    kept = shown if shown.any() else ~shown
    return tuple(_Shown(one.rms[kept], one.lengths[kept]) for one in (first, second))  # type: ignore[return-value]


def _noise(campaign: Campaign, number: int, rng: np.random.Generator) -> Array:
    n = len(campaign.noise)
    return rng.choice(campaign.noise, (n, number)) * rng.choice([-1.0, 1.0], (n, number))


def _lengths(campaign: Campaign, responses: Array) -> Array:
    """How long each cause's effect looks in each log, (n, m) -> (m, k)."""
    everything = np.arange(len(campaign.scale))
    return _along(campaign, everything, campaign.effects, responses)


def _along(campaign: Campaign, training: Indices, columns: Array, responses: Array) -> Array:
    """Responses of some rows along columns, recalibration taken out of them; (n, c), (n, m) -> (m, c)."""
    direction = left_over(campaign.basis, training, training, columns)
    return responses[training].T @ (direction / np.maximum(np.linalg.norm(direction, axis=0), 1e-12))


def _shown(campaign: Campaign, splits: Sequence[Split], responses: Array, rng: np.random.Generator) -> _Shown:
    m, k = responses.shape[1], len(campaign.slopes)
    squares, count = np.zeros((m, k + 1)), 0
    for split in splits:
        doubts = [DOUBT * rng.standard_normal((m, len(each.ahead))) for each in campaign.rivals]
        made = np.stack(
            [made_of(campaign, j, split.training, responses, doubts[j]) for j in range(k)], axis=1
        )
        for what in np.unique(made, axis=0):
            mine = np.flatnonzero(np.all(made == what, axis=1))
            for step in range(k + 1):
                columns = _columns(campaign, what[:step])
                off = predicted_off(campaign.basis, split, columns, responses[:, mine])
                squares[mine, step] += np.sum((off * campaign.scale[split.held, None]) ** 2, axis=0)
        count += len(split.held)
    return _Shown(np.sqrt(squares / count), _lengths(campaign, responses))


def made_of(
    campaign: Campaign, cause: int, training: Indices, responses: Array, doubt: Array | float = 0.0
) -> Indices:
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
    length = np.abs(_along(campaign, training, columns, responses))
    left = left_over(campaign.basis, training, training, responses)
    freedom = len(training) - len(np.unique(campaign.basis[training].indices))
    explained = length**2 / np.sum(left**2, axis=0)[:, None]
    likely = log_likelihood_ratio(explained, freedom)
    likely[:, 1:] += rivals.ahead + doubt
    best = np.argmax(likely, axis=1)
    alarm = np.take_along_axis(length, best[:, None], axis=1)[:, 0] > campaign.thresholds[cause]
    return np.where(alarm & np.append(True, rivals.names)[best], best, NOTHING)


def log_likelihood_ratio(explained: npt.ArrayLike, freedom: int) -> Array:
    """Of what explains a share of the squared residuals, at its best, the noise's size being unknown."""
    return -0.5 * freedom * np.log1p(-np.minimum(explained, 1.0 - 1e-12))


def _columns(campaign: Campaign, made: Indices) -> list[Array]:
    """What the laws can do with what a search made of the first causes."""
    return [
        campaign.slopes[cause] if what == NAMED else campaign.rivals[cause].shapes[:, what - 1 : what]
        for cause, what in enumerate(made)
        if what != NOTHING
    ]


def predicted_off(basis: csr_array, split: Split, slopes: Sequence[Array], responses: Array) -> Array:
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
    plain = left_over(basis, split.calibrating, split.held, responses)
    if not slopes:
        return plain
    columns = np.concatenate(slopes, axis=1)
    trained = left_over(basis, split.training, split.training, columns)
    sizes = np.linalg.lstsq(trained, responses[split.training], rcond=1e-6)[0]
    return plain - left_over(basis, split.calibrating, split.held, columns) @ sizes


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
