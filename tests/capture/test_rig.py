"""A rig in a process of its own, driven over its port and heard by its sound, until it is unplugged."""

import math
from contextlib import contextmanager
from pathlib import Path

import pytest

from stickslip_fit.capture.campaign import Campaign, begin_journal, resume_journal
from stickslip_fit.capture.devices import open_controller
from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.campaign import tune_emulated
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import emulate_rig
from stickslip_fit.capture.end_stop import SequentialDetector
from stickslip_fit.capture.operator import OperatorReply
from stickslip_fit.capture.protocols import ConnectionLost, RealClock
from stickslip_fit.capture.rigs import tune_by_hand
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log
from stickslip_fit.simulation import read_law_values
from tests.capture.emulator_process import start_emulator
from tests.capture.played import MACHINE, Joints, Player, plan_of

LAW = Path(__file__).parents[2] / "data" / "reference" / "law.toml"
PERIOD_MS = 1
PLAN = f"""
check_every = 10
[sessions]
dates = [2012-03-05]
[timing]
step_period_ms = {PERIOD_MS}
[[sweep]]
joint = 3
q2_deg = -90
ranges_mm = [[0, 0.4]]
"""


class AtProcess(Player):
    """Sets the rig as asked, and pulls its plug once so many steps of a traverse were made."""

    def __init__(self, rig, pull_at=math.inf):
        super().__init__(Joints())
        self.rig = rig
        self.pull_at = pull_at

    def begin_session(self, label):
        self.rig.begin_session(label)
        return OperatorReply()

    def set_up(self, wanted, before):
        for stops in wanted.stops:
            self.rig.set_stops(*stops)
        return OperatorReply()

    def progress(self, drive, steps, detection):
        if drive.title.startswith("2 of 2") and steps >= self.pull_at:
            self.rig.close()


@contextmanager
def rig_at_work():
    """A rig in a process of its own, and its controller."""
    pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    options = ("--step-period-ms", str(PERIOD_MS), "--snr-db", "20", "--repeatability-pct", "0")
    with start_emulator(LAW, *options) as rig:
        controller = open_controller(rig.port, "new", pytest.fail, PERIOD_MS / 1000)
        yield rig, controller
        controller.close()


def capture(folder, journal, replay, rig, controller, tuning, pull_at=math.inf):
    """Capture the plan at a rig, which is unplugged at `pull_at`."""
    ear, operator = SequentialDetector(rig, tuning), AtProcess(rig, pull_at)
    where = (plan_of(folder, PLAN), MACHINE, folder / "log.csv", journal, replay)
    with journal:
        return Campaign(*where, Rig(controller, ear, RealClock()), operator).run()


@pytest.mark.nightly
def test_unplugged_in_mid_traverse_it_loses_nothing_and_goes_on_later(tmp_path):
    with rig_at_work() as (rig, controller):
        tuning = tune_emulated(controller, rig, RealClock(), 10)
        with pytest.raises(ConnectionLost, match="go on with --resume"):
            capture(tmp_path, *begin_journal(tmp_path / "log.csv"), rig, controller, tuning, pull_at=200)
    rows = read_log(tmp_path / "log.csv").rows
    first = rows[rows["status"] == "ok"]
    assert first["direction"].tolist() == ["+"]
    assert rows["status"].iloc[-1] == "interrupted"
    assert 200 < rows["steps"].iloc[-1] <= 220
    with rig_at_work() as (rig, controller):
        assert capture(tmp_path, *resume_journal(tmp_path / "log.csv"), rig, controller, tuning)
    rows = read_log(tmp_path / "log.csv").rows
    made = rows[rows["status"] == "ok"]
    assert made["direction"].tolist() == ["+", "-"]
    assert made["steps"].iloc[0] == first["steps"].iloc[0]
    # 0.4 mm in steps of 972 and 899 nm, within what days differ by, the stop heard a few checks late.
    assert 395 <= made["steps"].iloc[0] <= 460
    assert 425 <= made["steps"].iloc[1] <= 500


class ListeningOperator:
    """Keys of a person who hears the stop themselves."""

    def __init__(self, manipulator):
        self.manipulator = manipulator

    def key(self):
        self.manipulator.set(q3=0.003)

    def pressed(self):
        return self.manipulator.position(3) == 0.0


@pytest.mark.slow
def test_the_detector_is_tuned_with_a_person_who_hears_the_stop():
    emulator = emulate_rig(HiddenLaws(read_law_values(LAW, MACHINE), MACHINE))
    controller, source = emulator.controller(pytest.fail), emulator.microphone(Acoustics(9.0))
    keys = ListeningOperator(emulator.manipulator)
    tuning = tune_by_hand(controller, source, emulator.clock, 3, 5, keys, AtProcess(emulator.manipulator))
    assert tuning.separates
    assert abs(tuning.frequency - Acoustics().peak) < 1000


@pytest.mark.slow
def test_a_stop_that_nobody_hears_ends_the_tuning(monkeypatch):
    emulator = emulate_rig(HiddenLaws(read_law_values(LAW, MACHINE), MACHINE))
    controller, source = emulator.controller(pytest.fail), emulator.microphone(Acoustics(9.0))
    keys = ListeningOperator(emulator.manipulator)
    monkeypatch.setattr(keys, "pressed", lambda: False)
    with pytest.raises(InputError, match="nobody said that the joint has met its stop"):
        tune_by_hand(controller, source, emulator.clock, 3, 5, keys, AtProcess(emulator.manipulator))
