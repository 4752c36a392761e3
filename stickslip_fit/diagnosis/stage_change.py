"""What changed in the stage: friction, mass, voltage or ramp time, from how a finding acts under load.

A finding says when steps changed and by how much. Under the physical law each change of the stage leaves a
fingerprint of its own on the step size without load and on the response to load (`laws.physical`):

- friction or preload times k: a_f and with it a_f T1^2 times k, r and lambda over k;
- moving mass times k: the reverse, so that counts cannot tell it from friction;
- ramp time T1 times k: a_f T1^2 times k^2, lambda over k^2;
- voltage, and with it the throw D, times k: lambda times k.

Each is fitted with the finding's course in time. Its size is shared by the joints and directions on which the
finding acts; the lambda of each is integrated out, so that both regimes take part. The posterior over the
four, all as likely beforehand, gives the credible set. Whether one of them suffices is tested against changes
of step size and response of each joint and direction by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtrc, logsumexp

from stickslip_fit._typing import Array
from stickslip_fit.causes.base import Cause
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.load import PayloadChange
from stickslip_fit.diagnosis.finding import Finding
from stickslip_fit.diagnosis.misfit import UNKNOWN
from stickslip_fit.diagnosis.residuals import remove_effects, term_change
from stickslip_fit.diagnosis.selection import Selection
from stickslip_fit.diagnosis.stage_fingerprint import FREE, MAX_SPREAD, SINGLE, Fingerprint, fit_changes
from stickslip_fit.errors import InputError
from stickslip_fit.estimation._groups import usable_rows
from stickslip_fit.estimation.drive_ratio import prior_shares
from stickslip_fit.laws import Laws, StepLaw, choose_laws, describe_law, state_at
from stickslip_fit.laws.physical import Physical
from stickslip_fit.logs import Log
from stickslip_fit.logs.schema import COVARIATE_PREFIX
from stickslip_fit.machine import Machine
from stickslip_fit.units import CREDIBLE, Interval

COURSE_COLUMNS = {
    "session",
    "session_seconds",
    "steps_before",
    "temperature",
    "humidity",
    "supply",
    "payload",
}
SAME_COURSE = 0.6  # correlation of two findings that are one change
QUANTITIES = ("friction", "mass", "voltage", "ramp time")
SAME_TRACE = {"mass": "friction"}  # of which counts cannot tell one from the other
NO_FIT = 0.001  # p-value below which none of the changes suffices
PRIOR_SD = 0.15  # of the logarithm of a quantity's change
SIZES = np.linspace(-0.7, 0.7, 2801)


@dataclass(frozen=True)
class StageChange:
    """A change of the stage that a finding may be.

    Attributes
    ----------
    quantity : {'friction', 'mass', 'voltage', 'ramp time'}
        Friction stands for the preload too.
    probability : float
        Posterior, all four as likely beforehand.
    size : Interval
        Relative, where the finding's course is at its largest, with 95 %.
    """

    quantity: str
    probability: float
    size: Interval

    @property
    def trace(self) -> str:
        """The quantity of which the same trace is known by: friction's, of a change of mass."""
        return SAME_TRACE.get(self.quantity, self.quantity)


def choose_credible(changes: Sequence[StageChange], p_value: float) -> tuple[StageChange, ...]:
    """The smallest set of `changes`, in their order, that holds the true one with 95 %.

    Those of one trace stay together. Empty where none suffices: `p_value` is that of the likeliest.
    """
    if p_value < NO_FIT:
        return ()
    total = 0.0
    chosen: list[StageChange] = []
    for change in changes:
        if total >= CREDIBLE and change.trace != chosen[-1].trace:
            break
        chosen.append(change)
        total += change.probability
    return tuple(chosen)


def order_changes(changes: Iterable[StageChange]) -> tuple[StageChange, ...]:
    """Likeliest trace first; those of one trace together."""
    changes = tuple(changes)
    total = {
        one.trace: sum(other.probability for other in changes if other.trace == one.trace) for one in changes
    }
    return tuple(sorted(changes, key=lambda one: (-total[one.trace], one.trace, -one.probability)))


