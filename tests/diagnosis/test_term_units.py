"""Formulas of proposed terms are true as they are printed: with the units of their numbers and of k."""

import re

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit.causes.proposed import LOADS, POSITION, ZETA, ProposedTerm
from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis._summary import write_headline
from stickslip_fit.diagnosis.expressions import build_log_dictionary
from stickslip_fit.diagnosis.hypotheses import compute_changes
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.units import share_per, to_si
from tests.hidden.generate import hide
from tests.hidden.reading import read_hidden
from tests.joints.generated import machine_text, write_log

STAGE = [("rotary", (0.0, 400.0)), ("prismatic", (0.0, 25.0))]
SIX = [*STAGE, ("prismatic", (0.0, 10.0)), ("rotary", (0.0, 90.0)), ("prismatic", (0.0, 5.0))]


def read_generated(folder, joints, **options):
    (folder / "machine.toml").write_text(machine_text(joints))
    write_log(folder / "log.csv", joints, **options)
    return ssf.read_log(folder / "log.csv", machine=ssf.load_machine(folder / "machine.toml"))


def degrees(function):
    return lambda x: function(np.radians(x))


def evaluate(formula, values):
    """A formula by hand: in it are values in the units in which they are shown, and angles in degrees."""
    text, *_ = formula.split(", ")
    text = re.sub(r"(?<=\d) (?:°C|K|h|ms|%|V|g|deg|mm)(?=[)|\s]|$)", "", text).replace("/ s)", ")")
    text = re.sub(r"\|([^|]*)\|", r"abs(\1)", text).replace("^", "**")
    names = sorted(values, key=len, reverse=True)
    text = re.sub("|".join(map(re.escape, names)), lambda match: f"values[{match[0]!r}]", text)
    functions = {"sin": degrees(np.sin), "cos": degrees(np.cos), "log": np.log, "abs": abs}
    return eval(text, functions | {"values": values})


def shown_values(row, machine):
    """What a reader has of a traverse, in the units of a log and hours."""
    values = {"theta": np.degrees(row["theta"]), "psi": np.degrees(row["psi"])}
    for joint in machine.joints:
        q = row[f"q{joint}"]
        values[f"q{joint}"] = 1e3 * q if machine.is_prismatic(joint) else np.degrees(q)
    scale = {"humidity": 100.0, "step_period": 1e3, "payload": 1e3}
    for name in row.index:
        if isinstance(row[name], int | float | np.number) and name not in values:
            own = name.startswith("covariate:")
            shown = name.removeprefix("covariate:") if own else name.replace("_", " ")
            values[shown] = row[name] * scale.get(name, 1.0)
    values |= {"session time": row["session_seconds"] / 3600, "temperature": row["temperature"] - 273.15}
    values["time of day"] = row["time_of_day"] / 3600
    for minutes in (5, 20, 80):
        values[f"travels in {minutes} min"] = row[f"use_{minutes}min"]
        values[f"own travels in {minutes} min"] = row[f"joint_use_{minutes}min"]
        values[f"other travels in {minutes} min"] = row[f"other_use_{minutes}min"]
        values[f"net travels in {minutes} min"] = row[f"net_use_{minutes}min"]
        values[f"own net travels in {minutes} min"] = row[f"joint_net_use_{minutes}min"]
    for column in ("temperature", "humidity", "supply", "step_period", "payload"):
        for minutes in (10, 40):
            changed = row.get(f"{column}_change_{minutes}min", np.nan) * scale.get(column, 1.0)
            values[f"{column.replace('_', ' ')} change in {minutes} min"] = changed
    for coordinate in ("theta", "psi", "q1", "q2", "q3"):
        shown = 1e3 if coordinate == "q3" else 180.0 / np.pi
        for minutes in (10, 40):
            changed = row.get(f"{coordinate}_change_{minutes}min", np.nan)
            values[f"{coordinate} change in {minutes} min"] = shown * changed
    for minutes in (10, 20, 40, 80):
        values[f"temperature {minutes}min"] = row[f"temperature_{minutes}min"] - 273.15
    if "q2" in values:
        values["zeta"] = values["psi"] - values["q2"]
    return values | {"before direction": {"+": 1.0, "-": -1.0}.get(row["before_direction"], 0.0)}


@pytest.fixture(scope="module")
def stage_log(tmp_path_factory):
    """A turntable of which the step falls by 0.2 % for each mm of a slide that stands anywhere."""
    folder = tmp_path_factory.mktemp("stage")
    return read_generated(folder, STAGE, n=30, scatter=0.004, cross=(1, 2, -0.002), seed=1)


@pytest.fixture(scope="module")
def stage(stage_log):
    return diagnose(stage_log, gain=False)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["the arm", "a machine of six"])
