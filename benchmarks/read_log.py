"""Reading and checking a log of a million rows, beside a plain pandas read of the same file."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from stickslip_fit.logs import read_log

ROWS = 1_000_000
PER_SESSION = 500
REPEATS = 7
ALLOWED = 15.0


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "million.csv"
        make_campaign(ROWS).to_csv(path, index=False)
        plain, checked = [], []
        for _ in range(REPEATS):
            plain.append(seconds(lambda: pd.read_csv(path)))
            checked.append(seconds(lambda: read_log(path)))
    ratio = median(checked) / median(plain)
    print(
        f"| read and check a log | {ROWS:,} rows | {median(checked):.2f} s | "
        f"pandas.read_csv {median(plain):.2f} s | {ratio:.1f} times (allowed: {ALLOWED:g}) |"
    )


def seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def make_campaign(count: int) -> pd.DataFrame:
    """Make up a campaign of all joints, many sessions and some optional columns, as a lab would write it."""
    rng = np.random.default_rng(20120305)
    times = np.datetime64("1990-01-01T00:00:00") + np.cumsum(rng.integers(60, 300, count)).astype("m8[s]")
    joint = rng.integers(1, 4, count)
    configuration = {
        "q1_deg": rng.integers(-4, 5, count) * 30.0,
        "q2_deg": rng.integers(-14, 3, count) * 15.0,
        "q3_mm": rng.integers(0, 25, count) / 2,
    }
    rows = pd.DataFrame(
        {
            "session": [f"session {number // PER_SESSION}" for number in range(count)],
            "time": np.datetime_as_string(times, unit="s"),
            "joint": joint,
            "direction": np.where(rng.random(count) < 0.5, "+", "-"),
            "steps": 5 * rng.integers(2_000, 4_000, count),
            **configuration,
            "theta_deg": rng.integers(-6, 7, count) * 15,
            "psi_deg": rng.integers(-6, 7, count) * 15,
            "temperature_C": np.round(rng.normal(22, 1, count), 2),
            "humidity_pct": np.round(rng.normal(40, 3, count), 1),
            "status": np.where(rng.random(count) < 0.01, "interrupted", "ok"),
            "pressure_hPa": np.round(rng.normal(990, 3, count), 3),
        }
    )
    for number, name in enumerate(configuration, start=1):
        rows[name] = rows[name].mask(joint == number)
    return rows


if __name__ == "__main__":
    main()
