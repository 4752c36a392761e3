"""Results that are corrupt, foreign or newer end with one message; those of every released version load."""

import copy
import json
import re
from pathlib import Path

import numpy as np
import pytest

from stickslip_fit.cli._options import load_fit
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import load_result
from stickslip_fit.estimation.result import VERSION, compute_checksum
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.moves import DriveCommand, calibrated_arm, dead_reckon, plan_move
from stickslip_fit.moves.prediction import predict
from stickslip_fit.reporting.moves import summarize_move, summarize_pose
from stickslip_fit.reporting.predictions import summarize_predictions

SAVED = Path(__file__).parent / "saved"
LATEST = SAVED / f"result-{VERSION}.json"
PLAN = """
[sessions]
dates = [2012-03-09]
[[sweep]]
joint = 3
q2_deg = [-90, 0]
theta_deg = -90
[[sweep]]
joint = 2
q3_mm = 6
[[sweep]]
joint = 1
q2_deg = -90
q3_mm = 12
"""
LOW, HIGH = np.array([0.0, -1.5, 0.0]), np.array([0.1, -1.0, 0.006])
NUMBERS = (0, -1, 1, 0.5, -1e-9, 1e3, 1e9, 1e30, 1e300, 1e-300, -1e300, 2**53, 10**30)
VALUES = (
    *NUMBERS,
    None,
    True,
    "",
    "x",
    "+",
    "1",
    [],
    {},
    [[]],
    [None],
    {"name": "x"},
    float("nan"),
    float("inf"),
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN)
    return read_plan(path, load_machine())


@pytest.fixture(scope="module")
def content():
    return json.loads(LATEST.read_text("utf-8"))


def use(path, plan):
    """What the commands predict, plan-move, dead-reckon and fit --causes-from do with a saved result."""
    fitted, result = load_fit([path], None)
    str(result.summary())
    summarize_predictions(result, plan, predict(fitted, plan))
    arm = calibrated_arm(result)
    summarize_move(arm, plan_move(arm, LOW, HIGH, (1, 2, 3)))
    summarize_pose(arm, dead_reckon(arm, LOW, [DriveCommand(3, "+", 500), DriveCommand(2, "-", 300)]), 1e-5)


def refused(path, plan):
    """Whether using a file ends with one InputError of one problem that names the file or what to do."""
    messages = []
    try:
        use(path, plan)
    except InputError as error:
        messages = [str(problem) for problem in error.problems]
    assert len(messages) <= 1
    assert len("".join(messages)) < 600
    return bool(messages)


