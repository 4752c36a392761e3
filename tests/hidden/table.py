"""A campaign as the lab writes it down."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from tests.hidden.campaign import Campaign
from tests.hidden.designs import Ints
from tests.hidden.physics import Array


def write_down(campaign: Campaign, steps: Ints, decoys: Mapping[str, Array]) -> pd.DataFrame:
    """The log file's columns, one row per traverse in order of time."""
    plan = campaign.plan
    angles = {"q1_deg": 0, "q2_deg": 1, "q3_mm": 2, "theta_deg": 3, "psi_deg": 4}
    held = {name: plan.settings[:, column].copy() for name, column in angles.items()}
    for joint, name in enumerate(("q1_deg", "q2_deg", "q3_mm"), start=1):
        held[name][plan.joint == joint] = np.nan
    return pd.DataFrame(
        {
            "session": campaign.labels,
            "time": np.datetime_as_string(campaign.time),
            "joint": plan.joint,
            "direction": np.where(plan.forward > 0, "+", "-"),
            "steps": steps,
            **held,
            **(_ends(campaign) if plan.partial else {}),
            **campaign.columns,
            **decoys,
        }
    )


def _ends(campaign: Campaign) -> dict[str, Array]:
    plan = campaign.plan
    low, high = plan.settings[:, 5], plan.settings[:, 6]
    start, stop = np.where(plan.forward > 0, low, high), np.where(plan.forward > 0, high, low)
    guide = plan.joint == 3
    return {
        "from_deg": np.where(guide, np.nan, start),
        "to_deg": np.where(guide, np.nan, stop),
        "from_mm": np.where(guide, start, np.nan),
        "to_mm": np.where(guide, stop, np.nan),
    }
