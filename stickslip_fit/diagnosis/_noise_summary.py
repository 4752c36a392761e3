"""What is said of noise that is not as assumed."""

from __future__ import annotations

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit.diagnosis._unknown_summary import name_carrier
from stickslip_fit.diagnosis.problem import DiagnosisProblem
from stickslip_fit.diagnosis.result import Diagnosis

MANY_SESSIONS = 3  # above which they are counted instead of named
NOISY = 2.0  # times the noise of the quietest session
COMMON = {
    "configuration": "in some configurations",
    "range": "in some ranges of the travel",
    "position": "in some places of the travel",
    "part of a session": "in some parts of the sessions",
}


def describe_noise(diagnosis: Diagnosis) -> list[str]:
    """A sentence on skewed, rounded or uneven noise; none where there is none of these."""
    problem, listed = diagnosis.selection.problem, diagnosis.noise_properties
    said = []
    if "uneven" in listed:
        said += [_describe_unevenness(problem, carrier) for carrier in problem.uneven]
    if "skewed" in listed and problem.skewness is not None:
        said.append(f"its long tail is towards {'more' if problem.skewness.g > 0 else 'fewer'} steps")
    if "rounded" in listed and problem.spacing is not None:
        spacing = np.round(problem.spacing * problem.rows["steps"].to_numpy(float)).astype(int)
        found = [str(one) for one in np.unique(spacing[spacing > 0])]
        said.append(f"counts are multiples of {join_words(found, 'or')} steps, which no column says")
    if not said:
        return []
    return [f"The noise is not as assumed, which is allowed for: {join_words(said)}."]


def _describe_unevenness(problem: DiagnosisProblem, carrier: str) -> str:
    ratio = pd.Series(problem.noise_ratio)
    if carrier != "session":
        size = float(ratio.quantile(0.98) / ratio.quantile(0.02))
        where = COMMON.get(carrier, f"at some values of {name_carrier(carrier)}")
        return f"it is up to {size:.0f} times as large {where} as {where[:2]} others"
    by_session = ratio.groupby(problem.rows["session"].to_numpy(object)).median()
    noisy = by_session[by_session > NOISY * by_session.min()]
    quiet = float(by_session[by_session <= NOISY * by_session.min()].median())
    names = join_words([str(name) for name in noisy.index])
    where = f"session {names}" if len(noisy) == 1 else f"sessions {names}"
    if len(noisy) > MANY_SESSIONS:
        where = f"{len(noisy)} of {len(by_session)} sessions"
    return f"it is {float(noisy.median()) / quiet:.0f} times as large in {where} as in others"
