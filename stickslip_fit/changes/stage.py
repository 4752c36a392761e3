"""Which change of the stage stands behind changes of an actuator, from the counts of two logs.

Under the physical law (`laws.physical`) a quantity of the stage times e^s multiplies a_f T1^2, the load's
share r of friction and lambda, each by a power of its own (`POWERS`). Each log is fitted by itself at one
lambda after the other, which says how likely its lambda is, and gives the step size without load and r of
every session. A change says what becomes of both and of lambda, so that one that takes some loads from one
regime to the other is no exception. The means over the sessions of both logs are compared with that, with
the scatter from day to day (`difference`); lambda is integrated out, as in `diagnosis.stage_change`. Errors
are taken as normal and as wide as Student's t of their degrees of freedom; s is normal about 0 beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import chdtrc

from stickslip_fit._typing import Array, BoolArray
from stickslip_fit.changes.detection import Changes
from stickslip_fit.changes.difference import Difference, SessionEstimates, compare_means
from stickslip_fit.diagnosis.stage_change import (
    SIZES,
    StageChange,
    choose_credible,
    find_regime,
    friction_limited,
    weigh_changes,
)
from stickslip_fit.estimation.drive_ratio import HIGHEST, LOWEST, RatioProfile, RatioSearch, prior_shares
from stickslip_fit.laws import is_published
from stickslip_fit.laws.physical import FRICTION_LIMITED, POWERS, Physical, physical_law_with

LOG_RATIOS = np.linspace(np.log(LOWEST), np.log(HIGHEST), 1201)
MODEL_SPREAD = 0.01  # of log lambda, by what is not Coulomb's friction, from one log to the other
MAX_SPREAD = 0.1  # and by the scatter from day to day
LEAST_LIKELIHOOD = 1e-200
MIN_DF = 2.5  # of a difference, with fewer of which its error is too uncertain


@dataclass(frozen=True)
class StageDifference:
    """Which change of the stage the differences of two logs stand for.

    Attributes
    ----------
    changes : tuple of StageChange
        Of the likeliest trace first; relative sizes, new against old.
    regime : str
        Of the old log, where it has 95 %, else empty.
    p_value : float
        That the likeliest describes all differences.
    """

    changes: tuple[StageChange, ...]
    regime: str
    p_value: float

    @property
    def credible(self) -> tuple[StageChange, ...]:
        """The smallest set that holds the change with 95 %; empty where none describes the differences."""
        return choose_credible(self.changes, self.p_value)


def read_stage_difference(changes: Changes) -> StageDifference | None:
    """Read changes of published or physical laws as one change of the stage.

    Returns
    -------
    StageDifference or None
        None where nothing changed, for other laws, and where the scatter from day to day is hardly known.
    """
    if not changes.significant or not changes.logs[0].machine.has_published_geometry:
        return None
    joints = [joint for joint, law in changes.laws.items() if is_published(law) or isinstance(law, Physical)]
    fits = dict(pair for joint in joints for pair in _fit_drives(changes, joint))
    drives = list(fits.values())
    compared = iter(compare_means([one for drive in drives for one in drive.estimates], changes.alpha))
    errors = [np.array([_widen(next(compared)) for _ in drive.estimates]) for drive in drives]
    known = [np.isfinite(own) for own in errors]
    if not (any(own[0] for own in known) and any(own[1:].any() for own in known)):
        return None
    squares = {
        quantity: [drive.squares(quantity, own) for drive, own in zip(drives, errors, strict=True)]
        for quantity in POWERS
    }
    prior = [np.log(prior_shares(drive.ratios))[:, None] for drive in drives]
    terms = {
        quantity: [start - each / 2 for start, each in zip(prior, own, strict=True)]
        for quantity, own in squares.items()
    }
    found, log_posterior = weigh_changes(terms)
    limited = friction_limited([drive.ratios for drive in drives], terms, log_posterior)
    is_whole = all((one.joint, one.direction) in fits for one in changes.significant)
    best = found[0].trace
    at = int(np.argmax(log_posterior[best]))
    excess = sum(float(own[:, at].min()) for own in squares[best])
    free = sum(int(own.sum()) + drive.knows_ratio for drive, own in zip(drives, known, strict=True)) - 1
    return StageDifference(found, find_regime(limited) if is_whole else "", float(chdtrc(free, excess)))


@dataclass(frozen=True, eq=False)
class _DriveFits:
    """A joint and direction, of which each log was fitted at every lambda.

    Attributes
    ----------
    ratios : array, shape (m,)
    profiles : tuple of RatioProfile
        Of the old and the new log.
    values, variances : array, shape (m, g, q)
        By lambda and session the logarithm of the step size without load, then the values of r.
    known : array of bool, shape (g, q)
        Whether a session determines a quantity, whatever lambda.
    is_new : array of bool, shape (g,)
    """

    ratios: Array
    profiles: tuple[RatioProfile, RatioProfile]
    values: Array
    variances: Array
    known: BoolArray
    is_new: BoolArray

    @property
    def estimates(self) -> list[SessionEstimates]:
        """Of each quantity, at the likeliest lambda of the old log."""
        found = []
        for k in range(self.values.shape[2]):
            values, variances = (
                array[self._place, self.known[:, k], k] for array in (self.values, self.variances)
            )
            kind, scale = ("r", float(np.sqrt(np.mean(variances)))) if k else ("unloaded", 1.0)
            found.append(SessionEstimates(kind, values, variances, self.is_new[self.known[:, k]], scale))
        return found

    @property
    def knows_ratio(self) -> bool:
        """Whether both logs bound lambda."""
        ends = [end for profile in self.profiles for end in profile.interval()]
        return min(ends) > 0 and max(ends) < np.inf

    @property
    def _place(self) -> int:
        return int(np.argmax(self.profiles[0].probability))

    def squares(self, quantity: str, errors: Array) -> Array:
        """Sum of squares, in units of the errors, at each lambda of the old log and size, shape (m, sizes).

        `errors`, shape (q,), are those of the differences of `estimates`; infinite where nothing is known.
        """
        unit, by_share, by_ratio = (power * SIZES for power in POWERS[quantity])
        before, factor = np.log(self.ratios)[:, None], np.exp(by_share)
        after = before + by_ratio
        spread = float(np.hypot(MODEL_SPREAD, min(errors[0], MAX_SPREAD)))
        old, new = self.profiles
        total = -2 * (_log_likelihood(old, 0.0)(before) + _log_likelihood(new, spread)(after))
        for k, error in enumerate(errors):
            means = self._means(k, is_new=True)
            mean, slope = (
                np.interp(after, before[:, 0], each) for each in (means, np.gradient(means, before[:, 0]))
            )
            off = mean - self._means(k, is_new=False)[:, None] * (factor if k else 1.0)
            if k:  # below all lambdas the response to load is that of lambda r
                off += mean * np.expm1(np.maximum(np.log(LOWEST) - after, 0.0))
            else:
                off += np.minimum(before, 0.0) - np.minimum(after, 0.0) - unit
            widened = error * (np.hypot(1.0, factor) / np.sqrt(2.0) if k else 1.0)
            total += off**2 / ((widened * self._spread(k)[:, None]) ** 2 + (slope * spread) ** 2)
        return total

    def _means(self, k: int, *, is_new: bool) -> Array:
        """Over the sessions of one log, at each lambda, shape (m,)."""
        return self.values[:, self.known[:, k] & (self.is_new == is_new), k].mean(axis=1)

    def _spread(self, k: int) -> Array:
        """Scatter by a session's traverses over that of the likeliest lambda, shape (m,)."""
        variance = self.variances[:, self.known[:, k], k].mean(axis=1)
        return np.sqrt(variance / variance[self._place])


