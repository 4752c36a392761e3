"""The misfit test: Bayes factors of all hypotheses, and the p-value of the whole search.

With unknown noise variance and effect strength tau, the Bayes factor of a hypothesis against noise
alone is prod (1 + tau^2 s_i)^(-1/2) (1 - sum u_i^2 tau^2 s_i / (1 + tau^2 s_i) / u'u)^(-df/2), with u_i
the residual along direction i and s_i its prior share (A. Zellner, g-prior, 1986), averaged over four
values of tau. The statistic is the mean Bayes factor over all causes and unstructured alternatives.

Its null distribution is a wild bootstrap: signs of the residuals flipped at random, then the
calibration parameters projected out again (J. L. Horowitz, Annu. Rev. Econ. 11:193, 2019). A real effect
would inflate it, so the best hypothesis is subtracted first; residuals are divided by sqrt(1 - leverage)
as in the jackknife (J. G. MacKinnon and H. White, J. Econometrics 29:305, 1985).

The p-value of a `Diagnosis` is min(1, p_outliers / 0.25, p_rest / 0.75), a weighted Bonferroni
correction for two tests. p_outliers is that of the likelihood ratio test in `noise.find_outliers`; p_rest
is `compute_misfit(...).p_value` of the baseline's residuals, outlying counts removed: the share of
bootstrap samples with at least the log's statistic, (1 + exceedances) / (1 + samples). Where the noise was
found heteroscedastic from the same residuals, that share is doubled. `selection.select_causes` does both
tests in this order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from scipy.sparse import csc_array, csr_array, hstack
from scipy.special import logsumexp

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit

UNKNOWN = "unknown"
STRENGTHS = np.array([4.0, 10.0, 25.0, 60.0])  # tau: hyperprior on the norm of an effect, whitened
MAX_LOG_EVIDENCE = 600.0  # nats; keeps sums of Bayes factors finite
MAX_EXPLAINED = 1.0 - 1e-12  # share of the squared residuals
MIN_LOG_BAYES_FACTOR = 5.0  # nats for a structure to be subtracted before the bootstrap
MAX_ROW_LEVERAGE = 0.15  # of an effect in one row; above, its signs are too few for a bootstrap
MIN_TAIL_DF = 5.0  # of the Student t noise that is simulated instead
BATCH_SIZE, MAX_ELEMENTS = 500, 25_000_000  # bootstrap samples at a time, and residuals in them


@dataclass(frozen=True, eq=False)
class HypothesisBatch:
    """Hypotheses side by side, so that all are evaluated in one matrix product.

    Attributes
    ----------
    directions : array, shape (n, m)
        Of the hypotheses with dense directions.
    sparse_directions : sparse array, shape (m', n)
        Directions of the others, in rows.
    prior_share : array, shape (m + m',)
    first_direction : array of int
        Where the directions of each hypothesis begin.
    ar1s : tuple of AR1
    position : array of int, shape (H,)
        Of each hypothesis, in the order given, in (dense, sparse, AR(1)).
    df : int
    """

    directions: Array
    sparse_directions: csr_array
    prior_share: Array
    first_direction: npt.NDArray[np.intp]
    ar1s: tuple[AR1, ...]
    position: npt.NDArray[np.intp]
    df: int

    def log_evidence(self, residuals: Array) -> Array:
        """Log Bayes factor of each hypothesis against noise alone; (n, k) -> (H, k)."""
        subspaces = logsumexp(np.stack(list(self._at_each_strength(residuals))), axis=0)
        return np.concatenate([subspaces - np.log(len(STRENGTHS)), *self._ar1_log_evidence(residuals)])[
            self.position
        ]

    def log_mean_evidence(self, residuals: Array, log_weight: Array) -> Array:
        """Log of the weighted sum of all Bayes factors, weights (H,); (n, k) -> (k,)."""
        subspaces = sum(
            np.exp(np.minimum(log, MAX_LOG_EVIDENCE)) for log in self._at_each_strength(residuals)
        )
        ar1s = [np.exp(np.minimum(log, MAX_LOG_EVIDENCE)) for log in self._ar1_log_evidence(residuals)]
        evidence = np.concatenate([subspaces / len(STRENGTHS), *ar1s])
        weight = np.empty(len(log_weight))
        weight[self.position] = np.exp(log_weight)
        return np.log(weight @ evidence)

    def _at_each_strength(self, residuals: Array) -> Iterator[Array]:
        along = np.concatenate([self.directions.T @ residuals, self.sparse_directions @ residuals]) ** 2
        along /= np.sum(residuals**2, axis=0)
        for strength in STRENGTHS:
            signal = strength**2 * self.prior_share
            explained = along * (signal / (1.0 + signal))[:, None]
            if len(self.first_direction) < len(self.prior_share):
                explained = np.add.reduceat(explained, self.first_direction, axis=0)
            spread = np.add.reduceat(np.log1p(signal), self.first_direction)
            log = np.log1p(-np.minimum(explained, MAX_EXPLAINED))
            log *= -0.5 * self.df
            log -= 0.5 * spread[:, None]
            yield log

    def _ar1_log_evidence(self, residuals: Array) -> list[Array]:
        return [ar1.log_evidence(residuals, self.df)[None] for ar1 in self.ar1s]


def batch_hypotheses(hypotheses: Sequence[Hypothesis | AR1], df: int) -> HypothesisBatch:
    """Put hypotheses side by side: dense directions, sparse ones, then AR(1)."""
    storage = np.array(
        [2 if isinstance(one, AR1) else int(not isinstance(one.columns, np.ndarray)) for one in hypotheses]
    )
    groups: tuple[list[Any], list[Any], list[Any]] = ([], [], [])
    for hypothesis, number in zip(hypotheses, storage, strict=True):
        groups[number].append(hypothesis)
    dense, sparse, ar1s = groups
    place = np.empty(len(storage), dtype=np.intp)
    place[np.argsort(storage, kind="stable")] = np.arange(len(storage))
    subspaces = (*dense, *sparse)
    n = subspaces[0].columns.shape[0]
    return HypothesisBatch(
        np.concatenate([np.zeros((n, 0)), *(one.columns for one in dense)], axis=1),
        csr_array(hstack([csc_array((n, 0)), *(one.columns for one in sparse)], format="csc").T),
        np.concatenate([one.prior_share for one in subspaces]),
        np.concatenate([[0], np.cumsum([len(one.prior_share) for one in subspaces])[:-1]]).astype(np.intp),
        tuple(ar1s),
        place,
        df,
    )


@dataclass(frozen=True, eq=False)
class StructureRemoved:
    """Residuals without their best-fitting structure.

    Attributes
    ----------
    residual : array, shape (n,)
    leverage : array, shape (n,)
        Share of each row's noise that was subtracted with the structure.
    """

    residual: Array
    leverage: Array


def remove_structure(
    residual: Array, hypotheses: Sequence[Hypothesis | AR1], log_evidence: Array
) -> StructureRemoved:
    """Subtract the likeliest structure from residuals, (n,), shrunk as its prior says."""
    best = int(np.argmax(log_evidence))
    shape, zeros = hypotheses[best], np.zeros(len(residual))
    if log_evidence[best] < MIN_LOG_BAYES_FACTOR:
        return StructureRemoved(residual, zeros)
    if isinstance(shape, AR1):
        return StructureRemoved(residual - shape.shape(residual), zeros)
    along = shape.coefficients(residual)
    strength = STRENGTHS[np.argmin(np.abs(np.log(STRENGTHS**2 / max(float(along @ along), 1.0))))]
    kept = strength**2 * shape.prior_share / (1.0 + strength**2 * shape.prior_share)
    return StructureRemoved(residual - shape.combine(kept * along), shape.leverage(kept))


@dataclass(frozen=True, eq=False)
class Misfit:
    """The misfit test of some residuals.

    Attributes
    ----------
    residual : array, shape (n,)
    hypotheses : tuple of Hypothesis or AR1
    log_evidence : array, shape (H,)
        Log Bayes factor of each hypothesis.
    log_evidence_by_cause : dict of str to float
        That of each cause, averaged over its shapes.
    p_value : float
    null_log_evidence : array, shape (n_bootstrap,)
        The statistic in the bootstrap samples.
    p_value_factor : float
        Factor on the p-value, for heteroscedasticity chosen by the same residuals.
    """

    residual: Array
    hypotheses: tuple[Hypothesis | AR1, ...]
    log_evidence: Array
    log_evidence_by_cause: dict[str, float]
    p_value: float
    null_log_evidence: Array
    p_value_factor: float = 1.0

    def critical_value(self, level: float) -> float:
        """Value of the statistic that noise alone exceeds with probability `level`."""
        if not len(self.null_log_evidence):
            return np.nan
        return float(np.quantile(self.null_log_evidence, 1.0 - level / self.p_value_factor))

    def best_hypothesis(self, cause: str) -> Hypothesis | AR1:
        """The likeliest shape of a cause."""
        places = [k for k, one in enumerate(self.hypotheses) if classify_cause(one) == cause]
        return self.hypotheses[max(places, key=lambda k: self.log_evidence[k])]

    def n_shapes(self, cause: str) -> int:
        """Number of shapes over which the evidence of a cause is averaged, at least 1."""
        return max(sum(one.cause == cause for one in self.hypotheses), 1)


def classify_cause(hypothesis: Hypothesis | AR1) -> str:
    """The cause, or ``unknown`` for any unstructured alternative."""
    return UNKNOWN if hypothesis.cause.startswith(f"{UNKNOWN}:") else hypothesis.cause


def compute_misfit(
    linearized: LinearizedFit,
    hypotheses: Sequence[Hypothesis | AR1],
    n_bootstrap: int,
    rng: np.random.Generator,
    max_exceedances: int | None = None,
    p_value_factor: float = 1.0,
) -> Misfit:
    """Test the residuals of a fit by `n_bootstrap` samples; 0 gives no p-value (NaN).

    After `max_exceedances` samples above the log's statistic the bootstrap ends (J. Besag and P. Clifford,
    Biometrika 78:301, 1991). `p_value_factor` is that of `Misfit`.
    """
    batch = batch_hypotheses(hypotheses, linearized.df)
    causes = [classify_cause(hypothesis) for hypothesis in hypotheses]
    weight = _log_weights(hypotheses, causes)
    own = batch.log_evidence(linearized.residual[:, None])[:, 0]
    by_cause = {
        name: float(logsumexp((own + weight)[[cause == name for cause in causes]]))
        for name in dict.fromkeys(causes)
    }
    statistic, null = float(logsumexp(list(by_cause.values()))), np.zeros(0)
    draw_noise = _make_null_sampler(linearized, remove_structure(linearized.residual, hypotheses, own), rng)
    size = min(BATCH_SIZE, max(MAX_ELEMENTS // max(len(linearized), len(batch.prior_share)), 1))
    for first in range(0, n_bootstrap, size):
        noise = draw_noise(min(size, n_bootstrap - first))
        null = np.concatenate([null, batch.log_mean_evidence(linearized.project(noise), weight)])
        if max_exceedances is not None and np.sum(null >= statistic) >= max_exceedances:
            break
    share = (1 + int(np.sum(null >= statistic))) / (1 + len(null)) if n_bootstrap else np.nan
    p_value = min(p_value_factor * share, 1.0)
    return Misfit(linearized.residual, tuple(hypotheses), own, by_cause, p_value, null, p_value_factor)


def _make_null_sampler(
    linearized: LinearizedFit, left: StructureRemoved, rng: np.random.Generator
) -> Callable[[int], Array]:
    """A generator of noise alone, calibration not yet projected out: number of samples k -> (n, k)."""
    n = len(linearized)
    if left.leverage.max() > MAX_ROW_LEVERAGE:
        return lambda number: rng.standard_t(MIN_TAIL_DF, (n, number))
    # Projection and subtraction shrink residuals; undo both.
    kept = (1.0 - left.leverage) * np.sqrt(1.0 - np.minimum(linearized.leverage, MAX_LEVERAGE))
    sizes = (left.residual / kept)[:, None]
    return lambda number: rng.choice([-1.0, 1.0], (n, number)) * sizes


def _log_weights(hypotheses: Sequence[Hypothesis | AR1], causes: Sequence[str]) -> Array:
    """Log weight of each hypothesis: equal for the shapes of a cause; for ``unknown`` kind by kind."""
    families = [
        hypothesis.cause.split(" ")[0].removesuffix(",") if cause == UNKNOWN else cause
        for hypothesis, cause in zip(hypotheses, causes, strict=True)
    ]
    sizes = {family: families.count(family) for family in families}
    n_kinds = len({family for family in families if family.startswith(f"{UNKNOWN}:")})
    return -np.array(
        [
            np.log(sizes[family]) + (np.log(n_kinds) if cause == UNKNOWN else 0.0)
            for family, cause in zip(families, causes, strict=True)
        ]
    )


def detection_length(critical: float, n_shapes: int, df: int) -> float:
    """Norm of an effect in one direction at which its cause alone reaches a critical value of the statistic.

    `n_shapes` is the number of shapes over which the evidence of the cause is averaged.
    """

    def evidence(z: float) -> float:
        signal = STRENGTHS**2
        log = -0.5 * np.log1p(signal) - 0.5 * df * np.log1p(
            -np.minimum(z**2 * signal / (1 + signal) / (df + z**2), MAX_EXPLAINED)
        )
        return float(np.log(np.mean(np.exp(log - log.max()))) + log.max() - np.log(n_shapes))

    if not np.isfinite(critical) or evidence(0.0) > critical:
        return 0.0
    return float(brentq(lambda z: evidence(z) - critical, 0.0, 60.0, xtol=1e-3))
