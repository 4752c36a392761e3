"""A diagnosis as people see it: page, section, notebook, figures; and the verb that makes them."""

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

from stickslip_fit._format import NO_BREAK_SPACE
from stickslip_fit.diagnosis import Diagnosis, Gain, NextTraverse, diagnose
from stickslip_fit.diagnosis._summary import write_headline
from stickslip_fit.diagnosis.cause_set import cause_probabilities
from stickslip_fit.diagnosis.residuals import compare_residuals, compute_shape
from stickslip_fit.errors import InputError
from stickslip_fit.machine import load_machine
from stickslip_fit.plotting.diagnosis import (
    compute_confusion_rates,
    list_selection_steps,
    plot_gain,
    plot_ranking,
)
from stickslip_fit.plotting.residuals import draw_finding, draw_residuals_overview
from stickslip_fit.reporting.diagnosis import diagnosis_page, number_residuals
from tests.reporting.conftest import hours_in_session

SETTINGS = tuple(
    {"joint": 3, "q2_deg": q2, "theta_deg": theta} for q2 in (-90.0, -45.0, 0.0) for theta in (0.0, -60.0)
)
SESSIONS = ("2012-03-05", "2012-03-06", "<i>third</i>")
DATES = ("2012-03-05", "2012-03-06", "2012-03-07")


@pytest.fixture(scope="module")
def drifting(campaign):
    """Three sessions, one with markup in its name, in which steps shrink by 0.3 % an hour."""
    table = campaign(DATES, SETTINGS, replicates=4)
    steps = np.round(table["steps"] * (1.0 + 0.003 * hours_in_session(table)) / 5.0).astype(int) * 5
    return table.assign(
        steps=steps, session=table["session"].replace(dict(zip(DATES, SESSIONS, strict=True)))
    )


@pytest.fixture(scope="module")
def made(drifting, fitted):
    return fitted(drifting, "drifting.csv")


@pytest.fixture(scope="module")
def found(made) -> Diagnosis:
    """With a gain and traverses that would tell, as if they had been worked out."""
    sessions = pd.DataFrame(
        {
            "session": SESSIONS,
            "baseline": [0.01, 0.02, 0.03],
            "extended": [0.003, 0.004, 0.005],
            "traverses": 8,
        }
    )
    gain = Gain(0.0216, 0.0041, 0.0027, 0.012, 0.021, sessions)
    traverse = NextTraverse(
        *("new", 3, "-", 0.0, -np.pi / 4, np.nan, 0.0, 0.0, np.nan, np.nan, 4),
        *(("drift", "thermal-warm-up"), "late"),
    )
    decided = diagnose(made.log, alpha=0.02, gain=False)
    (drift,) = decided.findings
    rate = replace(drift.parameters[0], session=SESSIONS[-1])
    return replace(
        decided,
        findings=(replace(drift, parameters=(rate,)),),
        gain=gain,
        gain_new_session=gain,
        next_experiment=(traverse,),
    )


@pytest.fixture(scope="module")
def source(found):
    return diagnosis_page(found, command="stickslip-fit diagnose drifting.csv")


@pytest.fixture(scope="module")
def page(source, read_page):
    return read_page(source)


def unspaced(text: str) -> str:
    return text.replace(NO_BREAK_SPACE, " ")


def test_the_page_begins_with_the_answer(page, found):
    text = unspaced(page.text)
    places = [text.index(unspaced(sentence).replace(" deg", "°")) for sentence in write_headline(found)]
    assert places == sorted(places)
    assert places[-1] < text.rindex("The evidence") < text.rindex("What else it could be")


def test_the_tables_hold_the_diagnosis(page, found):
    (finding,) = found.findings
    assert page.column("What is wrong", "found") == ["drift"]
    assert float(page.column("What is wrong", "effect, rms%")[0]) == pytest.approx(
        100 * finding.effect.estimate, abs=0.006
    )
    assert page.column("What the extended law gains", "published law%")[0] == "2.16"
    assert page.column("Discriminating traverses", "q2") == ["−45°"]
    assert page.column("Discriminating traverses", "from") == ["stop"]
    unseen = " ".join(page.texts)
    assert all(cause in unseen for cause in found.untestable)