def _fit_drives(changes: Changes, joint: int) -> Iterator[tuple[tuple[int, str], _DriveFits]]:
    """Of the directions of a joint that both logs determine."""
    machine = changes.logs[0].machine
    rows = [log.usable[log.usable["joint"] == joint] for log in changes.logs]
    laws = [physical_law_with(joint, own, machine, (FRICTION_LIMITED, FRICTION_LIMITED)) for own in rows]
    if laws[0].describe() != laws[1].describe():
        return
    searches = [RatioSearch(joint, own, machine) for own in rows]
    for search in searches:
        search.refine()
    ratios = sorted({ratio for search in searches for ratio in search.found})
    for search in searches:
        search.evaluate(ratios)
    old, new = (search.profiles() for search in searches)
    for way in sorted(old.keys() & new.keys()):
        sessions = [search.sessions(way) for search in searches]
        values, variances, known = (
            np.concatenate([getattr(one, name) for one in sessions], axis=1)
            for name in ("values", "variances", "known")
        )
        is_new = np.repeat([False, True], [one.values.shape[1] for one in sessions])
        known = known.all(axis=0)
        if all(known[is_new == side].any(axis=0).all() for side in (False, True)):
            yield (
                (joint, way),
                _DriveFits(np.array(ratios), (old[way], new[way]), values, variances, known, is_new),
            )


def _log_likelihood(profile: RatioProfile, spread: float) -> Callable[[Array], Array]:
    """Of log lambda, relative to that of the likeliest, where lambda scatters by `spread` beside."""
    known = np.log(np.maximum(profile.likelihood, LEAST_LIKELIHOOD))
    if not spread:
        return lambda log_ratio: np.interp(log_ratio, np.log(profile.ratios), known)
    sharp = np.exp(np.interp(LOG_RATIOS, np.log(profile.ratios), known))
    smooth = gaussian_filter1d(sharp, spread / (LOG_RATIOS[1] - LOG_RATIOS[0]), mode="nearest")
    log_smooth = np.log(np.maximum(smooth / smooth.max(), LEAST_LIKELIHOOD))
    return lambda log_ratio: np.interp(log_ratio, LOG_RATIOS, log_smooth)


def _widen(difference: Difference) -> float:
    """Its error, as wide as Student's t; infinite with too few degrees of freedom."""
    if not difference.df > MIN_DF:
        return np.inf
    return float(difference.standard_error * np.sqrt(difference.df / (difference.df - 2.0)))
