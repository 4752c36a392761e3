"""The verb `compare`."""

from pathlib import Path

import pandas as pd
import pytest

from stickslip_fit import estimation as fit
from stickslip_fit.causes import library
from stickslip_fit.logs import read_log
from tests.conftest import CALIBRATION, SWEEPS

JOINT_3 = tuple(each for each in CALIBRATION + SWEEPS if each["joint"] == 3)


def test_a_log_is_compared_with_causes_numbers_and_chart(run, written, tmp_path):
    path = written(sessions=("2012-03-05", "2012-03-06"), settings=JOINT_3)
    files = ("--numbers", tmp_path / "all", "--chart", tmp_path / "p.svg")
    status, told, complained = run("compare", path, "--cause", "drift", "--more", 2, "--full", *files)
    assert (status, complained) == (0, "")
    assert "closed form, with causes" in told
    table = pd.read_parquet(tmp_path / "all" / "accuracy.parquet").set_index("strategy")
    row = table.loc["least squares, I-optimal +2"]
    assert row["traverses_made"] == 5
    lines = [line.split() for line in told.splitlines() if line.startswith("least squares, I-optimal +2 ")]
    minutes = f"{row['seconds'] / 60:.0f}"
    assert lines[0][4] == minutes, "the table of all joints"
    assert lines[1][4:6] == ["5", minutes]
    assert lines[2][4] == f"{row['rms']:.1f}"
    assert (tmp_path / "p.svg").read_text().startswith("<?xml")


def test_what_cannot_be_is_refused_before_any_work(run, log, written, tmp_path):
    path = written(sessions=("2012-03-05", "2012-03-06"), settings=JOINT_3)
    drift = next(each for each in library() if each.name == "drift")
    saved = tmp_path / "law.json"
    fit.fit_least_squares(read_log(path), causes=[drift]).save(saved)
    assert (
        "fitted to the traverses that they would be judged by"
        in run("compare", path, "--causes-from", saved)[2]
    )
    both = run("compare", path, "--causes-from", saved, "--cause", "drift")
    assert both[0] == 2
    assert "exclude each other" in both[2]
    assert "no kind of picture" in run("compare", path, "--chart", tmp_path / "p.txt")[2]
    assert "existing folder" in run("compare", path, "--numbers", tmp_path / "none" / "none")[2]


@pytest.mark.slow
def test_causes_of_another_log_may_be_taken(run, written, tmp_path):
    drift = next(each for each in library() if each.name == "drift")
    other = read_log(written(sessions=("2012-04-05", "2012-04-06"), settings=JOINT_3, seed=4))
    fit.fit_least_squares(other, causes=[drift]).save(tmp_path / "law.json")
    path = written(sessions=("2012-03-05", "2012-03-06"), settings=JOINT_3)
    status, told, _ = run("compare", path, "--causes-from", tmp_path / "law.json")
    assert status == 0
    assert "closed form, with causes" in told


@pytest.mark.slow
def test_tables_never_replace_the_log_that_they_are_of(run, written, tmp_path, monkeypatch):
    """Its name is that of a table, so that the folder that it is in cannot take the tables."""
    path = written(sessions=("2012-03-05", "2012-03-06"), settings=JOINT_3)
    (tmp_path / "day").mkdir()
    content = path.rename(tmp_path / "day" / "pairs.csv").read_bytes()
    monkeypatch.chdir(tmp_path / "day")
    status, told, complained = run("compare", "pairs.csv", "--numbers", ".")
    assert (status, told) == (2, "")
    assert complained == "pairs.csv: is a log that this was computed from; name another file\n"
    assert [each.name for each in Path().iterdir()] == ["pairs.csv"]
    assert Path("pairs.csv").read_bytes() == content
