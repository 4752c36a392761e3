"""A smooth function whose prior is the average over its forms.

A form has a correlation length, and shares of its variance that are of opposite sign in the two directions
and each session's own. The likeliest form alone predicts worse than the average: few traverses rarely tell
forms apart, and what one leaves out is left out of every prediction (J. A. Hoeting et al., Stat. Sci. 14:382,
1999). The average of their covariances is one covariance, so that the law has one function. Evidence counts
at a learning rate below one, as the noise is no exact model (P. Grunwald and T. van Ommen, Bayesian Anal.
12:1069, 2017).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes.proposed import Mode, NestedTerm, SmoothTerm
from stickslip_fit.causes.smooth import MIN_PRIOR_SD, prior_sds
from stickslip_fit.diagnosis.carriers import BEYOND
from stickslip_fit.diagnosis.carriers import LENGTHS as CARRIER_LENGTHS
from stickslip_fit.diagnosis.evidence import find_strength
from stickslip_fit.diagnosis.hypotheses import EFFECT_TOL, VARIANCE_TOL, compute_effects
from stickslip_fit.diagnosis.linearized import LinearizedFit, split_positions

# Of a travel, as shares of the range of its cosines, which is wider.
LENGTHS = tuple(length / (1.0 + 2.0 * BEYOND) for length in (0.5, 0.25, 0.1, 0.05, 0.03))
N_COARSE = 2  # of these, for carriers with few values and for functions that are looked for with few waves
SHARES = (0.0, 0.2, 0.5, 0.8, 1.0)
LEARNING_RATE = 1.0 / 6.0
MIN_WEIGHT = 0.01  # of a form over that of the likeliest, below which its neighbours are not tried
MIN_PART = 0.01  # of the average's variance, below which a part is left out

Form = tuple[int, int, int]
"""Places of its length, of its share that is opposite in directions, and of its share of sessions."""


def average_forms(term: SmoothTerm, linearized: LinearizedFit, residual: Array) -> NestedTerm:
    """The average over the forms of a function of one carrier that differs between sessions.

    Whitened residuals, shape (n,), weigh them and tell the size of the prior.
    """
    priors = [prior_sds(length) for length in LENGTHS]
    if len(term.orders) < len(prior_sds(max(CARRIER_LENGTHS))):
        priors = [prior[: len(term.orders)] for prior in priors[:N_COARSE]]
    modes: tuple[Mode, ...] = ("same", "opposite") if np.ptp(linearized.direction_sign) else ("same",)
    kinds = list(product((False, True), modes))
    units = (1.0,) * max(map(len, priors))
    wholes = [NestedTerm.of_parts(term, [(*kind, units)]) for kind in kinds]
    effects = [compute_effects(linearized, whole, np.eye(len(whole.parameters))) for whole in wholes]
    variances = _Forms(effects, priors, residual, linearized.df).average()
    total = variances.sum(axis=0)
    variances = variances[:, : 1 + int(np.max(np.flatnonzero(total >= MIN_PRIOR_SD**2 * total.max())))]
    kept = variances.sum(axis=1) > MIN_PART * variances.sum()
    sds = np.sqrt(variances).tolist()
    return NestedTerm.of_parts(
        term, [(*kind, tuple(own)) for kind, own, keep in zip(kinds, sds, kept, strict=True) if keep]
    )


@dataclass(frozen=True)
class _Weighed:
    """The log evidence of a form at its likeliest size, and the variance of its function there."""

    evidence: float
    variance: float


class _Forms:
    """The forms that a function may have, weighed by whitened residuals, shape (n,).

    `effects` are those of unit coefficients of the functions that all sessions share, the same and, where
    there are both directions, opposite in them, then of those of each session; each shape (n, groups m).
    `priors` are standard deviations of the coefficients for each length, shape (m,) or shorter.
    """

    def __init__(self, effects: Sequence[Array], priors: Sequence[Array], residual: Array, df: int) -> None:
        self.priors, self.n_parts, m = priors, len(effects), max(map(len, priors))
        acting = [one.reshape(len(one), -1, m) for one in effects]
        self.by_length: list[list[tuple[Array, Array]]] = [[] for _ in priors]
        for rows in _split_rows(acting):
            own = [one[rows] for one in acting]
            own = [one[:, np.any(one, axis=(0, 2))] for one in own]
            for known, prior in zip(self.by_length, priors, strict=True):
                known.append(_find_covariances(own, prior, residual[rows]))
        self.residual, self.df = residual, df
        self.opposite = SHARES if len(effects) == 4 else SHARES[:1]

    def average(self) -> Array:
        """The mean variance of each coefficient of each part, shape (parts, m)."""
        weighed = self.explore()
        likeliest = max(one.evidence for one in weighed.values())
        variances, total = np.zeros((self.n_parts, max(map(len, self.priors)))), 0.0
        for form, one in weighed.items():
            weight, prior = np.exp(LEARNING_RATE * (one.evidence - likeliest)), self.priors[form[0]]
            total += weight
            variances[:, : len(prior)] += weight * one.variance * np.outer(self.shares(form), prior**2)
        return variances / total

    def explore(self) -> dict[Form, _Weighed]:
        """Every second form, and the neighbours of those that are not far less likely than the likeliest."""
        weighed: dict[Form, _Weighed] = {}
        coarse = product(range(len(self.priors)), range(0, len(self.opposite), 2), range(0, len(SHARES), 2))
        new: list[Form] = list(coarse)
        while new:
            for form in new:
                weighed[form] = self.weigh(form)
            least = max(one.evidence for one in weighed.values()) + np.log(MIN_WEIGHT) / LEARNING_RATE
            likely = [form for form, one in weighed.items() if one.evidence >= least]
            new = sorted({near for form in likely for near in self.neighbours(form)} - weighed.keys())
        return weighed

    def neighbours(self, form: Form) -> Iterable[Form]:
        """Forms whose shares are the next larger or smaller ones."""
        length, opposite, own = form
        for one in (opposite - 1, opposite, opposite + 1):
            for other in (own - 1, own, own + 1):
                if 0 <= one < len(self.opposite) and 0 <= other < len(SHARES):
                    yield length, one, other

    def shares(self, form: Form) -> Array:
        """Of the variance of a form, in each part."""
        opposite, own = self.opposite[form[1]], SHARES[form[2]]
        ways = [1.0 - opposite, opposite][: self.n_parts // 2]
        return np.array([share * way for share in (1.0 - own, own) for way in ways])

    def weigh(self, form: Form) -> _Weighed:
        """The size of a form under which the residuals are likeliest."""
        shares, variances, coefficients = self.shares(form), [np.zeros(0)], [np.zeros(0)]
        for covariances, residual in self.by_length[form[0]]:
            own, directions = np.linalg.eigh(np.einsum("p,pij->ij", shares, covariances))
            variances.append(own)
            coefficients.append(directions.T @ residual)
        variance, along = np.concatenate(variances), np.concatenate(coefficients)
        total = float(variance.sum())
        if total < EFFECT_TOL**2:  # calibration absorbs it
            return _Weighed(-np.inf, 0.0)
        kept = variance > VARIANCE_TOL * total
        along = along[kept]
        size = find_strength(along, variance[kept] / total, self.residual, self.df)
        return _Weighed(size.evidence, size.strength**2 * size.noise / total)


def _split_rows(effects: Sequence[Array]) -> list[IntArray]:
    """Rows that functions couple with each other, as those of one joint, without any on which none acts.

    Effects, each of shape (n, groups, m), have covariances that are zero between these sets of rows.
    """
    acts = np.concatenate([np.any(np.abs(one) > EFFECT_TOL, axis=2) for one in effects], axis=1)
    near, reach = np.zeros((0, 0), dtype=bool), acts.T @ acts
    while not np.array_equal(near, reach):
        near, reach = reach, reach @ reach
    rows = np.flatnonzero(acts.any(axis=1))
    first = np.argmax(reach, axis=1)[np.argmax(acts[rows], axis=1)]
    return [rows[places] for places in split_positions(first)]


def _find_covariances(effects: Sequence[Array], prior: Array, residual: Array) -> tuple[Array, Array]:
    """The covariance of the effects of each part, and the residual, shape (n,), along the same axes.

    Effects, each of shape (n, groups, m), of coefficients with these standard deviations, (m,) or fewer. The
    axes are the rows, or fewer where all effects span fewer.
    """
    scaled = [(one[..., : len(prior)] * prior).reshape(len(one), -1) for one in effects]
    ends = np.cumsum([one.shape[1] for one in scaled])[:-1]
    columns = np.concatenate(scaled, axis=1)
    if columns.shape[1] < len(columns):
        axes, columns = np.linalg.qr(columns)
        residual = axes.T @ residual
    return np.stack([own @ own.T for own in np.split(columns, ends, axis=1)]), residual
