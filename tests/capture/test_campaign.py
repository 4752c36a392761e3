"""A plan gone through at a rig whose truth is known, whatever happens on the way."""

import math
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import numpy as np
import pytest

from stickslip_fit.capture.campaign import begin_journal
from stickslip_fit.capture.operator import OperatorChoice, OperatorReply
from stickslip_fit.capture.protocols import ConnectionLost, ControllerError
from stickslip_fit.errors import InputError
from tests.capture.played import SHORT, STEP, Capture, Joints, Player, plan_of
from tests.capture.test_journal import disk_of

# Joint 3 is set by hand just before its stop, and then brought to that stop.
HAND = """
check_every = 1
[sessions]
dates = [2012-03-05]
[[sweep]]
joint = 2
q3_mm = [0.3, 0]
replicates = 3
"""
REPEAT, SKIP, QUIT = (
    OperatorReply(choice) for choice in (OperatorChoice.REPEAT, OperatorChoice.SKIP, OperatorChoice.QUIT)
)


@pytest.fixture(scope="module")
def memory(tmp_path_factory):
    """Where writing for good costs nothing, if there is such a place: it is done thousands of times here."""
    place = Path("/dev/shm")
    if not os.access(place, os.W_OK):
        yield tmp_path_factory.mktemp("capture")
        return
    with TemporaryDirectory(dir=place) as name:
        yield Path(name)


@pytest.fixture
def folder(memory):
    return Path(mkdtemp(dir=memory))


@pytest.fixture
def short(folder):
    return Capture(folder, plan_of(folder, SHORT))


class Watched(Joints):
    """Remembers how far a joint was ever driven against a stop."""

    longest = 0

    def step(self, joint, steps):
        super().step(joint, steps)
        self.longest = max(self.longest, self.against_stop)


@pytest.fixture(scope="module")
def captured(memory):
    """A whole campaign in which nothing goes wrong."""
    folder = Path(mkdtemp(dir=memory))
    capture = Capture(folder, plan_of(folder), Watched())
    assert capture.run()
    return capture


def true_count(row):
    """Steps of one size from stop to stop, seen at the next check."""
    steps = math.ceil(abs(row.stop - row.start) / STEP[row.joint, row.direction] - 1e-9)
    return math.ceil(steps / row.check_every) * row.check_every


def assert_whole(capture):
    """The log holds every traverse of the plan once, in its order, with its true count."""
    kept = capture.rows[capture.rows["status"] == "ok"].reset_index(drop=True)
    planned = capture.plan.rows()
    for name in ("session", "joint", "direction"):
        assert kept[name].astype(str).tolist() == planned[name].astype(str).tolist()
    for name in ("q1", "q2", "q3", "theta", "psi", "start", "stop"):
        np.testing.assert_array_equal(kept[name], planned[name])
    assert kept["steps"].tolist() == [true_count(row) for row in kept.itertuples()]


def test_every_traverse_is_made_once_from_stop_to_stop(captured):
    assert_whole(captured)
    assert not any(reading.deviation for reading in captured.player.told)
    assert not captured.player.troubles


def test_the_log_holds_every_step_that_a_joint_made(captured):
    assert captured.rows.groupby("joint")["steps"].sum().to_dict() == captured.joints.made


def test_with_a_good_ear_no_joint_is_driven_against_its_stop_for_longer_than_a_check(captured):
    assert captured.joints.longest < 5


def test_what_only_a_person_can_set_is_asked_for_when_it_changes(captured):
    asked = [(round(math.degrees(each.theta)), len(each.stops)) for each in captured.player.asked]
    visits = [(0, 0), (-90, 0), (0, 0), (-90, 0), (0, 0), (0, 1), (0, 0), (0, 1)]
    # The second session begins as the first ended with other stops, which is a change too.
    assert asked == visits * 2


def test_a_position_that_is_no_stop_is_reached_by_count_and_is_no_reading(captured):
    counted = captured.rows[captured.rows["note"].str.contains("by count")]
    assert (counted["status"] == "excluded").all()
    for row in counted.itertuples():
        reached = abs(row.stop - row.start) / STEP[row.joint, row.direction]
        assert row.steps == pytest.approx(reached, abs=0.5)
    assert abs(captured.joints.position[3] - 0.006) < STEP[3, "+"]


