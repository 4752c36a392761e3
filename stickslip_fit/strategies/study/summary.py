"""Campaigns of a study summed up, with intervals over campaigns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from stickslip_fit.machine import JOINTS
from stickslip_fit.strategies.accuracy import reach

OFTEN = (0.05, 0.95)


def summarise(steps: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Errors of the mean step size, every campaign counting alike.

    Parameters
    ----------
    steps : DataFrame
        Rows of joints and directions, see `step_size_errors` and `spent`.
    by : sequence of str
        Columns to group by.

    Returns
    -------
    DataFrame
        The columns `by`; campaigns; traverses (each way) and seconds of a session's calibration; failed, the
        share of calibrations that found no parameters; for absolute errors, and relative ones under
        ``_relative``: rms and bias with ``_low`` and ``_high``, 95 % by Student's t over the campaigns, and
        worst, of any campaign; covered, the share of 95 % intervals that hold the truth, with its interval.
        NaN where campaigns are too few.
    """
    work = steps.assign(
        **{f"square{end}": steps[f"rms{end}"] ** 2 * steps["predictions"] for end in ("", "_relative")},
        **{f"sum{end}": steps[f"bias{end}"] * steps["predictions"] for end in ("", "_relative")},
        held=steps["covered"] * steps["predictions"],
    )
    names = ["predictions", "seconds", "sessions", "failed", "held"]
    names += [f"{kind}{end}" for kind in ("square", "sum") for end in ("", "_relative")]
    each = work.groupby([*by, "campaign"], sort=False)[names].sum(min_count=1)
    for name in ("held", "square", "sum", "square_relative", "sum_relative"):
        each[name] /= each["predictions"].where(each["predictions"] > 0)
    groups = each.groupby(list(by), sort=False)
    size, mean = groups["square"].count(), groups.mean()
    half = groups.std(ddof=1).mul(reach(size) / np.sqrt(size), axis=0)
    found = pd.DataFrame({"campaigns": groups.size()})
    found["traverses"] = steps.groupby(list(by), sort=False)["traverses"].mean()
    found["seconds"], found["failed"] = mean["seconds"], mean["failed"] / mean["sessions"]
    for end in ("", "_relative"):
        square, spread = mean[f"square{end}"], half[f"square{end}"]
        factor = np.exp(spread / square / 2)
        root = np.sqrt(square)
        found[f"rms{end}"] = root
        found[f"rms{end}_low"], found[f"rms{end}_high"] = root / factor, root * factor
        bias, spread = mean[f"sum{end}"], half[f"sum{end}"]
        found[f"bias{end}"] = bias
        found[f"bias{end}_low"], found[f"bias{end}_high"] = bias - spread, bias + spread
        worst = steps.groupby(list(by), sort=False)[f"worst{end}"]
        found[f"worst{end}"] = worst.max().where(worst.max() >= -worst.min(), worst.min())
    found["covered"] = mean["held"]
    found["covered_low"] = np.maximum(mean["held"] - half["held"], 0.0)
    found["covered_high"] = np.minimum(mean["held"] + half["held"], 1.0)
    return found.reset_index()


def summarise_tips(tips: pd.DataFrame) -> pd.DataFrame:
    """The tip's error after moves.

    Parameters
    ----------
    tips : DataFrame
        See `tip_distributions`.

    Returns
    -------
    DataFrame
        scenario, strategy; campaigns; unknown, the share of moves for which a calibration has no steps; in m:
        rms over all moves; median and often (within which half and 95 % of a campaign's moves end) of the
        median campaign; often_low and often_high, between which often lies in nine campaigns of ten; worst of
        all moves; share_1, share_2, share_3 of each joint in the mean square.
    """
    groups = tips.groupby(["scenario", "strategy"], sort=False)
    known = tips["moves"] - tips["unknown"]
    square = tips["rms"] ** 2 * known
    weighted = tips[["scenario", "strategy"]].assign(known=known, square=square)
    for joint in JOINTS:
        weighted[f"share_{joint}"] = tips[f"share_{joint}"] * square
    sums = weighted.groupby(["scenario", "strategy"], sort=False).sum()
    found = pd.DataFrame({"campaigns": groups.size()})
    found["unknown"] = groups["unknown"].sum() / groups["moves"].sum()
    found["rms"] = np.sqrt(sums["square"] / sums["known"].where(sums["known"] > 0))
    found["median"], found["often"] = groups["median"].median(), groups["often"].median()
    found["often_low"], found["often_high"] = (groups["often"].quantile(end) for end in OFTEN)
    found["worst"] = groups["worst"].max()
    for joint in JOINTS:
        found[f"share_{joint}"] = sums[f"share_{joint}"] / sums["square"]
    return found.reset_index()
