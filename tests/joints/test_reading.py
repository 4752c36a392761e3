"""Logs of machines other than the published arm: columns, faults, missing times and orientation."""

import re

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.errors import InputError
from stickslip_fit.logs import write_log as write
from tests.joints.generated import MACHINES, machine_text, write_log

HISTORY = ["session_seconds", "before_direction", "before_load", "steps_before"]


@pytest.fixture
def named(machine_of):
    return lambda name: machine_of(machine_text(MACHINES[name]))


@pytest.fixture
def read(tmp_path, named):
    def from_text(text, name):
        path = tmp_path / "day.csv"
        path.write_text(text, encoding="utf-8")
        return ssf.read_log(path, machine=named(name))

    return from_text


def issues(read, text, name):
    with pytest.raises(InputError) as error:
        read(text, name)
    return [(problem.column, problem.line, problem.message) for problem in error.value.problems]


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("name", MACHINES)
def test_what_is_read_is_written_and_read_again(tmp_path, named, name, timed):
    machine = named(name)
    write_log(tmp_path / "log.csv", MACHINES[name], timed=timed)
    log = ssf.read_log(tmp_path / "log.csv", machine=machine)
    joints = [f"q{joint}" for joint in machine.joints]
    assert [column for column in log.rows if re.fullmatch(r"q\d+", column)] == joints
    assert log.rows[["theta", "psi"]].isna().all(axis=None)
    assert log.rows["time"].notna().all() == timed
    log.to_csv(tmp_path / "again.csv")
    again = ssf.read_log(tmp_path / "again.csv", machine=machine)
    pd.testing.assert_frame_equal(again.rows, log.rows)
    write(log.rows, tmp_path / "rows.csv", machine)
    assert (tmp_path / "rows.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()


def test_a_prismatic_first_joint_and_two_turns_are_si(tmp_path, named):
    write_log(tmp_path / "log.csv", MACHINES["another order"])
    log = ssf.read_log(tmp_path / "log.csv", machine=named("another order"))
    slide = log.rows[log.rows["joint"] == 1]
    assert slide[["start", "stop"]].to_numpy().max() < 0.025
    assert slide["q3"].to_numpy() == pytest.approx(np.pi)
    write_log(tmp_path / "turns.csv", MACHINES["two turns"])
    turns = ssf.read_log(tmp_path / "turns.csv", machine=named("two turns"))
    assert turns.rows["start"].max() > 2 * np.pi


def test_without_times_nothing_of_the_order_is_made_up(tmp_path, named):
    machine = named("two turns")
    write_log(tmp_path / "log.csv", MACHINES["two turns"], timed=False)
    log = ssf.read_log(tmp_path / "log.csv", machine=machine)
    assert log.rows[["time", *HISTORY]].isna().all(axis=None)
    lines = (tmp_path / "log.csv").read_text().splitlines()
    shuffled = tmp_path / "shuffled.csv"
    shuffled.write_text("\n".join([lines[0], *np.random.default_rng(1).permutation(lines[1:])]) + "\n")
    again = ssf.read_log(shuffled, machine=machine)
    pd.testing.assert_frame_equal(again.rows, log.rows)
    with pytest.raises(InputError, match="the log has no times"):
        ssf.read_log(tmp_path / "log.csv", machine=machine, since="2026-03-03")
    assert "Without times" in str(log)


def test_with_times_the_history_is_there_but_for_the_load(tmp_path, named):
    write_log(tmp_path / "log.csv", MACHINES["six joints"])
    rows = ssf.read_log(tmp_path / "log.csv", machine=named("six joints")).rows
    assert rows["before_load"].isna().all()
    sixth = rows[(rows["joint"] == 6) & (rows["session"] == rows["session"].iloc[0])]
    assert list(sixth["before_direction"]) == ["", *sixth["direction"].iloc[:-1]]
    assert sixth["steps_before"].iloc[-1] == sixth["steps"].iloc[:-1].sum()


HEADER = "session,joint,direction,steps,check_every,q1_deg,q2_deg,from_deg,to_deg\n"
FAULTS = {
    "no such joint": (HEADER + "a,3,+,100,1,0,0,0,9\n", "joint", "write 1 or 2 (rotary)"),
    "beyond the range": (HEADER + "a,1,+,100,1,,0,0,721\n", "to_deg", "0 to 720 deg"),
    "the other's position": (HEADER + "a,1,+,100,1,,,0,9\n", "q2_deg", "is empty"),
    "a column of another joint": (
        HEADER.replace("q2_deg", "q2_deg,q3_mm") + "a,1,+,100,1,,0,4,0,9\n",
        "q3_mm",
        "no such joint, but 1 to 2",
    ),
    "mm on a rotary machine": (
        HEADER.replace("from_deg", "from_mm") + "a,1,+,100,1,,0,0,9\n",
        "from_mm",
        "no unit of from",
    ),
    "the other's column": (
        HEADER.replace("q2_deg", "x") + "a,1,+,100,1,,0,0,9\n",
        "q2_deg",
        "another joint moves",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_named_with_its_column(read, case):
    text, column, advice = FAULTS[case]
    found = {name: message for name, _, message in issues(read, text, "two turns")}
    assert advice in found[column]


def test_times_are_in_all_files_or_in_none(tmp_path, named):
    write_log(tmp_path / "a.csv", MACHINES["one slide"])
    write_log(tmp_path / "b.csv", MACHINES["one slide"], timed=False, seed=1)
    with pytest.raises(InputError, match=r"b\.csv.*time.*other files have it"):
        ssf.read_log([tmp_path / "a.csv", tmp_path / "b.csv"], machine=named("one slide"))


def test_a_moving_joints_own_column_may_be_missing(read):
    text = "session,joint,direction,steps,check_every\na,1,+,9000,1\na,1,-,9100,1\n"
    log = read(text, "one slide")
    assert log.rows[["start", "stop"]].to_numpy().tolist() == [[0.0, 0.025], [0.025, 0.0]]


def test_the_published_arm_still_needs_times_and_orientation(tmp_path):
    path = tmp_path / "day.csv"
    path.write_text("session,joint,direction,steps,q1_deg,q2_deg,q3_mm\na,3,+,12300,0,-90,\n")
    with pytest.raises(InputError) as error:
        ssf.read_log(path)
    missing = {problem.column for problem in error.value.problems}
    assert missing == {"time", "theta_deg", "psi_deg"}
