"""The misfit test: Bayes factors of all hypotheses, and the p-value of the whole search.

The statistic is the mean Bayes factor (`evidence`) over all causes and unstructured alternatives.

For the p-value, residuals beyond 2.5 standard deviations are set to that first, in the log as in every
sample (winsorized; P. J. Huber, Ann. Math. Stat. 35:73, 1964): of heavy-tailed noise a single row would
otherwise decide about hypotheses that rest on few rows. Not so where noise is autocorrelated.

Its null distribution is a wild bootstrap: signs of the residuals flipped at random, then the
calibration parameters projected out again (J. L. Horowitz, Annu. Rev. Econ. 11:193, 2019). A real effect
would inflate it, so the best hypothesis is subtracted first; residuals are divided by sqrt(1 - leverage)
as in the jackknife (J. G. MacKinnon and H. White, J. Econometrics 29:305, 1985). A wild bootstrap keeps
the largest residuals where they are; in small logs with heavy tails their places look like structure about
twice as often as the p-value says. So where it comes out small, Student t noise is simulated, too, its
degrees of freedom drawn from their posterior distribution, and the larger p-value counts. Where the noise is
clearly skewed, residuals drawn with replacement take its place; where counts are coarsely rounded, so are
the simulated ones.

The p-value of a `Diagnosis` is min(1, p_outliers / 0.25, p_rest / 0.75), a weighted Bonferroni
correction for two tests. p_outliers is that of the likelihood ratio test in `noise.find_outliers`; p_rest
is `compute_p_value(...).p_value` of the baseline's residuals, outlying counts removed: the share of
bootstrap samples with at least the log's statistic, (1 + exceedances) / (1 + samples). There are no more
samples once no decision depends on the rest: so many exceed the statistic, or it is so far above 500 of them
that these count as 20 for each expected false alarm. Where the noise was found
heteroscedastic or skewed from the same residuals, that share is doubled. `selection.select_causes` does both
tests in this order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import compress
from operator import and_, not_
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.special import logsumexp, poch, softmax

from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.evidence import (
    MAX_EXPLAINED,
    STRENGTHS,
    batch_hypotheses,
    find_strength,
    log_likelihood_ratio,
)
from stickslip_fit.diagnosis.hypotheses import Hypothesis
from stickslip_fit.diagnosis.linearized import MAX_LEVERAGE, LinearizedFit
from stickslip_fit.diagnosis.memory import AR1
from stickslip_fit.diagnosis.noise_shape import Quantization

UNKNOWN = "unknown"
OF_UNKNOWN = f"{UNKNOWN}:"
# Standard deviations at which residuals are cut off for the p-value: of normal noise that costs 0.2 % of the
# information.
MAX_DEVIATION = 2.5
FINE_STRENGTHS = np.geomspace(4.0, 400.0, 11)  # the same of structure far above the noise
MAX_DETECTION_LENGTH = 60.0  # whitened norm
# Nats for a structure to be subtracted before the bootstrap: of its evidence, and of its odds to nothing.
MIN_LOG_BAYES_FACTOR, MIN_LOG_ODDS = 5.0, -6.0
# Nats for a version of a cause that adds parameters to another: of its evidence, or of a criterion.
MIN_ADDED_LOG_EVIDENCE, MIN_CRITERION_GAIN = 2.0, 1.0
# Shares of the evidence of structure without a name, by the first word of an alternative's name.
LARGE_KINDS = {"product": 0.25, "period": 0.125, "steps": 0.125}
UNKNOWN_WEIGHT = 4.0  # in the test's statistic, in which each cause has 1: what nobody thought of is not rare
MIN_AHEAD = 1e-3  # nats, more than rounding
MAX_ROW_SHARE = 0.4  # of an effect's prior variance in one row
MIN_LEFT_SHARE = 0.5  # of a cause's shapes, that are in more rows
MAX_ROW_LEVERAGE = 0.15  # of an effect in one row; above, its signs are too few for a bootstrap
TAIL_DF = (5.0, 8.0, 15.0, 200.0)  # of Student t noise that is simulated
# Student t noise cannot change the answer where the bootstrap's p-value is above this, or where the statistic
# is so many nats above all bootstrap samples.
MAX_DOUBTFUL_P_VALUE, MAX_DOUBTFUL_LOG_EVIDENCE = 0.05, 10.0
SMOOTHING_SD = 0.2  # of resampled residuals, in units of the noise
# Of few samples a single one would decide: with so few of them above the statistic, there are more.
MIN_DECISIVE_SAMPLES, FEW_EXCEEDANCES = 1000, 5
# Samples after which more say nothing if the statistic is so many nats above them: in noise a Bayes factor is
# 1 on average, so that it is K or more with a probability of at most 1 / K (Markov's inequality). They count
# as this share of those that a p-value without a factor has.
FEW_SAMPLES, CLEAR_LOG_EVIDENCE, CLEAR_SHARE = 500, 7.0, 2 / 3
MIN_STUDENT_SAMPLES = 2000  # few samples would let one of them decide
# Bootstrap samples at a time, and coefficients in them; for larger arrays the system clears memory each time.
BATCH_SIZE, MAX_ELEMENTS = 250, 8_000_000


@dataclass(frozen=True, eq=False)
class StructureRemoved:
    """Residuals without their best-fitting structure.

    Attributes
    ----------
    residual : array, shape (n,)
    leverage : array, shape (n,)
        Share of each row's noise that was subtracted with the structure.
    log_evidence : float
        Log Bayes factor of what was subtracted.
    """

    residual: Array
    leverage: Array
    log_evidence: float = 0.0


def remove_structure(
    residual: Array, hypotheses: Sequence[Hypothesis | AR1], log_evidence: Array, df: int
) -> StructureRemoved:
    """Subtract the likeliest structure from residuals, (n,), shrunk as its prior says.

    At the likeliest strength whatever the noise, which is known only once the structure is removed. Of
    thousands of shapes one is about as likely as this in noise alone.
    """
    causes, zeros = list(map(classify_cause, hypotheses)), np.zeros(len(residual))
    log_odds = log_evidence + weigh_hypotheses(hypotheses, causes) - np.log(len({*causes}))
    best = int(np.argmax(log_evidence))
    shape = hypotheses[best]
    if log_evidence[best] < MIN_LOG_BAYES_FACTOR or log_odds[best] < MIN_LOG_ODDS:
        return StructureRemoved(residual, zeros)
    if isinstance(shape, AR1):
        return StructureRemoved(residual - shape.shape(residual), zeros, float(log_evidence[best]))
    along, share = shape.coefficients(residual), shape.prior_share
    signal = find_strength(along, share, residual, df, FINE_STRENGTHS).strength ** 2 * share
    kept = signal / (1.0 + signal)
    left = residual - shape.combine(kept * along)
    return StructureRemoved(left, shape.leverage(kept), float(log_evidence[best]))


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
    basis : sparse array, shape (n, number of parameters), or None
        Of the calibration that is projected out; None for residuals of no fit.
    failed : dict of str to (int, int)
        Causes of which trials were left out, with their number and that of all its trials.
    inconsistent : tuple of str
        Causes that are no less likely than the likeliest one, though neither is right, see
        `cause_set.limit_evidence`.
    """

    residual: Array
    hypotheses: tuple[Hypothesis | AR1, ...]
    log_evidence: Array
    log_evidence_by_cause: dict[str, float]
    p_value: float
    null_log_evidence: Array
    p_value_factor: float = 1.0
    basis: csr_array | None = None
    failed: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    inconsistent: tuple[str, ...] = ()

    @property
    def statistic(self) -> float:
        """That of these residuals as they are, in which none is cut off."""
        evidence = self.log_evidence_by_cause
        weight = [UNKNOWN_WEIGHT if cause == UNKNOWN else 1.0 for cause in evidence]
        return float(logsumexp(list(evidence.values()), b=weight)) if evidence else -np.inf

    def critical_value(self, level: float) -> float:
        """Value of the statistic that noise alone exceeds with probability `level`."""
        if not len(self.null_log_evidence):
            return np.nan
        return float(np.quantile(self.null_log_evidence, 1.0 - level / self.p_value_factor))

    def rank_causes(self, least: float, without: Sequence[str] = ()) -> list[str]:
        """Causes with more evidence than `least`, the likeliest first; none `without` a name."""
        evidence = self.log_evidence_by_cause
        known = [cause for cause in evidence if cause not in (UNKNOWN, *without) and evidence[cause] > least]
        return sorted(known, key=lambda cause: -evidence[cause])

    def special_case_of(self, cause: str) -> str:
        """A cause whose form contains that of this one; empty where there is none."""
        versions: list[Any] = [self.hypotheses[place].version for place in self._places.get(cause, ())]
        return next((one.special_case_of for one in versions if one is not None), "")

    def with_likeliest(self, shape: Hypothesis) -> Misfit:
        """The test with an unstructured alternative that takes the place of the likeliest one."""
        hypotheses, known = (*self.hypotheses, shape), self.log_evidence[self._places[UNKNOWN]]
        evidence = np.append(self.log_evidence, known.max() + MIN_AHEAD)
        causes = [classify_cause(one) for one in hypotheses]
        unknown = average_by_cause(causes, weigh_hypotheses(hypotheses, causes), evidence)[UNKNOWN]
        by_cause = self.log_evidence_by_cause | {UNKNOWN: unknown}
        return replace(self, hypotheses=hypotheses, log_evidence=evidence, log_evidence_by_cause=by_cause)

    def best_hypothesis(self, cause: str) -> Hypothesis | AR1:
        """The likeliest shape of a cause; of all causes, if this one has no shape."""
        places = self._places.get(cause) or range(len(self.hypotheses))
        return self.hypotheses[self._choose(places)]

    def best_equation(self, cause: str) -> Hypothesis | AR1:
        """As `best_hypothesis`; where a shape that the data may bend is likelier, the likeliest equation."""
        best = self.best_hypothesis(cause)
        places = [k for k in self._places.get(cause, ()) if not may_bend(self.hypotheses[k])]
        return self.hypotheses[self._choose(places)] if may_bend(best) and places else best

    def best_subspace(self, cause: str) -> Hypothesis:
        """As `best_hypothesis`, autoregressions left out."""
        for places in (self._places.get(cause, ()), range(len(self.hypotheses))):
            if own := [k for k in places if isinstance(self.hypotheses[k], Hypothesis)]:
                break
        best = self.hypotheses[self._choose(own)]
        assert isinstance(best, Hypothesis)
        return best

    def single_directions(self, cause: str) -> list[Hypothesis]:
        """The hypotheses of a cause by its equation alone, without a shape that the data may bend."""
        own = (self.hypotheses[k] for k in self._places.get(cause, ()))
        return [one for one in own if isinstance(one, Hypothesis) and one.values is not None]

    def _choose(self, places: Sequence[int]) -> int:
        """The likeliest hypothesis, or the simpler one that it adds parameters to, for no clear reason.

        Clear is so much more evidence, or a Bayesian information criterion that is better with them.
        """
        best = max(places, key=lambda k: self.log_evidence[k])
        simpler = [k for k in places if not _adds_to_simpler(self.hypotheses[k])]
        if not _adds_to_simpler(self.hypotheses[best]) or not simpler:
            return best
        simple = max(simpler, key=lambda k: self.log_evidence[k])
        more = self.log_evidence[best] - self.log_evidence[simple]
        lower = self._criterion(best) - self._criterion(simple)
        return best if more > MIN_ADDED_LOG_EVIDENCE or lower > MIN_CRITERION_GAIN else simple

    def _criterion(self, place: int) -> float:
        """Bayesian information criterion of a hypothesis, over -2, in which nothing is shrunk."""
        shape, n = self.hypotheses[place], len(self.residual)
        assert isinstance(shape, Hypothesis)
        explained = float(np.sum(shape.coefficients(self.residual) ** 2) / (self.residual @ self.residual))
        price = 0.5 * len(shape.prior_share) * np.log(n)
        return float(log_likelihood_ratio(explained, n)) - price

    @cached_property
    def _places(self) -> dict[str, list[int]]:
        """Where the hypotheses of each cause stand."""
        places: dict[str, list[int]] = {}
        for place, one in enumerate(self.hypotheses):
            places.setdefault(classify_cause(one), []).append(place)
        return places

    def n_shapes(self, cause: str) -> float:
        """Number of shapes over which the statistic averages the evidence of a cause, at least 1.

        Those that are as likely as the best one, since they resemble it, count as one with it.
        """
        best = max((self.log_evidence[k] for k in self._places.get(cause, ())), default=-np.inf)
        weight = UNKNOWN_WEIGHT if cause == UNKNOWN else 1.0
        return max(float(np.exp(best - self.log_evidence_by_cause.get(cause, best))) / weight, 1.0)


