"""A whole campaign at the emulated rig: what the log says is what was hidden, history included."""

import ast
from datetime import UTC
from pathlib import Path

import numpy as np
import pytest

import stickslip_fit.capture
from stickslip_fit.capture.campaign import Campaign, begin_journal, resume_journal
from stickslip_fit.capture.emulator.rig import EmulatedOperator, emulate_rig
from stickslip_fit.capture.operator import OperatorChoice, OperatorReply
from stickslip_fit.capture.protocols import VirtualClock
from stickslip_fit.capture.terminal import UnattendedOperator
from stickslip_fit.capture.traverse import Rig
from stickslip_fit.laws import observed_count
from stickslip_fit.logs import read_log
from stickslip_fit.simulation import expected_counts
from tests.capture.truths import MACHINE, plan_of, truth_of

HIDDEN = """
[[cause]]
name = "thermal-warm-up"
A = "5 %"
tau = "20 min"
[[cause]]
name = "wear"
k = "2 %"
n0 = "5000 steps"
[[cause]]
name = "reversal-loss"
L = "40 steps"
"""


class Willing(UnattendedOperator):
    """A person who does whatever is asked, and finds everything in order."""

    def handle_failure(self, drive, why):
        pytest.fail(why)


class Leaving(Willing):
    """Goes to lunch after so many readings."""

    def __init__(self, readings):
        super().__init__()
        self.left = readings

    def review(self, reading):
        self.left -= 1
        return OperatorReply() if self.left else OperatorReply(OperatorChoice.QUIT)


def part(path, truth, plan, operator, opened=begin_journal):
    """A campaign at a rig switched on for it; whether it is complete."""
    journal, replay = opened(path)
    with journal:
        began = replay.last_time or plan.sessions[0].begins.replace(tzinfo=UTC)
        rig = emulate_rig(truth, clock=VirtualClock(began))
        rig.manipulator.remember(replay.rows(), rig.clock.today(), rig.clock.now())
        parts = Rig(rig.controller(pytest.fail), rig.ideal_detector(), rig.clock)
        operator = EmulatedOperator(operator, rig.manipulator, rig.clock, plan)
        complete = Campaign(plan, MACHINE, path, journal, replay, parts, operator).run()
        return complete, rig


@pytest.mark.slow
@pytest.mark.parametrize("lunch", [pytest.param(None, marks=pytest.mark.nightly), 7])
def test_a_captured_log_holds_what_the_emulator_hides(tmp_path, lunch):
    """Every count is that of the hidden law after the history that the log itself tells."""
    truth, plan = truth_of(tmp_path, HIDDEN), plan_of(tmp_path, replicates=1)
    path = tmp_path / "log.csv"
    if lunch:
        assert not part(path, truth, plan, Leaving(lunch))[0]
    complete, rig = part(path, truth, plan, Willing(), resume_journal if lunch else begin_journal)
    assert complete
    log = read_log(path, machine=MACHINE)
    assert log.sessions == tuple(session.label for session in plan.sessions)
    assert len(log.usable) == len(plan.rows())
    assert log.usable["session_seconds"].max() > 600
    for joint in log.joints:
        rows = log.usable[log.usable["joint"] == joint]
        values, _ = truth.laws.of_rows(rows, joint)
        expected = observed_count(expected_counts(truth.laws.laws[joint], rows, values), rows["check_every"])
        assert rows["steps"].to_numpy() == pytest.approx(expected, abs=5)
        assert np.mean(rows["steps"].to_numpy() == expected) > 0.8
    for joint in log.joints:
        assert rig.manipulator.total_steps(joint) == log.rows.loc[log.rows["joint"] == joint, "steps"].sum()


def test_only_the_emulator_knows_a_law():
    folder = Path(stickslip_fit.capture.__file__).parent
    knowing = (
        *("simulation", "laws", "causes", "moves", "estimation"),
        *("bayes", "diagnosis", "strategies", "anova"),
    )
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                assert not node.module.startswith(tuple(f"stickslip_fit.{room}" for room in knowing)), path
                assert "capture.emulator" not in node.module, path
