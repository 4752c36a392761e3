"""Testability: which causes a log could show at all, and whether it has enough rows for a test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from stickslip_fit._format import pluralize
from stickslip_fit._linalg import svd
from stickslip_fit._typing import Array
from stickslip_fit.diagnosis.hypotheses import (
    EFFECT_TOL,
    SessionFit,
    compute_effects,
    count_failed,
    split_sessions,
)
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.problem import DiagnosisProblem

MIN_TESTABLE_STRENGTH = 3.0  # whitened norm of the effect at the largest plausible size
MIN_DF, MIN_TABLE_DF = 10, 6  # of a log; of a table, whose rows are one law's, and with fewer show nothing

NO_TRIALS = (
    "none of its trials could be computed: the effect of each is no number, or its equations have no solution"
)


def find_untestable(problem: DiagnosisProblem, linearized: LinearizedFit) -> dict[str, str]:
    """Causes that would not be detectable even at their largest plausible size, with the reason."""
    untestable, sessions = {}, split_sessions(linearized)
    data = "log" if is_log(linearized) else "table"
    for cause in problem.causes:
        share = cause.share_where_noise_persists if len(problem.correlation) else 1.0
        strength = largest_strength(cause, linearized, sessions, problem.outlier_cause, share)
        if strength < EFFECT_TOL and _always_fails(cause, linearized, sessions):
            untestable[cause.name] = NO_TRIALS
        elif strength < EFFECT_TOL:
            untestable[cause.name] = (
                "this log's traverses show nothing of it, once each session is recalibrated"
                if is_log(linearized)
                else "this table shows nothing of it, once the law is recalibrated to each session"
            )
        elif strength < MIN_TESTABLE_STRENGTH:
            shown = min(strength, MIN_TESTABLE_STRENGTH - 0.1)
            untestable[cause.name] = (
                f"even at its largest plausible size it would be {shown:.1f} standard errors in this {data}, "
                f"less than {MIN_TESTABLE_STRENGTH:.0f}"
            )
    return untestable


def largest_strength(
    cause: Any,
    linearized: LinearizedFit,
    sessions: Mapping[str, SessionFit],
    outlier_cause: str,
    share: float = 1.0,
) -> float:
    """Whitened norm of a share of a cause's largest plausible effect, beyond what calibration absorbs.

    Of a cause that is tried at many values, the first norm that is large enough for a test.
    """
    if cause.name == outlier_cause:
        return np.inf
    largest, strongest = cause.largest_plausible(), 0.0
    versions = getattr(cause, "versions", (cause,))  # more than one where the log leaves a law's regime open
    tried = [(one, np.array(largest)) for one in versions] if largest else cause.trials(linearized.rows)
    for version, values in tried:
        scaled = np.arange(values.shape[1]) == 0  # the size is the first parameter, or each if they combine
        factor = np.where(scaled | cause.combine_trials, cause.max_trial_factor, 1.0)
        sizes = values if largest else values * factor
        combined = cause.combine_trials and not largest
        where = sessions[version.session] if version.session else linearized
        for some in [sizes] if combined else filter(len, (sizes[:1], sizes[1:])):
            effects = compute_effects(where, version, some)
            own = _largest_combination(effects) if combined else np.linalg.norm(effects, axis=0).max()
            strongest = max(strongest, share * float(own))
            if strongest >= MIN_TESTABLE_STRENGTH:
                return strongest
    return strongest


def _largest_combination(effects: Array) -> float:
    """Norm of the strongest combination of columns, shape (n, m), none of which is taken more than once."""
    _, singular, right = svd(effects)
    return float(singular[0] / np.abs(right[0]).max())


def _always_fails(cause: Any, linearized: LinearizedFit, sessions: Mapping[str, SessionFit]) -> bool:
    """Whether the effect of a cause is no number at any of its trials."""
    return all(
        count_failed(sessions[version.session] if version.session else linearized, version, trials)
        == len(trials)
        for version, trials in cause.trials(linearized.rows)
    )


def explain_too_small(linearized: LinearizedFit) -> str | None:
    """Why a log is too small for a test, and what would suffice; None where it is not."""
    least = MIN_DF if is_log(linearized) else MIN_TABLE_DF
    if linearized.df >= least:
        if linearized.fits_exactly:
            return "the law fits every row to within rounding: there is no scatter to compare anything with"
        return None
    parameters = pluralize(linearized.basis.shape[1], "parameter")
    lacking = least - linearized.df
    needed = f"{parameters}, and at least {len(linearized) + lacking} are needed; add {lacking}"
    if not is_log(linearized):
        where = " in the same sessions" if linearized.rows["session"].nunique() > 1 else ""
        return f"too few rows to test: {len(linearized)} for the law's {needed}{where}"
    return (
        f"too few traverses to test: {len(linearized)} for the baseline's {needed} in the same sessions and "
        "directions, replicates or new configurations"
    )


def is_log(linearized: LinearizedFit) -> bool:
    """Whether the laws are of joints, and the rows traverses."""
    return any(hasattr(part.law, "joint") for part in linearized.parts)