def test_without_counting_the_person_brings_joints_to_such_positions(short):
    short.count_predictor = None
    short.run()
    assert_whole(short)
    assert short.player.brought == [(1, 0.0), (2, -math.pi / 2)]


@pytest.mark.slow
def test_a_doubtful_reading_is_marked_and_made_again(short):
    short.predictor.off = 0.9
    short.answer(OperatorReply(), REPEAT, OperatorReply(OperatorChoice.REPEAT, "door slammed"))
    short.run()
    assert_whole(short)
    assert "11" in short.player.told[0].deviation
    doubted = short.rows[short.rows["note"].str.contains("made again")]
    assert doubted["status"].tolist() == ["excluded"] * 2
    assert doubted["note"].tolist() == ["doubted, and made again", "doubted, and made again; door slammed"]


def test_a_reading_left_out_is_not_made_again(short):
    short.answer(SKIP)
    assert short.run()
    kept = short.rows[short.rows["status"] == "ok"]
    assert len(kept) == len(short.plan.rows()) - 1
    assert len(short.player.told) == len(short.plan.rows())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "note"),
    [
        ("joint 1", "joint 1 brought to its stop at 120.00 deg; stopped by a key"),
        ("3 of", "stopped by a key"),
    ],
)
def test_a_key_breaks_a_drive_off_and_the_traverse_is_made_from_its_beginning(short, drive, note):
    short.player.key_at, short.player.key_in = 250, drive
    short.run()
    assert_whole(short)
    broken = short.rows[short.rows["status"] == "interrupted"]
    assert broken["steps"].tolist() == [250]
    assert broken["note"].tolist() == [note]
    assert short.joints.stopped == 1


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), InputError("the microphone is gone"), BrokenPipeError(32, "Broken pipe")]
)
def test_whatever_ends_it_in_mid_traverse_the_controller_is_stopped_and_the_log_says_so(short, error):
    class Ends(Player):
        def progress(self, drive, steps, detection):
            if drive.title.startswith("3 of") and steps == 100:
                raise error

    short.player = Ends(short.joints)
    with pytest.raises(type(error)):
        short.run()
    assert short.joints.stopped == 1
    assert short.rows["status"].iloc[-1] == "interrupted"
    assert short.rows["steps"].iloc[-1] == 100
    assert short.rows.groupby("joint")["steps"].sum().to_dict() == short.joints.made


@pytest.mark.slow
def test_quit_and_resumed_it_goes_on_with_the_next_traverse(short):
    short.answer(OperatorReply(), OperatorReply(), OperatorReply(OperatorChoice.QUIT, "lunch"))
    assert not short.run()
    assert (short.rows["status"] == "ok").sum() == 3
    assert short.rows["note"].iloc[-1] == "lunch"
    again = Capture(short.folder, short.plan)
    assert again.run(again=True)
    assert_whole(again)
    assert len(again.player.told) == len(short.plan.rows()) - 3
    assert again.rows["time"].is_monotonic_increasing


def test_a_joint_whose_stop_is_not_heard_is_driven_once_over_the_whole_way(short):
    short.joints.deaf = True
    with pytest.raises(InputError, match=r"no stop was heard within the limit of .* tune .* --resume"):
        short.run()
    assert not short.player.troubles
    row = short.rows.iloc[-1]
    assert row["status"] == "interrupted"
    least = abs(row["stop"] - row["start"]) / STEP[row["joint"], row["direction"]]
    assert row["steps"] <= 1.25 * (1.01 * least + 5) + 101
    assert short.joints.against_stop <= row["steps"]


class Deafened(Player):
    """Whose joints are no longer heard from the third traverse on."""

    def begin_drive(self, drive):
        super().begin_drive(drive)
        self.joints.deaf |= drive.title.startswith("3 of")


def test_a_traverse_whose_stop_is_not_heard_is_asked_about_and_no_stop_is_run_into_again(short):
    short.player = Deafened(short.joints)
    with pytest.raises(InputError, match="no stop was heard"):
        short.run()
    assert len(short.player.troubles) == 1
    traverse, back_off, home = short.rows["steps"].tolist()[-3:]
    assert back_off == 200
    assert max(traverse, home) <= 1.25 * (1.01 * 0.012 / STEP[3, "-"] + 5) + 101