@dataclass(frozen=True, eq=False)
class StageReading:
    """What findings that share a course in time say of the stage.

    Attributes
    ----------
    causes : tuple of str
    changes : tuple of StageChange
        Of the likeliest trace first.
    fingerprint : DataFrame
        joint, direction; unloaded and response, the relative changes of the step size without load and of the
        response to load, each with ``_error``; friction_limited, the probability of this regime.
    p_value : float
        That the likeliest change suffices, against a free change of each joint and direction.
    left_out : tuple of int
        Joints whose counts do not follow the physical law, in one direction or both.
    """

    causes: tuple[str, ...]
    changes: tuple[StageChange, ...]
    fingerprint: pd.DataFrame
    p_value: float
    left_out: tuple[int, ...] = ()

    @property
    def has_size(self) -> bool:
        """Whether one change suffices, and is known not to be 0 for at least one that it may be."""
        return self.suffices and any(one.size.low > 0 or one.size.high < 0 for one in self.credible)

    @property
    def suffices(self) -> bool:
        """Whether one change of the stage describes the findings."""
        return self.p_value >= NO_FIT

    @property
    def credible(self) -> tuple[StageChange, ...]:
        """The smallest set that holds the change with 95 %; empty where none suffices."""
        return choose_credible(self.changes, self.p_value)

    @property
    def regime(self) -> str:
        """``friction-limited`` or ``velocity-limited`` where all joints and directions are, else empty."""
        return find_regime(self.fingerprint["friction_limited"])


def read_stage(
    selection: Selection, findings: Sequence[Finding], machine: Machine
) -> tuple[StageReading, ...]:
    """Read what changed in the stage from each finding that follows time, use, or a logged condition.

    Findings with one course, such as a jump of the step size and a jump of the response to load, are read
    together.

    Parameters
    ----------
    selection : Selection
        Of a log.
    findings : sequence of Finding
    machine : Machine
        With the published geometry, else there is nothing to read.
    """
    if not machine.has_published_geometry:
        return ()
    named = {one.cause for one in findings}
    courses = {name: course for name, course in find_courses(selection).items() if name in named}
    readings = []
    unread = list(courses)
    while unread:
        first, *others = unread
        together = [first, *(name for name in others if _is_same(courses[first], courses[name]))]
        unread = [name for name in unread if name not in together]
        if (reading := _read(selection, tuple(together), courses, machine)) is not None:
            readings.append(reading)
    return tuple(readings)


def find_courses(selection: Selection) -> dict[str, Array]:
    """How strongly each cause of a selection that follows time, use or a logged condition acts.

    Returns
    -------
    dict of str to array, shape (n,)
        By cause; 1 where it acts most.
    """
    found = {}
    for place, one in zip(selection.slices, selection.law_causes, strict=True):
        course = _course(selection, one.version, selection.fit.values[place])
        if course is not None and one.cause != UNKNOWN:
            found[one.cause] = course
    return found


def choose_laws_anew(log: Log, selection: Selection, laws: Laws | None) -> Mapping[int, StepLaw] | None:
    """The laws chosen once more, from counts without what follows time, use or a logged condition.

    Where the log itself chooses a law, as it does lambda of a physical one, such an effect has had a say.

    Returns
    -------
    mapping of int to StepLaw or None
        None where they are the same, or the log leaves those of the selection open.
    """
    courses = find_courses(selection)
    if not courses or laws is None:
        return None
    chosen = choose_laws(usable_rows(remove_effects(log, selection, list(courses))), log.machine, laws)
    before = {part.law.joint: part.law for part in selection.problem.parts}
    return None if all(_is_same_law(law, before[joint]) for joint, law in chosen.items()) else chosen


def _is_same_law(law: StepLaw, before: StepLaw) -> bool:
    """Whether a law is no other, but for a lambda that the log leaves open."""
    if isinstance(law, Physical) and isinstance(before, Physical) and any(law.plausible):
        return law.allows(before.ratios)
    return _describe(law) == _describe(before)


def _describe(law: StepLaw) -> dict[str, Any]:
    """What a law is made of; nothing of one that only its own program knows, which chooses no other."""
    try:
        return describe_law(law)
    except InputError:
        return {}


