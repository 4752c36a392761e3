"""Hidden logs as the package reads them, which what makes them does not know."""

from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from stickslip_fit.logs import Log, read_log
from tests.hidden.generate import Hidden

LAB_COLUMNS = ["temperature_C", "humidity_pct", "supply_V", "air_pressure_hPa", "operator_load"]


def drop_lab_columns(table: pd.DataFrame) -> pd.DataFrame:
    """A log's table without a lab's columns: where they act on nothing, each has many functions to try."""
    return table.drop(columns=LAB_COLUMNS, errors="ignore")


def read_hidden(hidden: Hidden, joints: Collection[int] = (1, 2, 3)) -> Log:
    """A hidden log as a user's file, the traverses of some joints."""
    with TemporaryDirectory() as folder:
        hidden.write(Path(folder) / "log.csv")
        log = read_log(Path(folder) / "log.csv")
    return log.select(log.rows["joint"].isin(joints)) if len(joints) < 3 else log
