"""What a journal says of a drive that was broken off."""

import json
import subprocess
import sys
from zlib import crc32

import pytest

from stickslip_fit.capture.journal import read_journal
from stickslip_fit.drive.diffusion import Burst
from stickslip_fit.drive.record import DriveReplay, begin_record, resume_record
from stickslip_fit.errors import InputError
from stickslip_fit.moves import DriveReckoning, calibrated_arm
from stickslip_fit.units import Z_95

START = [0.2, -1.3, 0.006]


def drive_on(record, drive, bursts, seconds=0.0):
    for number, (joint, way, steps) in enumerate(bursts):
        moment = seconds + 0.01 * number
        record.burst(Burst(joint, way, steps), drive, moment)
        drive.advance(joint, way, steps, moment)


MOVES = [(3, "+", 2), (1, "-", 1), (3, "+", 1), (2, "+", 3), (3, "-", 1)] * 60


@pytest.fixture
def journal(tmp_path):
    return tmp_path / "drive.journal"


def test_a_drive_goes_on_where_it_was_broken_off(arm, journal):
    drive = DriveReckoning(arm, START)
    with_rest = begin_record(journal, drive)
    drive_on(with_rest, drive, MOVES)
    with_rest.rest(drive, 4.0)
    drive_on(with_rest, drive, MOVES[:50], 4.0)
    with_rest.close()
    record, again = resume_record(journal, arm)
    record.close()
    assert record.seconds == pytest.approx(4.49, abs=0.5)
    assert record.steps == [-60 - 10, 3 * 60 + 30, 2 * 60 + 20]
    last = drive.step_size(3, "-", 5.0)
    assert again.q[:2] == pytest.approx(drive.q[:2], abs=2e-8)
    assert again.q[2] == pytest.approx(drive.q[2] + last / 2, abs=1e-9)
    assert again.variance(1) == pytest.approx(drive.variance(1), rel=1e-4)
    assert again.variance(3) == pytest.approx(drive.variance(3) + last**2 / 4, rel=1e-4)
    assert Z_95 * again.q_error[2] > last / 2


def test_after_a_rest_nothing_is_in_doubt(arm, journal):
    drive = DriveReckoning(arm, START)
    record = begin_record(journal, drive)
    drive_on(record, drive, MOVES)
    record.rest(drive, 4.0)
    record.close()
    record, again = resume_record(journal, arm)
    record.close()
    assert again.snapshot() == drive.snapshot()
    with pytest.raises(InputError, match="was begun earlier"):
        begin_record(journal, drive)


def test_a_long_motion_is_kept_short(arm, journal):
    drive = DriveReckoning(arm, START)
    record = begin_record(journal, drive)
    drive_on(record, drive, MOVES * 4)
    record.close()
    replay = DriveReplay()
    read_journal(journal, replay.apply)
    assert len(replay.bursts) < 500


def test_another_law_or_session_is_refused(arm, journal):
    begin_record(journal, DriveReckoning(arm, START)).close()
    with pytest.raises(InputError, match="another law or session"):
        resume_record(journal, calibrated_arm(arm.result, "2012-03-06"))
    with pytest.raises(InputError, match="another law or session"):
        resume_record(journal, calibrated_arm(arm.result, theta=0.1))
    resume_record(journal, arm)[0].close()


BEGUN = {"version": "", "time": "2026-01-01T00:00:00Z", "law": "a", "session": "x"}
SNAPSHOT = {"q": [0.0, -1.0, 0.0], "history": [["", 0.0, 0]] * 3, "sums": {}}
SNAPSHOT |= {"variance": [0.0, 0.0, 0.0], "doubt": [0.0, 0.0, 0.0]}


def test_the_journals_of_these_tests_are_whole_otherwise(journal):
    journal.write_bytes(record_of({"number": 0, "event": "begun", **BEGUN, "snapshot": SNAPSHOT}))
    assert read_journal(journal, DriveReplay().apply).count == 1


def record_of(event):
    text = json.dumps(event).encode()
    return b"%08x %s\n" % (crc32(text, 0), text)


@pytest.mark.parametrize(
    "event",
    [
        {"number": 0, "event": "drive", "row": {}},
        {"number": 0, "event": "burst", "joint": 1, "steps": 5, "seconds": 0.0},
        {"number": 0, "event": "begun", **BEGUN, "snapshot": {}},
        {"number": 0, "event": "begun", **BEGUN, "time": "yesterday", "snapshot": SNAPSHOT},
        {"number": 0, "event": "begun", **BEGUN, "snapshot": SNAPSHOT | {"q": [0.0, 1.0]}},
        {"number": 0, "event": "rest", "seconds": 1.0, "steps": [0, 0, 0], "snapshot": SNAPSHOT},
    ],
)
def test_a_journal_that_no_drive_writes_is_refused_with_its_line(arm, journal, event):
    journal.write_bytes(record_of(event))
    with pytest.raises(InputError, match=r"line 1: holds an event that no capture writes"):
        resume_record(journal, arm)


@pytest.mark.parametrize("steps", [0, 1.5, True, 10**6])
def test_a_burst_of_no_whole_steps_is_refused(arm, journal, steps):
    drive = DriveReckoning(arm, START)
    record = begin_record(journal, drive)
    assert record.journal is not None
    record.journal.append({"event": "burst", "joint": 1, "steps": steps, "seconds": 0.0})
    record.close()
    with pytest.raises(InputError, match="line 2"):
        resume_record(journal, arm)


def test_what_is_not_there_or_empty_cannot_be_resumed(arm, journal):
    with pytest.raises(InputError, match="is not there"):
        resume_record(journal, arm)
    journal.touch()
    with pytest.raises(InputError, match="is empty"):
        resume_record(journal, arm)
    begin_record(journal, DriveReckoning(arm, START)).close()
    resume_record(journal, arm)[0].close()


@pytest.mark.parametrize("kills", [3, pytest.param(50, marks=pytest.mark.nightly)])
def test_killed_at_random_the_joints_are_where_the_journal_says(tmp_path, kills):
    program = [sys.executable, "-m", "tests.drive.killed", str(tmp_path), str(kills), "5"]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    bursts, moved = ([int(word) for word in line.split()] for line in done.stdout.splitlines())
    assert sum(number > 0 for number in bursts) >= kills // 3
    assert max(moved) > 5
