"""Machine files of joints alone: what they say, what is refused, and what then needs an arm."""

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import load_result
from stickslip_fit.logs import read_plan
from stickslip_fit.machine import (
    forward,
    gravity_scale,
    inertia_matrix,
    inverse,
    jacobian,
    load_machine,
    reach,
)
from tests.joints.generated import MACHINES, machine_text, write_log


def test_joints_have_their_kinds_ranges_and_names(machine_of):
    machine = machine_of(
        'name = "Stage 7"\n[[joint]]\nkind = "prismatic"\nrange_um = [-500, 500]\n'
        '[[joint]]\nkind = "rotary"\nname = "Phi"\nrange_deg = [0, 720]\n'
    )
    assert (machine.name, machine.joints, machine.kinds) == ("Stage 7", (1, 2), ("prismatic", "rotary"))
    assert machine.ranges[1] == pytest.approx((-5e-4, 5e-4))
    assert machine.span(2) == pytest.approx(4 * np.pi)
    assert [machine.is_prismatic(joint) for joint in machine.joints] == [True, False]
    assert [machine.describe_joint(joint) for joint in machine.joints] == ["prismatic", "Phi, rotary"]
    assert not machine.has_published_geometry
    assert load_machine().has_published_geometry


FAULTS = {
    "no joint": ("joint = []", "joint", "one to 30"),
    "no table": ("joint = 3", "joint", "one to 30"),
    "a screw": ('[[joint]]\nkind = "screw"\nrange_mm = [0, 1]', "joint 1 kind", '"rotary" or "prismatic"'),
    "no range": ('[[joint]]\nkind = "rotary"', "joint 1 range_deg", "[lowest, highest]"),
    "mm of a rotary joint": ('[[joint]]\nkind = "rotary"\nrange_mm = [0, 1]', "joint 1 range_mm", "no key"),
    "falling": ('[[joint]]\nkind = "rotary"\nrange_deg = [9, 0]', "joint 1 range_deg", "[lowest, highest]"),
    "arm lengths beside": (
        '[[joint]]\nkind = "rotary"\nrange_deg = [0, 9]\n[geometry]\na1_mm = 3',
        "geometry",
        "which may have name, joint",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_named_with_its_key(machine_of, case):
    text, column, advice = FAULTS[case]
    with pytest.raises(InputError) as error:
        machine_of(text)
    found = {problem.column: problem.message for problem in error.value.problems}
    assert advice in found[column]


NEEDS_AN_ARM = {
    "reach": lambda machine: reach(machine, 0.0, 0.0),
    "forward": lambda machine: forward(machine, [0.0, 0.0]),
    "jacobian": lambda machine: jacobian(machine, [0.0, 0.0]),
    "inverse": lambda machine: inverse(machine, [0.05, 0.0, 0.0]),
    "inertia": lambda machine: inertia_matrix(machine, [0.0, 0.0]),
    "gravity": lambda machine: gravity_scale(machine, [0.0, 0.0]),
    "plan": lambda machine: read_plan("any.toml", machine),
}


@pytest.mark.parametrize("what", NEEDS_AN_ARM)
def test_what_needs_an_arm_says_so_in_one_sentence(machine_of, what):
    machine = machine_of(machine_text(MACHINES["two turns"]))
    with pytest.raises(InputError, match=r"lengths are known, and the machine mine is none(;|$)") as error:
        NEEDS_AN_ARM[what](machine)
    assert len(error.value.problems) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "one slide",
        "another order",
        *(pytest.param(name, marks=pytest.mark.nightly) for name in ("six joints", "two turns")),
    ],
)
def test_a_saved_result_has_its_machine(tmp_path, machine_of, name):
    machine = machine_of(machine_text(MACHINES[name]))
    write_log(tmp_path / "log.csv", MACHINES[name])
    fit = ssf.fit(ssf.read_log(tmp_path / "log.csv", machine=machine))
    fit.save(tmp_path / "fit.json")
    again = load_result(tmp_path / "fit.json")
    assert (again.machine.kinds, again.machine.ranges) == (machine.kinds, machine.ranges)
    assert again.machine.sha256 == machine.sha256
    assert again.si.parameters["estimate"].to_numpy() == pytest.approx(
        fit.si.parameters["estimate"].to_numpy()
    )
    assert str(again) == str(fit)
