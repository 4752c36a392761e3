"""A capture on a page: what it shows is what the operator saw, and it decides nothing."""

import json
import re
import subprocess
import sys
import time
from urllib.request import Request, urlopen

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.capture.operator import (
    ExpectedCount,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
)
from stickslip_fit.capture.protocols import Detection, PacedClock
from stickslip_fit.drive.live_capture import (
    MAX_LEVELS,
    CapturePage,
    LiveOperator,
    compare_reading,
    serve_capture_page,
)
from stickslip_fit.logs import read_log
from tests.drive.test_page import JSON, own, request, stream

ROW = {"joint": 3, "direction": "-", "start": 0.012, "stop": 0.0, "check_every": 5, "step_period": 0.01}
PLAN = """
name = "Short"
check_every = 5
[sessions]
dates = [2012-03-05]
[[sweep]]
joint = 3
q2_deg = -90
ranges_mm = [[2, 2.4]]
"""


def drive(expected=ExpectedCount(12300.0, 12230.0, 12370.0), title="3 of 24: arm level", **changes):  # noqa: B008
    return PlannedDrive(pd.Series(ROW | changes), title, expected)


class Recorder:
    """An operator who notes what is asked, looks at the page meanwhile, and answers as told."""

    def __init__(self, page: CapturePage) -> None:
        self.page = page
        self.asked: list[tuple[object, ...]] = []
        self.seen: list[str] = []
        self.reply = OperatorReply(OperatorChoice.GO_ON, "a note", {"temperature": 300.0})

    def __getattr__(self, name):
        def answer(*given):
            self.asked.append((name, *given))
            self.seen.append(self.page.content("")["question"])
            return name == "stop_wanted" or (
                self.reply if name not in ("show", "begin_drive", "progress") else None
            )

        return answer


@pytest.fixture
def page():
    return CapturePage()


@pytest.fixture
def recorder(page):
    return Recorder(page)


@pytest.fixture
def operator(page, recorder):
    return LiveOperator(recorder, page)


def reading(steps=12400, deviation="", **changes):
    return TraverseReading(drive(**changes), steps, 0.012 / steps, deviation)


def test_everything_is_passed_on_and_every_answer_comes_back(operator, recorder):
    begun, done, detection = drive(), reading(), Detection(False, 0.3)
    setting = RigSetting(0.5, 0.0)
    for name, given in (
        ("begin_session", ("2012-03-05",)),
        ("set_up", (setting, None)),
        ("bring_joint", (2, -1.0)),
        ("review", (done,)),
        ("handle_failure", (begun, "no stop was heard")),
    ):
        assert getattr(operator, name)(*given) is recorder.reply
        assert recorder.asked[-1] == (name, *given)
    operator.show("text")
    operator.begin_drive(begun)
    operator.progress(begun, 5, detection)
    assert operator.stop_wanted() is True
    assert recorder.asked[-4:] == [
        ("show", "text"),
        ("begin_drive", begun),
        ("progress", begun, 5, detection),
        ("stop_wanted",),
    ]


def test_a_question_is_on_the_page_while_it_is_asked(operator, recorder, page):
    operator.set_up(RigSetting(np.radians(-45.0), 0.0), RigSetting(0.0, 0.0))
    operator.bring_joint(2, np.radians(-90.0))
    operator.review(reading(13000, "5.7 % more steps than predicted (12,300)"))
    assert recorder.seen == [
        "Set theta to −45.0 deg.",
        "Bring joint 2 to −90.00 deg by hand.",
        "Doubtful: 5.7 % more steps than predicted (12,300)",
    ]
    assert page.content("")["question"] == ""


def test_a_question_that_ends_in_an_error_is_not_left_on_the_page(page):
    class Gone(Recorder):
        def set_up(self, wanted, before):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        LiveOperator(Gone(page), page).set_up(RigSetting(0.0, 0.0), None)
    assert page.content("")["question"] == ""


def test_the_count_stands_beside_its_prediction(operator, page):
    operator.begin_drive(drive())
    operator.progress(drive(), 8245, Detection(False, 0.4))
    shown = page.content("")["drive"]
    assert shown["title"] == "3 of 24: arm level (3−)"
    assert shown["count"] == "8,245"
    assert shown["about"] == "of about 12,300 (12,230 to 12,370 in 95 %)"
    operator.begin_drive(drive(ExpectedCount()))
    assert page.content("")["drive"]["about"] == ""
    assert page.content("")["drive"]["steps"] == 0


