"""A drive over a port, by the real clock: an emulated controller in a process of its own, and its plug."""

import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from stickslip_fit.drive.record import resume_record
from stickslip_fit.drive.session import DriveJob, drive_real
from stickslip_fit.units import Z_95
from tests.capture.emulator_process import start_emulator

pytest.importorskip("serial", reason="pyserial is not installed")
pytest.importorskip("pty", reason="this system has no pseudo-terminals")
LAW = Path("data/reference/law.toml")
START = np.array([0.0, -1.2, 0.004])


def job_of(arm, folder, seconds):
    (folder / "path.csv").write_text(
        f"time_s,vx_um_s,vy_um_s,vz_um_s\n0,30,0,20\n{seconds},0,0,0\n", encoding="utf-8"
    )
    journal = folder / "drive.journal"
    return DriveJob(
        arm=arm,
        start=START,
        tolerance=1e-5,
        journal=journal,
        log=None,
        script=folder / "path.csv",
        device="keyboard",
        page_port=0,
        speed=2e-5,
        hold=0.05,
        step_period=0.01,
    )


@pytest.fixture
def emulator():
    with start_emulator(LAW, "--repeatability-pct", "0") as process:
        process.set(q1=START[0], q2=START[1], q3=START[2])
        yield process


@pytest.mark.nightly
def test_a_script_over_a_port(arm, emulator, tmp_path):
    """Steps that the controller really made, at the pace of its replies."""
    began = time.monotonic()
    text = drive_real(job_of(arm, tmp_path, 2.0), emulator.port, "new", None, None)
    assert 1.9 < time.monotonic() - began < 20.0
    steps = np.array([int(count) for count in re.findall(r"[+-]\d+(?=[, ])", text.split("made ")[1])])
    moved = np.array([emulator.position(joint) for joint in (1, 2, 3)]) - START
    assert moved / [98e-6, 98e-6, 0.85e-6] == pytest.approx(steps, rel=0.3)
    assert steps[2] > 20


@pytest.mark.nightly
def test_a_pulled_plug(arm, emulator, tmp_path):
    positions = []

    def pull():
        time.sleep(1.5)
        positions.append([emulator.position(joint) for joint in (1, 2, 3)])
        emulator.close()

    puller = threading.Thread(target=pull)
    puller.start()
    text = drive_real(job_of(arm, tmp_path, 30.0), emulator.port, "new", None, None)
    puller.join()
    assert "connection to the controller is lost" in text
    record, drive = resume_record(tmp_path / "drive.journal", arm)
    record.close()
    assert np.all(np.isfinite(drive.q_error))
    between = np.array([3e-4, 3e-4, 10e-6])  # steps after the question and before the plug
    other_day = 0.05 * np.abs(np.array(positions[0]) - START)
    off = np.abs(np.array(positions[0]) - drive.q)
    assert np.all(off <= between + other_day + Z_95 * drive.q_error)