def test_nothing_is_fetched_and_nothing_is_run(page):
    tags = {tag for tag, _ in page.elements}
    assert not tags & {"script", "img", "link", "iframe"}
    references = [attrs.get("href", "#") for _, attrs in page.elements]
    assert all(reference.startswith(("#", "data:image/png;base64,")) for reference in references)
    names = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(names) == len(set(names))


def test_markup_in_a_session_stays_text(page):
    assert page.column("Parameters of what was named", "of") == ["session <i>third</i>"]
    assert "i" not in {tag for tag, _ in page.elements}


def test_every_figure_says_in_words_what_to_see(page, found):
    cards = [attrs for _, attrs in page.elements if attrs.get("role") == "img"]
    labels = " ".join(card["aria-label"] for card in cards)
    assert "drift: residuals before and after" in labels
    assert "Residuals against each quantity, joint 3" in labels
    assert "How likely each cause is" in labels
    assert "Errors on held-out traverses" in labels


@pytest.mark.nightly
def test_the_same_diagnosis_gives_the_same_page(found, source):
    assert diagnosis_page(found, command="stickslip-fit diagnose drifting.csv") == source


def test_a_notebook_shows_the_answer_and_the_tables(found, read_page):
    shown_there = read_page(found._repr_html_())
    assert unspaced(write_headline(found)[0]) in unspaced(shown_there.text)
    assert {"What is wrong", "Candidate causes", "What the extended law gains"} <= set(shown_there.tables)


def test_before_shows_the_drift_and_after_shows_none(found):
    left = compare_residuals(found.selection, found.seed)
    look = found.selection.selected[0]
    shape = compute_shape(look, found.selection.problem.linearize())
    label, figure = draw_finding(found.findings[0], look, shape, left, load_machine())
    assert label == "hours in session"
    points = [line for axis in figure.axes for line in axis.lines if line.get_linestyle() == "None"]
    assert len(points) > 0
    assert not any(line.get_clip_on() for line in points)  # those at the edge are whole
    slopes = []
    for axis in figure.axes:
        lines = [line for line in axis.lines if line.get_marker() == "o" and line.get_linestyle() == "-"]
        slopes.append([np.polyfit(line.get_xdata(), line.get_ydata(), 1)[0] for line in lines])
    before, after = slopes
    assert before == pytest.approx([0.3, 0.3], rel=0.25)
    assert after == pytest.approx([0.0, 0.0], abs=0.06)


def test_a_panel_for_everything_that_varied(found):
    left = compare_residuals(found.selection, found.seed)
    labels = {axis.get_xlabel() for axis in draw_residuals_overview(3, left, load_machine()).axes} - {""}
    assert {"hours in session", "load along the axis", "q2 (°)", "theta (°)"} <= labels
    assert "psi (°)" not in labels


def test_the_ranking_has_a_look_for_each_cause_and_one_for_what_is_left(found):
    steps = list_selection_steps(found)
    assert [named for _, _, named, _ in steps] == ["drift", ""]
    figure = plot_ranking(found)
    first = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    last = [label.get_text() for label in figure.axes[1].get_yticklabels()]
    assert first[0] == "drift"
    assert last[0] == "chance alone"
    ends = [10 ** float(line.get_xdata()[-1]) for line in figure.axes[1].lines[::2]]
    assert ends[0] == pytest.approx(
        1.0 - sum(cause_probabilities(found.selection.last_misfit.log_evidence_by_cause).values())
    )
    assert sum(ends) <= 1.0 + 1e-9


def test_the_gain_of_each_session_is_drawn(found):
    axis = plot_gain(found).axes[0]
    before, after, floor = (line.get_ydata() for line in axis.lines)
    assert list(before) == pytest.approx([1.0, 2.0, 3.0])
    assert list(after) == pytest.approx([0.3, 0.4, 0.5])
    assert floor[0] == pytest.approx(0.27)


def test_confusion_falls_with_strength_and_hard_pairs_stay_hard(found):
    causes = ["drift", "thermal-warm-up", "theta-offset"]
    weak, strong = (
        compute_confusion_rates(causes, found.selection.first_misfit, strength) for strength in (4.0, 40.0)
    )
    assert np.all(strong[np.isfinite(strong)] <= weak[np.isfinite(weak)])
    assert weak[1, 0] > 0.2 > weak[2, 0]


