"""What of a sampled signal is structure, not noise that persists, while its noise is estimated.

An autoregression follows whatever is smooth in time. Where the law lacks something, the estimate would take
it for noise that persists, of which few values are independent, and nothing would be wrong. Each effect of a
candidate cause, and each unstructured alternative, is therefore tried as part of the mean: the noise is
estimated beside it, and noise alone is compared with the effect in noise by the Bayesian information
criterion (G. Schwarz, Ann. Stat. 6:461, 1978), the logarithm of the number of effects being a price. Where
noise really persists, noise alone has the better of it, since no effect makes its innovations much smaller.

So are polynomials in time, each session's own: a law may lack something else in every session, as of another
body that falls. Since noise close to a unit root persists less beside them, they need a greater advantage,
the greater the more sessions there are (`benchmarks/README.md`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.table_terms import CourseTerm
from stickslip_fit.diagnosis.autocorrelation import (
    MAX_WITHOUT_GAIN,
    SPAN_TOL,
    Autocorrelation,
    criterion,
    estimate_noise,
    price,
    spanning,
)
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL
from stickslip_fit.diagnosis.linearized import LinearizedFit

MAX_EFFECTS = 4
MIN_ADVANTAGE = 3.0  # nats beyond what the criterion asks for
MIN_COURSE_ADVANTAGE, FOR_EACH_SESSION = 13.0, 2.0  # the same of polynomials
MAX_SHARE = 0.2  # of the rows, of an effect's directions
MAX_DEGREE = 6  # of a polynomial
# Of all sessions' polynomials; where they come beside causes of someone's own that explain much.
MAX_COURSE_DIRECTIONS, MAX_BESIDE_OWN = 150, 20


@dataclass(frozen=True, eq=False)
class Mean:
    """What counts as part of the mean of a signal, and the noise beside it.

    Attributes
    ----------
    columns : array, shape (n, m)
        Whitened and projected.
    value : float
        Of both, by the criterion.
    """

    columns: Array
    noise: Autocorrelation
    value: float

    @classmethod
    def of(cls, linearized: LinearizedFit, columns: Array, sample: IntArray) -> Mean:
        """Some columns, with the noise that is likeliest beside them; `sample` is as of `Autocorrelation`."""
        noise = estimate_noise(linearized, columns, sample)
        return cls(columns, noise, criterion(linearized, columns, noise))

    def extend(self, linearized: LinearizedFit, columns: Array) -> Mean:
        """The same with more columns, and the noise beside all of them."""
        together = np.concatenate([self.columns, columns], axis=1)
        return self.of(linearized, together, self.noise.sample)


def find_mean_effects(linearized: LinearizedFit, effects: Sequence[Array], mean: Mean) -> Mean:
    """The mean with those effects that describe a signal better than noise that persists does.

    Parameters
    ----------
    linearized : LinearizedFit
        Of n rows, whose noise counts as independent.
    effects : sequence of array, shape (n, q)
        Whitened and projected; each is fitted as a whole.
    """
    n = len(linearized)
    tried = [one for one in effects if 0 < one.shape[1] <= MAX_SHARE * n]
    for _ in range(MAX_EFFECTS if tried else 0):
        better = None
        for under in (Autocorrelation(mean.noise.sample, None), mean.noise):
            effect = tried[most_explained(linearized, tried, mean.columns, under)]
            beside = mean.extend(linearized, effect)
            advantage = beside.value - mean.value - price(effect) - np.log(len(tried))
            if better is None or advantage > better[0]:
                better = advantage, beside
        if better is None or better[0] < MIN_ADVANTAGE:
            break
        mean = better[1]
    return mean


def find_session_courses(
    linearized: LinearizedFit, mean: Mean, most: int = MAX_COURSE_DIRECTIONS
) -> tuple[Mean, int]:
    """The mean with each session's own polynomial in time, if these are likelier than noise that persists.

    Returns
    -------
    mean : Mean
    degree : int
        Of all polynomials, which together have at most so many directions; 0 where there are none.
    """
    most = min(int(MAX_SHARE * len(linearized)), most)
    best, found, without_gain = -np.inf, (mean, 0), 0
    for degree, one in enumerate(_session_polynomials(linearized), start=1):
        if not 0 < one.shape[1] <= most or without_gain == MAX_WITHOUT_GAIN:
            continue
        beside = mean.extend(linearized, one)
        value = beside.value - price(one)
        better = value > best
        best, without_gain = (value, 0) if better else (best, without_gain + 1)
        found = (beside, degree) if better else found
    least = MIN_COURSE_ADVANTAGE + FOR_EACH_SESSION * linearized.rows["session"].nunique()
    return found if best >= mean.value + least else (mean, 0)


def _session_polynomials(linearized: LinearizedFit) -> Iterator[Array]:
    """Up to each degree in turn, of every session; whitened and projected."""
    sessions, seconds = (linearized.rows[name].to_numpy() for name in ("session", "session_seconds"))
    powers = []
    for session in dict.fromkeys(sessions):
        inside = sessions == session
        limits = ((0.0, max(float(seconds[inside].max()), float(np.finfo(float).tiny))),)
        course = CourseTerm.of_degrees(range(1, MAX_DEGREE + 1), limits=limits, unit="")
        powers.append(course.functions(linearized.columns) * inside[:, None])
    columns = np.stack(powers, axis=2)
    columns = linearized.project(linearized.whiten(columns.reshape(len(sessions), -1))).reshape(columns.shape)
    for degree in range(1, MAX_DEGREE + 1):
        own = columns[:, :degree].reshape(len(sessions), -1)
        yield own[:, np.linalg.norm(own, axis=0) > EFFECT_TOL]


def most_explained(
    linearized: LinearizedFit, effects: Sequence[Array], mean: Array, noise: Autocorrelation
) -> int:
    """Which effect explains most of what is left under some noise, at half of log(n) for each direction."""
    n = len(linearized)
    absorbed = spanning(noise.whiten(np.concatenate([linearized.basis.toarray(), mean], axis=1)))
    target = noise.whiten(linearized.residual)
    target = target - absorbed @ (absorbed.T @ target)
    squares = max(float(target @ target), float(np.finfo(float).tiny))
    scores = []
    for columns in _whitened(effects, noise):
        left = columns - absorbed @ (absorbed.T @ columns)
        known = np.linalg.norm(left, axis=0) > SPAN_TOL * np.linalg.norm(columns, axis=0)
        own = spanning(left[:, known])
        explained = min(float(np.sum((own.T @ target) ** 2)) / squares, 1.0 - 1e-12)
        scores.append(-0.5 * n * np.log1p(-explained) - 0.5 * columns.shape[1] * np.log(n))
    return int(np.argmax(scores))


def _whitened(effects: Sequence[Array], noise: Autocorrelation) -> Iterator[Array]:
    """Each effect under some noise; all are filtered at once."""
    ends = np.cumsum([one.shape[1] for one in effects])[:-1]
    yield from np.split(noise.whiten(np.concatenate(effects, axis=1)), ends, axis=1)
