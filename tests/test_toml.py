"""What all TOML files have in common: their faults, the examples in the documentation, their JSON schemas."""

import json
import sys
import tomllib

import pytest

from stickslip_fit._toml import MAX_ISSUES, parse_toml
from stickslip_fit.causes.law_file import FormulaFile
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan_reader import PlanFile
from stickslip_fit.machine import load_machine
from stickslip_fit.machine.machine_file import JointsFile, MachineFile
from stickslip_fit.simulation.truth import LawFile
from stickslip_fit.studies.plan import StudyFile
from tests.docs.commands import ROOT
from tests.docs.fences import fences

REFERENCE = ROOT / "data/reference"
LAW = (REFERENCE / "law.toml").read_text("utf-8")
MODELS = {
    "plan": (PlanFile, load_machine()),
    "law": (LawFile, None),
    "study": (StudyFile, (REFERENCE, load_machine())),
    "machine": (MachineFile, None),
    "formula": (FormulaFile, None),
    "joints": (JointsFile, None),
}
FILES = {path.name: path.read_text("utf-8") for path in sorted(REFERENCE.glob("*.toml"))}
FILES |= {"mm3a.toml": (ROOT / "stickslip_fit/machine/mm3a.toml").read_text("utf-8")}
FILES |= {
    f"{page.relative_to(ROOT)}:{fence.line}": fence.text
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if "generated" not in page.parts
    for fence in fences(page)
    if fence.language == "toml" and "[project" not in fence.text
}
FIVE = """\
seed = "one"
chek_every = 5
replicates = 0
[sessions]
dates = [2012-03-05]

[[sweep]]
joint = 3
q2_deg = 99

[[sweep]]
joint = 2
theta_deg = [0, 400]
q3_mm = [0,
  6]
"""


def kind_of(text):
    content = tomllib.loads(text)
    if "formula" in content or isinstance(content.get("joint"), dict):
        return "formula"
    if isinstance(content.get("joint"), list):
        return "joints"
    keys = {"sweep": "plan", "geometry": "machine", "scenario": "study", "law": "law", "cause": "law"}
    keys |= {"stage": "law"}
    return next(kind for key, kind in keys.items() if key in content)


def test_five_faults_are_told_at_once_with_line_key_value_and_what_to_do():
    with pytest.raises(InputError) as caught:
        parse_toml(FIVE.encode(), "plan.toml", PlanFile, load_machine())
    assert {str(problem) for problem in caught.value.problems} == {
        "plan.toml, line 1, column seed, value 'one': give a whole number from 0 to 9223372036854775807",
        "plan.toml, line 2, column chek_every, value '5': is no key of this table, which may have "
        "name, seed, check_every, order, replicates, sessions, timing, noise, sweep; "
        "did you mean check_every?",
        "plan.toml, line 3, column replicates, value '0': give a whole number from 1 to 10000",
        "plan.toml, line 9, column sweep 1 q2_deg, value '99': give a number in deg, -210 to 30, "
        "or a list of such",
        "plan.toml, line 13, column sweep 2 theta_deg, value '[0, 400]': give a number in deg, -360 to 360, "
        "or a list of such",
    }


def test_a_missing_key_is_told_at_the_line_of_its_table():
    text = LAW.replace("a_nm = 899\n", "").replace("c_nm = 375.55", "c_nm = 375.55\nc_um = 0.376")
    with pytest.raises(InputError) as caught:
        parse_toml(text.encode(), "law.toml", LawFile)
    lines = text.splitlines()
    places = [(problem.column, lines[problem.line - 1]) for problem in caught.value.problems]
    assert places == [("law 1 c_um", "c_um = 0.376"), ("law 2 a_nm", "[[law]]")]


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 200_000 + "]" * 200_000, "is no TOML file"),
        ("a = " + "{a = " * 60_000 + "1" + "}" * 60_000, "is no TOML file"),
        (".".join("a" * 100_000) + " = 1", "more than 32 parts"),
        ("[" + " . ".join(["'a'"] * 100_000) + "]", "more than 32 parts"),
        ("seed = " + "9" * 100_000, "is no TOML file"),
        ("a" * 500_000 + " = 1", "is no key of this table"),
        ("a = 1\na = 2", "is no TOML file"),
        ("\0", "is no TOML file"),
    ],
)
def test_deep_and_huge_values_are_refused_with_one_short_message(kind, text, said):
    model, context = MODELS[kind]
    with pytest.raises(InputError, match=said) as caught:
        parse_toml(text.encode(), "plan.toml", model, context)
    assert len(str(caught.value)) < 5_000


def test_a_thousand_faults_are_counted():
    text = "".join(f"key{number} = 1\n" for number in range(1_000))
    with pytest.raises(InputError) as caught:
        parse_toml(text.encode(), "mm3a.toml", MachineFile)
    assert len(caught.value.problems) == MAX_ISSUES + 1
    assert str(caught.value.problems[-1]) == "mm3a.toml: ... and 906 more"  # and six missing ones


def test_a_plan_of_more_traverses_than_a_session_has_is_refused(tmp_path):
    text = "[sessions]\ndates = [2012-03-05]\n" + 600 * (
        "[[sweep]]\njoint = 3\nq2_deg = -90\nreplicates = 1000\n"
    )
    with pytest.raises(InputError, match="list has 1,200,000 traverses; keep it to 500,000"):
        parse_toml(text.encode(), "plan.toml", PlanFile, load_machine())


@pytest.mark.parametrize("name", FILES)
def test_every_example_is_a_good_file(name):
    text = FILES[name]
    model, context = MODELS[kind_of(text)]
    # Pieces of a law file are shown without the laws.
    own = {"law", "stage"} & {*tomllib.loads(text)}
    whole = text if own or model is not LawFile else f"{LAW}\n{text}"
    parse_toml(whole.encode(), name, model, context)


@pytest.fixture(scope="module")
def schemas():
    sys.path.insert(0, str(ROOT / "docs/_ext"))
    try:
        import toml_page

        return {name: json.loads(text) for name, text in toml_page.schemas().items()}
    finally:
        sys.path.remove(str(ROOT / "docs/_ext"))


def complaints(schema, text):
    from jsonschema import Draft202012Validator

    content = json.loads(json.dumps(tomllib.loads(text), default=str))
    return [error.message for error in Draft202012Validator(schema).iter_errors(content)]


@pytest.mark.parametrize("name", ["plan.toml", "law.toml", "study.toml", "mm3a.toml"])
def test_the_json_schema_of_a_file_takes_what_the_model_takes(schemas, name):
    schema = schemas[kind_of(FILES[name])]
    assert complaints(schema, FILES[name]) == []
    assert complaints(schema, f"nonsense = 1\n{FILES[name]}")
    assert complaints(schema, FILES[name].replace("\n[[", "\n[[un"))


@pytest.mark.parametrize("name", ["absent.toml", "nul\0byte.toml", "lone\udfff.toml"])
def test_a_name_that_no_file_can_have_is_a_fault_like_any_other(name):
    with pytest.raises(InputError, match="cannot be read"):
        load_machine(name)