def classify_cause(hypothesis: Hypothesis | AR1) -> str:
    """The cause, or ``unknown`` for any unstructured alternative."""
    return UNKNOWN if hypothesis.cause.startswith(OF_UNKNOWN) else hypothesis.cause


def may_bend(hypothesis: Hypothesis | AR1) -> bool:
    """Whether it is a cause as a smooth function of its column, in place of its equation at some values."""
    version = hypothesis.version
    is_shape = isinstance(hypothesis, Hypothesis) and hypothesis.values is None and version is not None
    return is_shape and not getattr(version, "combine_trials", True)


def _adds_to_simpler(hypothesis: Hypothesis | AR1) -> bool:
    """Whether another version of the same cause has fewer parameters."""
    return bool(getattr(hypothesis.version, "adds_to_simpler", False))


def drop_single_rows(hypotheses: Sequence[Hypothesis | AR1]) -> list[Hypothesis | AR1]:
    """The hypotheses whose effect is in several rows, and all those of causes that have few such shapes.

    What is mostly in one row cannot be told from an outlier there. But a few shapes that are left would only
    stand for those that are not.
    """
    if not hypotheses:
        return []
    causes = list(map(classify_cause, hypotheses))
    shares = [one.prior_share if isinstance(one, Hypothesis) else np.zeros(1) for one in hypotheses]
    begins = np.cumsum([0, *map(len, shares[:-1])])
    # No row has more than the largest share, since the directions are orthonormal.
    is_shared = (np.maximum.reduceat(np.concatenate(shares), begins) <= MAX_ROW_SHARE).tolist()
    for place in [place for place, is_wide in enumerate(is_shared) if not is_wide]:
        shape = hypotheses[place]
        is_shared[place] = isinstance(shape, Hypothesis) and shape.largest_row_share <= MAX_ROW_SHARE
    number, left = Counter(causes), Counter(compress(causes, is_shared))
    known = {cause for cause, count in left.items() if count >= MIN_LEFT_SHARE * number[cause]} | {UNKNOWN}
    of_known = [cause in known for cause in causes]
    return [*compress(hypotheses, map(not_, of_known)), *compress(hypotheses, map(and_, is_shared, of_known))]


