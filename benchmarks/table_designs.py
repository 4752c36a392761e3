"""Simulated tables whose noise differs between rows, and tables of two factors: what is found in them.

`python -m benchmarks.table_designs noise --tables 15` counts right answers in tables of nothing but noise;
with `--strength 10` each has the effect of a column beside. `python -m benchmarks.table_designs factors
--tables 16` counts what is found of the effects of two labels, each of strength 12.
"""

import argparse
from collections import Counter
from collections.abc import Callable

import numpy as np
import pandas as pd

import stickslip_fit as ssf

SD, LARGE, EDGE = 0.05, 5.0, 0.7  # of the noise; how many times as large; above which value of a column
SEVERAL = {"w0": 1.0, "w1": 1.0, "w2": 2.0, "w3": 4.0, "w4": 6.0}
Ratio = Callable[[pd.DataFrame], np.ndarray]

NOISE: dict[str, Ratio] = {
    "alike": lambda rows: np.ones(len(rows)),
    "one label": lambda rows: np.where(rows["who"] == "w1", LARGE, 1.0),
    "all labels": lambda rows: rows["who"].map(SEVERAL).to_numpy(float),
    "range of a column": lambda rows: np.where(rows["c1"] > EDGE, LARGE, 1.0),
    "grows with a column": lambda rows: np.exp(0.8 * rows["c1"].to_numpy()),
    "range of the law's column": lambda rows: np.where(rows["x"] > EDGE, LARGE, 1.0),
}
FACTORS = {
    "nothing": (0, 0, 0),
    "one alone": (1, 0, 0),
    "both alone": (1, 1, 0),
    "together": (0, 0, 1),
    "alone and together": (1, 1, 1),
}


def draw_noise(kind: str, seed: int, strength: float) -> pd.DataFrame:
    """60, 120 or 250 rows about a line in x, with four columns and five labels; the effect is of c2."""
    rng = np.random.default_rng(91000 + seed)
    n = int(rng.choice([60, 120, 250]))
    columns = {"x": rng.uniform(0, 1, n), **{f"c{k}": rng.standard_normal(n) for k in range(4)}}
    rows = pd.DataFrame({**columns, "who": [f"w{k}" for k in rng.integers(0, len(SEVERAL), n)]})
    ratio, effect = NOISE[kind](rows), np.abs(rows["c2"]) - 1.0 if seed % 2 else rows["c2"]
    effect = effect * strength / np.sqrt(np.sum((effect / ratio) ** 2))
    slope = -2.0 * (seed % 3)
    return rows.assign(
        y=1.0 + slope * rows["x"] + SD * (ratio * rng.standard_normal(n) + effect), effect=effect
    )


def study_noise(tables: int, strength: float) -> None:
    """Print how many answers are right, and how often the interval of the effect's size is."""
    expected = ["covariate:c2"] if strength else []
    for kind in NOISE:
        right = inside = 0
        for seed in range(tables):
            rows = draw_noise(kind, seed, strength)
            effect = SD * rows.pop("effect")
            found = ssf.diagnose_table(rows, "y ~ a + b*x", gain=False).findings
            if [one.cause for one in found] != expected:
                continue
            right += 1
            if strength:
                left = effect - np.polyval(np.polyfit(rows["x"], effect, 1), rows["x"])
                inside += found[0].effect.low <= np.sqrt(np.mean(left**2)) <= found[0].effect.high
        interval = f", interval right in {inside}" if strength else ""
        print(f"{kind}: right in {right} of {tables}{interval}", flush=True)


def draw_factors(shares: tuple[int, int, int], seed: int) -> pd.DataFrame:
    """72, 144 or 288 rows of labels A and B, a column C of two numbers and one more."""
    rng = np.random.default_rng([7, seed])
    n = int(rng.choice([72, 144, 288]))
    a, b = (rng.permutation(np.resize(np.arange(k), n)) for k in (4, 3))
    c, z = rng.permutation(np.resize([1, 2], n)), rng.standard_normal(n)
    cells = rng.standard_normal((4, 3))
    cells -= cells.mean(axis=0) + cells.mean(axis=1)[:, None] - cells.mean()
    y = 3.0 + (rng.standard_normal(n) if seed % 2 else rng.standard_t(5, n) * np.sqrt(3 / 5))
    for share, effect in zip(
        shares, (rng.standard_normal(4)[a], rng.standard_normal(3)[b], cells[a, b]), strict=True
    ):
        centred = effect - effect.mean()
        y = y + share * 12.0 * centred / np.linalg.norm(centred)
    return pd.DataFrame(
        {"A": np.array(list("abcd"))[a], "B": np.array(list("uvw"))[b], "C": c, "z": z, "y": y}
    )


def study_factors(tables: int) -> None:
    """Print what is found of each kind of effects, and how often."""
    for kind, shares in FACTORS.items():
        answers: Counter[str] = Counter()
        for seed in range(tables):
            found = ssf.diagnose_table(draw_factors(shares, seed), "y ~ m", gain=False).findings
            answers[", ".join(sorted(one.carrier or one.cause for one in found)) or "nothing wrong"] += 1
        told = "; ".join(f"{answer} ({n})" for answer, n in answers.most_common())
        print(f"{kind}: {told}", flush=True)


def main() -> None:
    """Run a study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("study", choices=("noise", "factors"))
    parser.add_argument("--tables", type=int, default=15)
    parser.add_argument("--strength", type=float, default=0.0)
    given = parser.parse_args()
    if given.study == "noise":
        study_noise(given.tables, given.strength)
    else:
        study_factors(given.tables)


if __name__ == "__main__":
    main()
