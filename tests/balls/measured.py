"""The drops that were measured."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

DATA = Path(__file__).parents[3] / "shared" / "data" / "ball_drops"
OUNCE, CENTIMETRE = 0.0283495231, 0.01


def measured() -> pd.DataFrame:
    """A row for each frame, SI; without the last one of each drop, which may show the impact."""
    frames = pd.read_csv(DATA / "drops.csv").merge(pd.read_csv(DATA / "balls.csv"), on="ball", how="left")
    frames = frames[frames.groupby(["ball", "drop"]).cumcount(ascending=False) > 0]
    return pd.DataFrame(
        {
            "ball": frames["ball"],
            "session": frames["drop"].map("drop {}".format),
            "seconds": frames["time_s"],
            "height": frames["height_m"],
            "weight": OUNCE * frames["weight_oz"],
            "circumference": CENTIMETRE * frames["circumference_cm"],
        }
    ).reset_index(drop=True)