def weigh_evidence(
    linearized: LinearizedFit, hypotheses: Sequence[Hypothesis | AR1], known: Misfit | None = None
) -> Misfit:
    """The evidence of the residuals of a fit for some hypotheses; no p-value (NaN).

    That of hypotheses which a `known` test has of the same residuals is not computed again.
    """
    # A law with as many parameters as rows fits anything; one that leaves nothing has nothing to be tested.
    if not hypotheses or linearized.df < 1 or linearized.fits_exactly:
        return Misfit(linearized.residual, (), np.zeros(0), {}, 1.0, np.zeros(0), basis=linearized.basis)
    before = {}
    if known is not None and np.array_equal(known.residual, linearized.residual):
        before = dict(zip(map(id, known.hypotheses), known.log_evidence.tolist(), strict=True))
    batch = batch_hypotheses([one for one in hypotheses if id(one) not in before], linearized.df)
    found = iter(batch.log_evidence(linearized.residual[:, None])[:, 0])
    own = np.array([before[id(one)] if id(one) in before else next(found) for one in hypotheses])
    causes = [classify_cause(hypothesis) for hypothesis in hypotheses]
    by_cause = average_by_cause(causes, weigh_hypotheses(hypotheses, causes), own)
    return Misfit(
        linearized.residual, tuple(hypotheses), own, by_cause, np.nan, np.zeros(0), basis=linearized.basis
    )