def test_every_formula_is_what_it_says(source, tmp_path):
    """A k of 1 in the unit that it is shown in changes steps by that many per cent of the rest."""
    log = (
        read_hidden(hide("many", (), None, "gaussian", ("walk",), 2))
        if source == "the arm"
        else read_generated(tmp_path, SIX, n=12, cross=(1, 2, 0.0))
    )
    linearized = problem_from_log(log)[0].linearize()
    dictionary = build_log_dictionary(linearized, log.machine)
    checked = set()
    for best in range(dictionary.squares.shape[1]):
        if not np.isfinite(dictionary.squares[0, best]) or (dictionary.n_factors[best] > 1 and best % 5):
            continue
        term, _ = dictionary.make(0, best, np.ones(1))
        if {POSITION, *LOADS} & {*term.carriers}:  # of which an effect is an average along the traverse
            continue
        (parameter,) = term.parameters
        effects = -compute_changes(linearized, term, np.array([[to_si(1.0, parameter.unit)]]))[:, 0]
        acts = np.flatnonzero(effects)
        if ZETA in term.carriers:  # along a traverse of joint 2 it is one of the position
            acts = acts[linearized.rows["joint"].to_numpy()[acts] != 2]
        for place in acts[:: max(len(acts) - 1, 1)]:
            row = linearized.rows.iloc[place]
            shown = evaluate(term.formula, {"k": 1.0, **shown_values(row, log.machine)})
            assert 100 * effects[place] == pytest.approx(shown, rel=1e-5), (term.formula, parameter.unit)
            checked.add(term.formula)
    assert len(checked) > 50


@pytest.mark.slow
def test_a_slide_has_no_harmonics_whatever_its_number(stage_log, tmp_path):
    six = read_generated(tmp_path, SIX, n=12, cross=(1, 2, 0.0))
    for log, slides in ((stage_log, {"q2"}), (six, {"q2", "q3", "q5"})):
        linearized, machine = problem_from_log(log)[0].linearize(), log.machine
        dictionary = build_log_dictionary(linearized, machine)
        formulas, turned = set(), set()
        for place, best in np.argwhere(np.isfinite(dictionary.squares[: dictionary.n_single])):
            term, _ = dictionary.make(place, best, np.ones(1))
            formulas.add(term.formula.split(", ")[0])
            if "sin(position)" in term.formula:
                turned |= {joint for joint, _ in term.on}
        assert not {
            text for text in formulas for name in slides if re.search(rf"(sin|cos)\([23*]*{name}", text)
        }
        assert {f"k * {name}^2" for name in slides} <= formulas
        assert "k * sin(2*q1)" in formulas
        assert turned == {joint for joint in machine.joints if not machine.is_prismatic(joint)}


@pytest.mark.slow
def test_a_term_in_a_slide_is_told_in_mm_and_true_as_told(stage):
    (finding,) = stage.findings
    assert finding.term == "k * q2, joint 1"
    first, second = write_headline(stage)
    size = float(re.search(r"k = (−[\d.]+) ± [\d.]+ %/mm", first)[1].replace("−", "-"))
    assert size == pytest.approx(-0.2, abs=0.02)
    places = re.findall(r"joint 1 at q2 = ([\d.]+) mm \(steps ([+−][\d.]+) %\)", second)
    told = np.array([[float(x.replace("−", "-")) for x in one] for one in places])
    assert told.shape == (2, 2)
    assert told[:, 0].min() < 3 < 22 < told[:, 0].max() <= 25
    assert told[:, 1] == pytest.approx(size * told[:, 0], abs=0.06)


@pytest.mark.slow
def test_json_and_the_law_have_the_unit_of_k(stage):
    (finding,) = diagnosis_to_json(stage)["findings"]
    (k,) = finding["parameters"]
    assert (k["unit"], finding["term"]) == ("%/mm", "k * q2, joint 1")
    assert k["low"] < -0.2 < k["high"]
    law = stage.extended_law()
    last = law.parameters.iloc[-1]
    assert (last["unit"], last["estimate"]) == ("%/mm", pytest.approx(k["estimate"], rel=0.02))
    assert re.search(r"%/mm +size of the proposed term k \* q2, joint 1", str(law))


def test_a_term_of_an_earlier_version_says_what_it_computes():
    """The number by which it is divided was never that of the largest value."""
    term = ProposedTerm((("x", "session_seconds", 0.0, 6551.5),), ((2, "+"), (2, "-")))
    assert (term.formula, term.parameters[0].unit) == ("k * (session time / 6551.5), joint 2", "%")


@pytest.mark.parametrize(
    ("powers", "symbol", "si"),
    [
        ({}, "%", 0.01),
        ({"mm": 1}, "%/mm", 10.0),
        ({"deg": 2}, "%/deg²", 0.01 * (180 / np.pi) ** 2),
        ({"h": 1, "mm": 2}, "%/(mm² h)", 1e4 / 3600),
    ],
)
def test_units_of_a_share_for_each_unit_of_coordinates(powers, symbol, si):
    assert share_per(powers) == symbol
    assert to_si(1.0, symbol) == pytest.approx(si)


def test_the_time_of_a_session_is_in_hours(tmp_path):
    """Of joint 1 alone, by 0.6 % an hour."""
    log = read_generated(tmp_path, STAGE[:1], n=40, scatter=0.002, drift=0.006)
    linearized = problem_from_log(log)[0].linearize()
    dictionary = build_log_dictionary(linearized, log.machine)
    terms = (
        dictionary.make(0, m, dictionary.coefficients(0, m, linearized.residual))
        for m in range(dictionary.squares.shape[1])
    )
    term, start = next(one for one in terms if one[0].formula == "k * session time")
    assert term.parameters[0].unit == "%/h"
    assert start[0] / to_si(1.0, "%/h") == pytest.approx(0.6, rel=0.05)
