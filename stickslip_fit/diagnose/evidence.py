"""How much more likely the residuals are under a hypothesis than under noise alone.

With the noise's size unknown and an effect of strength tau, the ratio of marginal likelihoods is

    prod (1 + tau^2 s_i)^(-1/2)  (1 - sum u_i^2 tau^2 s_i / (1 + tau^2 s_i) / u'u)^(-nu / 2),

u_i being the residual along the i-th direction, s_i its share and nu the degrees of freedom (A. Zellner,
in Bayesian Inference and Decision Techniques, 1986, for one direction). Strengths are averaged over a ladder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from stickslip_fit.diagnose.hypothesis import Hypothesis
from stickslip_fit.diagnose.memory import Memory

Array = npt.NDArray[np.float64]

STRENGTHS = np.array([4.0, 10.0, 25.0, 60.0])


@dataclass(frozen=True, eq=False)
class Stack:
    """Hypotheses laid side by side, so that all are judged at once.

    Attributes
    ----------
    directions : array, shape (n, m)
        Of all hypotheses that have some.
    share : array, shape (m,)
    first : array of int
        Where each hypothesis's directions begin.
    memories : tuple of Memory
    place : array of int, shape (H,)
        Of each hypothesis, in the order given, among those with directions and then the memories.
    freedom : int
    """

    directions: Array
    share: Array
    first: npt.NDArray[np.intp]
    memories: tuple[Memory, ...]
    place: npt.NDArray[np.intp]
    freedom: int

    def log_evidence(self, residuals: Array) -> Array:
        """Log ratio of each hypothesis's marginal likelihood to that of noise alone; (n, k) -> (H, k)."""
        along = (self.directions.T @ residuals) ** 2
        total = np.sum(residuals**2, axis=0)
        found = np.empty((len(STRENGTHS), len(self.first), residuals.shape[1]))
        for index, strength in enumerate(STRENGTHS):
            signal = strength**2 * self.share
            explained = np.add.reduceat(along * (signal / (1.0 + signal))[:, None], self.first, axis=0)
            spread = np.add.reduceat(np.log1p(signal), self.first)
            found[index] = -0.5 * spread[:, None] - 0.5 * self.freedom * np.log1p(-explained / total)
        shapes = logsumexp(found, axis=0) - np.log(len(STRENGTHS))
        carried = [memory.log_evidence(residuals, self.freedom)[None] for memory in self.memories]
        return np.concatenate([shapes, *carried])[self.place]


def stack(hypotheses: Sequence[Hypothesis | Memory], freedom: int) -> Stack:
    """Lay hypotheses side by side."""
    shapes = [each for each in hypotheses if isinstance(each, Hypothesis)]
    memories = tuple(each for each in hypotheses if isinstance(each, Memory))
    sizes = [len(each.share) for each in shapes]
    is_memory = np.array([isinstance(each, Memory) for each in hypotheses])
    place = np.where(is_memory, len(shapes) + np.cumsum(is_memory) - 1, np.cumsum(~is_memory) - 1)
    return Stack(
        np.concatenate([each.directions for each in shapes], axis=1),
        np.concatenate([each.share for each in shapes]),
        np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp),
        memories,
        place,
        freedom,
    )
