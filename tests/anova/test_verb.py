"""`stickslip-fit anova` as a person uses it."""

import json
from functools import partial
from pathlib import Path

import pytest

from stickslip_fit.anova.analysis import RECORD_COLUMNS

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "data" / "reference" / "campaign.csv"
CAMPAIGNS = ROOT.parent / "shared" / "data" / "campaigns"


@pytest.fixture
def run(run):
    return partial(run, "anova")


@pytest.mark.slow
def test_the_answer_comes_first_and_the_json_holds_it(run, tmp_path):
    status, out, _ = run(REFERENCE, "--joint", 3, "--json", tmp_path / "anova.json")
    assert status == 0
    assert out.startswith("Joint 3: the step size changes from session to session by up to 1.7 %")
    advice = "Recalibrate each session and keep separate parameters for each direction."
    assert advice in " ".join(out.split())
    assert len(out.splitlines()) <= 26, "a screen, and what was saved"
    records = json.loads((tmp_path / "anova.json").read_text("utf-8"))
    assert all(tuple(record) == RECORD_COLUMNS for record in records)
    alone = {"day", "direction", "normal-force", "position"}
    together = {f"all traverses: {term}" for term in ("day", "direction", "configuration", "day x direction")}
    assert {record["analysis"] for record in records} == alone | together


def test_a_formula_prints_and_saves_its_table(run, tmp_path):
    how = ("--formula", "step_size ~ C(session) * direction", "--type", 1, "--json", tmp_path / "f.json")
    status, out, _ = run(REFERENCE, "--joint", 3, *how)
    assert status == 0
    assert "step_size ~ C(session) * direction, type 1, 456 traverses" in " ".join(out.split())
    assert len(json.loads((tmp_path / "f.json").read_text("utf-8"))) == 3


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--session", "never"], "no usable traverse of session 'never'"),
        (["--formula", "step_size ~ nothing"], "'nothing' is no column"),
        (["--json", "absent/anova.json"], "absent/anova.json"),
    ],
)
def test_bad_input_ends_with_one_message_and_status_2(run, tmp_path, monkeypatch, options, told):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(REFERENCE, *options)
    assert (status, out) == (2, "")
    assert told in err
    assert "Traceback" not in err


@pytest.mark.skipif(not CAMPAIGNS.exists(), reason="the measured campaigns are not on this machine")
@pytest.mark.parametrize("name", ["a", *(pytest.param(name, marks=pytest.mark.nightly) for name in "bcdef")])
def test_measured_campaigns_get_an_answer(run, name, tmp_path):
    status, out, err = run(CAMPAIGNS / f"campaign-{name}.csv", "--json", tmp_path / "anova.json")
    assert (status, err) == (0, "")
    assert out.startswith("Joint ")
    assert any(record["F"] for record in json.loads((tmp_path / "anova.json").read_text("utf-8")))
