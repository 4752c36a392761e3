"""How much more likely the residuals are under a hypothesis than under noise alone.

With the noise's size unknown and an effect of strength tau, the ratio of marginal likelihoods is

    prod (1 + tau^2 s_i)^(-1/2)  (1 - sum u_i^2 tau^2 s_i / (1 + tau^2 s_i) / u'u)^(-nu / 2),

u_i being the residual along the i-th direction, s_i its share and nu the degrees of freedom (A. Zellner,
in Bayesian Inference and Decision Techniques, 1986, for one direction). Strengths are averaged over a ladder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array, hstack
from scipy.special import logsumexp

from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory

Array = npt.NDArray[np.float64]

STRENGTHS = np.array([4.0, 10.0, 25.0, 60.0])


AT_MOST = 600.0  # nats; where likelihoods are summed, none is larger than e to this


@dataclass(frozen=True, eq=False)
class Stack:
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
    memories : tuple of Memory
    place : array of int, shape (H,)
        Of each hypothesis, in the order given, among those with directions and then the memories.
    freedom : int
    """

    directions: Array
    sparse: csr_array
    share: Array
    first: npt.NDArray[np.intp]
    memories: tuple[Memory, ...]
    place: npt.NDArray[np.intp]
    freedom: int

    def log_evidence(self, residuals: Array) -> Array:
        """Log ratio of each hypothesis's marginal likelihood to that of noise alone; (n, k) -> (H, k)."""
        shapes = logsumexp(np.stack(list(self._at_each_strength(residuals))), axis=0) - np.log(len(STRENGTHS))
        return np.concatenate([shapes, *self._carried(residuals)])[self.place]

    def log_mean_evidence(self, residuals: Array, log_weight: Array) -> Array:
        """Log of the weighed sum of all hypotheses' evidence, weights (H,); (n, k) -> (k,)."""
        shapes = sum(np.exp(np.minimum(each, AT_MOST)) for each in self._at_each_strength(residuals))
        carried = [np.exp(np.minimum(each, AT_MOST)) for each in self._carried(residuals)]
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
            log *= -0.5 * self.freedom
            log -= 0.5 * spread[:, None]
            yield log

    def _carried(self, residuals: Array) -> list[Array]:
        return [memory.log_evidence(residuals, self.freedom)[None] for memory in self.memories]


def stack(hypotheses: Sequence[Hypothesis | Memory], freedom: int) -> Stack:
    """Lay hypotheses side by side."""
    groups: tuple[list[Any], list[Any], list[Any]] = ([], [], [])
    group = np.array([_group(each) for each in hypotheses])
    for each, number in zip(hypotheses, group, strict=True):
        groups[number].append(each)
    dense, sparse, memories = groups
    place = np.empty(len(group), dtype=np.intp)
    place[np.argsort(group, kind="stable")] = np.arange(len(group))
    n = (*dense, *sparse)[0].stored.shape[0]
    sizes = [len(each.share) for each in (*dense, *sparse)]
    return Stack(
        np.concatenate([np.zeros((n, 0)), *(each.stored for each in dense)], axis=1),
        csr_array(hstack([csc_array((n, 0)), *(each.stored for each in sparse)], format="csc").T),
        np.concatenate([each.share for each in (*dense, *sparse)]),
        np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp),
        tuple(memories),
        place,
        freedom,
    )


def _group(hypothesis: Hypothesis | Memory) -> int:
    """0 for dense directions, 1 for sparse ones, 2 for memories."""
    if isinstance(hypothesis, Memory):
        return 2
    return int(not isinstance(hypothesis.stored, np.ndarray))
