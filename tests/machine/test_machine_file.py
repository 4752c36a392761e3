import hashlib
from importlib import resources

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.machine import load_machine

NOMINAL = resources.files("stickslip_fit.machine").joinpath("mm3a.toml").read_text(encoding="utf-8")


def problems(machine_of, content):
    with pytest.raises(InputError) as error:
        machine_of(content)
    assert all(problem.file.endswith("mine.toml") for problem in error.value.problems)
    return [(problem.column, problem.value, problem.message) for problem in error.value.problems]


def test_the_nominal_arm_in_si(nominal):
    assert (nominal.a1, nominal.l2, nominal.ranges[3]) == (0.0125, 0.0375, (0.0, 0.012))
    assert np.degrees([*nominal.ranges[1], *nominal.ranges[2]]) == pytest.approx([-120, 120, -210, 30])
    assert nominal.span(2) == pytest.approx(4 * np.pi / 3)
    first, second, third = nominal.links
    assert (first.mass, second.com, third.com) == pytest.approx((0.020, 0.010, 0.015))
    assert second.inertia == pytest.approx((9e-7, 9e-7, 3e-7))


# What stands in mm3a.toml, what is put in its place, the key and the value that the message must name.
FAULTS = {
    "missing length": ("l2_mm = 37.5", "", "geometry.l2_mm", None, "length in mm"),
    "text for a number": ("a1_mm = 12.5", 'a1_mm = "12.5 mm"', "geometry.a1_mm", "12.5 mm", "length in mm"),
    "true for a number": ("a1_mm = 12.5", "a1_mm = true", "geometry.a1_mm", "true", "length in mm"),
    "negative length": ("a1_mm = 12.5", "a1_mm = -12.5", "geometry.a1_mm", "-12.5", "zero or more"),
    "nan": ("a1_mm = 12.5", "a1_mm = nan", "geometry.a1_mm", "nan", "length in mm"),
    "inf": ("q3_mm = [0, 12]", "q3_mm = [0, inf]", "range.q3_mm", "[0, inf]", "[lowest, highest] in mm"),
    "too large for a float": (
        "a1_mm = 12.5",
        f"a1_mm = 1{'0' * 400}",
        "geometry.a1_mm",
        "1000",
        "length in mm",
    ),
    "range reversed": ("[-210, 30]", "[30, -210]", "range.q2_deg", "[30, -210]", "[lowest, highest] in deg"),
    "range of nothing": ("[0, 12]", "[12, 12]", "range.q3_mm", "[12, 12]", "[lowest, highest] in mm"),
    "one end": ("[-120, 120]", "[120]", "range.q1_deg", "[120]", "[lowest, highest] in deg"),
    "one number": ("[-120, 120]", "120", "range.q1_deg", "120", "[lowest, highest] in deg"),
    "arcminutes": ("[-120, 120]", "[-7200, 7200]", "range.q1_deg", "[-7200, 7200]", "within ±360"),
    "tip behind joint 2": ("[0, 12]", "[-37.5, 12]", "geometry.l2_mm", "37.5", "clear of joint 2's axis"),
    "another unit": ("q3_mm = [0, 12]", "q3_um = [0, 12000]", "range.q3_um", "[0, 12000]", "may have"),
    "unknown table": ("[range]", "[motor]\nvolts = 5\n[range]", "motor", "{'volts': 5}", "may have"),
    "no table": ("[geometry]", "[[geometry]]", "geometry", "[{", "write it as a table"),
    "nameless": ('name = "Kleindiek MM3A (nominal)"', "name = 3", "name", "3", "in quotes"),
    "weightless": ("mass_g = 15.0", "mass_g = 0", "link 2 mass_g", "0", "above 0"),
    "no centre": ("com_mm = 15.0", "", "link 3 com_mm", None, "distance in mm"),
    "two moments": ("[400.0, 400.0, 50.0]", "[400, 50]", "link 3 inertia_g_mm2", "[400, 50]", "[xx, yy, zz]"),
    "moment below 0": (
        "900.0, 300.0]",
        "900, -3]",
        "link 2 inertia_g_mm2",
        "[900.0, 900, -3]",
        "zero or more",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_named_with_its_key_and_value(machine_of, case):
    there, instead, key, value, advice = FAULTS[case]
    assert NOMINAL.count(there) == 1
    told = problems(machine_of, NOMINAL.replace(there, instead))
    found = {column: (shown, message) for column, shown, message in told}
    shown, message = found[key]
    assert advice in message
    assert shown is None if value is None else shown.startswith(value)


@pytest.mark.parametrize(
    "links",
    ["", "link = 3", "link = [{}, {}, {}, 4]", "[[link]]\nmass_g = 1\ncom_mm = 1\ninertia_g_mm2 = [1, 1, 1]"],
)
def test_three_links_are_wanted(machine_of, links):
    top, rest = ("", links) if links.startswith("[[") else (links, "")
    text = f"{top}\n{NOMINAL[: NOMINAL.index('[[link]]')]}\n{rest}"
    assert [(column, message) for column, _, message in problems(machine_of, text)] == [
        ("link", "give three [[link]] tables, base to tip")
    ]


def test_all_faults_are_told_together(machine_of):
    text = NOMINAL.replace("a1_mm = 12.5", "a1_mm = -1").replace("[-210, 30]", "[30, -210]")
    text = text.replace("mass_g = 5.0", "mass_g = 'light'")
    assert [column for column, _, _ in problems(machine_of, text)] == [
        "geometry.a1_mm",
        "range.q2_deg",
        "link 3 mass_g",
    ]


@pytest.mark.parametrize(
    "content",
    [
        "a1: 12.5",
        "a = " + "[" * 20_000,
        f"a = {'9' * 5_000}",
        b"\xff\xfe\x00\x01",
        NOMINAL.encode("utf-16"),
        "[geometry]\na1_mm = 1\na1_mm = 2",
    ],
    ids=["yaml", "bottomless", "endless", "bytes", "utf-16", "twice"],
)
def test_what_is_no_toml(machine_of, content):
    ((column, _, message),) = problems(machine_of, content)
    assert column is None
    assert "is no TOML file" in message


def test_an_empty_file_lacks_everything(machine_of):
    assert [column for column, _, _ in problems(machine_of, "")] == [
        "geometry.a1_mm", "geometry.l2_mm", "range.q1_deg", "range.q2_deg", "range.q3_mm", "link",
    ]  # fmt: skip


def test_no_such_file(tmp_path):
    for path in (tmp_path / "absent.toml", tmp_path):
        with pytest.raises(InputError) as error:
            load_machine(path)
        assert str(path) in str(error.value)
        assert "name an existing machine file" in str(error.value)


def test_a_byte_order_mark_is_no_fault(machine_of, nominal):
    assert machine_of("\ufeff" + NOMINAL).ranges == nominal.ranges


def test_the_hash_is_of_the_bytes(machine_of, nominal):
    assert machine_of(NOMINAL).sha256 == nominal.sha256 == hashlib.sha256(NOMINAL.encode()).hexdigest()
    assert machine_of(NOMINAL + "# remeasured\n").sha256 != nominal.sha256
