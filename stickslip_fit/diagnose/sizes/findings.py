"""From what a search found to findings with sizes and intervals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import beta

from stickslip_fit.diagnose.diagnosis import Finding, SizedParameter
from stickslip_fit.diagnose.experiments.separability import told_apart
from stickslip_fit.diagnose.laid_out.bench import Bench
from stickslip_fit.diagnose.laid_out.study import Study
from stickslip_fit.diagnose.searching.evidence import STRENGTHS
from stickslip_fit.diagnose.searching.misfit import UNKNOWN
from stickslip_fit.diagnose.searching.search import MISFIRE, Found, Search, others_level
from stickslip_fit.diagnose.shapes.candidates import acts_on
from stickslip_fit.diagnose.shapes.hypothesis import Hypothesis
from stickslip_fit.diagnose.shapes.memory import Memory
from stickslip_fit.diagnose.sizes.amplitude import strength_interval, threshold_length
from stickslip_fit.diagnose.sizes.carried import carried
from stickslip_fit.diagnose.sizes.effect import effect_of
from stickslip_fit.logs.columns import COVARIATE
from stickslip_fit.units import Interval

Array = npt.NDArray[np.float64]
TWO_SIDED = 1.959964


def findings(searched: Search, given: Bench, alpha: float) -> tuple[Finding, ...]:
    """Size up everything that was found, strongest first; what has no name comes last.

    Parameters
    ----------
    searched : Search
    given : Bench
        What was searched, misfired rows and all.
    alpha : float
        Of the search.
    """
    study, first = searched.bench.study(), 0
    sized = []
    for found in searched.found:
        number = len(found.start)
        if found.cause == MISFIRE:
            sized.append(_misfires(searched, given, found))
        elif found.cause == UNKNOWN:
            sized.append(_unknown(searched, found, alpha))
        else:
            sized.append(_named(searched, study, found, slice(first, first + number), alpha))
            first += number
    return tuple(sorted(sized, key=lambda each: (each.cause == UNKNOWN, -each.effect.estimate)))


def _named(searched: Search, study: Study, found: Found, mine: slice, alpha: float) -> Finding:
    values, covariance = searched.fit.values[mine], searched.fit.covariance[mine, mine]
    effect = effect_of(searched, study, found, mine)
    strength = _strength(found, effect.length, effect.error, effect.dimensions, study, alpha)
    per_strength = effect.rms / max(effect.length, 1e-12)
    looked = found.misfit
    assert looked is not None
    rivals = tuple(
        rival
        for rival in found.naming.rivals
        if not told_apart(looked.best_of(found.cause), looked, rival, strength.estimate)
    )
    error = np.sqrt(np.diag(covariance))
    error = np.where(error > 0, error, np.nan)  # of a sudden moment no error is known
    sizes = [
        SizedParameter(
            parameter.name, parameter.unit,
            Interval(value, value - TWO_SIDED * spread, value + TWO_SIDED * spread),
            parameter.joint, parameter.direction, parameter.session,
        )
        for parameter, value, spread in zip(found.version.parameters, values, error, strict=True)
        if np.isfinite(spread) or getattr(parameter, "sudden", False)
    ]  # fmt: skip
    shown = () if found.cause.startswith(COVARIATE) else tuple(sizes)
    laws = [part.law for part in searched.bench.parts if acts_on(found.version, part.law)]
    return Finding(
        found.cause, found.version, rivals, found.p_value, _joints(laws),
        strength.times(per_strength), shown,
    )  # fmt: skip


def _unknown(searched: Search, found: Found, alpha: float) -> Finding:
    looked, study = found.misfit, searched.study
    assert looked is not None
    best = looked.best_of(UNKNOWN)
    shape = _structure(best, study.residual)
    strength2 = float(shape @ shape)
    length = float(np.linalg.norm(shape))
    if isinstance(best, Memory):
        effect = carried(study, best).times(_rms(study.scale))
    else:
        strength = _strength(found, np.sqrt(strength2 + 1.0), 1.0, 1, study, alpha)
        effect = strength.times(_rms(shape * study.scale) / max(length, 1e-12))
    causes = {cause: value for cause, value in looked.by_cause.items() if cause != UNKNOWN}
    closest = max(causes, key=lambda cause: causes[cause]) if causes else ""
    share = 0.0
    if closest:
        near = looked.best_of(closest)
        assert isinstance(near, Hypothesis)
        share = float(np.sum(near.along(shape) ** 2)) / max(strength2, 1e-12)
    carrier = best.cause.removeprefix(f"{UNKNOWN}:")
    size = np.abs(shape)
    touched = _joints(part.law for part in study.parts if np.any(size[part.rows] > 1e-3 * size.max()))
    return Finding(UNKNOWN, None, (), found.p_value, touched, effect, (), None, closest, share, carrier)


def _structure(shape: Hypothesis | Memory, residual: Array) -> Array:
    """What a structure explains of the residuals, shrunk by what noise alone would give it; shape (n,)."""
    if isinstance(shape, Memory):
        return shape.shape(residual)
    along = shape.along(residual)
    strength2 = max(float(along @ along) - len(along), 0.0)
    taken = shape.share * strength2 / (1.0 + shape.share * strength2)
    return shape.sum_of(taken * along)


def _misfires(searched: Search, given: Bench, found: Found) -> Finding:
    out, n = searched.misfired, len(given)
    departure = _departures(searched, given, out)
    off = np.abs(departure)
    rms = float(np.sqrt(np.sum(off**2) / n))
    spread = TWO_SIDED * rms * float(np.sqrt(np.mean(given.scale[out] ** 2) / np.mean(off**2) / len(out)))
    share = Interval(
        len(out) / n,
        float(beta.ppf(0.025, len(out), n - len(out) + 1)),
        float(beta.ppf(0.975, len(out) + 1, n - len(out))),
    )
    low, middle, high = np.quantile(off, [0.025, 0.5, 0.975])
    joints = _joints(part.law for part in given.parts if np.isin(part.rows, out).any())
    return Finding(
        MISFIRE, None, (), found.p_value, joints, Interval(rms, max(rms - spread, 0.0), rms + spread),
        (SizedParameter("share", "%", share), SizedParameter("size", "%", Interval(middle, low, high))),
        traverses=given.rows.iloc[out].assign(departure=departure),
    )  # fmt: skip


def _departures(searched: Search, given: Bench, out: npt.NDArray[np.intp]) -> Array:
    """By how much rows that were left out of the fit differ from it; those it cannot predict by nothing."""
    off = np.zeros(len(given))
    for part, fitted in zip(given.parts, searched.fit.parts, strict=True):
        blocks, first = np.unique(fitted.block, return_index=True)
        mine = np.isin(part.rows, out) & np.isin(part.block, blocks)
        values = fitted.values[first[np.searchsorted(blocks, part.block[mine])]]
        rows = part.rows[mine]
        if len(rows):
            off[rows] = given.responses[rows] - fitted.law.predict(given.rows.iloc[rows], values)
    return off[out]


def _strength(
    found: Found, length: float, error: float, dimensions: int, study: Study, alpha: float
) -> Interval:
    """Strength of an effect seen with this length, known to within `error`, because it raised the alarm."""
    looked = found.misfit
    assert looked is not None
    shapes = sum(each.cause == found.cause for each in looked.hypotheses) or 1
    threshold = threshold_length(looked.critical(others_level(alpha)), shapes, study.freedom, STRENGTHS)
    return strength_interval(length / error, dimensions, threshold / error).times(error)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _joints(laws: Iterable[Any]) -> tuple[int, ...]:
    """Of which joints some laws are; of none where they have nothing to do with any."""
    return tuple(sorted(int(law.joint) for law in laws if hasattr(law, "joint")))