def _is_same(one: Array, other: Array) -> bool:
    """Whether two courses rise and fall together, or are opposite."""
    if not (np.ptp(one) > 0 and np.ptp(other) > 0):
        return False
    return bool(abs(np.corrcoef(one, other)[0, 1]) > SAME_COURSE)


def _course(selection: Selection, version: Cause, values: Array) -> Array | None:
    """How strongly a cause acts on each traverse, 1 at most, shape (n,); None where that is no course."""
    columns = set(version.columns)
    known = columns <= COURSE_COLUMNS or all(name.startswith(COVARIATE_PREFIX) for name in columns)
    if not (known and columns and isinstance(version, FactorCause | PayloadChange)):
        return None
    if version.acts_at == "count":
        return None
    course = np.zeros(len(selection.problem))
    for part in selection.problem.parts:
        if not version.acts_on(part.law):
            continue
        rows = version.row_values(part.law, selection.problem.rows.iloc[part.rows])
        state = state_at(part.law.joint, rows, np.stack([rows["start"], rows["stop"]], axis=-1))
        own = [np.full((len(part.rows), 1), value) for value in values]
        if isinstance(version, PayloadChange):
            one = state.with_changes(override_load=np.ones((len(part.rows), 1)))
            factor = np.asarray(version.change(one, own).load)
        else:
            factor = version.factor(state, own)
        if factor.shape[1] > 1 and np.ptp(factor, axis=1).max() > 0:
            return None
        course[part.rows] = factor[:, 0] - 1.0
    largest = course[np.argmax(np.abs(course))]
    return course / largest if largest else None


def _read(
    selection: Selection, causes: tuple[str, ...], courses: Mapping[str, Array], machine: Machine
) -> StageReading | None:
    """What causes with one course say; None where the physical law describes no joint.

    The course is that of the first, whose effect is the largest.
    """
    problem, course = selection.problem, courses[causes[0]]
    response, effect = problem.responses.copy(), np.zeros(len(problem))
    for one in selection.law_causes:
        if one.cause in causes:
            effect += term_change(selection, one.version)
        elif one.cause in courses or one.version.acts_at in ("count", "state"):
            response -= term_change(selection, one.version)  # all else may be what the physical law is about
    ways = (problem.rows["direction"] == "-").to_numpy()
    prints = []
    for joint in sorted({part.law.joint for part in problem.parts}):
        for sign, way in enumerate("+-"):
            chosen = np.flatnonzero((problem.rows["joint"] == joint).to_numpy() & (ways == sign))
            if len(chosen) and np.ptp(course[chosen]) > 0:
                data = response[chosen], effect[chosen], problem.scale[chosen], course[chosen]
                rows = problem.rows.iloc[chosen].reset_index(drop=True)
                prints.append(fit_changes(joint, way, rows, machine, *data))
    described = [one for one in prints if one.spread < MAX_SPREAD]
    left_out = tuple(sorted({one.joint for one in prints if one.spread >= MAX_SPREAD}))
    return _combine(causes, described, left_out) if described else None


def _combine(
    causes: tuple[str, ...], prints: Sequence[Fingerprint], left_out: tuple[int, ...]
) -> StageReading:
    """The posterior over changes, with lambda of each joint and direction integrated out."""
    terms = {name: [_log_likelihoods(one, name) for one in prints] for name in SINGLE}
    ordered, log_posterior = weigh_changes(terms)
    best = ordered[0].trace
    limited = friction_limited([one.ratios for one in prints], terms, log_posterior)
    excess, free = _excess_deviance(prints, terms, best, log_posterior[best])
    table = pd.DataFrame([_fingerprint_row(one, float(p)) for one, p in zip(prints, limited, strict=True)])
    return StageReading(causes, ordered, table, float(chdtrc(free, excess)), left_out)


def _log_likelihoods(one: Fingerprint, change: str) -> Array:
    """Of each size of a change at each lambda, with the prior of lambda, shape (m, sizes)."""
    fits = [fits[change] for fits in one.fits]
    deviance = [fit.deviance + fit.information[0, 0] * (SIZES - fit.size[0]) ** 2 for fit in fits]
    excess = np.array(deviance) + one.penalty[:, None] - one.least
    return np.log(prior_shares(one.ratios))[:, None] - one.log_ratio(excess) / 2