def test_a_picture_of_what_is_not_there_is_refused(found):
    assert found.plot_residuals().size
    assert found.plot_ranking().size
    assert found.plot_gain().size
    with pytest.raises(InputError, match="there is no finding 1"):
        found.plot_residuals(1)
    with pytest.raises(InputError, match="no gain"):
        replace(found, gain=None).plot_gain()


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 3, pytest.param(30, marks=pytest.mark.nightly)])
def test_a_page_of_hardly_anything(drifting, read_table, read_page, rows):
    diagnosis = diagnose(read_table(drifting.head(rows), "few.csv"), alpha=0.1, gain=False)
    source = diagnosis_page(diagnosis)
    assert unspaced(write_headline(diagnosis)[0]).replace(" deg", "°") in unspaced(read_page(source).text)
    assert diagnosis_page(diagnosis) == source


@pytest.fixture
def run(run):
    return partial(run, "diagnose")


@pytest.mark.slow
def test_the_verb_answers_and_saves(run, campaign, tmp_path):
    campaign(DATES[:2], SETTINGS, replicates=3).to_csv(tmp_path / "log.csv", index=False)
    outputs = ("--json", tmp_path / "out.json", "--report", tmp_path / "out.html")
    status, out, err = run(tmp_path / "log.csv", *outputs, "--alpha", 0.02, "--seed", 3)
    assert (status, err) == (0, "")
    assert out.startswith("Nothing is wrong that this log can show")
    content = json.loads((tmp_path / "out.json").read_text("utf-8"))
    assert (content["verdict"], content["seed"], content["log"]["file"]) == ("nothing wrong", 3, "log.csv")
    assert "stickslip-fit diagnose" in (tmp_path / "out.html").read_text("utf-8")


@pytest.mark.slow
def test_the_same_seed_gives_the_same_answer(run, campaign, tmp_path):
    campaign(DATES[:1], SETTINGS, replicates=3).to_csv(tmp_path / "log.csv", index=False)
    texts = []
    for name in ("one.json", "two.json"):
        run(tmp_path / "log.csv", "--json", tmp_path / name, "--alpha", 0.1)
        texts.append(re.sub(r'"seconds": [\d.]+', "", (tmp_path / name).read_text("utf-8")))
    assert texts[0] == texts[1]


def test_what_cannot_be_written_is_refused_before_the_work(refused, campaign, tmp_path, monkeypatch):
    campaign(DATES[:1], SETTINGS).to_csv(tmp_path / "log.csv", index=False)
    monkeypatch.setattr(
        "stickslip_fit.cli.diagnose.diagnose_with_progress", lambda *_: pytest.fail("worked before refusing")
    )
    for option in ("--json", "--report"):
        assert "cannot be written" in refused(tmp_path / "log.csv", option, tmp_path / "nowhere" / "out")
    same = tmp_path / "out"
    refused(tmp_path / "log.csv", "--json", same, "--report", same)


def test_a_log_that_cannot_be_read_leaves_no_file(run, campaign, tmp_path):
    campaign(DATES[:1], SETTINGS).drop(columns="steps").to_csv(tmp_path / "log.csv", index=False)
    status, out, err = run(tmp_path / "log.csv", "--json", tmp_path / "out.json")
    assert (status, out) == (2, "")
    assert "steps" in err
    assert not (tmp_path / "out.json").exists()


def test_points_of_the_evidence_are_numbered_as_in_the_log(found, made, monkeypatch):
    usable = made.log.usable
    assert list(number_residuals(found).rows.index) == list(usable.index)
    wild = pd.DataFrame(index=[0, 5])
    left = replace(
        compare_residuals(found.selection, 0), rows=usable.drop(index=wild.index).reset_index(drop=True)
    )
    monkeypatch.setattr("stickslip_fit.reporting.diagnosis.compare_residuals", lambda *_: left)
    rows = number_residuals(replace(found, findings=(replace(found.findings[0], traverses=wild),))).rows
    assert (rows["time"] == usable.loc[rows.index, "time"]).all()
