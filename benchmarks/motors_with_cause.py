"""Real piezo motors with a known cause added: whether a diagnosis names it beside the motor's own profile.

Logs of the Cobra motor maps whose traverses have ends of their own (`tests/cobra/maps.py`), at times drawn at
random, two minutes apart. The counts are changed by one effect whose rms over all traverses is `--strength`
standard errors of a noise of 5 %, whatever noise the diagnosis finds. Part of it is lost to calibration and
to the profile of each session and direction.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from stickslip_fit.diagnosis import Diagnosis, diagnose
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine
from tests.cobra.maps import JOINTS, MACHINE, SHARED, positioners, write_cut

COLUMNS = {"supply_V": (60.0, 1.0), "room_ppm": (400.0, 50.0)}  # mean and standard deviation
SETTLING = 15.0  # min, of a warm-up
SPACING = 2.0  # min, between traverses
NOISE = 0.05


def make_table(positioner: str, joint: str, folder: Path) -> pd.DataFrame:
    """A motor's log with times and columns; `minutes` into the session are no column of a log."""
    path, rng = folder / "cut.csv", np.random.default_rng([9, int(positioner)])
    write_cut(positioner, 2, path, only=joint)
    table = pd.read_csv(path, dtype={"session": str})
    table["minutes"] = 0.0
    for day, (_, rows) in enumerate(table.groupby("session", sort=False).groups.items()):
        table.loc[rows, "minutes"] = SPACING * rng.permutation(len(rows)) + rng.uniform(0, 1, len(rows))
        start = pd.Timestamp("2020-01-01") + pd.Timedelta(days=day)
        table.loc[rows, "time"] = [
            (start + pd.Timedelta(minutes=minutes)).isoformat() for minutes in table.loc[rows, "minutes"]
        ]
    for name, (mean, sd) in COLUMNS.items():
        table[name] = np.round(mean + sd * rng.standard_normal(len(table)), 2)
    return table


def shapes(table: pd.DataFrame) -> dict[str, np.ndarray]:
    """By how much each cause changes the logarithm of a step, but for its size."""
    minutes, found = table["minutes"].to_numpy(), {}
    for cause, name in (("supply-voltage", "supply_V"), ("covariate:room_ppm", "room_ppm")):
        found[cause] = table[name].to_numpy()
    found["thermal-warm-up"] = -np.exp(-minutes / SETTLING)
    first = (table["session"] == table["session"].iloc[0]).to_numpy()
    found["session-jump"] = first & (minutes > np.median(minutes[first]))
    turned = np.zeros(len(table))
    for _, rows in table.sort_values("time").groupby("session"):
        turned[rows.index] = np.r_[
            False, rows["direction"].to_numpy()[1:] != rows["direction"].to_numpy()[:-1]
        ]
    found["reversal-loss"] = -turned / table["steps"].to_numpy()
    return {cause: (shape - shape.mean()) / shape.std() for cause, shape in found.items()}


def diagnose_table(table: pd.DataFrame, folder: Path) -> Diagnosis:
    """As a user would, but for the gain."""
    (folder / "cobra.toml").write_text(MACHINE, encoding="utf-8")
    table.drop(columns="minutes").to_csv(folder / "log.csv", index=False)
    return diagnose(read_log(folder / "log.csv", machine=load_machine(folder / "cobra.toml")), gain=False)


def main() -> None:
    """Print an answer a line, and how often each cause is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--strength", type=float, default=12.0)
    parser.add_argument("--positioners", nargs="+", default=None)
    options = parser.parse_args()
    if not SHARED.exists():
        print(f"No motor maps at {SHARED}.")
        return
    counts: dict[tuple[str, str], list[bool]] = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        for positioner in options.positioners or positioners():
            for joint in JOINTS:
                table = make_table(positioner, joint, folder)
                own = diagnose_table(table, folder).findings
                print(f"{positioner} {joint}: {', '.join(one.cause for one in own)}", flush=True)
                size = options.strength * NOISE / np.sqrt(len(table))
                for cause, shape in shapes(table).items():
                    steps = np.maximum(np.round(table["steps"] * np.exp(-size * shape)), 1).astype(int)
                    found = diagnose_table(table.assign(steps=steps), folder).findings
                    named = any(cause in (one.cause, *one.equivalent) for one in found)
                    counts.setdefault((joint, cause), []).append(named)
                    print(f"  {cause}: {', '.join(one.cause for one in found)}", flush=True)
    for (joint, cause), named in counts.items():
        print(f"{joint:6s}{cause:20s}{sum(named)} of {len(named)}")


if __name__ == "__main__":
    main()
