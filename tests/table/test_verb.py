"""stickslip-fit diagnose-table: what it prints and writes, and what it refuses."""

import json

import pandas as pd
import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.cli import app
from stickslip_fit.diagnosis.table_rows import read_table
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
    bench(1, n=100).to_csv("bench.csv", index=False)
    (tmp_path / "friction.toml").write_text(LAW, "utf-8")
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(app, ["diagnose-table", *arguments])


@pytest.mark.slow
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


@pytest.mark.nightly
def test_a_formula_is_a_law(desk):
    pd.read_csv("bench.csv").head(30).to_csv("short.csv", index=False)
    done = run("short.csv", "--law", "F ~ Fv*vel + offset", "--time", "t")
    assert done.exit_code == 0, done.output
    headline = str(ssf.diagnose_table("short.csv", "F ~ Fv*vel + offset", time="t")).splitlines()[0]
    assert done.stdout.splitlines()[0] == headline


@pytest.mark.parametrize(
    ("law", "told"),
    [
        ("F = a*vel", "write ~ in place of ="),
        ("~/no-such-law.toml", "name an existing law file"),
        ("law~1.toml", "name an existing law file"),
    ],
)
def test_what_is_neither_a_formula_nor_a_file_is_named(desk, law, told):
    assert told in str(run("bench.csv", "--law", law).exception)


def test_a_law_file_may_have_a_tilde_in_its_name(desk):
    (desk / "friction~1").write_text('formula = "F ~ Fv*vel"\n[roles]\ntime = "tea"\n', "utf-8")
    assert "is named as the time" in str(run("bench.csv", "--law", "friction~1").exception)


def test_diagnose_of_a_table_that_is_no_log_ends_with_the_command_for_it(desk):
    done = CliRunner().invoke(app, ["diagnose", "bench.csv"])
    told = str(done.exception).splitlines()[-1]
    assert told.endswith("stickslip-fit diagnose-table bench.csv --law 'F ~ a + b*t'")
    (desk / "log.csv").write_text("session,joint,steps\na,1,1000\n", "utf-8")
    assert "diagnose-table" not in str(CliRunner().invoke(app, ["diagnose", "log.csv"]).exception)


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
        ("bench.xlsx", "Date", "has no sheet 'Date', but 'Cover' and 'Data'"),
        ("bench.csv", "Data", "is no Excel workbook, and has no sheets; leave the sheet out"),
    ):
        with pytest.raises(ssf.InputError, match=told):
            read_table(file, sheet)
