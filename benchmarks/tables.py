"""Measured tables that others have analysed, under a law that lacks what they are known for; tables of noise.

`python -m benchmarks.tables FOLDER`: FOLDER holds R's data sets as CSV files, such as those of the Python
package pydataset, unpacked (`rdata/csv`); without it only those that statsmodels ships are diagnosed.
`python -m benchmarks.tables --nothing 300` counts alarms in tables in which there is nothing but noise.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import stickslip_fit as ssf

ALONE = ssf.Law("y ~ mean", units={"year": "years"})


@dataclass(frozen=True)
class Case:
    """A table, a law that lacks something, and what others found in it."""

    name: str
    known: str
    law: Any
    frame: pd.DataFrame
    options: dict[str, Any] = field(default_factory=dict)


def read_statsmodels() -> Iterator[Case]:
    """Of the data sets that statsmodels ships."""
    from statsmodels.datasets import elnino, nile, sunspots

    timed = {"time": "year"}
    flow = nile.load_pandas().data.rename(columns={"volume": "y"})
    yield Case("Nile", "lower by 248 after 1898 (Cobb 1978)", ALONE, flow, timed)
    sea = elnino.load_pandas().data.set_index("YEAR").stack().reset_index(drop=True)
    frame = pd.DataFrame({"year": 1950 + np.arange(len(sea)) / 12.0, "y": sea})
    yield Case("El Nino", "seasons", ALONE, frame, timed)
    spots = sunspots.load_pandas().data.set_axis(["year", "y"], axis=1)
    yield Case("sunspots", "11 years, of drifting phase", ALONE, spots, timed)


def read_r(folder: Path) -> Iterator[Case]:
    """Of R's data sets."""

    def read(name: str) -> pd.DataFrame:
        return pd.read_csv(folder / f"{name}.csv", index_col=0).reset_index(drop=True)

    def series(name: str) -> pd.DataFrame:
        return read(name).set_axis(["year", "y"], axis=1)

    timed = {"time": "year"}
    yield Case("nottem", "seasons", ALONE, series("datasets/nottem"), timed)
    yield Case("UKDriverDeaths", "seasons, fewer after 1974", ALONE, series("datasets/UKDriverDeaths"), timed)
    yield Case("lynx", "a cycle of 10 years", ALONE, series("datasets/lynx"), timed)
    air = series("datasets/AirPassengers").assign(y=lambda rows: np.log(rows["y"]))
    trend = ssf.Law("y ~ a + b*year", units={"year": "years"})
    yield Case("AirPassengers", "seasons", trend, air, timed)
    yield Case("whiteside", "other line after insulation", "Gas ~ a + b*Temp", read("MASS/whiteside"))
    saturation = "rate ~ Vm*conc/(K + conc)"
    yield Case("Puromycin", "other Vm if untreated", saturation, read("datasets/Puromycin"))
    poisons = read("boot/poisons").assign(rate=lambda rows: 1.0 / rows["time"]).drop(columns="time")
    yield Case("poisons", "poison and treatment", "rate ~ mean", poisons)
    yield Case("mcycle", "a blow and its swing", "accel ~ a + b*times", read("MASS/mcycle"))
    yield Case("ethanol", "a peak in E, C beside it", "NOx ~ a + b*C", read("lattice/ethanol"))
    stars = read("robustbase/starsCYG").set_axis(["T", "L"], axis=1)
    yield Case("starsCYG", "four giants", "L ~ a + b*T", stars)
    yield Case("kootenay", "one slip of the pen", "Newgate ~ a + b*Libby", read("robustbase/kootenay"))
    yield Case("hills", "one slip of the pen", "time ~ a*dist + b*climb", read("MASS/hills"))
    yield Case("trees", "nothing", "Volume ~ c*Girth**2*Height", read("datasets/trees"))
    yield Case("wtloss", "nothing", "Weight ~ a + b*exp(-Days/tau)", read("MASS/wtloss"), {"time": "Days"})


def diagnose_case(case: Case) -> None:
    """Print what is found, and the errors on held-out rows with and without it."""
    began = time.process_time()
    found = ssf.diagnose_table(case.frame, case.law, **case.options)
    seconds, gain = time.process_time() - began, found.gain
    names = ", ".join(one.term or f"{one.cause} {one.carrier}".rstrip() for one in found.findings)
    errors = f"{gain.baseline:.3g} -> {gain.extended:.3g}" if gain else ""
    print(
        f"{case.name:15s} {case.known:36s} {names or found.verdict:44s} {errors:16s} "
        f"{found.repeatability:6.3g}  {seconds:4.1f} s",
        flush=True,
    )


KINDS = ("normal", "Student t", "AR(1)", "swing", "uneven", "skewed")


def draw_nothing(seed: int) -> tuple[str, pd.DataFrame]:
    """The kind of noise, and a table of 30 to 220 rows: a line, and decoys.

    They are of numbers, of few texts, of few integers, one after the other in every other table, and of many
    texts.
    """
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    n = int(rng.integers(30, 220))
    x, z, noise = rng.uniform(0.0, 10.0, n), rng.standard_normal(n), rng.standard_normal(n + 200)
    if kind == "Student t":
        noise = rng.standard_t(5, n + 200)
    elif kind == "AR(1)":
        noise = lfilter([1.0], [1.0, -0.6], noise)
    elif kind == "swing":
        noise = lfilter([1.0], [1.0, -1.8 * np.cos(2.0 * np.pi / 9.0), 0.81], noise)
    elif kind == "skewed":
        noise = np.exp(0.5 * noise)
    noise = noise[-n:] * (0.5 + x / 5.0 if kind == "uneven" else 1.0)
    who, lot = rng.choice(["a", "b", "c"], n), rng.integers(1, 7, n)
    decoys = {"z": z, "who": who, "lot": np.sort(lot) if seed // len(KINDS) % 2 else lot}
    decoys["part"] = rng.choice([f"part {number}" for number in range(20)], n)
    return kind, pd.DataFrame({"t": 0.5 * np.arange(n), "x": x, **decoys, "y": 2.0 + 0.3 * x + noise})


def count_alarms(first: int, number: int) -> None:
    """Print the alarms by kind of noise."""
    alarms = dict.fromkeys(KINDS, 0)
    for seed in range(first, first + number):
        kind, frame = draw_nothing(seed)
        options = {"time": "t"} if kind in ("AR(1)", "swing") or seed % 2 == 0 else {}
        found = ssf.diagnose_table(frame, "y ~ a + b*x", gain=False, seed=seed, **options)
        alarms[kind] += len(found.findings) > 0
        if found.findings:
            print(seed, kind, [one.cause + " " + one.carrier for one in found.findings], flush=True)
    print(f"alarms in {number} tables of noise: {alarms}")


def main() -> None:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--nothing", type=int, default=0)
    parser.add_argument("--first", type=int, default=1)
    given = parser.parse_args()
    if given.nothing:
        count_alarms(given.first, given.nothing)
        return
    for case in (*read_statsmodels(), *(read_r(given.folder) if given.folder else ())):
        diagnose_case(case)


if __name__ == "__main__":
    main()