def test_without_a_law_a_drive_is_limited_by_the_readings_before_it(short):
    short.predictor = short.count_predictor = None
    short.player = Deafened(short.joints)
    with pytest.raises(InputError, match="no stop was heard"):
        short.run()
    (reading,) = short.rows[short.rows["direction"].eq("-") & short.rows["status"].eq("ok")]["steps"]
    assert short.rows["steps"].max() <= 6 * reading + 100


@pytest.mark.slow
def test_a_planned_warm_up_drive_is_made_once_and_logged_as_excluded(folder):
    warm_up = (
        HAND.replace("replicates = 3", 'replicates = 1\nstatus = "excluded"')
        + "[[sweep]]"
        + (HAND.partition("[[sweep]]")[2])
    )
    capture = Capture(folder, plan_of(folder, warm_up))
    assert capture.run()
    planned = capture.plan.rows()
    assert (capture.rows["status"] == "ok").sum() == (planned["status"] == "ok").sum() == 12
    logged = capture.rows[capture.rows["status"] == "excluded"]
    assert (abs(logged["stop"] - logged["start"]) > 1.0).sum() >= 4


@pytest.mark.slow
def test_a_joint_that_was_set_by_hand_is_driven_as_far_as_it_may_stand_away(folder):
    class Misplaced(Player):
        def bring_joint(self, joint, position):
            reply = super().bring_joint(joint, position)
            self.joints.position[joint] += 0.0012 if joint == 3 else 0.0
            return reply

    capture = Capture(folder, plan_of(folder, HAND), count_predictor=None)
    capture.player = Misplaced(capture.joints)
    assert capture.run()
    assert_whole(capture)
    assert capture.rows["start"].eq(0.0003).any()


def test_a_controller_that_hangs_is_stopped_by_the_clock(short):
    class Slow(Joints):
        def step(self, joint, steps):
            self.clock.sleep(20.0)
            super().step(joint, steps)

    short.joints = Slow()
    short.__post_init__()
    short.answer(QUIT)
    short.run()
    assert "s (" in short.player.troubles[0]


def test_a_fault_of_the_detector_ends_the_drive(short):
    short.joints.fault = "the microphone is dead: plug it in"
    short.answer(QUIT)
    short.run()
    assert short.player.troubles == ["the microphone is dead: plug it in"]
    assert short.rows["steps"].tolist() == [5]
    assert short.rows["status"].tolist() == ["interrupted"]


@pytest.mark.slow
@pytest.mark.parametrize("commands", [1, *(pytest.param(n, marks=pytest.mark.nightly) for n in (2, 30)), 501])
def test_unplugged_in_mid_move_it_says_so_and_goes_on_later(short, commands):
    class Frail(Joints):
        left = commands

        def step(self, joint, steps):
            self.left -= 1
            if self.left == 0:
                raise ConnectionLost(f"joint {joint}: the connection is lost")
            super().step(joint, steps)

    short.joints = Frail()
    short.__post_init__()
    with pytest.raises(ConnectionLost, match="lost; see to the controller, then go on with --resume"):
        short.run()
    driven = sum(short.joints.made.values())
    assert driven <= short.rows["steps"].sum() <= driven + 5
    assert short.rows["status"].iloc[-1] == "interrupted"
    again = Capture(short.folder, short.plan)
    assert again.run(again=True)
    assert_whole(again)


@pytest.mark.slow
def test_what_the_controller_refuses_is_told_and_tried_again(short):
    class Moody(Joints):
        moods = iter([None] * 10 + [ControllerError("joint 1: piezo voltage breakdown")])

        def step(self, joint, steps):
            if error := next(self.moods, None):
                raise error
            super().step(joint, steps)

    short.joints = Moody()
    short.__post_init__()
    assert short.run()
    assert short.player.troubles == ["joint 1: piezo voltage breakdown"]
    assert_whole(short)


@pytest.mark.slow
@pytest.mark.parametrize("size", [100, 10_000, pytest.param(20_000, marks=pytest.mark.nightly)])
def test_on_a_full_disk_nothing_acknowledged_is_lost(short, size):
    with disk_of(size), pytest.raises(InputError, match="make room"):
        short.run()
    shown = [reading.steps for reading in short.player.told]
    again = Capture(short.folder, short.plan)
    assert again.run(again=True)
    assert_whole(again)
    kept = again.rows[again.rows["status"] == "ok"]["steps"].tolist()
    assert kept[: len(shown)] == shown
    assert len(again.player.told) == len(kept) - len(shown)


