"""Going home, at the emulated rig: the end of a joint's uncertainty, and a row of a log."""

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import emulate_rig
from stickslip_fit.capture.journal import read_journal
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.drive.diffusion import Burst
from stickslip_fit.drive.emulated import draw_laws
from stickslip_fit.drive.homing import HomingLog, StopFinder
from stickslip_fit.drive.loop import DriveLoop
from stickslip_fit.drive.record import DriveReplay, begin_record
from stickslip_fit.drive.state import VelocityInput
from stickslip_fit.logs import read_log
from stickslip_fit.logs.plan import Noise
from stickslip_fit.moves import DriveReckoning
from stickslip_fit.units import Z_95
from tests.drive.rig import Hand, Shown, joint
from tests.drive.test_loop import drive_of

REPEATABILITY = Noise({(number, way): 0.0027 for number in (1, 2, 3) for way in "+-"})


class Bench:
    """A drive at an emulated rig that ends where its joints truly are known."""

    def __init__(self, arm, tmp_path, wishes, start, interrupted=lambda: False):
        laws = draw_laws(arm, np.random.default_rng(4))
        self.rig = emulate_rig(HiddenLaws(laws, arm.machine, REPEATABILITY, seed=4))
        self.rig.manipulator.set(**{f"q{number + 1}": start[number] for number in range(3)})
        self.rig.manipulator.begin_session(arm.session)
        self.rig.manipulator.begin_drive()
        self.drive, self.journal = DriveReckoning(arm, start), tmp_path / "drive.journal"
        record = begin_record(self.journal, self.drive)
        controller, clock = self.rig.controller(print), self.rig.clock
        self.hand, self.shown = Hand(wishes, lag=0.05), Shown()
        self.loop = DriveLoop(self.drive, controller, clock, self.hand, self.shown, record, 1.0)
        self.log = tmp_path / "homing.csv"
        self.loop.homing = StopFinder(
            drive=self.drive,
            rig=Rig(controller, self.rig.ideal_detector(), clock),
            record=record,
            log=HomingLog(self.log, arm.machine),
            seconds=lambda: self.loop.seconds,
            interrupted=interrupted,
            progress=self.loop.show,
            step_period=0.01,
        )
        self.state = self.loop.run()
        record.close()
        self.true = np.array([self.rig.manipulator.position(number) for number in (1, 2, 3)])


@pytest.fixture
def bench(arm, tmp_path):
    def run(wishes, start, **options):
        return Bench(arm, tmp_path, wishes, start, **options)

    return run


class Once:
    """Asks for a joint to go home at a moment, once."""

    def __init__(self, number, at, then):
        self.number, self.at, self.then, self.asked = number, at, then, False

    def read(self, now):
        if now >= self.at and not self.asked:
            self.asked = True
            return VelocityInput(home=self.number, valid_until=now + 0.05)
        return self.then(now, self.asked)


def away_and_home(rate, seconds, number=3):
    """Moves a joint by hand, brings it home, and ends."""

    def then(now, asked):
        if asked or now >= seconds + 0.5:
            return VelocityInput(ends=asked)
        return VelocityInput(**joint(number, rate), valid_until=min(now + 0.05, seconds))

    return Once(number, seconds, then)


def run_with(monkeypatch, device):
    monkeypatch.setattr("tests.drive.test_homing.Hand", lambda wishes, lag: device)


def test_a_stop_ends_the_uncertainty_and_the_row_is_excluded(bench, monkeypatch):
    run_with(monkeypatch, away_and_home(60e-6, 3.0))
    found = bench([], [0.2, -1.2, 0.0005])
    assert found.state.q[2] == found.true[2] == 0.0
    assert found.state.q_error[2] == 0.0
    assert found.state.steps[2] < 0
    row = read_log(found.log).rows.iloc[0]
    assert (row["joint"], row["direction"], row["status"]) == (3, "-", "excluded")
    note = str(row["note"])
    assert note.startswith("brought home from an estimated start, ± ")
    assert row["steps"] % 5 == 0
    assert row["start"] == pytest.approx(0.0005 + 3 * 60e-6, abs=3e-6)
    assert "homing" in {state.status for state in found.shown.states}
    replay = DriveReplay()
    read_journal(found.journal, replay.apply)
    assert replay.restore(found.drive.arm).q == pytest.approx(list(found.state.q), abs=1e-9)


def go_by_hand(found, number, steps):
    """What the loop does for each burst."""
    for _ in range(steps // 10):
        seconds = found.loop.seconds
        found.loop.record.burst(Burst(number, "+", 10), found.drive, seconds)
        found.drive.advance(number, "+", 10, seconds)
        found.loop.controller.step(number, 10)


@pytest.mark.slow
@pytest.mark.parametrize("spoilt", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_all_the_way_from_the_other_stop_is_a_reading(bench, monkeypatch, arm, spoilt):
    """By hand past the middle, then home to the far stop: a count, unless another joint moved meanwhile."""
    found = bench([], [0.2, -1.2, 0.0])
    found.loop.record.journal = None
    go_by_hand(found, 3, 3000)
    if spoilt:
        go_by_hand(found, 1, 10)
    go_by_hand(found, 3, 6010)
    found.loop.homing(3)
    assert found.rig.manipulator.position(3) == pytest.approx(0.012)
    row = read_log(found.log).rows.iloc[0]
    assert (row["direction"], row["check_every"], row["steps"] % 5) == ("+", 5, 0)
    if spoilt:
        assert row["status"] == "excluded"
        return
    assert row["status"] == "ok"
    assert (row["start"], row["stop"]) == pytest.approx((0.0, 0.012))
    law, values, _, _ = arm.law(3, "+")
    expected = law.counts(arm.drive_row(np.array([0.2, -1.2, 0.0]), 3, 0.012), values)[0][0]
    assert row["steps"] == pytest.approx(expected, rel=5 * 0.0027)
    assert row["steps"] == found.loop.record.steps[2]


def test_a_key_stops_a_going_home_and_the_position_stays_known(bench, monkeypatch):
    calls = []
    run_with(monkeypatch, away_and_home(60e-6, 3.0))
    found = bench([], [0.2, -1.2, 0.003], interrupted=lambda: bool(calls.append(1)) or len(calls) > 40)
    assert "stopped by a key" in found.shown.states[-1].message
    row = pd.read_csv(found.log).iloc[0]
    assert (row["status"], row["check_every"], row["steps"]) == ("interrupted", 1, 200)
    off = np.abs(found.true - found.state.q)
    assert np.all(off <= Z_95 * 1.5 * found.state.q_error)
    assert found.state.q_error[2] > 0


def test_a_joint_at_its_stop_stays_there(bench, monkeypatch):
    run_with(monkeypatch, away_and_home(60e-6, 0.0))
    found = bench([], [0.2, -1.2, 0.0])
    assert found.state.steps == (0, 0, 0)
    assert found.state.message == "joint 3 is at its stop already"
    assert not found.log.exists()


def test_without_a_microphone_nothing_goes_home(arm):
    loop, controller, _ = drive_of(arm, [(0.5, {"home": 3})])
    state = loop.run()
    assert not controller.made
    assert "--tuning" in state.message
