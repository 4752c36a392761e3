"""stickslip-fit diagnose-table: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.cli import app
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
    assert "viscous-by-direction" in done.output
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


def test_faults_of_a_law_file_are_named_with_their_lines(desk):
    text = LAW.replace("[units]", "[unitz]").replace('time = "t"', 'clock = "t"')
    (desk / "friction.toml").write_text(text.replace("name = ", "nom = "), "utf-8")
    with pytest.raises(ssf.InputError) as caught:
        ssf.read_law_file("friction.toml")
    message = str(caught.value)
    assert "friction.toml, line 4, column unitz" in message
    assert "did you mean units?" in message
    assert "session, time, position, direction or group" in message
    assert "give the cause a name" in message


def test_formulas_that_cannot_be_read_are_all_named(desk):
    (desk / "friction.toml").write_text(LAW.replace("+ offset", "+ (").replace("+ dFv", "dFv"), "utf-8")
    with pytest.raises(ssf.InputError) as caught:
        ssf.read_law_file("friction.toml")
    assert len(caught.value.problems) == 2
    assert all(str(issue).startswith("friction.toml: ") for issue in caught.value.problems)


def test_a_law_file_gives_what_python_would(desk):
    file = ssf.read_law_file("friction.toml")
    assert file.law.formula == "F ~ M*acc + Fv*vel + Fc*sign(vel) + offset"
    assert file.roles == {"time": "t"}
    assert [cause.name for cause in file.causes] == ["viscous-by-direction"]
