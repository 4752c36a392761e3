"""A rig and a person played by the test: joints with steps of one size, and an ear that knows."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from stickslip_fit.capture.campaign import Campaign, begin_journal, resume_journal
from stickslip_fit.capture.operator import OperatorReply, PlannedDrive, RigSetting, TraverseReading
from stickslip_fit.capture.protocols import Detection, VirtualClock
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.logs import read_log
from stickslip_fit.logs.plan import Plan
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine

MACHINE = load_machine()
# A few hundred steps for a traverse, so that thousands are made in a moment.
STEP = {
    (1, "+"): 0.0113,
    (1, "-"): 0.0117,
    (2, "+"): 0.0121,
    (2, "-"): 0.0109,
    (3, "+"): 3.1e-5,
    (3, "-"): 2.9e-5,
}
PLAN = """
[sessions]
dates = [2012-03-05, 2012-03-06]
[[sweep]]
joint = 3
q2_deg = [-90, -30]
theta_deg = [0, -90]
[[sweep]]
joint = 2
q3_mm = [0, 6]
ranges_deg = [[-210, 30], [-60, 0]]
"""
SHORT = """
[sessions]
dates = [2012-03-05]
[[sweep]]
joint = 3
q2_deg = [-90, 30]
replicates = 2
"""


def plan_of(folder: Path, text: str = PLAN) -> Plan:
    path = folder / "plan.toml"
    path.write_text(text)
    return read_plan(path, MACHINE)


class Joints:
    """Where the joints truly are; the controller that moves them, and the ear at them.

    The ear knows a stop only as a change: it has to have heard the joint run free since it began.
    """

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.position = {1: 0.0, 2: 0.2, 3: 0.005}
        self.stops = dict(MACHINE.ranges)
        self.made = dict.fromkeys(MACHINE.ranges, 0)  # steps, those against a stop among them
        self.against_stop = 0
        self.stopped = 0
        self.deaf = False
        self.fault = ""
        self._free, self._blocked = False, False

    @property
    def rig(self) -> Rig:
        return Rig(self, self, self.clock)

    def step(self, joint: int, steps: int) -> None:
        way = "+" if steps > 0 else "-"
        size = STEP[joint, way] if steps > 0 else -STEP[joint, way]
        for _ in range(abs(steps)):
            self.clock.sleep(0.01)
            low, high = self.stops[joint]
            at_stop = self.position[joint] == (high if steps > 0 else low)
            self.position[joint] = min(max(self.position[joint] + size, low), high)
            self._blocked = self.position[joint] == (high if steps > 0 else low)
            self._free |= not self._blocked
            self.made[joint] += 1
            self.against_stop = self.against_stop + 1 if at_stop else 0

    def stop(self) -> None:
        self.stopped += 1

    def version(self) -> str:
        return "played"

    def begin(self) -> None:
        self._free = False

    def check(self, seconds: float) -> Detection:
        assert seconds > 0
        return Detection(self._blocked and self._free and not self.deaf, 12.0 * self._blocked, self.fault)

    def close(self) -> None:
        pass


class Player:
    """The person: sets what is asked for, and answers as they were told to."""

    def __init__(self, joints: Joints, answers: Iterable[OperatorReply] = ()) -> None:
        self.joints = joints
        self.answers = iter(answers)  # to readings and to trouble, in order; then everything is fine
        self.asked: list[RigSetting] = []
        self.brought: list[tuple[int, float]] = []
        self.told: list[TraverseReading] = []
        self.troubles: list[str] = []
        self.key_at: int | None = None
        self.key_in = ""  # the drive, by the beginning of its title, in which the key is pressed
        self._steps = 0
        self._title = ""

    def show(self, text: str) -> None:
        pass

    def begin_session(self, label: str) -> OperatorReply:
        return OperatorReply()

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        self.asked.append(wanted)
        self.joints.stops = dict(MACHINE.ranges)
        for joint, low, high in wanted.stops:
            self.joints.stops[joint] = (low, high)
            self.joints.position[joint] = (low + high) / 2
        return OperatorReply()

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        self.brought.append((joint, position))
        self.joints.position[joint] = position
        return OperatorReply()

    def begin_drive(self, drive: PlannedDrive) -> None:
        self._steps, self._title = 0, drive.title

    def progress(self, drive: PlannedDrive, steps: int, detection: Detection) -> None:
        self._steps = steps

    def stop_wanted(self) -> bool:
        if self.key_at is not None and self._steps >= self.key_at and self._title.startswith(self.key_in):
            self.key_at = None
            return True
        return False

    def review(self, reading: TraverseReading) -> OperatorReply:
        self.told.append(reading)
        return next(self.answers, OperatorReply())

    def handle_failure(self, drive: PlannedDrive, why: str) -> OperatorReply:
        self.troubles.append(why)
        return next(self.answers, OperatorReply())


@dataclass
class Knowing:
    """A predictor that knows the steps' size, to within 1 %."""

    off: float = 1.0

    def predict(self, rows: pd.DataFrame) -> pd.DataFrame:
        sizes = [STEP[int(row.joint), row.direction] for row in rows.itertuples()]
        steps = (rows["stop"] - rows["start"]).abs() / sizes * self.off
        return pd.DataFrame({"steps": steps, "low": steps * 0.99 - 5, "high": steps * 1.01 + 5})


@dataclass
class Capture:
    """A campaign at the played rig, and everything it was made of."""

    folder: Path
    plan: Plan
    joints: Joints = field(default_factory=Joints)
    predictor: Knowing | None = field(default_factory=Knowing)
    count_predictor: Knowing | None = field(default_factory=Knowing)
    conditions: dict[str, float] = field(default_factory=dict)
    player: Player = field(init=False)

    def __post_init__(self) -> None:
        self.player = Player(self.joints)

    @property
    def log(self) -> Path:
        return self.folder / "log.csv"

    @property
    def rows(self) -> pd.DataFrame:
        return read_log(self.log, machine=MACHINE).rows

    def answer(self, *answers: OperatorReply) -> None:
        self.player.answers = iter(answers)

    def run(self, again: bool = False) -> bool:
        journal, replay = resume_journal(self.log) if again else begin_journal(self.log)
        with journal:
            rig, operator = self.joints.rig, self.player
            where = (self.plan, MACHINE, self.log, journal, replay, rig, operator)
            return Campaign(*where, self.predictor, self.count_predictor, conditions=self.conditions).run()
