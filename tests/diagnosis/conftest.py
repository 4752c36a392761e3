"""Diagnoses of small campaigns whose truth is known, one of each verdict."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.hypotheses import make_hypothesis
from stickslip_fit.diagnosis.linearized import LawBlock, linearize_fit
from stickslip_fit.diagnosis.row_table import RowTable
from stickslip_fit.laws import Prismatic

SETTINGS = (
    *({"joint": 3, "q2_deg": q2, "theta_deg": theta} for q2 in (-90.0, -45.0, 0.0) for theta in (0.0, -60.0)),
    *({"joint": 2, "q3_mm": q3, "theta_deg": theta} for q3 in (0.0, 12.0) for theta in (0.0, -90.0)),
)
REPEATABILITY, DRIFT = 0.0027, -0.003  # relative; and an hour
ALPHA = 0.02
Q2 = np.radians([-90.0, 0.0, 0.0, -45.0, -135.0])
THETA = np.radians([0.0, -90.0, 0.0, 0.0, -30.0])
NOISE = 0.003  # of a count, relative


def hours_in(table: pd.DataFrame) -> np.ndarray:
    """Since each session began."""
    time = pd.to_datetime(table["time"])
    return (time - time.groupby(table["session"]).transform("min")).dt.total_seconds().to_numpy() / 3600.0


def changed(table: pd.DataFrame, relative: np.ndarray) -> pd.DataFrame:
    """The same campaign, counts grown by as much."""
    steps = np.round(table["steps"] * (1.0 + relative) / 5.0).astype(int) * 5
    return table.assign(steps=steps)


def waves(study):
    """One unstructured alternative in the place of all, to be quick."""
    hours = study.rows["session_seconds"].to_numpy(float) / 3600
    columns = np.stack([np.cos(np.pi * k * hours / hours.max()) for k in range(1, 5)], axis=-1)
    return [make_hypothesis("unknown:time", None, None, study.project(columns / study.scale[:, None]))]


@pytest.fixture(scope="package")
def table(campaign):
    """Two sessions of joints 2 and 3 in which nothing is wrong."""
    return campaign(settings=SETTINGS, replicates=5, repeatability=REPEATABILITY)


@pytest.fixture(scope="package")
def drifting(table, read_table):
    """The log in which steps shrink by 0.3 % an hour, so that counts grow."""
    return read_table(changed(table, -DRIFT * hours_in(table)), "drifting.csv")


@pytest.fixture(scope="package")
def named(drifting):
    return diagnose(drifting, alpha=ALPHA, gain=False)


@pytest.fixture(scope="package")
def nothing(table, read_table):
    return diagnose(read_table(table, "fine.csv"), alpha=ALPHA, gain=False)


@pytest.fixture(scope="package")
def unnamed(table, read_table):
    """Counts that come and go with a period that no column of the log has."""
    wave = 0.012 * np.sin(2 * np.pi * hours_in(table) / 0.9)
    return diagnose(read_table(changed(table, wave), "waving.csv"), alpha=ALPHA, gain=False)


@pytest.fixture(scope="package")
def tiny(table, read_table):
    """Three traverses."""
    return diagnose(read_table(table.head(3), "tiny.csv"), gain=False)


@pytest.fixture(scope="package")
def rows():
    """Two sessions of joint 3 in both directions, ten hours each."""
    n = 100
    return pd.DataFrame(
        {
            "session": np.repeat(["a", "b"], n),
            "joint": 3,
            "direction": np.tile(["+", "-"], n),
            "q1": 0.0,
            "q2": np.tile(np.repeat(Q2, 2), 2 * n // 10),
            "q3": np.nan,
            "theta": np.tile(np.repeat(THETA, 2), 2 * n // 10),
            "psi": 0.0,
            "start": np.tile([0.0, 0.012], n),
            "stop": np.tile([0.012, 0.0], n),
            "session_seconds": np.tile(np.linspace(0.0, 36_000.0, n), 2),
        }
    )


@pytest.fixture(scope="package")
def parts(rows):
    block = 2 * (rows["session"] == "b").to_numpy() + (rows["direction"] == "-").to_numpy()
    values = np.where(block[:, None] % 2 == 0, [976e-9, 0.3, 438e-9], [903e-9, 0.3, -405e-9])
    return (LawBlock(Prismatic(), np.arange(len(rows)), block.astype(np.intp), values),)


@pytest.fixture(scope="package")
def linearize(rows, parts):
    """A maker of studies from departures of the responses."""

    def make(departure):
        responses = Prismatic().predict(rows, parts[0].values) + departure
        return linearize_fit(RowTable(rows), parts, responses, np.full(len(rows), NOISE))

    return make
