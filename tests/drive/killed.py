"""A drive that is killed again and again, and where its joints truly stand after each time.

Run as a program: FOLDER KILLS SEED. It forks before anything has threads, so it is no part of the test's own
process. Where the joints truly are outlives the drive in shared memory: they step by the law itself, single
step by single step, each half a standard deviation farther than it says. A drive is killed after so many
steps, not after some time, in which a busy machine may not have begun.
"""

import mmap
import os
import random
import signal
import struct
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from stickslip_fit.capture.journal import read_journal
from stickslip_fit.capture.protocols import VirtualClock
from stickslip_fit.drive.loop import DriveLoop
from stickslip_fit.drive.record import DriveReplay, begin_record, resume_record
from stickslip_fit.drive.state import VelocityInput
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import read_log
from stickslip_fit.moves import CalibratedArm, DriveReckoning, calibrated_arm
from stickslip_fit.units import Z_95

PLACE, COUNT = struct.Struct("=ddd"), struct.Struct("=q")
START = (0.2, -1.3, 0.006)
MOST_STEPS, PATIENCE = 60, 60.0  # before a drive is killed, and how long in s it may take for them
PACE = 4e-4  # s for a step, so that kills find joints in motion
SPEED = 50e-6  # m/s


class Joints:
    """A controller whose joints' true positions outlive it; between recording and moving there is time."""

    def __init__(self, arm: CalibratedArm, clock: VirtualClock) -> None:
        self.arm = arm
        self.clock = clock
        self.memory = mmap.mmap(-1, PLACE.size + COUNT.size)
        self.place = START

    @property
    def place(self) -> tuple[float, ...]:
        return PLACE.unpack_from(self.memory)

    @place.setter
    def place(self, q: tuple[float, ...]) -> None:
        PLACE.pack_into(self.memory, 0, *q)

    @property
    def taken(self) -> int:
        """Single steps so far."""
        return int(COUNT.unpack_from(self.memory, PLACE.size)[0])

    def step(self, joint: int, steps: int) -> None:
        way = "+" if steps > 0 else "-"
        law, values, _, repeatability = self.arm.law(joint, way)
        for _ in range(abs(steps)):
            q = np.array(self.place)
            row = self.arm.drive_row(q, joint, q[joint - 1] + (1 if steps > 0 else -1))
            gamma = law.step_size(row, np.array([[q[joint - 1]]]), values)[0, 0]
            q[joint - 1] += (1 + 0.5 * repeatability) * gamma * (1 if steps > 0 else -1)
            time.sleep(PACE)
            self.place = tuple(q)
            COUNT.pack_into(self.memory, PLACE.size, self.taken + 1)
            time.sleep(PACE)
            self.clock.sleep(0.01)

    def stop(self) -> None:
        """Nothing moves between commands."""

    def version(self) -> str:
        return ""

    def close(self) -> None:
        """Nothing to close."""


class Wandering:
    """A hand that wants something else every now and then, and sometimes nothing."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.wanted = VelocityInput()

    def read(self, now: float) -> VelocityInput:
        if now >= self.wanted.valid_until:
            way = self.rng.standard_normal(3)
            velocity = SPEED * way / np.linalg.norm(way)
            resting = VelocityInput(valid_until=now + 0.05)
            moving = VelocityInput(tip_velocity=velocity, valid_until=now + self.rng.uniform(0.05, 1.0))
            self.wanted = resting if self.rng.random() < 0.3 else moving
        return self.wanted


class Unseen:
    def show(self, state: object) -> None:
        """Nobody looks."""


def drive(journal: Path, arm: CalibratedArm, joints: Joints, seed: int) -> None:
    """Begin, or go on, until killed."""
    if journal.exists() and journal.stat().st_size:
        record, reckoning = resume_record(journal, arm)
    else:
        reckoning = DriveReckoning(arm, START)
        record = begin_record(journal, reckoning)
    DriveLoop(reckoning, joints, joints.clock, Wandering(seed), Unseen(), record, 1.0).run()


def run_and_kill(journal: Path, arm: CalibratedArm, joints: Joints, chance: random.Random, seed: int) -> None:
    enough, give_up = joints.taken + chance.randint(0, MOST_STEPS), time.monotonic() + PATIENCE
    child = os.fork()
    if child == 0:
        try:
            drive(journal, arm, joints, seed)
        finally:
            os._exit(1)
    while joints.taken < enough and time.monotonic() < give_up:
        time.sleep(PACE)
    time.sleep(chance.uniform(0.0, 8 * PACE))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), "the drive failed by itself"
    assert joints.taken >= enough, f"{joints.taken} of {enough} steps in {PATIENCE:.0f} s"


def judge(journal: Path, arm: CalibratedArm, joints: Joints) -> int:
    """Compare the joints with what the journal says; bursts since its last snapshot."""
    replay = DriveReplay()
    if journal.exists():
        read_journal(journal, replay.apply)
    if not replay.law:
        assert joints.place == START, "moved before it was written down"
        return 0
    found = replay.restore(arm)
    off = np.abs(np.array(joints.place) - found.q)
    assert np.all(off <= Z_95 * found.q_error + 1e-12), f"{off} off, {Z_95 * found.q_error} said"
    return len(replay.bursts)


def main(folder: Path, kills: int, seed: int) -> None:
    """Kill that often; say how many bursts were open each time."""
    arm = calibrated_arm(fit_least_squares(read_log("data/reference/campaign.csv")))
    joints, chance = Joints(arm, VirtualClock()), random.Random(seed)
    journal = folder / "drive.journal"
    # What is loaded late is loaded now, so that the kills fall into the drive.
    DriveReckoning(arm, START).advance(1, "+", 1, 0.0)
    open_bursts = []
    for number in range(kills):
        run_and_kill(journal, arm, joints, chance, seed + number)
        open_bursts.append(judge(journal, arm, joints))
    moved = np.abs(np.array(joints.place) - START) / [1e-4, 1e-4, 1e-6]
    print(*open_bursts)
    print(*moved.round().astype(int))


if __name__ == "__main__":
    warnings.simplefilter("ignore", DeprecationWarning)  # pyarrow's thread holds no lock of ours
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
