"""stickslip-fit diagnose-table: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json

import pandas as pd
import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.cli import app
from stickslip_fit.diagnosis.table import read_table
from tests.table.bench import bench

LAW = """
formula = "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"

[units]
F = "N"
M = "kg"
Fv = "N s/m"
Fc = "N"
offset = "N"

[[cause]]
name = "viscous-by-direction"
formula = "+ dFv*abs(vel)"
parameters = "dFv in N s/m"

[roles]
time = "t"
"""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bench(1, n=200).to_csv("bench.csv", index=False)
    (tmp_path / "friction.toml").write_text(LAW, "utf-8")
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(app, ["diagnose-table", *arguments])


def test_text_json_page_and_law(desk):
    outputs = ["--json", "out.json", "--report", "out.html", "--save-law", "law.json"]
    done = run("bench.csv", "--law", "friction.toml", *outputs)
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("Viscous-by-direction: the law lacks dFv*abs(vel) (")
    assert "100.0 %" not in done.output
    assert "law (extended by viscous-by-direction) saved to law.json" in done.output
    content = json.loads((desk / "out.json").read_text("utf-8"))
    assert content["verdict"] == "cause named"
    assert content["table"]["roles"] == {"time": "t"}
    assert "viscous-by-direction.dFv" in (desk / "out.html").read_text("utf-8")
    fit = ssf.load_table_fit(desk / "law.json")
    parameter = content["findings"][0]["parameters"][0]
    assert parameter["estimate"] == pytest.approx(fit.parameters["estimate"].iloc[-1], rel=1e-3)


def test_an_option_goes_before_the_law_file(desk):
    done = run("bench.csv", "--law", "friction.toml", "--time", "tea")
    assert isinstance(done.exception, ssf.InputError)
    assert "tea" in str(done.exception)
    assert not list(desk.glob("*.json"))


@pytest.mark.parametrize("option", ["--json", "--report", "--save-law"])
@pytest.mark.parametrize("name", ["bench.csv", "friction.toml"])
def test_what_is_read_is_kept(desk, option, name):
    before = (desk / name).read_bytes()
    done = run("bench.csv", "--law", "friction.toml", option, name)
    assert isinstance(done.exception, ssf.InputError)
    assert "would overwrite" in str(done.exception)
    assert (desk / name).read_bytes() == before


def test_a_fault_of_the_law_file_is_named_with_its_line_and_nothing_is_written(desk):
    (desk / "friction.toml").write_text(LAW.replace("[units]", "[unitz]"), "utf-8")
    done = run("bench.csv", "--law", "friction.toml", "--json", "out.json")
    assert isinstance(done.exception, ssf.InputError)
    assert "friction.toml, line 4, column unitz" in str(done.exception)
    assert not (desk / "out.json").exists()


def test_laws_of_joints_are_no_law_of_a_table(desk):
    (desk / "friction.toml").write_text('[joint.1]\nformula = "gamma ~ a"\n', "utf-8")
    done = run("bench.csv", "--law", "friction.toml")
    assert "laws of a log's joints alone" in str(done.exception)


def test_a_law_file_gives_what_python_would(desk):
    file = ssf.read_law_file("friction.toml")
    assert file.law.formula == "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"
    assert file.roles == {"time": "t"}
    assert [cause.name for cause in file.causes] == ["viscous-by-direction"]


def test_a_table_is_read_from_the_sheet_that_is_named(desk):
    with pd.ExcelWriter("bench.xlsx") as book:
        pd.DataFrame({"note": ["see the next sheet"]}).to_excel(book, sheet_name="Cover", index=False)
        pd.read_csv("bench.csv").to_excel(book, sheet_name="Data", index=False)
    table, source = read_table("bench.xlsx", "Data")
    pd.testing.assert_frame_equal(table, pd.read_csv("bench.csv"))
    assert source["file"] == "bench.xlsx"
    other = run("bench.xlsx", "--law", "friction.toml", "--sheet", "Cover")
    assert str(other.exception).endswith("its columns are note")
    for file, sheet, told in (
        ("bench.xlsx", "Date", "Worksheet named 'Date' not found"),
        ("bench.csv", "Data", "is no Excel workbook, and has no sheets; leave the sheet out"),
    ):
        with pytest.raises(ssf.InputError, match=told):
            read_table(file, sheet)