def places(value, at=()):
    """The path of every key and item."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*at, key)
        yield from places(inner, (*at, key))


def damaged_content(content, rng):
    """The content with one member deleted, doubled, replaced, renamed or moved."""
    content = copy.deepcopy(content)
    every = list(places(content))
    lengths = np.array([len(at) for at in every])
    # Members near the root as often as the many numbers at the leaves.
    depth = rng.choice(np.unique(lengths))
    at = every[rng.choice(np.flatnonzero(lengths == depth))]
    parent = content
    for key in at[:-1]:
        parent = parent[key]
    key, way = at[-1], rng.integers(7)
    if way == 0:
        del parent[key]
    elif way == 1 and isinstance(parent, list):
        parent.insert(key, copy.deepcopy(parent[key]))
    elif way == 2 and isinstance(parent, dict):
        parent[f"{key}_"] = parent.pop(key)
    elif way == 3 and isinstance(parent[key], int | float):
        parent[key] = parent[key] * float(rng.choice([-1, 0, 2, 1e3, 1e-3, 1e6, 1e9]))
    elif way == 4:
        other = every[rng.integers(len(every))]
        parent[key] = copy.deepcopy(value_at(content, other))
    elif way == 5 and isinstance(parent[key], list) and len(parent[key]) > 1:
        parent[key] = parent[key][::-1]
    else:
        parent[key] = copy.deepcopy(VALUES[rng.integers(len(VALUES))])
    return content


def value_at(content, at):
    for key in at:
        content = content[key]
    return content


def damaged_bytes(raw, rng):
    """The bytes cut, flipped, doubled, filled with zeros, or nested."""
    raw, place, way = bytearray(raw), int(rng.integers(len(raw))), rng.integers(6)
    if way == 0:
        return bytes(raw[:place])
    if way == 1:
        raw[place] ^= 1 << int(rng.integers(8))
    elif way == 2:
        raw[place:place] = raw[place : place + int(rng.integers(1, 200))]
    elif way == 3:
        raw[place : place + 50] = bytes(50)
    elif way == 4:
        del raw[place : place + int(rng.integers(1, 200))]
    else:
        raw[place:place] = b"[" * int(rng.choice([10, 1000, 200_000]))
    return bytes(raw)


def try_many(count, seed, content, plan, tmp_path):
    """How many files of forged content, with a checksum that is right, and of damaged bytes are refused."""
    rng, path, numbers = np.random.default_rng(seed), tmp_path / "r.json", {"forged": 0, "bytes": 0}
    raw = LATEST.read_bytes()
    for trial in range(count):
        if trial % 4:
            forged = damaged_content(content, rng)
            forged["checksum"] = compute_checksum(forged)
            path.write_text(json.dumps(forged), encoding="utf-8")
            numbers["forged"] += refused(path, plan)
        else:
            path.write_bytes(damaged_bytes(raw, rng))
            numbers["bytes"] += refused(path, plan)
    return numbers


@pytest.mark.slow
def test_results_of_every_version_ever_released_load(plan):
    files = {int(re.search(r"(\d+)\.json$", path.name)[1]): path for path in SAVED.glob("result-*.json")}
    assert sorted(files) == list(range(1, VERSION + 1))
    for path in files.values():
        use(path, plan)
        assert load_result(path).joints[3].law.parameters[0].name == "a"


@pytest.mark.slow
def test_damaged_files_end_with_one_message(content, plan, tmp_path):
    numbers = try_many(16, 1, content, plan, tmp_path)
    assert numbers["bytes"] == 4
    assert numbers["forged"] >= 6


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(4))
def test_a_thousand_damaged_files_end_with_one_message_each(content, plan, tmp_path, seed):
    numbers = try_many(400, 100 + seed, content, plan, tmp_path)
    assert numbers["forged"] > 150


def edit(**changes):
    def apply(content):
        for name, value in changes.items():
            content[name] = value

    return apply


def at(*place, value):
    def apply(content):
        value_at(content, place[:-1])[place[-1]] = (
            value(value_at(content, place)) if callable(value) else value
        )

    return apply


def scaled(covariance, parameter, factor):
    """A covariance matrix with another standard error of one parameter."""
    factors = np.ones(len(covariance))
    factors[parameter] = factor
    return (np.array(covariance) * np.outer(factors, factors)).tolist()


def swap_joints(content):
    first, second = content["joints"][0]["law"], content["joints"][1]["law"]
    content["joints"][0]["law"], content["joints"][1]["law"] = second, first


def as_metres_were_nanometres(content):
    fit = content["joints"][2]
    fit["values"] = [[1e9 * row[0], row[1], 1e9 * row[2], 0.0, 0.0, 0.0, 0.0] for row in fit["values"]]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (edit(schema="stickslip-fit/result/2"), "made by a newer version"),
        (edit(schema="stickslip-fit/result/99999999999999"), "made by a newer version"),
        (edit(schema="stickslip-fit/diagnosis/1"), "is no saved result"),
        (edit(schema=None), "is no saved result"),
        (edit(method="guess"), "damaged result: method"),
        (edit(joints=[]), "damaged result"),
        (at("joints", value=lambda joints: joints + joints[:1]), "stands in it twice"),
        (at("joints", 0, "law", "joint", value=2), "of another joint"),
        (swap_joints, "damaged result"),
        (as_metres_were_nanometres, "no step size that can be"),
        (at("joints", 0, "covariance", 0, 0, 0, value=lambda v: -v), "covariance of joint 1 is none"),
        (at("joints", 0, "covariance", 0, 0, 1, value=lambda v: 9 * v), "covariance of joint 1 is none"),
        (at("joints", 0, "covariance", 0, value=lambda v: v[1:]), "covariance of joint 1: its shape|damaged"),
        (at("joints", 2, "covariance", 1, value=lambda v: scaled(v, 6, 1e6)), "differ between its groups"),
        (at("joints", 1, "covariance", 1, value=lambda v: scaled(v, -1, 1.1)), "differ between its groups"),
        (at("joints", 0, "repeatability", "+", "value", value=1e6), "repeatability of joint 1"),
        (at("joints", 2, "values", 0, 0, value=lambda v: 1.01 * v), "parameters: estimate of a is not what"),
        (at("machine", "ranges", "1", value=[1.0, -1.0]), "machine's ranges"),
        (at("joints", 2, "law", "causes", 0, "name", value="gremlins"), "gremlins"),
    ],
)
def test_what_is_wrong_with_a_forged_result_is_named(content, tmp_path, change, reason):
    forged = copy.deepcopy(content)
    change(forged)
    forged["checksum"] = compute_checksum(forged)
    (tmp_path / "r.json").write_text(json.dumps(forged), encoding="utf-8")
    with pytest.raises(InputError, match=reason) as caught:
        load_result(tmp_path / "r.json")
    assert len(caught.value.problems) == 1
    assert "r.json" in str(caught.value)


@pytest.mark.parametrize("depth", [100, 5_000, 200_000])
def test_lists_nested_deep_are_refused(content, tmp_path, depth):
    nested = "[" * depth + "]" * depth
    text = json.dumps(content | {"remarks": "here"}).replace('"here"', nested)
    (tmp_path / "r.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"r.json: is (no JSON|a damaged result)"):
        load_result(tmp_path / "r.json")


@pytest.mark.slow
def test_a_result_without_a_checksum_is_still_read(content, tmp_path):
    """It may come from elsewhere; all else is checked as ever."""
    del (forged := copy.deepcopy(content))["checksum"]
    (tmp_path / "r.json").write_text(json.dumps(forged), encoding="utf-8")
    assert load_result(tmp_path / "r.json").parameters.equals(load_result(LATEST).parameters)
    forged["joints"][0]["covariance"][0][0][0] = -1.0
    (tmp_path / "r.json").write_text(json.dumps(forged), encoding="utf-8")
    with pytest.raises(InputError, match="covariance of joint 1"):
        load_result(tmp_path / "r.json")


def test_a_number_that_was_edited_is_noticed(content, tmp_path):
    text = LATEST.read_text("utf-8")
    number = repr(content["joints"][1]["covariance"][0][0][1])
    assert text.count(number) >= 1
    (tmp_path / "r.json").write_text(text.replace(number, number[:5] + "9" + number[6:]), encoding="utf-8")
    with pytest.raises(InputError, match="checksum"):
        load_result(tmp_path / "r.json")
