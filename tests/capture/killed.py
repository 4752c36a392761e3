"""A capture that is killed again and again, and what must hold after each time.

Run as a program: FOLDER KILLS SEED. It forks before anything has threads, so it is no part of the test's
own process. The joints are played; what they truly did outlives them in shared memory.
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

from stickslip_fit.capture.campaign import journal_path
from stickslip_fit.capture.journal import INTERRUPTED_NOTE, JournalReplay, read_journal
from stickslip_fit.capture.operator import OperatorReply, PlannedDrive, TraverseReading
from stickslip_fit.logs.plan import Plan
from tests.capture.played import SHORT, Capture, Joints, Player, plan_of

ACKNOWLEDGED = struct.Struct("=iii")  # which traverse of the plan, its steps, those that the joint made
MADE = struct.Struct("=i")
LONGEST = 0.3  # s
PACE = 3e-4  # s for a command, so that kills find joints in motion and not only files being written
Acknowledged = list[tuple[int, int, int]]


class Truth:
    """How many steps the joints made in the drive under way, whoever is killed."""

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, MADE.size)

    @property
    def made(self) -> int:
        return MADE.unpack(self._memory[:])[0]

    @made.setter
    def made(self, steps: int) -> None:
        self._memory[:] = MADE.pack(steps)


class Witnessed(Joints):
    def __init__(self, truth: Truth) -> None:
        super().__init__()
        self.truth = truth

    def step(self, joint: int, steps: int) -> None:
        time.sleep(PACE)
        for _ in range(abs(steps)):
            super().step(joint, 1 if steps > 0 else -1)
            self.truth.made += 1


class Acknowledging(Player):
    """Writes what it was shown into a pipe that outlives it."""

    def __init__(self, joints: Witnessed, pipe: int) -> None:
        super().__init__(joints)
        self.truth = joints.truth
        self.pipe = pipe

    def begin_drive(self, drive: PlannedDrive) -> None:
        super().begin_drive(drive)
        self.truth.made = 0

    def review(self, reading: TraverseReading) -> OperatorReply:
        number = int(reading.drive.title.split(" ")[0]) - 1
        os.write(self.pipe, ACKNOWLEDGED.pack(number, reading.steps, self.truth.made))
        return OperatorReply()


def capture(folder: Path, plan: Plan, truth: Truth, pipe: int) -> None:
    """Begin, or go on, until killed or done."""
    campaign = Capture(folder, plan, Witnessed(truth))
    campaign.player = Acknowledging(campaign.joints, pipe)
    campaign.run(again=journal_path(campaign.log).exists())


def run_and_kill(folder: Path, plan: Plan, truth: Truth, after: float | None) -> Acknowledged:
    """Readings that a child acknowledged before it was killed `after` so many seconds, or done."""
    receive, send = os.pipe()
    truth.made = 0
    child = os.fork()
    if child == 0:
        status = 1
        try:
            capture(folder, plan, truth, send)
            status = 0
        finally:
            os._exit(status)
    os.close(send)
    if after is not None:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
    with os.fdopen(receive, "rb") as stream:
        said = stream.read()
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "the capture failed by itself"
    return list(ACKNOWLEDGED.iter_unpack(said))


def judge(folder: Path, acknowledged: Acknowledged, truth: Truth, before: int) -> int:
    """Compare the journal with what was acknowledged and driven; the steps of a drive that was broken off.

    The first `before` drives of the journal were judged already.
    A reading written down in the instant of the kill is added: it is kept, though nobody was shown it.
    """
    replay = replay_of(folder)
    assert len(replay.drives) >= before, "a drive is lost"
    kept = [(each.planned, each.steps) for each in replay.drives if each.status == "ok"]
    assert len({planned for planned, _ in kept}) == len(kept), "a reading stands twice"
    assert [(planned, steps) for planned, steps, _ in acknowledged] == kept[: len(acknowledged)], "lost"
    assert len(kept) <= len(acknowledged) + 1, "a reading that nobody was shown"
    assert all(steps == made for _, steps, made in acknowledged), "counted wrong"
    acknowledged += [(planned, steps, steps) for planned, steps in kept[len(acknowledged) :]]
    if len(replay.drives) == before or replay.drives[-1].notes != (INTERRUPTED_NOTE,):
        return 0
    broken = replay.drives[-1]
    assert 0 <= broken.steps - truth.made <= 5, f"{broken.steps} recorded, {truth.made} driven"
    return broken.steps


def replay_of(folder: Path) -> JournalReplay:
    replay = JournalReplay()
    if journal_path(folder / "log.csv").exists():
        read_journal(journal_path(folder / "log.csv"), replay.apply)
    return replay


def main(folder: Path, kills: int, seed: int) -> None:
    """Kill that often, then let it end; say the steps of the drives that were broken off."""
    # What is loaded late is loaded now, so that the kills fall into the capture.
    rehearsal = folder / "rehearsal"
    rehearsal.mkdir()
    plan = plan_of(rehearsal, SHORT)
    Capture(rehearsal, plan).run()
    chance, truth = random.Random(seed), Truth()
    acknowledged: Acknowledged = []
    broken = []
    for _ in range(kills):
        before = len(replay_of(folder).drives)
        acknowledged += run_and_kill(folder, plan, truth, chance.uniform(0.0, LONGEST))
        broken.append(judge(folder, acknowledged, truth, before))
    acknowledged += run_and_kill(folder, plan, truth, None)
    assert judge(folder, acknowledged, truth, len(replay_of(folder).drives)) == 0
    print(*filter(None, broken))


if __name__ == "__main__":
    warnings.simplefilter("ignore", DeprecationWarning)  # pyarrow's thread holds no lock of ours
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