def weigh_changes(
    terms: Mapping[str, Sequence[Array]],
) -> tuple[tuple[StageChange, ...], dict[str, Array]]:
    """The posterior over changes.

    Parameters
    ----------
    terms : mapping of str to sequence of array, shape (m, sizes)
        By change, of each joint and direction the log likelihood, with the prior of lambda, at its lambdas
        and at `SIZES`.

    Returns
    -------
    changes : tuple of StageChange
        Of the likeliest trace first.
    log_posterior : dict of str to array, shape (sizes,)
        By change, but for a constant.
    """
    log_posterior = {
        name: -0.5 * (SIZES / PRIOR_SD) ** 2 + sum(logsumexp(each, axis=0) for each in own)
        for name, own in terms.items()
    }
    log_mass = {name: float(logsumexp(values)) for name, values in log_posterior.items()}
    log_total = logsumexp([log_mass[SAME_TRACE.get(name, name)] for name in QUANTITIES])
    changes = []
    for name in QUANTITIES:
        source = SAME_TRACE.get(name, name)
        weights = np.exp(log_posterior[source] - log_mass[source])
        middle, low, high = np.interp([0.5, 0.025, 0.975], np.cumsum(weights), SIZES)
        ends = (-middle, -high, -low) if name == "mass" else (middle, low, high)
        probability = float(np.exp(log_mass[source] - log_total))
        changes.append(StageChange(name, probability, Interval(*map(float, np.expm1(ends)))))
    return order_changes(changes), log_posterior


def friction_limited(
    ratios: Sequence[Array], terms: Mapping[str, Sequence[Array]], log_posterior: Mapping[str, Array]
) -> list[float]:
    """The probability of lambda > 1, half of that of lambda = 1, of each joint and direction."""
    total = logsumexp(list(log_posterior.values()))
    limited = []
    for place, own_ratios in enumerate(ratios):
        above = (own_ratios > 1.0) + 0.5 * (own_ratios == 1.0)
        probability = 0.0
        for name, values in log_posterior.items():
            own = terms[name][place]
            whole = logsumexp(own, axis=0)
            share = np.exp(own - np.where(np.isfinite(whole), whole, 0.0))
            probability += float(above @ share @ np.exp(values - total))
        limited.append(probability)
    return limited


def find_regime(limited: Sequence[float] | pd.Series[float]) -> str:
    """``friction-limited`` or ``velocity-limited`` where all joints and directions are, else empty."""
    if all(share > CREDIBLE for share in limited):
        return "friction-limited"
    return "velocity-limited" if all(share < 1 - CREDIBLE for share in limited) else ""


def _excess_deviance(
    prints: Sequence[Fingerprint], terms: dict[str, list[Array]], change: str, log_posterior: Array
) -> tuple[float, int]:
    """By how much the likeliest change fits worse than free ones, and how many parameters it saves."""
    at, excess, free = int(np.argmax(log_posterior)), 0.0, -1
    for one, own in zip(prints, terms[change], strict=True):
        best = int(np.argmax(own[:, at]))
        fit, other = one.fits[best][change], one.fits[best][FREE]
        deviance = fit.deviance + fit.information[0, 0] * (SIZES[at] - fit.size[0]) ** 2
        excess += float(one.log_ratio(deviance - other.deviance))
        free += int(np.linalg.matrix_rank(other.information))
    return excess, max(free, 1)


def _fingerprint_row(one: Fingerprint, limited: float) -> dict[str, object]:
    """The free change at the lambda that fits best."""
    best = min(one.fits, key=lambda fits: fits[FREE].deviance)[FREE]
    covariance = np.linalg.pinv(best.information) * one.spread
    response = np.ones(2)
    return {
        "joint": one.joint,
        "direction": one.direction,
        "unloaded": float(best.size[0]),
        "unloaded_error": float(np.sqrt(covariance[0, 0])),
        "response": float(response @ best.size),
        "response_error": float(np.sqrt(response @ covariance @ response)),
        "friction_limited": np.minimum(limited, 1.0),  # sums of rounded probabilities
    }