def compute_p_value(
    misfit: Misfit,
    linearized: LinearizedFit,
    n_bootstrap: int,
    rng: np.random.Generator,
    max_exceedances: int | None = None,
    p_value_factor: float = 1.0,
    *,
    skewed: bool = False,
    quantization: Quantization | None = None,
) -> Misfit:
    """The `misfit` of a fit with its p-value, from `n_bootstrap` samples of noise.

    After `max_exceedances` samples above the log's statistic the bootstrap ends (J. Besag and P.
    Clifford, Biometrika 78:301, 1991), and where it is far above all of `FEW_SAMPLES`, which count as more.
    Either only ever makes the p-value larger than that of all samples. `p_value_factor` is that of `Misfit`.
    Noise that is `skewed`, or rounded by a `quantization`, is simulated as such.
    """
    hypotheses, own = misfit.hypotheses, misfit.log_evidence
    if not hypotheses:
        return replace(misfit, p_value_factor=p_value_factor)
    batch = batch_hypotheses(hypotheses, linearized.df)
    causes = [classify_cause(hypothesis) for hypothesis in hypotheses]
    weight = weigh_hypotheses(hypotheses, causes)
    weight += np.log([UNKNOWN_WEIGHT if cause == UNKNOWN else 1.0 for cause in causes])
    # In noise that persists, what changes at once and stays so is one row far out, whitened.
    bound = MAX_DEVIATION if linearized.noise_filter is None else np.inf

    def simulate(draw_noise: NoiseSampler, number: int, null: Array) -> tuple[Array, float]:
        """The statistic in samples of noise, after those of `null`, and the share of at least the log's."""
        before, enough = len(null), max(CLEAR_SHARE * number / p_value_factor, MIN_DECISIVE_SAMPLES)
        size = min(BATCH_SIZE, max(MAX_ELEMENTS // max(len(linearized), batch.n_coefficients), 1))
        for first in range(0, number, size):
            noise = winsorize(draw_noise(min(size, number - first)), bound)
            null = np.concatenate([null, batch.log_mean_evidence(linearized.project(noise), weight)])
            above = statistic - null.max()
            if max_exceedances is None:
                continue
            if above > CLEAR_LOG_EVIDENCE and len(null) >= FEW_SAMPLES:
                return null, 1.0 / (1.0 + max(enough, len(null)))
            if int(np.sum(null[before:] >= statistic)) >= max_exceedances:
                break
        return null, (1 + int(np.sum(null >= statistic))) / (1 + len(null))

    left = remove_structure(linearized.residual, hypotheses, own, linearized.df)
    shrinkage = np.sqrt(1.0 - np.minimum(linearized.leverage, MAX_LEVERAGE))
    standardized = left.residual / shrinkage
    within = linearized.project(winsorize(linearized.residual / shrinkage, bound) * shrinkage)
    statistic = float(batch.log_mean_evidence(within[:, None], weight)[0])
    wild = _make_wild_sampler(linearized, left, rng)
    student = _make_student_sampler(standardized, rng)
    sampler = wild or student
    null, share = simulate(sampler, n_bootstrap, np.zeros(0))
    if 0 < np.sum(null >= statistic) <= FEW_EXCEEDANCES and n_bootstrap < MIN_DECISIVE_SAMPLES:
        null, share = simulate(sampler, MIN_DECISIVE_SAMPLES - n_bootstrap, null)
    doubtful = statistic < null.max() + MAX_DOUBTFUL_LOG_EVIDENCE or skewed or quantization is not None
    if wild is not None and p_value_factor * share < MAX_DOUBTFUL_P_VALUE and doubtful:
        number = max(n_bootstrap, MIN_STUDENT_SAMPLES)
        sampler = _make_resampler(standardized, rng) if skewed else student
        if quantization is not None:
            sampler = _make_rounding_sampler(sampler, quantization)
        heavy_tailed, its_share = simulate(sampler, number, null[:0])
        if its_share > share:
            null, share = heavy_tailed, its_share
    return replace(
        misfit,
        p_value=min(p_value_factor * share, 1.0),
        null_log_evidence=null,
        p_value_factor=p_value_factor,
    )


def winsorize(columns: Array, bound: float) -> Array:
    """Columns, shape (n,) or (n, k), cut off at so many times the rms of each."""
    most = bound * np.sqrt(np.mean(columns**2, axis=0))
    return np.asarray(np.clip(columns, -most, most))


NoiseSampler = Callable[[int], Array]
"""Noise alone, calibration not yet projected out: number of samples k -> (n, k)."""


def _make_wild_sampler(
    linearized: LinearizedFit, left: StructureRemoved, rng: np.random.Generator
) -> NoiseSampler | None:
    """Residuals of random sign; None where what was subtracted rests on too few rows."""
    if left.leverage.max() > MAX_ROW_LEVERAGE:
        return None
    # Projection and subtraction shrink residuals; undo both.
    kept = (1.0 - left.leverage) * np.sqrt(1.0 - np.minimum(linearized.leverage, MAX_LEVERAGE))
    sizes = (left.residual / kept)[:, None]
    return lambda number: rng.choice([-1.0, 1.0], (len(linearized), number)) * sizes


def _make_student_sampler(residual: Array, rng: np.random.Generator) -> NoiseSampler:
    """Student t noise, its df in each sample drawn from those that residuals, shape (n,), may come from."""
    df, weight = np.array(TAIL_DF), _tail_probabilities(residual)

    def draw(number: int) -> Array:
        own = rng.choice(df, number, p=weight)
        return np.sqrt((own - 2.0) / own) * rng.standard_t(own, (len(residual), number))

    return draw


def _make_resampler(residual: Array, rng: np.random.Generator) -> NoiseSampler:
    """Noise as skewed as residuals, shape (n,): drawn from them with replacement, slightly smoothed."""
    centred = residual - residual.mean()
    centred /= np.sqrt(np.mean(centred**2))

    def draw(number: int) -> Array:
        shape = (len(centred), number)
        return rng.choice(centred, shape) + SMOOTHING_SD * rng.standard_normal(shape)

    return draw


def _make_rounding_sampler(sampler: NoiseSampler, quantization: Quantization) -> NoiseSampler:
    return lambda number: quantization.round(sampler(number))


def _tail_probabilities(residual: Array) -> Array:
    """Probability of each of `TAIL_DF`, given residuals of shape (n,); all alike before."""
    z, df = residual / np.sqrt(np.mean(residual**2)), np.array(TAIL_DF)
    scale = np.sqrt((df - 2.0) / df)
    constant = np.log(poch(0.5 * df, 0.5)) - 0.5 * np.log(np.pi * df) - np.log(scale)
    spread = np.sum(np.log1p((z[:, None] / scale) ** 2 / df), axis=0)
    return np.asarray(softmax(len(z) * constant - 0.5 * (df + 1.0) * spread))


def average_by_cause(causes: Sequence[str], log_weight: Array, log_evidence: Array) -> dict[str, float]:
    """Log evidence of each cause, averaged over its hypotheses; all of length H."""
    numbers = {cause: number for number, cause in enumerate(dict.fromkeys(causes))}
    label, total = np.array([numbers[cause] for cause in causes], dtype=np.intp), log_evidence + log_weight
    highest = np.full(len(numbers), np.finfo(float).min)
    np.maximum.at(highest, label, total)
    mean = np.log(np.bincount(label, np.exp(total - highest[label]), len(numbers))) + highest
    return dict(zip(numbers, mean.tolist(), strict=True))


def weigh_hypotheses(hypotheses: Sequence[Hypothesis | AR1], causes: Sequence[str]) -> Array:
    """Log weight of each hypothesis: equal for the shapes of a cause; for ``unknown`` kind by kind.

    A kind is what follows one carrier. All products, all waves and all steps that are added to counts have
    the shares of `LARGE_KINDS`.
    """
    families = [
        hypothesis.cause.split(" ")[0].removesuffix(",") if cause == UNKNOWN else cause
        for hypothesis, cause in zip(hypotheses, causes, strict=True)
    ]
    sizes = {family: np.log(size) for family, size in Counter(families).items()}
    kinds = [family for family in sizes if family.startswith(f"{UNKNOWN}:")]
    large = {f"{UNKNOWN}:{kind}": share for kind, share in LARGE_KINDS.items()}
    small = [kind for kind in kinds if kind not in large]
    left = 1.0 - sum(large[kind] for kind in kinds if kind in large)
    share = {kind: large.get(kind, left / max(len(small), 1)) for kind in kinds}
    total = sum(share.values())  # less than 1 where there are none but large kinds
    weights = [share[one] / total if one in share else 1.0 for one in families]
    return np.log(weights) - np.array([sizes[family] for family in families])


def detection_length(critical: float, n_shapes: float, df: int) -> float:
    """Norm of an effect in one direction at which its cause alone reaches a critical value of the statistic.

    `n_shapes` is the number of shapes over which the evidence of the cause is averaged.
    """
    from scipy.optimize import brentq

    def evidence(z: float) -> float:
        signal = STRENGTHS**2
        log = -0.5 * np.log1p(signal) - 0.5 * df * np.log1p(
            -np.minimum(z**2 * signal / (1 + signal) / (df + z**2), MAX_EXPLAINED)
        )
        return float(np.log(np.mean(np.exp(log - log.max()))) + log.max() - np.log(n_shapes))

    if not np.isfinite(critical) or evidence(0.0) > critical:
        return 0.0
    if evidence(MAX_DETECTION_LENGTH) < critical:  # too few rows for any effect to be detected
        return MAX_DETECTION_LENGTH
    return float(brentq(lambda z: evidence(z) - critical, 0.0, MAX_DETECTION_LENGTH, xtol=1e-3))
