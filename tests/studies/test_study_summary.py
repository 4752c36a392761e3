"""What a study says, draws and saves; the verb from end to end."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.causes import ThermalWarmUp
from stickslip_fit.errors import InputError
from stickslip_fit.studies import Cores, Scenario, run_study, save_study
from tests.studies.conftest import HEAD, JOINT_3, ROTARY, hidden, law_file
from tests.studies.test_plan import GOOD

SCENARIOS = (Scenario("nothing hidden"), hidden("a warm-up", ThermalWarmUp(), 0.08, 3600.0))


@pytest.fixture(scope="module")
def found(study):
    return run_study(
        study(JOINT_3 + ROTARY, scenarios=SCENARIOS, moves=4, good_enough=0.02), backend=Cores(1)
    )


@pytest.mark.slow
def test_the_answer_names_what_lasts_and_what_is_lost(found):
    answer, told = (" ".join(part.split()) for part in str(found).split("Joint 3 (prismatic)"))
    table = found.accuracy().set_index(["joint", "scenario", "strategy"])["rms_relative"][3]
    # What the answer rests on:
    assert table["nothing hidden"]["closed form"] < 0.01
    assert table["a warm-up"]["closed form"] > 0.025
    assert table["a warm-up"]["constant step"] > 0.1
    assert "In none: constant step." in told
    assert "closed form" not in told.split("In none")[0]
    assert answer.startswith(
        "Limit: 2 % rms (good_enough_pct of the plan), judged by the upper end of the 95 %"
    )
    assert "hold the truth too rarely with a warm-up (down to" in told


def test_numbers_are_those_of_the_campaigns(found):
    campaigns, accuracy = found.campaigns, found.accuracy()
    subset = campaigns[
        (campaigns["joint"] == 3)
        & (campaigns["strategy"] == "closed form")
        & (campaigns["scenario"] == "a warm-up")
    ]
    assert len(subset) == 20 * 2
    row = accuracy[
        (accuracy["joint"] == 3)
        & (accuracy["strategy"] == "closed form")
        & (accuracy["scenario"] == "a warm-up")
    ].iloc[0]
    assert row["campaigns"] == 20
    assert row["rms_relative"] == pytest.approx(np.sqrt(np.mean(subset["rms_relative"] ** 2)))
    assert row["bias_relative"] == pytest.approx(subset["bias_relative"].mean())
    assert row["seconds"] == pytest.approx(subset.groupby("campaign")["seconds"].sum().mean())
    assert abs(row["worst_relative"]) == subset["worst_relative"].abs().max()


def test_files_hold_every_number_in_peoples_units(found, tmp_path):
    written = save_study(found, tmp_path / "numbers")
    assert {path.stem for path in written} == {
        "campaigns", "accuracy", "accuracy_by_direction", "left_out", "tip", "tip_campaigns",
    }  # fmt: skip
    campaigns = pd.read_csv(tmp_path / "numbers" / "campaigns.csv")
    same = pd.read_parquet(tmp_path / "numbers" / "campaigns.parquet")
    assert len(campaigns) == len(same) == 2 * 20 * 3 * 6
    first, of = campaigns.iloc[0], found.campaigns.iloc[0]
    assert first["rms_pct"] == pytest.approx(100 * of["rms_relative"])
    assert (first["unit"], first["rms"]) == ("µrad", pytest.approx(1e6 * of["rms"]))
    tip = pd.read_parquet(tmp_path / "numbers" / "tip.parquet")
    assert tip["rms_um"].to_numpy() == pytest.approx(1e6 * found.tips()["rms"])


def test_charts_show_every_scenario_joint_and_strategy(found):
    figure = found.plot_errors().figure
    assert len(figure.axes) == 2 * 3
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert shown[:3] == ["constant step", "closed form", "least squares, I-optimal +2"]
    accuracy = found.accuracy().set_index(["scenario", "joint", "strategy"])["rms_relative"]
    drawn = sorted(
        line.get_ydata()[0] for line in figure.axes[-1].lines if line.get_marker() not in ("None", "", None)
    )
    np.testing.assert_allclose(drawn, np.sort(100 * accuracy["a warm-up"][3]))
    assert len(found.plot_tips()) == 2


@pytest.mark.slow
def test_a_notebook_shows_it(found):
    html = found._repr_html_()
    assert html.count("<table") == 5
    assert "a warm-up" in html


@pytest.mark.slow
def test_without_moves_there_is_nothing_of_the_tip(study):
    plain = run_study(study(campaigns=3), backend=Cores(1))
    assert "The tip after" not in str(plain)
    assert plain._repr_html_().count("<table") == 2
    with pytest.raises(InputError, match="made no moves"):
        plain.plot_tips()


@pytest.mark.slow
def test_the_verb_runs_keeps_and_carries_on(run, refused, tmp_path):
    head = HEAD.format(sessions=1, check_every=5, repeatability_pct=0.3)
    (tmp_path / "plan.toml").write_text(head + JOINT_3 + ROTARY)
    (tmp_path / "law.toml").write_text(law_file(0.0))
    text = GOOD.replace('"Bayes, 2 I-optimal"', '"constant step"').replace("campaigns = 50", "campaigns = 2")
    (tmp_path / "study.toml").write_text(text)
    status, told, _ = run("study", tmp_path / "study.toml", "-o", tmp_path / "out", "--workers", 1)
    assert status == 0
    assert "Joint 3: " in told
    assert (tmp_path / "out" / "errors.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "out" / "tips.png").exists()
    chunks = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "chunks").rglob("*.parquet")}
    assert len(chunks) == 2
    assert run("study", tmp_path / "study.toml", "-o", tmp_path / "out", "--workers", 1) == (0, told, "")
    assert chunks == {path: path.stat().st_mtime_ns for path in chunks}
    assert "--cluster and --workers exclude each other" in refused(
        "study", tmp_path / "study.toml", "--workers", 1, "--cluster", "tcp://x:1"
    )
