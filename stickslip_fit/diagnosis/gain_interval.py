"""95 % interval of the gain that a repeated campaign would show, by approximate Bayesian computation.

Effect strengths are drawn from a range around their estimates, and how well the law's form predicts
held-out rows. For each draw two campaigns are simulated, linearized at the fit, each with its noise and
a selection that may miss a cause or choose another one. Among the draws whose first campaign resembles
the log, the second campaigns give the interval (D. B. Rubin, Ann. Stat. 12:1151, 1984).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from stickslip_fit._linalg import svd
from stickslip_fit._rows import unique_rows
from stickslip_fit._typing import Array, BoolArray, IntArray
from stickslip_fit.diagnosis.cross_validation import Split
from stickslip_fit.diagnosis.evidence import log_likelihood_ratio
from stickslip_fit.diagnosis.linearized import MIN_EFFECT, seen_directions
from stickslip_fit.units import Z_95

Recolouring = Callable[[Array], Array]
"""From whitened columns, shape (n, m), to those in units of the noise of each row, correlated again."""

N_DRAWS = 2400
STRENGTH_RANGE = 4.0  # of the prior on a strength, on either side of the estimate
RIVAL_LOG_EVIDENCE_SD = 4.0  # nats; spread of a rival's evidence, from the maximum over its other shapes
EXACT_SHARE = 0.5  # of the draws, in which the law's form is that of the true effect
MAX_EXCESS = 1.4  # of the others: held-out error over that of the exact form, at most
ACCEPTED_SHARE = 0.15  # of the draws: those closest to the log
MAX_ELEMENTS = 2_000_000  # numbers in memory
MIN_LENGTH, RANK_TOL = 1e-12, 1e-6  # of a direction; of singular values
CAUSE_FOUND, NONE_FOUND = 0, -1  # result of a simulated selection; else the number of the rival, from 1


def keep_columns(columns: Array) -> Array:
    """The recolouring of rows whose noise is independent."""
    return columns


@dataclass(frozen=True, eq=False)
class CompetingCauses:
    """Rivals that a selection could confuse with a cause; r rivals.

    Attributes
    ----------
    shapes : array, shape (n, r)
        The part of the residuals that each explains, whitened.
    log_bayes_factor : array, shape (r,)
        Log Bayes factor of each rival over the cause where both explain the same share.
    is_known : array of bool, shape (r,)
        Whether it can extend the law; unknown structure cannot.
    """

    shapes: Array
    log_bayes_factor: Array
    is_known: BoolArray


@dataclass(frozen=True, eq=False)
class LinearizedCampaign:
    """A log linearized about its fit, whitened; n rows, k causes.

    Attributes
    ----------
    basis : sparse array, shape (n, p)
        Directions of the calibration parameters.
    scale : array, shape (n,)
        Standard deviation of the noise, relative.
    noise : array, shape (n,)
        Residuals under the fit over sqrt(1 - leverage).
    effects : array, shape (n, k)
    slopes : tuple of array, each shape (n, q)
        Derivatives with respect to each cause's parameters.
    penalties : tuple of array, each shape (q,)
        Inverse standard deviation of each parameter's prior about zero; 0 without one.
    thresholds : array, shape (k,)
        Length of an effect at which the selection detects it.
    competing_causes : tuple of CompetingCauses
        Of each cause.
    recolour : callable
        Held-out errors are those of the responses themselves, not of their innovations.
    """

    basis: csr_array
    scale: Array
    noise: Array
    effects: Array
    slopes: tuple[Array, ...]
    penalties: tuple[Array, ...]
    thresholds: Array
    competing_causes: tuple[CompetingCauses, ...]
    recolour: Recolouring = keep_columns

    def by_seen_directions(self) -> LinearizedCampaign:
        """The same with fewer parameters of causes that have more of them, all with a prior, than rows."""
        slopes, penalties = list(self.slopes), list(self.penalties)
        for number, (own, inverse) in enumerate(zip(slopes, penalties, strict=True)):
            if len(own) < own.shape[1] and inverse.all():
                slopes[number] = own / inverse @ seen_directions(own / inverse, MIN_EFFECT)
                penalties[number] = np.ones(slopes[number].shape[1])
        return replace(self, slopes=tuple(slopes), penalties=tuple(penalties))

    @cached_property
    def columns(self) -> Array:
        """All that a selection may find, shape (n, c): of each cause its effect, rivals and slopes."""
        parts = [
            np.column_stack([effect, rivals.shapes, slopes])
            for effect, rivals, slopes in zip(self.effects.T, self.competing_causes, self.slopes, strict=True)
        ]
        return np.concatenate(parts, axis=1)

    @cached_property
    def places(self) -> tuple[tuple[slice, slice], ...]:
        """Where the effect and rivals of each cause, and its slopes, stand in `columns`."""
        places, first = [], 0
        for rivals, slopes in zip(self.competing_causes, self.slopes, strict=True):
            middle = first + 1 + rivals.shapes.shape[1]
            last = middle + slopes.shape[1]
            places.append((slice(first, middle), slice(middle, last)))
            first = last
        return tuple(places)

    def spread_slopes(self, slopes: Array) -> Array:
        """Slopes of all causes, shape (h, q), where they stand in `columns`, and zeros, shape (h, c)."""
        spread = np.zeros((len(slopes), self.columns.shape[1]))
        spread[:, np.concatenate([np.r_[own] for _, own in self.places])] = slopes
        return spread

    @cached_property
    def _whole(self) -> CalibrationOperator:
        every = np.arange(len(self.scale))
        return prepare_calibration(self.basis, every, every)

    def effect_lengths(self, responses: Responses) -> Array:
        """Estimated length of each cause's effect in each log, shape (m, k)."""
        own = [candidates.start for candidates, _ in self.places]
        direction = self._whole.subtract(self.effects)
        products = self._whole.sum_training(self, responses).products[own]
        return (products / np.maximum(np.linalg.norm(direction, axis=0), MIN_LENGTH)[:, None]).T


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of m simulated logs, and sums over all rows, from which those over a part follow.

    Attributes
    ----------
    values : array, shape (n, m)
    squares : array, shape (m,)
    sums : array, shape (p, m)
        Products with the directions of the calibration.
    products : array, shape (c, m)
        With the campaign's `columns`.
    """

    values: Array
    squares: Array
    sums: Array
    products: Array

    @classmethod
    def of(cls, campaign: LinearizedCampaign, values: Array) -> Responses:
        """With their sums."""
        squares = np.einsum("ij,ij->j", values, values)
        return cls(values, squares, campaign.basis.T @ values, campaign.columns.T @ values)


@dataclass(frozen=True, eq=False)
class TrainingSums:
    """As of `Responses`, over the training rows only, the calibration by these projected out.

    Attributes
    ----------
    squares : array, shape (m,)
    products : array, shape (c, m)
    """

    squares: Array
    products: Array


@dataclass(frozen=True, eq=False)
class CalibrationOperator:
    """Calibration with c of n rows, and the prediction of h rows by it; p parameters act on these.

    It depends on the design only, so that one serves all simulated logs.

    Attributes
    ----------
    predicted : array of int, shape (h,)
    basis : sparse array, shape (h, p)
        Directions of the parameters in the predicted rows.
    inverse : sparse array, shape (p, p)
        Of the normal matrix of the calibration rows.
    known : sparse array, shape (p, n)
        Directions in the calibration rows; zero in the others.
    acting : array of int, shape (p,)
        Which of all directions these are.
    outside : array of int
        Rows that do not calibrate.
    unknown : sparse array, shape (p, number outside)
        Directions in those.
    recolour : callable
        Applied to what is predicted.
    """

    predicted: IntArray
    basis: csr_array
    inverse: csr_array
    known: csr_array
    acting: IntArray
    outside: IntArray
    unknown: csr_array
    recolour: Recolouring = keep_columns

    def subtract(self, columns: Array) -> Array:
        """The predicted rows less their prediction, (n, m) -> (h, m)."""
        return self._subtract(columns, self.known @ columns)

    def subtract_prediction(self, responses: Responses) -> Array:
        """As `subtract`, shape (h, m)."""
        return self._subtract(responses.values, self._sum_known(responses))

    def _subtract(self, columns: Array, sums: Array) -> Array:
        own = (
            columns[self.predicted]
            if self.recolour is keep_columns
            else self.recolour(columns)[self.predicted]
        )
        return own - self.basis @ (self.inverse @ sums)

    def _sum_known(self, responses: Responses) -> Array:
        """`known @ values`, by whichever rows are fewer."""
        if self.known.nnz < self.unknown.nnz:
            return self.known @ responses.values
        return responses.sums[self.acting] - self.unknown @ responses.values[self.outside]

    def sum_training(self, campaign: LinearizedCampaign, responses: Responses) -> TrainingSums:
        """Sums over the predicted rows, where these are those of calibration."""
        sums, columns = self._sum_known(responses), campaign.columns
        solved, outside = self.inverse @ sums, responses.values[self.outside]
        squares = responses.squares - np.einsum("ij,ij->j", outside, outside)
        products = responses.products - columns[self.outside].T @ outside
        return TrainingSums(
            squares - np.einsum("ij,ij->j", sums, solved), products - (self.known @ columns).T @ solved
        )


def prepare_calibration(
    basis: csr_array, calibration: IntArray, predicted: IntArray, recolour: Recolouring = keep_columns
) -> CalibrationOperator:
    """The calibration by some rows and the prediction of others.

    `basis`, shape (n, number of all parameters), spans the calibration. The calibration rows must determine
    every parameter that acts on the predicted rows.
    """
    wanted = (basis if recolour is keep_columns else csr_array(recolour(basis.toarray())))[predicted]
    acting, n = np.unique(wanted.indices).astype(np.intp), basis.shape[0]
    own = csc_array(basis[calibration][:, acting])
    normal = splu(csc_array(own.T @ own))
    place = csr_array(
        (np.ones(len(calibration)), (np.arange(len(calibration)), calibration)), shape=(len(calibration), n)
    )
    outside = np.setdiff1d(np.arange(n), calibration)
    return CalibrationOperator(
        predicted,
        csr_array(wanted[:, acting]),
        csr_array(normal.solve(np.eye(len(acting)))),
        csr_array(own.T @ place),
        acting,
        outside,
        csr_array(basis[outside][:, acting].T),
        recolour,
    )


@dataclass(frozen=True, eq=False)
class _SimulatedReplicates:
    """What m replicates show.

    Attributes
    ----------
    rms : array, shape (t, m, k + 1)
        Held-out rms error in each of t sets of splits: of the baseline, with the first cause, with the first
        two, and so on.
    lengths : array, shape (m, k)
        Estimated length of each cause's effect.
    """

    rms: Array
    lengths: Array

    def gains(self, first: int, last: int, excess: Array) -> Array:
        """Gain of the causes from one step to another, shape (t, m).

        `excess`, shape (m,), is the held-out error with the causes over that of causes of exact form.
        """
        return self.rms[..., first] - excess * self.rms[..., last]

    def select(self, which: BoolArray) -> _SimulatedReplicates:
        """Some of the replicates."""
        return _SimulatedReplicates(self.rms[:, which], self.lengths[which])


def simulate_gain_intervals(
    campaign: LinearizedCampaign,
    sets: Sequence[Sequence[Split]],
    observed: Array,
    rng: np.random.Generator,
    n_draws: int = N_DRAWS,
    beyond: Sequence[Sequence[Array]] | None = None,
) -> Array:
    """Interval of the gain that a replicate of the campaign would show, in each of t sets of splits.

    Parameters
    ----------
    campaign : LinearizedCampaign
    sets : sequence of sequence of Split
        Of this campaign and of a replicate.
    observed : array, shape (t, k + 1)
        Held-out rms error of the baseline, with the first cause, with the first two, and so on.
    rng : Generator
    n_draws : int, optional
    beyond : sequence of sequence of array, each shape (h, q), optional
        Of each split of each set, what `slopes` of all causes are less in its held-out rows, recoloured,
        since the causes are constant beyond what training rows show.

    Returns
    -------
    array, shape (t, 2, k + 1)
        Quantiles 0.025 and 0.975 of the gain of each cause after those before it, then of all; they enclose
        the gain in the log itself.
    """
    total = campaign.effects.sum(axis=1, keepdims=True)
    lengths = campaign.effect_lengths(Responses.of(campaign, total))[0]
    prepared = [[prepare_split(campaign.basis, split, campaign.recolour) for split in own] for own in sets]
    if beyond is not None:
        prepared = [
            [replace(one, beyond=campaign.spread_slopes(own)) for one, own in zip(*pair, strict=True)]
            for pair in zip(prepared, beyond, strict=True)
        ]
    first, second = _simulate_replicate_pairs(campaign, prepared, n_draws, rng)
    # What the true effect has beyond the law's form errs in the log and in its replicate alike.
    inexact = rng.random(len(first.lengths)) > EXACT_SHARE
    excess = np.where(inexact, rng.uniform(1.0, MAX_EXCESS, len(inexact)), 1.0)
    n_causes, n_accepted = observed.shape[1] - 1, int(ACCEPTED_SHARE * len(inexact)) + 1
    steps = [(k, k + 1) for k in range(n_causes)] + [(0, n_causes)]
    limits = np.zeros((len(sets), 2, len(steps)))
    for number, (start, end) in enumerate(steps):
        far = np.mean((first.lengths - lengths)[:, start:end] ** 2, axis=1)
        alike, values = np.argsort(far, kind="stable")[:n_accepted], observed[:, start] - observed[:, end]
        for own, value, gain, replicate_gain in zip(
            limits, values, first.gains(start, end, excess), second.gains(start, end, excess), strict=True
        ):
            spread = max(float(np.std(replicate_gain[alike] - gain[alike])), 1e-12)
            distance = far + ((gain - value) / spread) ** 2
            accepted = np.argsort(distance, kind="stable")[:n_accepted]
            low, high = np.quantile(replicate_gain[accepted], [0.025, 0.975])
            if not low <= value <= high:  # the log is a replicate, too, which others are about
                low, high = min(low, value - Z_95 * spread), max(high, value + Z_95 * spread)
            own[:, number] = low, high
    return limits


def _concatenate(parts: Sequence[_SimulatedReplicates]) -> _SimulatedReplicates:
    return _SimulatedReplicates(
        np.concatenate([part.rms for part in parts], axis=1), np.concatenate([part.lengths for part in parts])
    )


def _simulate_replicate_pairs(
    campaign: LinearizedCampaign,
    sets: Sequence[Sequence[SplitOperators]],
    n_draws: int,
    rng: np.random.Generator,
) -> tuple[_SimulatedReplicates, _SimulatedReplicates]:
    """Two replicates of each draw in which a cause is detected."""
    n, k = campaign.effects.shape
    lengths = campaign.effect_lengths(Responses.of(campaign, campaign.effects)).diagonal()
    width = STRENGTH_RANGE / np.maximum(lengths, 1e-9)
    pairs, size = [], max(MAX_ELEMENTS // n, 1)
    for begin in range(0, n_draws, size):
        number = min(size, n_draws - begin)
        factors = rng.uniform(np.maximum(1.0 - width, 0.0), 1.0 + width, (number, k))
        signal = campaign.effects @ factors.T
        pairs.append(
            [
                _simulate_replicates(campaign, sets, signal + _draw_noise(campaign, number, rng), rng)
                for _ in range(2)
            ]
        )
    first, second = (_concatenate(replicates) for replicates in zip(*pairs, strict=True))
    detected = np.any(np.abs(first.lengths) > campaign.thresholds, axis=1)
    kept = detected if detected.any() else ~detected
    return first.select(kept), second.select(kept)


def _draw_noise(campaign: LinearizedCampaign, number: int, rng: np.random.Generator) -> Array:
    n = len(campaign.noise)
    return rng.choice(campaign.noise, (n, number)) * rng.choice([-1.0, 1.0], (n, number))


def _simulate_replicates(
    campaign: LinearizedCampaign,
    sets: Sequence[Sequence[SplitOperators]],
    values: Array,
    rng: np.random.Generator,
) -> _SimulatedReplicates:
    responses = Responses.of(campaign, values)
    # Splits have nearly all rows of a campaign in common: what favours a rival in one does so in the others.
    spread = [
        RIVAL_LOG_EVIDENCE_SD * rng.standard_normal((values.shape[1], len(one.log_bayes_factor)))
        for one in campaign.competing_causes
    ]
    rms = [_held_out_rms(campaign, splits, responses, spread) for splits in sets]
    return _SimulatedReplicates(np.stack(rms), campaign.effect_lengths(responses))


def _held_out_rms(
    campaign: LinearizedCampaign,
    splits: Sequence[SplitOperators],
    responses: Responses,
    spread: Sequence[Array],
) -> Array:
    """As of `_SimulatedReplicates`, of one set of splits, shape (m, k + 1)."""
    m, k = responses.values.shape[1], len(campaign.slopes)
    squares, count = np.zeros((m, k + 1)), 0
    for operators in splits:
        sums = operators.training.sum_training(campaign, responses)
        results = np.stack(
            [simulate_selection(campaign, j, operators.training, sums, spread[j]) for j in range(k)], axis=1
        )
        held_out = operators.prediction.predicted
        scale = campaign.scale[held_out, None]
        plain = operators.prediction.subtract_prediction(responses) * scale
        plain_squares = np.einsum("ij,ij->j", plain, plain)
        squares[:, 0] += plain_squares
        distinct, which = unique_rows(results)
        for number, result in enumerate(distinct):
            logs = np.flatnonzero(which == number)
            for step in range(1, k + 1):
                place, penalties = _extension_columns(campaign, result[:step])
                held, sizes = fit_extension(
                    operators,
                    campaign.columns[:, place],
                    penalties,
                    sums.products[np.ix_(place, logs)],
                    None if operators.beyond is None else operators.beyond[:, place],
                )
                held = held * scale  # of which a sum of squares needs products only
                change = (held.T @ held) @ sizes - 2.0 * (held.T @ plain)[:, logs]
                squares[logs, step] += plain_squares[logs] + np.einsum("ij,ij->j", sizes, change)
        count += len(held_out)
    return np.sqrt(np.maximum(squares, 0.0) / count)  # below 0 by rounding, where next to nothing is left


def simulate_selection(
    campaign: LinearizedCampaign,
    cause: int,
    training: CalibrationOperator,
    sums: TrainingSums,
    spread: Array | float = 0.0,
) -> IntArray:
    """The cause that a selection from the training rows takes in the place of a true one, in each of m logs.

    The effects of the other causes are in the law, so that a rival does not stand for one of these.
    `training` predicts the training rows by themselves, `sums` are those of the responses over them;
    `spread`, shape (m, r), is added to the log Bayes factor of each rival. The result, shape (m,), is
    `CAUSE_FOUND`, the number of the rival, counted from 1, or `NONE_FOUND`.
    """
    rivals, (candidates, _) = campaign.competing_causes[cause], campaign.places[cause]
    others = [place.start for k, (place, _) in enumerate(campaign.places) if k != cause]
    own = training.subtract(campaign.columns[:, candidates])
    basis, turn = np.linalg.qr(training.subtract(campaign.columns[:, others]))
    along = basis.T @ own
    direction = own - basis @ along
    by_others = np.linalg.lstsq(turn.T, sums.products[others], rcond=RANK_TOL)[0]
    # Where next to nothing is left, rounding may make it less.
    squares = np.maximum(sums.squares - np.sum(by_others**2, axis=0), np.finfo(float).tiny)
    own_length = np.maximum(np.linalg.norm(direction, axis=0), MIN_LENGTH)
    length = np.abs((sums.products[candidates] - along.T @ by_others).T / own_length)
    df = len(training.predicted) - training.known.shape[0] - len(others)
    evidence = log_likelihood_ratio(length**2 / squares[:, None], df)
    evidence[:, 1:] += rivals.log_bayes_factor + spread
    best = np.argmax(evidence, axis=1)
    detected = np.take_along_axis(length, best[:, None], axis=1)[:, 0] > campaign.thresholds[cause]
    return np.where(detected & np.append(True, rivals.is_known)[best], best, NONE_FOUND)


def _extension_columns(campaign: LinearizedCampaign, result: IntArray) -> tuple[IntArray, Array]:
    """Which columns extend the law by the results for the first causes, and their penalties."""
    places, penalties = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]
    for cause, one in enumerate(result):
        candidates, slopes = campaign.places[cause]
        if one == CAUSE_FOUND:
            places.append(np.arange(slopes.start, slopes.stop))
            penalties.append(campaign.penalties[cause])
        elif one != NONE_FOUND:
            places.append(np.array([candidates.start + one]))
            penalties.append(np.zeros(1))
    return np.concatenate(places), np.concatenate(penalties)


@dataclass(frozen=True, eq=False)
class SplitOperators:
    """The calibrations of a split: of the training rows by themselves, and of the held-out rows.

    `beyond`, shape (h, c), is what columns are less in the held-out rows than the campaign has them.
    """

    training: CalibrationOperator
    prediction: CalibrationOperator
    beyond: Array | None = None


def prepare_split(basis: csr_array, split: Split, recolour: Recolouring = keep_columns) -> SplitOperators:
    """The calibrations of a split; `basis`, shape (n, p), spans the calibration."""
    training = prepare_calibration(basis, split.train, split.train)
    if split.calibration is split.train and recolour is keep_columns:
        held_out = csr_array(basis[split.held_out][:, training.acting])
        return SplitOperators(training, replace(training, predicted=split.held_out, basis=held_out))
    return SplitOperators(training, prepare_calibration(basis, split.calibration, split.held_out, recolour))


def fit_extension(
    operators: SplitOperators, columns: Array, penalties: Array, products: Array, beyond: Array | None = None
) -> tuple[Array, Array]:
    """Causes sized by the training rows, whose product is what they add to the held-out rows' prediction.

    Parameters
    ----------
    operators : SplitOperators
    columns : array, shape (n, q)
        Directions of the causes.
    penalties : array, shape (q,)
        As of `LinearizedCampaign`.
    products : array, shape (q, m)
        Of the directions with the responses, as of `TrainingSums`.
    beyond : array, shape (number held out, q), optional
        What the directions are less in the held-out rows.

    Returns
    -------
    held_out : array, shape (number held out, q)
        The directions there, whitened, less their own prediction.
    sizes : array, shape (q, m)
    """
    penalised = np.concatenate([operators.training.subtract(columns), np.diag(penalties)])
    _, singular, right = svd(penalised)
    kept = singular > RANK_TOL * singular.max(initial=0.0)
    scaled = right[kept] / singular[kept, None]
    held_out = operators.prediction.subtract(columns)
    return held_out if beyond is None else held_out - beyond, scaled.T @ (scaled @ products)
