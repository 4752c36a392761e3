"""Every number of a study as files, in people's units."""

from __future__ import annotations

import io
from pathlib import Path

import pandas as pd

from stickslip_fit.errors import InputError, Problem
from stickslip_fit.files import write_atomically
from stickslip_fit.machine import JOINTS
from stickslip_fit.strategies.numbers import in_peoples_units
from stickslip_fit.strategies.study.chunk import TIP
from stickslip_fit.strategies.study.study import Study
from stickslip_fit.units import from_si

LENGTHS = ("rms", "median", "often", "often_low", "often_high", "worst", "bias")
SHARES = tuple(f"share_{joint}" for joint in JOINTS)


def tables(found: Study) -> dict[str, pd.DataFrame]:
    """All tables of a study by name, in people's units.

    Angles and lengths of step sizes are in what the column unit says, those of the tip in µm, relative
    numbers in % under names that end so.
    """
    of_tip = found.campaigns["joint"] == TIP
    campaigns = found.campaigns[~of_tip].dropna(axis=1, how="all")
    tips = found.campaigns[of_tip].drop(columns=["joint", "direction"]).dropna(axis=1, how="all")
    shown = {
        "campaigns": in_peoples_units(campaigns.astype({"sessions": int, "failed": int, "predictions": int})),
        "accuracy": in_peoples_units(found.accuracy()),
        "accuracy_by_direction": in_peoples_units(found.accuracy("direction")),
        "left_out": found.design.left_out,
    }
    if len(tips):
        shown |= {"tip_campaigns": _of_tip(tips), "tip": _of_tip(found.tips())}
    return shown


def save_study(found: Study, folder: str | Path) -> list[Path]:
    """Write each table as CSV and as Parquet; the folder is made where it is not there.

    Raises
    ------
    InputError
        If the folder cannot be made or written to.
    """
    folder = Path(folder)
    make_folder(folder)
    written = []
    for name, table in tables(found).items():
        stream = io.BytesIO()
        table.to_parquet(stream, index=False)
        for suffix, content in ((".csv", table.to_csv(index=False)), (".parquet", stream.getvalue())):
            written.append(folder / f"{name}{suffix}")
            write_atomically(written[-1], content)
    return written


def make_folder(folder: Path) -> None:
    """Make a folder in an existing one, unless it is there.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        message = f"cannot be made ({error.strerror}); name a folder in an existing one"
        raise InputError(Problem(message, str(folder))) from None


def _of_tip(table: pd.DataFrame) -> pd.DataFrame:
    columns = {}
    for name in table:
        if name in LENGTHS:
            columns[f"{name}_um"] = from_si(table[name].to_numpy(float), "µm")
        elif name in SHARES:
            columns[f"{name}_pct"] = 100 * table[name].to_numpy(float)
        else:
            columns[str(name)] = table[name]
    return pd.DataFrame(columns)
