"""Files of formulas: what they hold, and every fault with its line."""

import pytest

import stickslip_fit as ssf

WHOLE = """\
formula = "F ~ M*acc + Fv*vel + offset"
shared = ["M"]
units = { M = "kg", Fv = "N s/m", offset = "N" }
start = { M = 2 }

[bounds]
M = [0, inf]

[[cause]]
name = "warm-up"
formula = "* (1 - A*expm1(-t/tau))"
parameters = "A in %, tau in s"
bounds = { tau = [1, 100] }

[roles]
session = "run"
time = "t"
"""
JOINTS = """\
[joint.2]
formula = "gamma ~ a - c*load"
units = { a = "µrad" }

[joint.3]
formula = "gamma ~ a"
"""
FAULTS = {
    'formula = "F ~ M*acc + os.system(\'x\')"': "line 1, column formula.*character 13",
    'formula = "F ~ a"\nshared = 3': "line 2, column shared.*give a list of parameters",
    'formula = "F ~ a"\n[bounds]\na = [0]': "bounds of a must be",
    'formula = "F ~ a"\n[[cause]]\nname = "c"\nformula = "k*t"\nparameters = "k"': "line 4.*is not said",
    'formula = "F ~ a"\n[[cause]]\nname = "c"\nformula = "+ k*t"\nparameters = "k, z"': "z is never used",
    'formula = "F ~ a"\n[[cause]]\nname = "c"\nformula = "+ k*exp(t*z)"\nparameters = "k, z"\n'
    "bounds = { z = [1] }": "bounds of z must be",
    'formula = "F ~ a"\n[roles]\nsesion = "run"': "line 3, column roles.sesion.*did you mean session",
    'function = "os:system"': "is no key of this table",
    'name = "motor"': "give a formula",
    '[joint.two]\nformula = "gamma ~ a"': "name a joint by its number",
    "[joint.2]\nunits = { a = 'nm' }": "give its formula",
    'formula = "F ~ a"\n[[law]]\njoint = 3': "line 2, column law.*is no key of this table",
}  # fmt: skip


def read(tmp_path, text):
    path = tmp_path / "law.toml"
    path.write_text(text, "utf-8")
    return ssf.read_law_file(path)


def test_a_file_holds_a_law_causes_and_roles(tmp_path):
    content = read(tmp_path, WHOLE)
    assert content.law.names == ("M", "acc", "Fv", "vel", "offset")
    assert (content.law.bounds, content.law.start, content.law.shared) == (
        {"M": (0.0, None)},
        {"M": 2.0},
        ("M",),
    )
    assert content.law.units["Fv"] == "N s/m"
    (cause,) = content.causes
    assert [(one.name, one.unit, one.upper) for one in cause.declared][1] == ("tau", "s", 100)
    assert content.roles == {"session": "run", "time": "t"}
    assert not content.laws


def test_a_file_may_hold_the_laws_of_joints(tmp_path):
    content = read(tmp_path, JOINTS)
    assert content.law is None
    assert {joint: law.text for joint, law in content.laws.items()} == {
        2: "gamma ~ a - c*load",
        3: "gamma ~ a",
    }


@pytest.mark.parametrize("text", FAULTS, ids=range(len(FAULTS)))
def test_a_faulty_file_is_refused_with_its_lines(tmp_path, text):
    with pytest.raises(ssf.InputError, match=FAULTS[text]):
        read(tmp_path, text)
