"""The two cuts of the Cobra motor maps as logs of a machine of two rotary joints, see their README."""

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np

SHARED = Path(__file__).parents[3] / "shared" / "data" / "cobra" / "maps.csv"
JOINTS, DIRECTIONS = {"theta": 1, "phi": 2}, {"fwd": "+", "rev": "-"}
MACHINE = """
name = "Cobra positioner"
[[joint]]
kind = "rotary"
name = "theta"
range_deg = [0, 400]
[[joint]]
kind = "rotary"
name = "phi"
range_deg = [0, 200]
"""
MERGED = 4  # neighbouring stretches of the first cut
LENGTHS = (10.0, 40.0)  # degrees, of the second


def positioners() -> list[str]:
    """Numbers of all positioners, in order."""
    with SHARED.open(encoding="utf-8") as file:
        return sorted({row["positioner"] for row in csv.DictReader(file)}, key=int)


def read_maps(positioner: str) -> dict[tuple[str, str, str], list[tuple[float, float, float]]]:
    """Stretches (from, to, degrees a step) of each map, joint and direction."""
    maps = defaultdict(list)
    with SHARED.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["positioner"] == positioner:
                numbers = (float(row[name]) for name in ("from_deg", "to_deg", "deg_per_step"))
                maps[row["map"], row["joint"], row["direction"]].append(tuple(numbers))
    return dict(maps)


def write_cut(positioner: str, cut: int, path: Path, *, only: str = "", seed: int = 0, every: int = 1) -> int:
    """Write one cut of a positioner's maps, of one joint or of both, without times; number of rows.

    Of its traverses `every` second, third ... one.
    """
    rng, rows = np.random.default_rng([seed, int(positioner)]), []
    for (session, joint, direction), stretches in read_maps(positioner).items():
        edges = np.array([stretches[0][0], *(stretch[1] for stretch in stretches)])
        counts = np.concatenate([[0.0], np.cumsum([(b - a) / step for a, b, step in stretches])])
        cuts = edges[np.r_[0 : len(edges) - 1 : MERGED, len(edges) - 1]]
        low, high = cuts[:-1], cuts[1:]
        if cut == 2:
            length = rng.uniform(*LENGTHS, len(low))
            low = rng.uniform(edges[0], edges[-1] - length)
            high = low + length
        if only not in ("", joint):
            continue
        steps = np.interp(high, edges, counts) - np.interp(low, edges, counts)
        for a, b, count in zip(low, high, steps.round().astype(int), strict=True):
            ends = (a, b) if direction == "fwd" else (b, a)
            others = {1: ("", 0), 2: (0, "")}[JOINTS[joint]]
            rows.append((session, JOINTS[joint], DIRECTIONS[direction], count, 1, *others, *ends))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            "session joint direction steps check_every q1_deg q2_deg from_deg to_deg".split()  # noqa: SIM905
        )
        writer.writerows(rows[::every])
    return len(rows[::every])
