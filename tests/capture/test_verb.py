"""The verb, as it is typed, at an emulated rig."""

import re
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.tuning import save_tuning
from stickslip_fit.logs import read_log
from tests.capture.hearing import SECONDS, steps, tuned, write_wav

LAW = Path(__file__).parents[2] / "data" / "reference" / "law.toml"
PLAN = """
check_every = 5

[sessions]
dates = [2012-03-05]
[[sweep]]
joint = 3
q2_deg = -90
ranges_mm = [[0, 12], [2, 3]]
"""
SHORT = PLAN.replace("[0, 12], ", "")
ALONE = ("--emulate", "--ideal-detector", "--unattended")


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.fixture
def short(plan):
    """Without the traverses over the whole guide."""
    plan.write_text(SHORT)
    return plan


@pytest.mark.slow
def test_an_emulated_campaign_is_what_simulate_makes_of_the_plan(run, plan, tmp_path):
    log, exact = tmp_path / "log.csv", tmp_path / "law.toml"
    # Days that do not differ, so that both counts follow from the law alone.
    exact.write_text(re.sub("day_to_day.*", "", LAW.read_text()))
    status, said, _ = run("capture", plan, "-o", log, *ALONE, "--truth", exact)
    assert status == 0
    assert "4 of 4 traverses are done" in said
    assert run("check", log)[0] == 0
    plan.write_text(PLAN + "[noise]\nrepeatability_pct = 0\n")
    run("simulate", plan, "--law", exact, "-o", tmp_path / "simulated.csv")
    captured, simulated = read_log(log).usable, read_log(tmp_path / "simulated.csv").usable
    assert captured["steps"].tolist() == simulated["steps"].tolist()
    assert captured["session"].tolist() == simulated["session"].tolist()


def test_what_was_begun_is_not_begun_again_but_gone_on_with(run, refused, short, tmp_path):
    log = tmp_path / "log.csv"
    assert run("capture", short, "-o", log, *ALONE)[0] == 0
    assert "--resume" in refused("capture", short, "-o", log, *ALONE)
    before = log.read_bytes()
    assert run("capture", short, "-o", log, "--resume", *ALONE)[0] == 0
    assert log.read_bytes() == before


@pytest.mark.slow
def test_by_ear_the_stop_is_heard_within_two_checks(run, short, tmp_path):
    logs = {ear: tmp_path / f"{ear}.csv" for ear in ("sound", "perfect")}
    run("capture", short, "-o", logs["perfect"], *ALONE)
    status, said, _ = run("capture", short, "-o", logs["sound"], "--emulate", "--unattended")
    assert status == 0
    assert "can be distinguished well" in said
    sound, perfect = (read_log(path).usable["steps"] for path in logs.values())
    assert (sound - perfect).between(0, 10).all()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ((), "give --port"),
        (("--port", "COM1"), "give --tuning"),
        (("--by-count",), "give --law"),
        (("--emulate", "--port", "COM1"), "--port means nothing at an emulated rig"),
        (("--hide", "wear"), "--hide means nothing at a real rig"),
        (("--emulate", "--hide", "temperature"), "give one of thermal-warm-up"),
        (("--emulate", "--hide", "gremlins"), "give one of thermal-warm-up"),
        (("--emulate", "--hide", "end-stop-misfire"), "write it into a law file"),
        (("--resume", "--emulate", "--unattended"), "is not there; leave --resume out"),
    ],
)
def test_what_cannot_be_is_said_before_anything_moves(refused, plan, tmp_path, options, complaint):
    assert complaint in refused("capture", plan, "-o", tmp_path / "log.csv", *options)
    assert not (tmp_path / "log.csv.journal").exists()


def test_a_campaign_that_recorded_nothing_fails(run, plan, tmp_path, monkeypatch):
    for typed, complaint in (
        ("q\n", "no traverse was recorded; go on with --resume"),
        ("s\n" * 9, "no traverse was recorded; all are left out"),
        ("\n", "the standard input has ended"),
    ):
        log = tmp_path / f"{len(typed)}.csv"
        monkeypatch.setattr(sys, "stdin", StringIO(typed))
        status, _, said = run("capture", plan, "-o", log, "--emulate", "--ideal-detector")
        assert (status, said.count("\n")) == (2, 1)
        assert complaint in said
        assert not log.exists()


