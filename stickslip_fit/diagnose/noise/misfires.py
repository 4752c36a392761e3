"""Counts that are wildly off, one here and one there.

Noise may have tails as heavy as Student's t with 5 degrees of freedom, and nobody says how heavy: the bulk of
the counts does. Misfires are what no such noise gives a log of this many traverses: a likelihood ratio of
noise with misfires to noise alone, each at its best, judged by logs of noise alone under every tail that the
bulk allows (R. L. Berger and D. D. Boos, J. Am. Stat. Assoc. 89:1012, 1994).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2
from scipy.stats import t as student_t

from stickslip_fit.diagnose.laid_out.study import Study

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TAILS = (5.0, 8.0, 15.0, 200.0)  # degrees of freedom that noise may have
UNLIKELY = 6.0  # nats by which a tail must be less likely than the best not to be judged by
WRONGLY = float(chi2.sf(2 * UNLIKELY, 1))  # chance that the true tail is
ENOUGH, AT_A_TIME = 40, 500  # logs of noise alone that are likelier misfires: no alarm, whatever others say
SCALES = (0.9, 1.0, 1.1)  # of what the median says
NEAREST, FARTHEST = 5.5, 120.0  # medians of the noise, between which misfires lie
SHARES = (0.0015, 0.003, 0.006, 0.012, 0.025, 0.05)
MOST = 0.1  # of a log: more are not looked at
LARGEST_LEVERAGE = 0.8
NOTHING = 1e-6  # repeatabilities; rounding noise of what recalibration absorbs
HARDLY = 0.5  # nats in favour of misfires; noise alone often gives as much, and need not be simulated


@dataclass(frozen=True, eq=False)
class Misfires:
    """Rows that look like misfires, and how likely anything like them is by chance."""

    rows: Indices
    p_value: float


def misfires(study: Study, residual: Array, drive: Indices, draws: int, rng: np.random.Generator) -> Misfires:
    """Look for counts that are wildly off.

    Parameters
    ----------
    study : Study
    residual : array, shape (n,)
        In units of the noise, with whatever else is wrong taken out.
    drive : array of int, shape (n,)
        Rows of one drive repeat equally well.
    draws : int
    rng : Generator
    """
    judge = _Judge(study, drive)
    ratio, odds, by_tail = _likelihood_ratio(judge.off(residual[:, None]))
    if ratio[0] < HARDLY:
        return Misfires(np.zeros(0, dtype=np.intp), 1.0)
    rows = judge.known[odds[0] > 1.0]
    if not len(rows):
        return Misfires(rows, 1.0)
    allowed = [freedom for freedom, fit in by_tail.items() if fit[0] > max(by_tail.values())[0] - UNLIKELY]
    by_chance = [judge.chance(float(ratio[0]), freedom, draws, rng) for freedom in allowed]
    return Misfires(rows, min(1.0, max(by_chance) + (WRONGLY if len(allowed) < len(TAILS) else 0.0)))


class _Judge:
    """Of rows that recalibration does not take up, by their departures in units of their drive's median.

    Parameters
    ----------
    study : Study
    drive : array of int, shape (n,)
    """

    def __init__(self, study: Study, drive: Indices) -> None:
        self.study = study
        self.known = np.flatnonzero(study.leverage < LARGEST_LEVERAGE)
        self.drive = drive[self.known]

    def off(self, residuals: Array) -> Array:
        """Departures, shape (n, k) -> (k, known)."""
        kept = np.sqrt(1.0 - self.study.leverage[self.known])
        return _by_median(np.abs(residuals[self.known]).T / kept, self.drive)

    def chance(self, ratio: float, freedom: float, draws: int, rng: np.random.Generator) -> float:
        """How often logs of noise alone, with a tail, reach a likelihood ratio once recalibrated."""
        higher = made = 0
        while made < draws and higher < ENOUGH:
            size = min(AT_A_TIME, draws - made)
            noise = student_t.rvs(freedom, size=(len(self.study), size), random_state=rng)
            higher += int(np.sum(_likelihood_ratio(self.off(self.study.project(noise)))[0] >= ratio))
            made += size
        return (1 + higher) / (1 + made)


def _by_median(off: Array, drive: Indices) -> Array:
    """Departures in units of their drive's median, which no few wild ones move; shape (k, n).

    Where recalibration takes up whatever a drive did, nothing in it departs.
    """
    found = np.empty_like(off)
    for each in np.unique(drive):
        mine = drive == each
        median = np.median(off[:, mine], axis=1, keepdims=True)
        found[:, mine] = off[:, mine] / np.where(median > NOTHING, median, np.inf)
    return found


def _log_density(off: Array, unit: float, freedom: float) -> Array:
    """Of the size of Student's t over `unit`."""
    constant = float(student_t.logpdf(0.0, freedom)) + np.log(2.0 * unit)
    return constant - (freedom + 1.0) / 2.0 * np.log1p((off * (unit / np.sqrt(freedom))) ** 2)


def _likelihood_ratio(off: Array) -> tuple[Array, Array, dict[float, Array]]:
    """Log likelihood ratio of noise with misfires to noise alone, (k,), and each row's odds of one, (k, n).

    A misfire's size is as likely between 5 and 10 medians as between 50 and 100. Beside these, the log
    likelihood of each tail, misfires allowed, (k,).
    """
    n = off.shape[1]
    number = max(int(MOST * n), 1)
    places = np.argpartition(-off, number - 1, axis=1)[:, :number]
    top = np.take_along_axis(off, places, axis=1)
    far = top > NEAREST
    wild = np.where(far & (top < FARTHEST), 1.0 / (top * np.log(FARTHEST / NEAREST)), 0.0)
    alone, both = np.full(len(off), -np.inf), np.full(len(off), -np.inf)
    odds, by_tail = np.zeros_like(top), dict.fromkeys(TAILS, both)
    for freedom in TAILS:
        middle = float(student_t.ppf(0.75, freedom))
        for scale in SCALES:
            log_noise = _log_density(off, middle / scale, freedom)
            total = log_noise.sum(axis=1)
            alone = np.maximum(alone, total)
            ratio = wild * np.exp(-np.take_along_axis(log_noise, places, axis=1))
            for share in SHARES:
                # Only for the few rows that are far does the mixture differ from a share of the noise.
                gained = np.where(far, np.log1p(share * (ratio - 1.0)), np.log1p(-share)).sum(axis=1)
                value = total + gained + (n - top.shape[1]) * np.log1p(-share)
                by_tail[freedom] = np.maximum(by_tail[freedom], value)
                better = value > both
                both = np.where(better, value, both)
                odds = np.where(better[:, None], share * ratio / (1 - share), odds)
    full = np.zeros_like(off)
    np.put_along_axis(full, places, odds, axis=1)
    return both - alone, full, by_tail
