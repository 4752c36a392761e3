"""The step size along a joint's travel: as a law has it and as traverses show it; sessions without it.

The profile is the factor by which causes in position multiply the step size (`along-travel`,
`guide-gradient`, `worn-spot`, `bearing-runout`). A session's parameters are those of the stretches that it
drove; sessions over other stretches are compared with the profile in the law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from stickslip_fit._format import join_words
from stickslip_fit._typing import Array, IntArray
from stickslip_fit.causes import Cause
from stickslip_fit.causes.base import ExtendedLaw
from stickslip_fit.causes.kinds import FactorCause
from stickslip_fit.causes.profile import AlongTravel
from stickslip_fit.causes.proposed import POSITION
from stickslip_fit.errors import InputError
from stickslip_fit.estimation.least_squares import fit_least_squares
from stickslip_fit.estimation.noise import Flag
from stickslip_fit.estimation.result import JointFit, Result
from stickslip_fit.estimation.with_causes import law_without_causes
from stickslip_fit.laws import state_at
from stickslip_fit.logs import Log

N_PLACES = 200  # of a travel
N_INSIDE = 32  # places along a traverse
MAX_UNLIKE = 0.1  # of the travelled length that a session drove elsewhere than all others together
MAX_SHARE_OF_TRAVEL = 0.5  # a longer traverse shows no place
ROWS_PER_BIN, MAX_BINS = 4, 24
OTHER_STRETCHES = "other_stretches"
OTHER_STRETCHES_TEXT = (
    "sessions drove different stretches of its travel, so that their parameters differ where the step size "
    "follows position; the cause along-travel in the fit compares them without that"
)


def follows_travel(cause: object) -> bool:
    """Whether a cause multiplies the step size by a function of the joint's own position alone.

    That may be another one in each session; a function of the load varies along a traverse, too, and follows
    the configuration.
    """
    if not isinstance(cause, FactorCause) or not cause.varies_along_traverse:
        return False
    carriers = getattr(cause, "carriers", (POSITION,))
    return {*carriers} == {POSITION} and {*cause.columns} <= {"session"}


def follows_position(cause: Cause) -> bool:
    """Whether a cause follows the joint's own position alone, alike in all sessions; see `follows_travel`."""
    return follows_travel(cause) and not cause.columns


def has_profile(fit: JointFit) -> bool:
    """Whether the law of a joint has a cause that follows its position."""
    return bool(_profile_causes(fit))


def _profile_causes(fit: JointFit) -> list[tuple[FactorCause, range]]:
    if not isinstance(fit.law, ExtendedLaw):
        return []
    return [
        (cause, columns)
        for cause, columns in fit.law.active_causes
        if isinstance(cause, FactorCause) and follows_position(cause)
    ]


def profile_factor(fit: JointFit, direction: str, position: Array) -> Array:
    """The factor at positions, rad or m, any shape; 1 where the law has no cause in position."""
    way = 1.0 if direction == "+" else -1.0
    state = state_at(fit.law.joint, {"start": [0.0], "stop": [way]}, position.reshape(1, -1))
    factor = np.ones((1, position.size))
    for cause, columns in _profile_causes(fit):
        factor = factor * cause.factor(state, [np.full((1, 1), fit.values[0, k]) for k in columns])
    return factor.reshape(position.shape)


@dataclass(frozen=True, eq=False)
class Profile:
    """One joint's profile in one direction, relative to its mean along the travel.

    Attributes
    ----------
    position, fitted : array, shape (N_PLACES,)
        The travel that traverses cover, rad or m; what the law's causes make of it, 0 without such causes.
    middle, mean, error : array, shape (K,)
        Traverses binned by their middle: mean departure from the law without these causes, and its standard
        error.
    """

    direction: str
    position: Array
    fitted: Array
    middle: Array
    mean: Array
    error: Array


def compute_profiles(rows: pd.DataFrame, fit: Result) -> list[Profile]:
    """The profile of each direction of a joint that was driven over several stretches.

    Parameters
    ----------
    rows : DataFrame
        One joint's traverses, see `collect_traverses`.
    fit : Result
        As used for `rows`.
    """
    joint_fit = fit.joints[int(rows["joint"].iloc[0])]
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    low, high = ends[:, 0].min(), ends[:, 1].max()
    short = np.diff(ends, axis=1)[:, 0] < MAX_SHARE_OF_TRAVEL * (high - low)
    profiles = []
    for direction in "+-":
        own = short & (rows["direction"] == direction).to_numpy(bool) & rows["departure"].notna().to_numpy()
        if len(np.unique(ends[own].round(9), axis=0)) < 2:
            continue
        places = np.linspace(ends[own, 0].min(), ends[own, 1].max(), N_PLACES)
        factor = profile_factor(joint_fit, direction, places)
        along = ends[own][:, :1] + np.diff(ends[own], axis=1) * (np.arange(N_INSIDE) + 0.5) / N_INSIDE
        of_traverse = 1.0 / np.mean(1.0 / profile_factor(joint_fit, direction, along), axis=1)
        seen = (1.0 + rows["departure"].to_numpy(float)[own]) * of_traverse
        binned = _bin(ends[own].mean(axis=1), seen / factor.mean() - 1.0)
        profiles.append(Profile(direction, places, factor / factor.mean() - 1.0, *binned))
    return profiles


