"""Open-loop moves of a study: as good as the steps are known."""

from dataclasses import dataclass

import numpy as np
import pytest

from stickslip_fit.causes import EndStopLatency, ThermalWarmUp
from stickslip_fit.laws import Base, Elbow, Prismatic
from stickslip_fit.machine import load_machine
from stickslip_fit.strategies import ClosedForm
from stickslip_fit.studies import Cores, Scenario, run_study
from tests.conftest import Truth
from tests.studies.conftest import JOINT_3, ROTARY, hidden

MOVES = {"moves": 6, "campaigns": 3, "sessions": 1, "day_to_day_pct": 0.0, "between_campaigns": 0.0,
         "between_sessions": 0.0, "repeatability": 1e-6, "check_every": 1}  # fmt: skip
WARM = hidden("warm", ThermalWarmUp(), 0.03, 60.0)


@dataclass(frozen=True)
class Told:
    """Knows the parameters without any traverse, times a factor of all step sizes."""

    name: str
    factor: float = 1.0

    def choose(self, task):
        return np.array([0])

    def calibrate(self, task, made):
        machine, truth = load_machine(), Truth()
        law = {1: Base(machine), 2: Elbow(machine), 3: Prismatic()}[task.law.joint]
        values = np.array({1: truth.base, 2: truth.elbow, 3: truth.prismatic}[task.law.joint][task.direction])
        units = {1: [1e-6, 1e-3, 1e-6, 1e-3], 2: [1e-6] * 4, 3: [1e-9, 1.0, 1e-9]}[task.law.joint]
        own = values * units
        return lambda rows: (law.predict(rows, own) - np.log(self.factor), np.zeros(len(rows)))


@pytest.fixture(scope="module")
def found(study):
    strategies = (Told("right"), Told("too long", 1.01), Told("warm too", 1.03), ClosedForm())
    late = hidden("late", EndStopLatency(), 200.0)
    plan = study(
        JOINT_3 + ROTARY, strategies=strategies, scenarios=(Scenario("nothing hidden"), WARM, late), **MOVES
    )
    tips = run_study(plan, backend=Cores(1)).tips()
    return tips.set_index(["scenario", "strategy"])


@pytest.mark.slow
def test_whoever_knows_the_steps_ends_within_a_few_of_them(found):
    # Half a step of each joint at full reach: 50 mm times 48 µrad, 50 and 62 mm.
    assert found.loc[("nothing hidden", "right"), "worst"] < 6e-6
    assert found.loc[("nothing hidden", "closed form"), "worst"] < 6e-6
    right, long = (found.loc[("nothing hidden", name), "rms"] for name in ("right", "too long"))
    # All joints stop short by the same share of their ways, and so does the tip, to first order.
    assert np.sqrt(long**2 - right**2) == pytest.approx(1e-3 * (1 - 1 / 1.01), rel=0.05)
    assert found["unknown"].eq(0).all()


@pytest.mark.slow
def test_moves_are_made_when_the_session_is_over(found):
    # By then all step sizes are 3 % longer.
    assert found.loc[("warm", "warm too"), "worst"] < 6e-6
    assert found.loc[("warm", "right"), "rms"] > 2 * found.loc[("nothing hidden", "too long"), "rms"]


@pytest.mark.slow
def test_what_is_only_in_hearing_the_stop_moves_nothing(found):
    assert found.loc[("late", "right"), "rms"] == pytest.approx(
        found.loc[("nothing hidden", "right"), "rms"], rel=0.1
    )
    assert found.loc[("late", "closed form"), "rms"] > 3 * found.loc[("late", "right"), "rms"]
