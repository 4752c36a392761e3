"""Functions of each session's time with details that are too fine to be looked for.

What comes and goes within a few traverses looks like noise with memory. A function of time says when, so
that it describes a traverse between others. It is as smooth as a Gaussian process with squared-exponential
covariance, or as rough as one with exponential covariance (an Ornstein-Uhlenbeck process, whose spectrum is
that of jumps).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stickslip_fit._typing import Array
from stickslip_fit.causes.proposed import SMOOTH_SCALE, SmoothTerm
from stickslip_fit.causes.smooth import cosines
from stickslip_fit.diagnosis.evidence import find_strength
from stickslip_fit.diagnosis.hypotheses import Hypothesis, split_sessions
from stickslip_fit.diagnosis.linearized import LinearizedFit
from stickslip_fit.diagnosis.session_stacks import build_per_session_hypotheses
from stickslip_fit.logs.schema import has_times

# Correlation lengths, of the longest session.
SMOOTH_LENGTHS = (0.2, 0.08, 0.04, 0.02)
ROUGH_LENGTHS = (1.0, 0.3, 0.1, 0.03, 0.01)
TRAVERSES_PER_WAVE, MAX_WAVES = 2, 100  # waves of a session: every half period of the finest has a traverse
MIN_WAVES, MIN_PRIOR_SD = 8, 1e-4  # a wave of a smaller one, relative to the largest, is left out: 0 is none
# Of the waves of all sessions, with which a law is fitted, and of the functions that are tried: a log of many
# sessions or rows has coarser ones.
MAX_COEFFICIENTS, MAX_ELEMENTS = 400, 20_000_000


def find_time_function(linearized: LinearizedFit, residual: Array) -> tuple[float, Hypothesis] | None:
    """The likeliest function of each session's time, alike or opposite by direction, and its log evidence.

    Whitened residuals have shape (n,). None for a table, and for a log without times or with few traverses in
    each session.
    """
    rows = linearized.rows
    if "time" not in rows or not has_times(rows):
        return None
    most = int(rows.groupby(rows["session"].astype(object)).size().max())
    n_lengths = len(SMOOTH_LENGTHS) + len(ROUGH_LENGTHS)
    number = min(
        most // TRAVERSES_PER_WAVE,
        MAX_WAVES,
        MAX_COEFFICIENTS // rows["session"].nunique(),
        MAX_ELEMENTS // (n_lengths * len(rows)),
    )
    if number < MIN_WAVES:
        return None
    seconds = rows["session_seconds"].to_numpy(float)
    last, sds = float(seconds.max()), _prior_sds(number)
    waves = cosines(seconds, 0.0, last, number) / linearized.scale[:, None]
    sessions = tuple(map(str, dict.fromkeys(rows["session"].astype(object))))
    plain = SmoothTerm(("session_seconds",), ((0.0, last),), sessions=sessions)
    kept = [own[own > 0].tolist() for own in sds]
    same = [
        replace(plain, orders=tuple((k,) for k in range(1, len(own) + 1)), sds=tuple(own)) for own in kept
    ]
    opposite = [replace(one, mode="opposite") for one in same]
    own_sessions = list(split_sessions(linearized).values())
    found = []
    for versions, sign in ((same, 1.0), (opposite, linearized.direction_sign[:, None])):
        effects = np.stack([waves * sign * own for own in sds], axis=1)
        names = ["unknown:time"] * len(versions)
        for one in build_per_session_hypotheses(names, len(rows), own_sessions, effects, versions):
            strength = find_strength(one.coefficients(residual), one.prior_share, residual, linearized.df)
            found.append((strength.evidence, one))
    return max(found, key=lambda one: one[0], default=None)


def _prior_sds(number: int) -> list[Array]:
    """Of the coefficients of so many waves, for each correlation length; 0 of those that are left out."""
    orders = np.pi * np.arange(1, number + 1)
    smooth = [np.exp(-((orders * length) ** 2) / 4.0) for length in SMOOTH_LENGTHS]
    rough = [1.0 / np.sqrt(1.0 + (orders * length) ** 2) for length in ROUGH_LENGTHS]
    return [SMOOTH_SCALE * np.where(one < MIN_PRIOR_SD * one[0], 0.0, one) for one in (*smooth, *rough)]