def test_another_plan_cannot_go_on_with_a_journal(short):
    short.answer(QUIT)
    short.run()
    other = Capture(short.folder, plan_of(short.folder, SHORT.replace("= 2", "= 3")))
    with pytest.raises(InputError, match="begun with another plan"):
        other.run(again=True)


def test_a_log_that_was_not_captured_is_not_written_over(short):
    short.log.write_text("session\n")
    with pytest.raises(InputError, match="would be written over"):
        short.run()


def test_a_journal_left_by_a_capture_that_never_began_is_in_nobodys_way(short):
    begin_journal(short.log)[0].close()
    assert short.run()
    assert_whole(short)


@pytest.mark.slow
def test_a_log_changed_by_hand_is_put_aside_before_it_is_written_again(short):
    short.answer(OperatorReply(), QUIT)
    short.run()
    written = short.log.read_text()
    short.log.write_text(written + "by hand\n")
    again = Capture(short.folder, short.plan)
    assert again.run(again=True)
    assert_whole(again)
    aside = short.log.with_name("log.csv.edited-1")
    assert aside.read_text() == written + "by hand\n"
    assert Capture(short.folder, short.plan).run(again=True)
    assert not short.log.with_name("log.csv.edited-2").exists()


@pytest.mark.slow
def test_conditions_stand_in_the_log_from_the_moment_they_are_said_to_the_end_of_the_session(folder):
    capture = Capture(folder, plan_of(folder, SHORT.replace("03-05]", "03-05, 2012-03-06]")))
    capture.conditions = {"supply": 80.0}
    warm = OperatorReply(conditions={"temperature": 295.65, "covariate:pressure_hPa": 1013.0})
    odd = OperatorReply(conditions={"temperature": 297.15})
    capture.predictor.off = 0.9
    capture.answer(OperatorReply(), warm, OperatorReply(), odd)
    capture.run()
    assert_whole(capture)
    kept = capture.rows[capture.rows["status"] == "ok"]
    first, second = (rows for _, rows in kept.groupby("session"))
    assert first["temperature"].tolist()[2:] == [295.65] * 2 + [297.15] * (len(first) - 4)
    assert first["temperature"].isna().tolist()[:2] == [True, True]
    assert first["covariate:pressure_hPa"].tolist()[2:] == [1013.0] * (len(first) - 2)
    assert second["temperature"].isna().all()
    assert (kept["supply"] == 80.0).all()


@pytest.mark.slow
def test_a_log_that_another_program_writes_meanwhile_is_kept(short):
    class Meanwhile(Player):
        def review(self, reading):
            if len(self.told) == 1:
                short.log.write_text("another campaign\n")
            return super().review(reading)

    short.player = Meanwhile(short.joints)
    assert short.run()
    assert_whole(short)
    assert short.log.with_name("log.csv.edited-1").read_text() == "another campaign\n"


def test_a_file_beside_the_log_that_is_no_journal_is_left_alone(short):
    other = short.log.with_name("log.csv.journal")
    for content in ("12 readings of last week", "0123abcd a letter", "one line\nanother"):
        other.write_text(content)
        for again in (False, True):
            with pytest.raises(InputError, match=r"log\.csv\.journal, line 1: does not agree"):
                short.run(again)
        assert other.read_text() == content


def test_two_captures_at_once_are_refused(short):
    with begin_journal(short.log)[0], pytest.raises(InputError, match="being written by another program"):
        short.run(again=True)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork a capture that is killed")
@pytest.mark.parametrize(("kills", "seed"), [(2, 1), pytest.param(200, 2, marks=pytest.mark.nightly)])
def test_killed_at_random_moments_it_loses_nothing(folder, kills, seed):
    program = [sys.executable, "-m", "tests.capture.killed", folder, str(kills), str(seed)]
    root = Path(__file__).parents[2]
    found = subprocess.run(program, cwd=root, capture_output=True, text=True, timeout=550, check=False)
    assert found.returncode == 0, found.stderr
    capture = Capture(folder, plan_of(folder, SHORT))
    assert_whole(capture)
    rows = capture.rows
    interrupted = rows[rows["status"] == "interrupted"]
    assert interrupted["steps"].tolist() == [int(steps) for steps in found.stdout.split()]
    assert interrupted["note"].eq("the capture ended in mid-traverse").all()