def _bin(middle: Array, values: Array) -> tuple[Array, Array, Array]:
    """Means of values in bins of about as many rows each, equal middles together, and standard errors."""
    number = int(np.clip(len(middle) // ROWS_PER_BIN, 2, MAX_BINS))
    rank = pd.Series(middle.round(9)).rank(method="min", pct=True)
    groups = pd.DataFrame({"middle": middle, "value": values}).groupby(np.ceil(rank * number).to_numpy())
    means, spread, count = groups.mean(), groups["value"].std(), groups["value"].count()
    pooled = float(np.sqrt(np.nansum(spread**2 * (count - 1)) / max(1, int((count - 1).sum()))))
    error = spread.where(count > 2, pooled) / np.sqrt(count)
    return means["middle"].to_numpy(), means["value"].to_numpy(), error.to_numpy()


def find_unlike_stretches(log: Log) -> tuple[int, ...]:
    """Joints of which a session drove other stretches than the other sessions, in either direction."""
    return tuple(
        int(str(joint))
        for joint, rows in log.usable.groupby("joint")
        if any(_most_unlike(own) > MAX_UNLIKE for _, own in rows.groupby("direction", observed=True))
    )


def _most_unlike(rows: pd.DataFrame) -> float:
    """The largest share of a session's length that lies elsewhere than that of all others."""
    ends = np.sort(rows[["start", "stop"]].to_numpy(float), axis=1)
    edges = np.linspace(ends[:, 0].min(), ends[:, 1].max(), 25)
    inside = np.clip(np.minimum(ends[:, 1:], edges[1:]) - np.maximum(ends[:, :1], edges[:-1]), 0.0, None)
    code: IntArray = pd.factorize(rows["session"].astype(str))[0]
    lengths = np.zeros((int(code.max()) + 1, inside.shape[1]))
    np.add.at(lengths, code, inside)
    if len(lengths) < 2:
        return 0.0
    others = lengths.sum(axis=0) - lengths
    return float(np.abs(_shares(lengths) - _shares(others)).sum(axis=1).max() / 2)


def _shares(lengths: Array) -> Array:
    return lengths / lengths.sum(axis=1, keepdims=True)


def flag_unlike_stretches(log: Log, fit: Result) -> Result:
    """The result with a flag on each joint whose sessions drove different stretches, without a profile."""
    flags = [
        Flag(OTHER_STRETCHES, joint, "", "", (), f"joint {joint}: {OTHER_STRETCHES_TEXT}")
        for joint in find_unlike_stretches(log)
        if not has_profile(fit.joints[joint])
    ]
    return replace(fit, flags=(*fit.flags, *flags))


@dataclass(frozen=True, eq=False)
class ComparableFit:
    """A fit whose sessions can be compared, and how that was reached, as a sentence; empty without need."""

    fit: Result
    note: str = ""


def make_comparable(log: Log, fit: Result, versions: Sequence[Cause] = ()) -> ComparableFit:
    """The fit with the profile along the travel in its law, where sessions would differ without it.

    Parameters
    ----------
    fit : Result
        Of this log.
    versions : sequence of Cause, optional
        Causes that a diagnosis named. Those in position are put into the law; without any, where a session
        drove other stretches than the others, a profile that all sessions share.
    """
    named = [cause for cause in versions if follows_position(cause)]
    unlike = find_unlike_stretches(log)
    where = f"joint{'s' if len(unlike) > 1 else ''} {join_words(list(map(str, unlike)))}"
    if any(map(has_profile, fit.joints.values())):
        return ComparableFit(fit, "The profile along the travel is in the law, so that it is no difference.")
    if named:
        names = join_words(list(dict.fromkeys(cause.name for cause in named)))
        note = f"The profile along the travel is taken out first ({names}, as the diagnosis has it)"
    elif unlike:
        named = [AlongTravel()]
        note = (
            f"Sessions drove different stretches of {where}: a profile along the travel that all share is "
            "taken out first"
        )
    else:
        return ComparableFit(fit)
    law = next(iter(fit.joints.values())).law
    others = law.causes if isinstance(law, ExtendedLaw) else ()
    laws = {joint: law_without_causes(each.law) for joint, each in fit.joints.items()}
    command = fit.provenance.command
    try:
        extended = fit_least_squares(log, laws=laws, causes=[*others, *named], command=command)
    except (InputError, np.linalg.LinAlgError):
        return ComparableFit(fit)  # the log cannot show a profile
    return ComparableFit(extended, f"{note}, so that another stretch is no difference.")