def test_the_sound_level_goes_on_from_drive_to_drive(operator, page):
    for _ in range(2):
        operator.begin_drive(drive())
        for steps in (5, 10, 15):
            operator.progress(drive(), steps, Detection(steps == 15, 20.0 if steps == 15 else np.nan))
    levels = page.content("")["levels"]
    assert [moved for moved, _, _ in levels] == pytest.approx([0.05, 0.1, 0.15, 0.2, 0.25, 0.3])
    assert [stop for _, _, stop in levels] == [False, False, True] * 2
    for steps in range(MAX_LEVELS + 10):
        operator.progress(drive(), steps, Detection(False, 0.0))
    assert len(page.content("")["levels"]) == MAX_LEVELS


def test_a_residual_is_the_count_between_two_checks_over_its_prediction():
    """By hand: 12,400 steps, checked every 5, are 12,397.5; the ends are those of the prediction."""
    point = compare_reading(reading())
    assert point.residual == pytest.approx(12397.5 / 12300 - 1)
    assert (point.low, point.high) == pytest.approx((12397.5 / 12370 - 1, 12397.5 / 12230 - 1))
    assert point.low < point.residual < point.high
    assert compare_reading(reading(check_every=1)).residual == pytest.approx(100 / 12300)
    assert np.isnan(compare_reading(reading(expected=ExpectedCount())).residual)
    alone = compare_reading(reading(expected=ExpectedCount(12300.0)))
    assert np.isnan([alone.low, alone.high]).all()


@pytest.mark.parametrize("choice", OperatorChoice)
def test_what_the_operator_leaves_out_is_marked(operator, recorder, page, choice):
    recorder.reply = OperatorReply(choice)
    operator.begin_session("one")
    operator.review(reading(deviation="far off"))
    (point,) = page.content("")["residuals"]
    assert point["doubtful"]
    assert point["kept"] == (choice in (OperatorChoice.GO_ON, OperatorChoice.QUIT))
    operator.begin_session("two")
    assert page.content("")["residuals"] == []


def test_the_page_takes_no_message_and_no_stranger():
    with serve_capture_page("plan") as page:
        answer = request(page, "POST", "messages", headers=JSON, origin=own(page), body=b"{}")
        assert (answer[0], b"does not control" in answer[2]) == (403, True)
        assert request(page, origin="http://evil.example")[0] == 403
        assert request(page)[0] == 200
        page.say("heard")
        with stream(page) as one, stream(page) as two:
            assert one.event()["messages"] == two.event()["messages"] == ["heard"]


def test_a_clock_with_a_pace_is_so_much_faster_and_sleeps_no_night():
    clock = PacedClock(20.0)
    began = time.monotonic()
    clock.sleep(1.0)
    clock.sleep(-5.0)
    assert clock.now() == 1.0
    assert 0.05 <= time.monotonic() - began < 0.5
    clock.sleep(43_200.0)
    assert time.monotonic() - began < 2.0
    assert clock.now() == 43_201.0


def test_an_emulated_capture_is_on_its_page_from_the_first_step_to_the_last(tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    command = ["capture", "plan.toml", "-o", "log.csv", "--emulate", "--ideal-detector", "--unattended"]
    command += ["--page", "--pace", "10"]
    program = [sys.executable, "-m", "stickslip_fit", *command]
    with subprocess.Popen(program, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        address = re.fullmatch(r"page: (http://127\.0\.0\.1:\d+/[\w-]+/)\n", process.stdout.readline())[1]
        with urlopen(Request(f"{address}events"), timeout=20) as answer:
            lines = [json.loads(line.removeprefix(b"data: ")) for line in answer if line.startswith(b"data")]
        assert process.wait(20) == 0
    log = read_log(tmp_path / "log.csv")
    assert lines[-1]["ended"]
    residuals = lines[-1]["residuals"]
    assert [f"{steps:,} steps" for steps in log.usable["steps"]] == [
        point["text"].partition(", ")[0] for point in residuals
    ]
    steps = [line["drive"]["steps"] for line in lines if line.get("drive")]
    assert len(set(steps)) > 5
    assert max(abs(point["residual"]) for point in residuals) < 0.1


def test_a_port_of_no_page_is_refused(run, tmp_path):
    (tmp_path / "plan.toml").write_text(PLAN)
    command = ("capture", tmp_path / "plan.toml", "-o", tmp_path / "log.csv", "--emulate")
    assert run(*command, "--page-port", "8000")[0] == 2
    status, _, complaint = run("capture", tmp_path / "plan.toml", "-o", tmp_path / "log.csv", "--pace", "10")
    assert (status, "--pace means nothing at a real rig" in complaint) == (2, True)
