import base64
import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from stickslip_fit.estimation import held_out_errors
from stickslip_fit.reporting.headline import write_headline
from stickslip_fit.strategies.claims import PRISMATIC_CLAIMS, ROTARY_CLAIMS
from tests.conftest import CALIBRATION_3
from tests.reporting.conftest import hours_in_session
from tests.thesis.published import value as published

ROOT = Path(__file__).parents[2]


TURNS = (
    *CALIBRATION_3,
    *({"joint": 3, "q2_deg": -90.0, "psi_deg": psi} for psi in (-60.0, -30.0, 30.0, 60.0) * 3),
)


def number(cell):
    return float(cell.replace("−", "-").replace(",", "").rstrip("*†"))


def half_a_digit(cell):
    """How far a printed number may be from the one it stands for."""
    decimals = len(cell.rstrip("*†").partition(".")[2])
    return 0.5 * 10.0**-decimals * 1.0001


def test_the_page_needs_nothing_but_itself(whole):
    for tag, attributes in whole.page.elements:
        assert tag not in {"link", "iframe", "object", "embed", "base", "img", "form"}
        for name, value in attributes.items():
            assert not name.startswith("on"), (tag, name)
            assert name != "style", tag
            if name in {"href", "xlink:href", "src", "action", "data"}:
                assert value.startswith(("#", "data:image/png;base64,")), (tag, name, value)
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)|fetch\(|XMLHttp|innerHTML|eval\(", whole.source)


def test_the_policy_trusts_this_style_and_this_script_alone(whole):
    (policy,) = [a["content"] for _, a in whole.page.elements if a.get("http-equiv")]
    rules = {name: set(rest) for name, *rest in map(str.split, policy.split(";"))}
    (style,) = re.findall(r"<style>(.*?)</style>", whole.source, re.DOTALL)
    (script,) = re.findall(r"<script>(.*?)</script>", whole.source, re.DOTALL)
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == {"'none'"}
    assert rules["style-src"] == {sha256(style)}
    assert rules["script-src"] == {sha256(script)}
    assert rules["img-src"] == {"data:"}
    assert whole.source.index("http-equiv") < whole.source.index("<style>")


def sha256(text):
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def test_anchors_and_names_are_unique_and_lead_somewhere(whole):
    names = [attributes["id"] for _, attributes in whole.page.elements if "id" in attributes]
    assert len(names) == len(set(names))
    wanted = {
        value[1:]
        for _, attributes in whole.page.elements
        for name, value in attributes.items()
        if name in {"href", "xlink:href"} and value.startswith("#")
    }
    wanted |= set(re.findall(r"url\(#([^)]+)\)", whole.source))
    assert wanted <= set(names)


def test_tables_and_figures_can_be_read_aloud(whole):
    tags = [tag for tag, _ in whole.page.elements]
    assert tags.count("caption") == tags.count("table") > 10
    assert all(caption for caption in whole.page.tables)
    for tag, attributes in whole.page.elements:
        if tag == "th":
            assert attributes["scope"] in {"col", "row", "colgroup"}
        if attributes.get("role") == "img":
            assert len(attributes["aria-label"]) > 80
    assert not re.search(r"<th[^>]*>\s*</th>", whole.source), "a head without a word"
    assert sum("role" in a and a["role"] == "img" for _, a in whole.page.elements) == tags.count("figure")


def test_every_table_is_rectangular(whole):
    for caption, rows in whole.page.tables.items():
        assert {len(row) for row in rows} == {len(whole.page.heads[caption])}, caption


@pytest.mark.slow
def test_the_same_log_gives_the_same_bytes(campaign, reported):
    made = reported(campaign(("2012-03-05",), TURNS[:3]))
    assert made.html == made.source


def test_parameters_on_the_page_are_those_of_the_results(whole):
    scale = {"nm": 1e9, "µrad": 1e6, "µrad/mm": 1e3, "1": 1.0}
    for result, estimator in ((whole.calibration, "closed form"), (whole.fit, "least squares")):
        found = result.si.parameters
        for row in found.itertuples():
            caption = f"Parameters of joint {row.joint} ({'prismatic' if row.joint == 3 else 'rotary'})"
            unit = "" if row.unit == "1" else row.unit
            cells = [
                cell
                for line, cell in zip(
                    whole.page.tables[caption], whole.page.column(caption, f"{row.name}{unit}"), strict=True
                )
                if line[:3] == [row.session, row.direction.replace("-", "−"), estimator]
            ]
            (cell,) = cells
            value, error = cell.rstrip("*").split(" ± ")
            assert abs(number(value) - row.estimate * scale[row.unit]) <= half_a_digit(value)
            assert abs(number(error) - row.standard_error * scale[row.unit]) <= half_a_digit(error)


def test_the_accuracy_of_the_prismatic_joint_by_hand(campaign, whole):
    """Chapter 7 again, from the counts alone: calibrate on three configurations, predict the rest."""
    table = campaign()
    table = table[(table["joint"] == 3) & (table["direction"] == "+")]
    errors = []
    for _, session in table.groupby("session"):
        gamma = 12e6 / (session["steps"] - 2.5)
        q2, theta, psi = (np.radians(session[f"{name}_deg"]) for name in ("q2", "theta", "psi"))
        first = {}
        for index, key in zip(session.index, zip(q2, theta, psi, strict=True), strict=True):
            first.setdefault(tuple(np.degrees(key).round()), index)
        plain, recoiling, loaded = (
            gamma[first[key]] for key in ((-90.0, 0.0, 0.0), (0.0, -90.0, 0.0), (0.0, 0.0, 0.0))
        )
        used = [first[key] for key in ((-90.0, 0.0, 0.0), (0.0, -90.0, 0.0), (0.0, 0.0, 0.0))]
        b = 1 - recoiling / plain
        c = plain - loaded / (1 - b)
        law = (1 - b * abs(np.cos(q2))) * (plain - c * np.cos(psi - q2) * np.cos(theta))
        errors.append((law - gamma).drop(used).to_numpy())
    error = np.concatenate(errors)
    caption = "Accuracy of joint 3 (prismatic) by direction"
    rms = whole.page.column(caption, "rmsnm")[0]
    assert abs(number(rms) - np.sqrt(np.mean(error**2))) <= half_a_digit(rms)
    worst = whole.page.column(caption, "worstnm")[0]
    assert abs(number(worst) - error[np.argmax(abs(error))]) <= half_a_digit(worst)
    assert whole.page.column(caption, "traverses")[0] == str(len(error))


@pytest.mark.slow
def test_what_a_correct_law_cannot_explain_is_said(campaign, fitted, whole):
    assert "no more than repeatability and the calibration's own uncertainty explain" in whole.page.text
    warming = campaign(settings=TURNS)
    grown = warming["steps"] * (1 + 0.05 * (1 - np.exp(-hours_in_session(warming))))
    warming["steps"] = (grown / 5).round().astype(int) * 5
    made = fitted(warming)
    errors = held_out_errors(made.log, made.calibration).si
    told = " ".join(write_headline(made.log, made.calibration, errors))
    assert "that is more than repeatability and the calibration's own uncertainty explain" in told
    assert "mostly have one sign" in told


def test_claims_are_the_published_ones():
    law = {(c.limit, c.unit) for c in PRISMATIC_CLAIMS if c.model == "law"}
    wide, nanometres = published("abstract_accuracy_prismatic")
    assert law == {(wide, "%"), (published("chapter_accuracy_prismatic"), "%"), (nanometres, "nm")}
    law = {(c.limit, c.unit) for c in ROTARY_CLAIMS if c.model == "law"}
    share, microradians = published("abstract_accuracy_rotary")
    assert law == {(share, "%"), (microradians, "µrad"), (published("conclusion_accuracy_rotary")[1], "µrad")}
    constant = [c.limit for c in (*PRISMATIC_CLAIMS, *ROTARY_CLAIMS) if c.model == "constant step"]
    assert constant == [published("constant_step_error_prismatic"), published("constant_step_error_rotary")]


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_claims_table_counts_traverses(whole, joint):
    errors = held_out_errors(whole.log, whole.calibration, whole.constant).si
    subset = errors[errors["joint"] == joint]
    limit, scale = (100.0, 1e9) if joint == 3 else (1.0, 1e6)
    within = sum(abs(row.law - row.measured) * scale <= limit for row in subset.itertuples()) / len(subset)
    rows = whole.page.tables["The thesis's claims and this log"]
    unit = "nm" if joint == 3 else "µrad"
    (shown,) = (
        row[3]
        for row in rows
        if row[0].startswith(f"joint {joint}") and row[1] == "law" and row[2] == f"±{limit:g} {unit}"
    )
    assert shown == (f"{100 * within:.0f}" if not 99 < 100 * within < 100 else ">99")