def test_what_was_recorded_before_is_no_failure(run, short, tmp_path, monkeypatch):
    log = tmp_path / "log.csv"
    assert run("capture", short, "-o", log, *ALONE)[0] == 0
    monkeypatch.setattr(sys, "stdin", StringIO(""))
    assert run("capture", short, "-o", log, "--resume", "--emulate", "--ideal-detector")[0] == 0


@pytest.mark.slow
def test_a_tuning_that_would_miss_the_stops_is_refused_before_anything_else(refused, plan, tmp_path):
    tuning, log = tmp_path / "tuning.json", tmp_path / "log.csv"
    save_tuning(tuned(Acoustics(-6.0)), tuning)
    of_rig = ("--port", "/dev/nothing", "--tuning", tuning)
    for command in (("capture", plan, "-o", log, *of_rig), ("capture", "listen", plan, "--tuning", tuning)):
        assert re.search(
            r"tuning\.json: stops would not be detected.* tune again with `capture tune`", refused(*command)
        )
    assert not log.with_name("log.csv.journal").exists()
    assert "stops would not be detected" in refused(
        "capture", plan, "-o", log, "--emulate", "--unattended", "--snr=-6"
    )


def test_tuning_at_a_rig_takes_a_terminal(refused, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", StringIO("\n" * 9))
    assert "tune at a terminal" in refused(
        "capture", "tune", "-o", tmp_path / "ear.json", "--port", "/dev/nothing"
    )


def test_conditions_given_beforehand_are_in_the_log(run, short, tmp_path):
    log = tmp_path / "log.csv"
    assert run("capture", short, "-o", log, *ALONE, "--condition", "temperature_C=22.5")[0] == 0
    assert (read_log(log).rows["temperature"] == 295.65).all()
    status, _, said = run(
        "capture", short, "-o", tmp_path / "b.csv", *ALONE, "--condition", "temperature=22.5"
    )
    assert (status, "has no unit" in said) == (2, True)


@pytest.fixture
def recordings(tmp_path):
    """A joint that moves, one at its stop, and a traverse that meets its stop at check 61."""
    pytest.importorskip("soundfile", reason="soundfile is not installed")
    day = Acoustics(snr_db=6.0)
    sounds = {
        "moving.wav": steps(day, 60, False, 1),
        "at_stop.wav": steps(day, 60, True, 2),
        "traverse.wav": np.concatenate([steps(day, 60, False, 3), steps(day, 5, True, 4, 60 * SECONDS)]),
    }
    for name, sound in sounds.items():
        write_wav(tmp_path / name, sound, day.rate)
    return tmp_path


@pytest.mark.slow
def test_an_ear_is_tuned_by_recordings_and_hears_the_stop_in_another(run, recordings):
    tuning, chart = recordings / "ear.json", recordings / "ear.png"
    of = ("--moving", recordings / "moving.wav", "--at-stop", recordings / "at_stop.wav")
    status, said, _ = run("capture", "tune", "-o", tuning, *of, "--chart", chart)
    assert status == 0
    assert "Listen at 6,0" in said
    assert chart.read_bytes().startswith(b"\x89PNG")
    _, heard, _ = run("capture", "listen", recordings / "traverse.wav", "--tuning", tuning)
    assert "(check 62 of 65)" in heard
    assert "a count of 305 steps" in heard
    _, silence, _ = run("capture", "listen", recordings / "moving.wav", "--tuning", tuning)
    assert "no stop is heard in 3.0 s" in silence


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ((), "give --port; or recordings"),
        (("--moving", "a.wav"), "give --at-stop"),
        (("--moving", "a.wav", "--port", "COM1"), "--port means nothing beside recordings"),
        (("--emulate", "--moving", "a.wav"), "--moving means nothing at an emulated rig"),
        (("--moving", "a.wav", "--at-stop", "b.wav"), "there is no such file"),
    ],
)
def test_an_ear_cannot_be_tuned_by_nothing(refused, tmp_path, options, complaint):
    assert complaint in refused("capture", "tune", "-o", tmp_path / "ear.json", *options)
    assert not (tmp_path / "ear.json").exists()


@pytest.mark.slow
def test_tuning_at_an_emulated_rig(run, tmp_path):
    assert "distinguished well" in run("capture", "tune", "-o", tmp_path / "a.json", "--emulate")[1]
    assert "cannot be distinguished" in run(
        "capture", "tune", "-o", tmp_path / "b.json", "--emulate", "--snr", "-9"
    )[1].replace("\n", " ")
