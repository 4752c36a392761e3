"""What people read of a table's diagnosis: its unit, rows and values, never steps or per cent of them."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.diagnosis import save_diagnosis
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis.withdrawal import withdraw_causes
from tests.table.bench import BY_DIRECTION, CUBIC, LAW, bench
from tests.table.conftest import diagnosed

WORDS_OF_LOGS = re.compile(
    r"\b(logs?|traverses?|joints?|step size|steps? taken|counts|published|misfires?|recalibrat\w+)\b", re.I
)


def visible(page):
    return re.sub(r"<style.*?</style>|<[^>]+>", " ", page, flags=re.S)


@pytest.fixture(scope="session")
def outlying():
    frame = bench(2, n=200)
    frame.loc[[50, 150], "F"] += 5.0
    return diagnosed(frame, gain=False)


@pytest.fixture(scope="session")
def unnamed():
    frame = bench(2, n=200, difference=0.0)
    frame["F"] += 0.5 * np.sin(8 * frame["q"] / 0.1)
    return ssf.diagnose_table(
        frame, LAW, position="q", causes=[BY_DIRECTION, CUBIC], generic_causes=(), gain=False
    )


CASES = ("named", "independent", "nothing", "outlying", "unnamed")


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [pytest.param(one, marks=[pytest.mark.nightly] * (one in ("outlying", "independent"))) for one in CASES],
)
def test_no_word_of_a_log_is_in_text_notebook_or_page(case, request):
    diagnosis = request.getfixturevalue(case)
    for text in (str(diagnosis), visible(diagnosis._repr_html_()), visible(ssf.report(diagnosis).html)):
        assert not WORDS_OF_LOGS.findall(text)
        assert "nan" not in text.split()


def test_the_answer_is_in_the_responses_unit(named):
    text, table = " ".join(str(named).split()), named.table
    assert "Viscous friction differs between directions (dFv = 1." in text
    given = r"\(each given those before it: from 0\.\d{3} N to 0\.\d{3} N\)"
    assert re.search(rf"from 0\.\d{{3}} N to 0\.\d{{3}} N {given}; the noise is 0\.\d{{3}} N", text)
    assert f"tell as much as about {round(table.independent)} independent ones" in text
    assert f"({0.01 * table.correlation_rows:.4f} s)" in text


def test_verdicts(named, nothing, outlying, unnamed):
    assert named.verdict == "cause named"
    assert nothing.verdict == "nothing wrong"
    assert [finding.cause for finding in outlying.findings] == ["outliers", "viscous-by-direction"]
    assert unnamed.verdict == "unknown cause"
    assert "Nothing is wrong that this table can show" in str(nothing)
    text = " ".join(str(outlying).split())
    rows = outlying.findings[0].traverses["departure"].abs().sort_values(ascending=False).index + 1
    assert f"2 values of F do not belong to the rest: row {rows[0]} (" in text
    assert re.search(rf"row {rows[0]} \([+−][\d.]+ N\) and row {rows[1]} \([+−][\d.]+ N\)", text)


def test_structure_without_a_name_says_what_to_do_next(unnamed):
    text = " ".join(str(unnamed).split())
    assert re.search(r"The law extended by the (smooth function|proposed term) leaves", text)
    assert re.search(
        r"What to do: find out what the (function|term) stands for .*, and diagnose again\.", text
    )


def test_json_says_what_per_cent_are_of(named, file):
    content, gain = diagnosis_to_json(named), named.gain
    sd = float(np.std(bench(1, phi=0.6)["F"]))
    assert content["response"] == {"name": "F", "unit": "N", "standard_deviation": pytest.approx(sd)}
    assert content["log"]["runs"] == 300
    assert (content["log"]["file"], content["log"]["joints"]) == (file.name, [])
    assert len(content["log"]["sha256"]) == 64
    assert content["gain"]["baseline_pct"] == pytest.approx(100 * gain.baseline / sd)
    assert content["gain"]["metric"] == "held-out rms error of F, % of its standard deviation"
    (finding,) = content["findings"]
    effect = named.findings[0].effect.estimate
    assert finding["effect_rms_pct"]["estimate"] == pytest.approx(100 * effect / sd)
    assert finding["joints"] == []
    (parameter,) = finding["parameters"]
    assert (parameter["name"], parameter["unit"]) == ("dFv", "N s/m")
    assert parameter["estimate"] == named.findings[0].parameters[0].size.estimate
    assert content["table"]["independent_values"] == named.table.independent
    assert content["next_experiment"] == []


def test_outliers_in_json_are_in_the_responses_unit(outlying):
    sizes = {one["name"]: one for one in diagnosis_to_json(outlying)["findings"][0]["parameters"]}
    assert sizes["size"]["unit"] == "N"
    assert sizes["size"]["estimate"] == pytest.approx(5.0, abs=0.7)
    assert sizes["share"]["estimate"] == pytest.approx(100 * 2 / 200)
    assert "+5." in str(outlying)


@pytest.fixture(scope="module")
def reported(named):
    return ssf.report(named, command="stickslip-fit diagnose-table bench.csv")


def test_json_is_a_file_and_the_table_is_kept(named, reported, file, tmp_path):
    save_diagnosis(named, tmp_path / "out.json")
    assert json.loads((tmp_path / "out.json").read_text("utf-8"))["verdict"] == "cause named"
    before = file.read_bytes()
    for save in (lambda: save_diagnosis(named, file), lambda: reported.save(file)):
        with pytest.raises(ssf.InputError):
            save()
    assert file.read_bytes() == before


def test_causes_that_cannot_be_told_apart_say_what_would_separate_them():
    twin = ssf.Cause(
        "viscous-twin",
        "+ k*(abs(vel) + 0.001*vel)",
        "k in N s/m",
        shows_best="at speeds far apart",
        phrase="a twin",
    )
    one = replace(BY_DIRECTION, shows_best="at any speed")
    diagnosis = ssf.diagnose_table(bench(1), LAW, causes=[one, twin], generic_causes=(), gain=False)
    assert diagnosis.verdict == "cannot tell apart"
    text = " ".join(str(diagnosis).split())
    assert "This table cannot tell what is wrong" in text
    assert "for viscous-twin, at speeds far apart" in text


def test_a_response_of_any_size_has_sensible_digits():
    """The same in nanonewtons, but in newtons: no number is 0.000."""
    frame = bench(1)
    frame["F"] *= 1e-9
    text = str(ssf.diagnose_table(frame, LAW, causes=[BY_DIRECTION], generic_causes=(), gain=False))
    assert "×10⁻⁹" in text
    assert "0.000 " not in text


@pytest.mark.parametrize("case", CASES)
def test_every_figure_is_drawn_with_units(case, request):
    diagnosis = request.getfixturevalue(case)
    panels = diagnosis.plot_columns()
    assert panels[0].get_ylabel() == "residual (N)"
    assert {"vel (m/s)", "acc (m/s²)"} <= {panel.get_xlabel() for panel in panels}
    for number, finding in enumerate(diagnosis.findings):
        if finding.traverses is None:
            assert diagnosis.plot_residuals(number)[0].get_ylabel().endswith("residual (N)")
    diagnosis.plot_ranking()
    assert diagnosis.extended_law().plot_measured()[0].get_ylabel() == "F measured (N)"


def test_the_residuals_figure_shows_the_finding_taken_away(named):
    before, after = named.plot_residuals(0)
    assert after.get_xlabel() == "vel (m/s)"

    def mean_size(axis):
        (bars,) = axis.containers
        return np.abs(bars.lines[0].get_ydata()).max()

    assert mean_size(after) < 0.3 * mean_size(before)


def test_the_page_has_the_law_the_evidence_and_what_could_not_be_tested(reported):
    page = reported.html
    for part in ('id="law"', 'id="evidence"', 'id="alternatives"', 'id="unseen"', "viscous-by-direction.dFv"):
        assert part in page
    assert page.count("<svg") >= 3
    assert "independent ones" in page
    assert "stickslip-fit diagnose-table bench.csv" in page


def test_no_cause_no_log():
    diagnosis = ssf.diagnose_table(bench(1), LAW, causes=[CUBIC], generic_causes=(), gain=False)
    with pytest.raises(ssf.InputError, match="not of a log"):
        diagnosis.require_log()


def withdrawn(diagnosis, **changes):
    """What a finding whose gain is changed is replaced by."""
    (finding,) = diagnosis.findings
    poor = replace(finding, gain=replace(finding.gain, **changes))
    _, (unknown,) = withdraw_causes(diagnosis.selection, [poor], [poor], diagnosis.table)
    return unknown


def test_a_cause_that_is_withdrawn_has_its_reason_in_the_responses_unit(named):
    before = named.gain.given_before[0]
    worse = withdrawn(named, extended=2.0 * named.gain.baseline, given_before=(before, 2.0 * before))
    assert worse.cause == "unknown"
    held_out = "held-out rows, each given those before it, are"
    errors = r"predicted better with it \(0\.\d+ N, without it 0\.\d+ N\)"
    assert re.search(rf"{held_out} not {errors}", worse.note)
    open_gain = withdrawn(named, low=-2.0 * named.gain.baseline)
    assert re.search(rf"{held_out} {errors}, but in a replicate", open_gain.note)


def days():
    rng = np.random.default_rng(3)
    frame = pd.DataFrame({"day": np.repeat([f"day {k}" for k in range(6)], 30), "x": rng.uniform(0, 10, 180)})
    frame["T"] = rng.uniform(18, 24, 180)
    noise = 0.2 * rng.standard_normal(180)
    return frame.assign(y=2 * frame["x"] + 5 + 0.3 * frame["T"] + noise)


@pytest.mark.slow
def test_a_generic_cause_is_named_with_its_column_and_sessions_stand_in_their_order():
    law = ssf.Law("y ~ slope*x + offset", units={"y": "mV", "x": "mm", "slope": "mV/mm", "offset": "mV"})
    diagnosis = ssf.diagnose_table(days(), law, session="day")
    assert [finding.cause for finding in diagnosis.findings] == ["covariate:T"]
    said = r"^The response follows the column T, by 0\.\d+ mV rms; beyond the law y rises with T\."
    assert re.search(said, str(diagnosis))
    assert list(diagnosis.gain.by_session["session"]) == [f"day {k}" for k in range(6)]
    assert diagnosis.gain.by_session["rows"].sum() == 180
    labels = [label.get_text() for label in diagnosis.plot_gain()[0].get_xticklabels()]
    assert sorted(labels) == [f"day {k}" for k in range(6)]


def test_a_table_has_no_next_experiment(named):
    assert ssf.next_experiment(named) == ()


def test_rows_have_the_numbers_that_they_have_in_the_file():
    """Rows are put in order of time and session before anything is computed."""
    rng = np.random.default_rng(3)
    x = rng.uniform(0.0, 10.0, 80)
    frame = pd.DataFrame({"t": np.arange(80.0), "run": np.tile(["a", "b"], 40), "x": x})
    frame["y"] = 1.0 + 0.5 * x + 0.2 * rng.standard_normal(80)
    frame = frame.sample(frac=1.0, random_state=1, ignore_index=True)
    frame.loc[[30, 61], "y"] += 30.0
    found = ssf.diagnose_table(frame, "y ~ a + b*x", time="t", session="run", gain=False)
    (table,) = [one for one in found.summary().sections[0].tables if one.caption == "Outlying values"]
    assert sorted(int(row[0]) for row in table.rows) == [31, 62]


@pytest.mark.slow
def test_where_nothing_is_wrong_the_rows_to_check_are_told():
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"x": rng.normal(27.0, 5.0, 66).round()})
    frame.loc[1, "x"] = -2.0
    found = ssf.diagnose_table(frame, "x ~ a", time="order", gain=False)
    assert found.verdict == "nothing wrong"  # tails as heavy as Student's t with 5 df may do that
    assert "Check row 2 (" in " ".join(found.summary().headline)
    bare = ssf.diagnose_table(frame, "x ~ a", gain=False)
    assert "no column beside the response could explain it" in bare.summary().headline[0]


def test_what_came_closest_to_an_alarm_is_told():
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 10.0, 40)
    headlines = []
    for size in (0.0, 0.03):
        y = 1.0 + 0.5 * x + size * (x - 5.0) ** 2 + 0.5 * rng.standard_normal(40)
        found = ssf.diagnose_table(pd.DataFrame({"x": x, "y": y}), "y ~ a + b*x", gain=False)
        headlines.append((found.p_value, " ".join(found.summary().headline)))
    for p_value, headline in headlines:
        assert ("Closest to an alarm" in headline) == (0.01 < p_value < 0.075)
    assert "y follows x beyond the law" in headlines[1][1]


def test_a_table_with_too_few_rows_says_how_many_are_needed():
    x = np.arange(7.0)
    frame = pd.DataFrame({"x": x, "y": 1.0 + 2.0 * x + np.random.default_rng(0).standard_normal(7)})
    found = ssf.diagnose_table(frame, "y ~ a + b*x")
    text = " ".join(str(found).split())
    assert "too few rows to test: 7 for the law's 2 parameters, and at least 8 are needed; add 1." in text
    assert "session" not in text
    extended = pd.concat([frame, pd.DataFrame({"x": [7.0], "y": [15.5]})])
    assert np.isfinite(ssf.diagnose_table(extended, "y ~ a + b*x").repeatability)
