"""The misfit test: Bayes factors of all hypotheses, and one p-value calibrated for the whole search.

With unknown noise variance and effect strength tau, the Bayes factor of a hypothesis against noise
alone is prod (1 + tau^2 s_i)^(-1/2) (1 - sum u_i^2 tau^2 s_i / (1 + tau^2 s_i) / u'u)^(-df/2), with u_i
the residual along direction i and s_i its prior share (A. Zellner, g-prior, 1986), averaged over four
values of tau. The null distribution is a wild bootstrap: signs flipped at random, then recalibration
(J. L. Horowitz, Annu. Rev. Econ. 11:193, 2019). The best hypothesis is removed first; residuals are
scaled as in the jackknife (J. G. MacKinnon and H. White, J. Econometrics 29:305, 1985).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array, hstack
from scipy.special import logsumexp

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.hypotheses import AR1, Hypothesis
from stickslip_fit.diagnosis.linearized import LinearizedFit

STRENGTHS = np.array([4.0, 10.0, 25.0, 60.0])


MAX_LOG_EVIDENCE = 600.0  # nats; where likelihoods are summed, none is larger than e to this


@dataclass(frozen=True, eq=False)
class HypothesisBatch:
    """Hypotheses laid side by side, so that all are judged at once.

    Attributes
    ----------
    directions : array, shape (n, m)
        Of all hypotheses that have some; sparse ones after the others.
    sparse : sparse array, shape (m', n)
        Directions in rows.
    share : array, shape (m + m',)
    first : array of int
        Where each hypothesis's directions begin.
    ar1s : tuple of Memory
    place : array of int, shape (H,)
        Of each hypothesis, in the order given, among those with directions and then the memories.
    freedom : int
    """

    directions: Array
    sparse: csr_array
    share: Array
    first: npt.NDArray[np.intp]
    ar1s: tuple[AR1, ...]
    place: npt.NDArray[np.intp]
    df: int

    def log_evidence(self, residuals: Array) -> Array:
        """Log ratio of each hypothesis's marginal likelihood to that of noise alone; (n, k) -> (H, k)."""
        shapes = logsumexp(np.stack(list(self._at_each_strength(residuals))), axis=0) - np.log(len(STRENGTHS))
        return np.concatenate([shapes, *self._ar1_log_evidence(residuals)])[self.place]

    def log_mean_evidence(self, residuals: Array, log_weight: Array) -> Array:
        """Log of the weighed sum of all hypotheses' evidence, weights (H,); (n, k) -> (k,)."""
        shapes = sum(np.exp(np.minimum(each, MAX_LOG_EVIDENCE)) for each in self._at_each_strength(residuals))
        carried = [np.exp(np.minimum(each, MAX_LOG_EVIDENCE)) for each in self._ar1_log_evidence(residuals)]
        evidence = np.concatenate([shapes / len(STRENGTHS), *carried])
        weight = np.empty(len(log_weight))
        weight[self.place] = np.exp(log_weight)
        return np.log(weight @ evidence)

    def _at_each_strength(self, residuals: Array) -> Iterator[Array]:
        along = np.concatenate([self.directions.T @ residuals, self.sparse @ residuals]) ** 2
        along /= np.sum(residuals**2, axis=0)
        for strength in STRENGTHS:
            signal = strength**2 * self.share
            explained = along * (signal / (1.0 + signal))[:, None]
            if len(self.first) < len(self.share):
                explained = np.add.reduceat(explained, self.first, axis=0)
            spread = np.add.reduceat(np.log1p(signal), self.first)
            log = np.log1p(-np.minimum(explained, 1.0 - 1e-12))
            log *= -0.5 * self.df
            log -= 0.5 * spread[:, None]
            yield log

    def _ar1_log_evidence(self, residuals: Array) -> list[Array]:
        return [ar1.log_evidence(residuals, self.df)[None] for ar1 in self.ar1s]


def batch_hypotheses(hypotheses: Sequence[Hypothesis | AR1], df: int) -> HypothesisBatch:
    """Lay hypotheses side by side."""
    groups: tuple[list[Any], list[Any], list[Any]] = ([], [], [])
    group = np.array([_storage_kind(each) for each in hypotheses])
    for each, number in zip(hypotheses, group, strict=True):
        groups[number].append(each)
    dense, sparse, memories = groups
    place = np.empty(len(group), dtype=np.intp)
    place[np.argsort(group, kind="stable")] = np.arange(len(group))
    n = (*dense, *sparse)[0].columns.shape[0]
    sizes = [len(each.share) for each in (*dense, *sparse)]
    return HypothesisBatch(
        np.concatenate([np.zeros((n, 0)), *(each.columns for each in dense)], axis=1),
        csr_array(hstack([csc_array((n, 0)), *(each.columns for each in sparse)], format="csc").T),
        np.concatenate([each.share for each in (*dense, *sparse)]),
        np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp),
        tuple(memories),
        place,
        df,
    )


def _storage_kind(hypothesis: Hypothesis | AR1) -> int:
    """0 for dense directions, 1 for sparse ones, 2 for memories."""
    if isinstance(hypothesis, AR1):
        return 2
    return int(not isinstance(hypothesis.columns, np.ndarray))


MIN_LOG_BAYES_FACTOR = 5.0  # nats by which a structure must be likelier than none to be taken out


@dataclass(frozen=True, eq=False)
class StructureRemoved:
    """What is left of n residuals.

    Attributes
    ----------
    residual : array, shape (n,)
    leverage : array, shape (n,)
        Share of each row's noise that went with the structure.
    """

    residual: Array
    leverage: Array


def remove_structure(
    residual: Array, hypotheses: Sequence[Hypothesis | AR1], log_evidence: Array
) -> StructureRemoved:
    """Take the likeliest structure out, as far as it is more than noise gives it.

    Parameters
    ----------
    residual : array, shape (n,)
    hypotheses : sequence of Hypothesis or Memory, H
    log_evidence : array, shape (H,)
    """
    best = int(np.argmax(log_evidence))
    shape, nothing = hypotheses[best], np.zeros(len(residual))
    if log_evidence[best] < MIN_LOG_BAYES_FACTOR:
        return StructureRemoved(residual, nothing)
    if isinstance(shape, AR1):
        return StructureRemoved(residual - shape.shape(residual), nothing)
    along = shape.along(residual)
    strength = STRENGTHS[np.argmin(np.abs(np.log(STRENGTHS**2 / max(float(along @ along), 1.0))))]
    kept = strength**2 * shape.share / (1.0 + strength**2 * shape.share)
    return StructureRemoved(residual - shape.combine(kept * along), shape.leverage(kept))


UNKNOWN = "unknown"
MAX_LEVERAGE = 0.8
MAX_ROW_LEVERAGE = 0.15  # share of an effect in one traverse, above which it shows in few alone
MIN_TAIL_DF = 5.0  # degrees of freedom
BATCH_SIZE, MAX_ELEMENTS = 500, 25_000_000  # flipped logs, and residuals in them


@dataclass(frozen=True, eq=False)
class Misfit:
    """How likely the residuals are by chance, and what each hypothesis makes of them.

    Attributes
    ----------
    residual : array, shape (n,)
    hypotheses : tuple of Hypothesis or Memory
    log_evidence : array, shape (H,)
    log_evidence_by_cause : dict of str to float
        Log evidence of each cause, averaged over its shapes.
    p_value : float
    null_log_evidence : array, shape (flips,)
        Log evidence, over everything, in logs in which nothing is wrong.
    times : float
        By how much `p_value` is larger than their share that looks worse than the log.
    """

    residual: Array
    hypotheses: tuple[Hypothesis | AR1, ...]
    log_evidence: Array
    log_evidence_by_cause: dict[str, float]
    p_value: float
    null_log_evidence: Array
    times: float = 1.0

    def critical_value(self, level: float) -> float:
        """Log evidence, over everything, that chance exceeds with probability `level`."""
        return (
            float(np.quantile(self.null_log_evidence, 1.0 - level / self.times))
            if len(self.null_log_evidence)
            else np.nan
        )

    def best_hypothesis(self, cause: str) -> Hypothesis | AR1:
        """The likeliest shape of a cause."""
        subset = [k for k, each in enumerate(self.hypotheses) if classify_cause(each) == cause]
        return self.hypotheses[max(subset, key=lambda k: self.log_evidence[k])]


def classify_cause(hypothesis: Hypothesis | AR1) -> str:
    """The cause, or ``unknown`` for any structure."""
    return UNKNOWN if hypothesis.cause.startswith(f"{UNKNOWN}:") else hypothesis.cause


def compute_misfit(
    linearized: LinearizedFit,
    hypotheses: Sequence[Hypothesis | AR1],
    n_bootstrap: int,
    rng: np.random.Generator,
    enough: int | None = None,
    times: float = 1.0,
) -> Misfit:
    """Judge the residuals of a study.

    Parameters
    ----------
    linearized : Study
    hypotheses : sequence of Hypothesis
    n_bootstrap : int
        Logs in which nothing is wrong; 0 gives no p-value (NaN).
    rng : Generator
    enough : int, optional
        Of those, that look worse than the log itself, after which no more are made (J. Besag and P.
        Clifford, Biometrika 78:301, 1991).
    times : float, optional
        Makes the p-value that much larger, where the rows' weights were chosen by the same residuals.
    """
    together = batch_hypotheses(hypotheses, linearized.df)
    kinds = [classify_cause(each) for each in hypotheses]
    weight = _log_weights(hypotheses, kinds)
    own = together.log_evidence(linearized.residual[:, None])[:, 0]
    each = {
        name: float(logsumexp((own + weight)[[kind == name for kind in kinds]]))
        for name in dict.fromkeys(kinds)
    }
    total, by_chance = float(logsumexp(list(each.values()))), np.zeros(0)
    noise = _make_null_sampler(linearized, remove_structure(linearized.residual, hypotheses, own), rng)
    for first in range(
        0,
        n_bootstrap,
        at_a_time := min(BATCH_SIZE, max(MAX_ELEMENTS // max(len(linearized), len(together.share)), 1)),
    ):
        drawn = noise(min(at_a_time, n_bootstrap - first))
        null = together.log_mean_evidence(linearized.project(drawn), weight)
        by_chance = np.concatenate([by_chance, null])
        if enough is not None and np.sum(by_chance >= total) >= enough:
            break
    share = (1 + int(np.sum(by_chance >= total))) / (1 + len(by_chance)) if n_bootstrap else np.nan
    return Misfit(
        linearized.residual, tuple(hypotheses), own, each, min(times * share, 1.0), by_chance, times
    )


def _make_null_sampler(
    linearized: LinearizedFit, left: StructureRemoved, rng: np.random.Generator
) -> Callable[[int], Array]:
    """A maker of logs in which nothing is wrong, before recalibration: their number k -> (n, k)."""
    n = len(linearized)
    if left.leverage.max() > MAX_ROW_LEVERAGE:
        return lambda number: rng.standard_t(MIN_TAIL_DF, (n, number))
    # As they were before recalibration, and what else was taken out, made them smaller.
    kept = (1.0 - left.leverage) * np.sqrt(1.0 - np.minimum(linearized.leverage, MAX_LEVERAGE))
    sizes = (left.residual / kept)[:, None]
    return lambda number: rng.choice([-1.0, 1.0], (n, number)) * sizes


def _log_weights(hypotheses: Sequence[Hypothesis | AR1], kinds: Sequence[str]) -> Array:
    """Log weight of each hypothesis in its cause: alike for all shapes, structures kind by kind."""
    families = [
        each.cause.split(" ")[0].removesuffix(",") if kind == UNKNOWN else kind
        for each, kind in zip(hypotheses, kinds, strict=True)
    ]
    sizes = {family: families.count(family) for family in families}
    structures = len({family for family in families if family.startswith(f"{UNKNOWN}:")})
    return -np.array(
        [
            np.log(sizes[family]) + (np.log(structures) if kind == UNKNOWN else 0.0)
            for family, kind in zip(families, kinds, strict=True)
        ]
    )
