"""Seasons: whole sessions are selected, their history stays the campaign's, and the rest is not read."""

from datetime import UTC, date, datetime

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log

SESSIONS, PER_SESSION = 20, 30


def seasons() -> pd.DataFrame:
    """Twenty sessions, one a day, each running past midnight."""
    rng = np.random.default_rng(0)
    count = SESSIONS * PER_SESSION
    day = np.repeat(np.arange(SESSIONS), PER_SESSION)
    minutes = day * 1440 + 20 * 60 + np.tile(np.arange(PER_SESSION), SESSIONS) * 13
    return pd.DataFrame(
        {
            "session": [f"{number:03d}" for number in day],
            "time": np.datetime64("2012-03-01T00:00") + minutes.astype("m8[m]"),
            "joint": rng.integers(1, 4, count),
            "direction": rng.choice(["+", "-"], count),
            "steps": 5 * rng.integers(100, 3000, count),
            "q1_deg": 0.0,
            "q2_deg": -90.0,
            "q3_mm": 6.0,
            "theta_deg": rng.choice([0.0, -30.0], count),
            "psi_deg": 0.0,
            "humidity_pct": rng.normal(40, 2, count),
        }
    )


@pytest.fixture(params=["csv", "parquet"])
def campaign(request, tmp_path):
    path = tmp_path / f"years.{request.param}"
    if request.param == "csv":
        seasons().assign(time=lambda rows: rows["time"].dt.strftime("%Y-%m-%dT%H:%M")).to_csv(
            path, index=False
        )
    else:
        seasons().to_parquet(path, row_group_size=PER_SESSION * 2)
    return path


@pytest.mark.parametrize(
    ("since", "until", "days"),
    [
        ("2012-03-05", "2012-03-08", range(4, 7)),
        ("2012-03-05T20:00", None, range(4, 20)),
        ("2012-03-05T20:01", None, range(5, 20)),
        (None, datetime(2012, 3, 5, 20), range(4)),
        (None, date(2012, 3, 5), range(4)),
        ("2012-01-01", "2013-01-01", range(20)),
    ],
)
def test_a_season_is_what_a_full_read_would_give_for_its_sessions(campaign, since, until, days):
    whole = read_log(campaign)
    chosen = whole.select(whole.rows["session"].isin([f"{day:03d}" for day in days]))
    season = read_log(campaign, since=since, until=until)
    pd.testing.assert_frame_equal(season.rows, chosen.rows)
    assert season.sha256 == whole.sha256


def test_a_season_reads_only_its_own_row_groups_beside_what_history_needs(tmp_path, monkeypatch):
    path = tmp_path / "years.parquet"
    seasons().to_parquet(path, row_group_size=PER_SESSION * 2)
    read = []
    groups_of = parquet.ParquetFile.read_row_groups
    whole_of = parquet.ParquetFile.read

    def some(self, row_groups, columns=None, **options):
        read.append((columns[0], tuple(row_groups)))
        return groups_of(self, row_groups, columns=columns, **options)

    def everything(self, columns=None, **options):
        read.append((columns[0], "all"))
        return whole_of(self, columns=columns, **options)

    monkeypatch.setattr(parquet.ParquetFile, "read_row_groups", some)
    monkeypatch.setattr(parquet.ParquetFile, "read", everything)
    read_log(path, since="2012-03-05", until="2012-03-08")
    assert {name for name, groups in read if groups == "all"} == {"session", "time", "joint", "steps"}
    # Sessions 4, 5 and 6 of two to a row group.
    assert {groups for _, groups in read if groups != "all"} == {(2, 3)}
    assert {"theta_deg", "humidity_pct", "direction"} <= {name for name, _ in read}


def test_faults_outside_the_season_are_not_looked_for_unless_history_needs_the_cell(tmp_path):
    rows = seasons()
    rows.loc[0, "theta_deg"] = np.nan
    rows.loc[599, "q2_deg"] = 95.0
    rows.to_parquet(tmp_path / "years.parquet", row_group_size=PER_SESSION)
    assert len(read_log(tmp_path, since="2012-03-05", until="2012-03-08")) == 3 * PER_SESSION
    rows.loc[3, "steps"] = -5
    rows.to_parquet(tmp_path / "years.parquet", row_group_size=PER_SESSION)
    with pytest.raises(InputError, match="line 4, column steps, value '-5'"):
        read_log(tmp_path, since="2012-03-05", until="2012-03-08")


def test_a_fault_in_the_season_is_told_with_its_row_of_the_file(tmp_path):
    rows = seasons()
    rows.loc[4 * PER_SESSION + 7, ["joint", "q2_deg"]] = 1, 95.0
    rows.to_parquet(tmp_path / "years.parquet", row_group_size=PER_SESSION)
    with pytest.raises(InputError) as refused:
        read_log(tmp_path, since="2012-03-05", until="2012-03-08")
    (told,) = refused.value.problems
    assert (told.line, told.column, told.value) == (4 * PER_SESSION + 8, "q2_deg", "95")


def test_files_without_a_chosen_row_still_count_in_history(tmp_path):
    rows = seasons()
    for year, part in enumerate(np.array_split(np.arange(len(rows)), 4)):
        rows.iloc[part].to_parquet(tmp_path / f"{year}.parquet")
    whole = read_log(tmp_path)
    season = read_log(tmp_path, since="2012-03-17")
    pd.testing.assert_frame_equal(season.rows, whole.select(whole.rows["session"] >= "016").rows)
    assert len(season.sources) == 4


@pytest.mark.parametrize(
    ("since", "until"), [("2013-01-01", None), (None, "2012-01-01"), ("2012-03-06", "2012-03-05")]
)
def test_a_season_without_sessions_says_when_the_log_s_sessions_began(campaign, since, until):
    with pytest.raises(InputError, match="2012-03-01T20:00") as refused:
        read_log(campaign, since=since, until=until)
    assert "2012-03-20T20:00" in str(refused.value)


@pytest.mark.parametrize("bound", ["spring", "2012-13-01", "2012-03-05T09:41+01:00"])
def test_a_bound_that_cannot_be_used_is_told(campaign, bound):
    with pytest.raises(InputError) as refused:
        read_log(campaign, since=bound)
    (told,) = refused.value.problems
    assert (told.argument, told.value) == ("since", bound)
    assert "--" not in str(told)
    assert str(told.at_shell).startswith("--since, value ")


def test_bounds_meet_a_log_with_zones_in_utc(tmp_path):
    rows = seasons()
    rows["time"] = rows["time"].dt.tz_localize("Europe/Berlin")
    rows.to_parquet(tmp_path / "years.parquet")
    # 20:00 in Berlin is 19:00 UTC in winter time.
    for since in ("2012-03-05T19:00", "2012-03-05T20:00+01:00", datetime(2012, 3, 5, 19, tzinfo=UTC)):
        assert read_log(tmp_path, since=since).sessions[0] == "004"
    assert read_log(tmp_path, since="2012-03-05T19:01").sessions[0] == "005"
    assert pa.types.is_timestamp(parquet.read_schema(tmp_path / "years.parquet").field("time").type)
