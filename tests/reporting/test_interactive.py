"""What the page's script is given: the log's own traverses, few enough, as data that stays data."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import spearmanr

from stickslip_fit._summary import embed_json
from stickslip_fit.plotting._style import select_recent, thin_rows
from stickslip_fit.plotting.residuals import FIT_MAX_POINTS
from stickslip_fit.reporting import report
from stickslip_fit.reporting.traverses import (
    MAX_OUTLYING,
    MAX_TRAVERSES,
    make_traverses_payload,
    thin_traverses,
)
from tests.conftest import CALIBRATION


@pytest.fixture(scope="module")
def given(whole):
    return make_traverses_payload(whole.log, whole.calibration, whole.fit)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_columns_are_the_log_s(given, campaign, joint):
    table = campaign().sort_values(["time", "joint"])
    table = table[table["joint"] == joint]
    (shown,) = [each for each in given["joints"] if each["joint"] == joint]
    assert shown["all"] == len(shown["row"]) == len(table)
    assert shown["steps"] == table["steps"].tolist()
    assert [given["sessions"][k] for k in shown["session"]] == table["session"].tolist()
    assert shown["sign"].replace("−", "-") == "".join(table["direction"])
    times = pd.to_datetime(given["begun"] + np.array(shown["time"]), unit="s")
    assert list(times) == list(pd.to_datetime(table["time"]))
    ends = ("from_mm", "to_mm") if joint == 3 else ("from_deg", "to_deg")
    way = abs(table[ends[1]].astype(float) - table[ends[0]].astype(float))
    way = way * 1e6 if joint == 3 else np.radians(way) * 1e6
    size = way / (table["steps"] - 2.5)
    assert np.array(shown["seen"]) / shown["per"] == pytest.approx(size.to_numpy(), abs=0.51 / shown["per"])
    psi = next((each for each in shown["quantities"] if each["label"] == "psi (°)"), None)
    assert (psi is None) == (table["psi_deg"].nunique() == 1)
    if psi:
        assert np.array(psi["values"]) / psi["per"] == pytest.approx(table["psi_deg"].to_numpy())


def test_the_law_is_the_fit_s(given, whole):
    for shown in given["joints"]:
        law = whole.fit.si.predict(whole.log.usable.loc[shown["row"]])["step_size"].to_numpy()
        scale = 1e9 if shown["unit"] == "nm" else 1e6
        assert np.array(shown["law"]) / shown["per"] == pytest.approx(scale * law, abs=0.51 / shown["per"])


def test_configurations_are_named_where_they_differ(given):
    shown = given["joints"][-1]
    assert len(set(shown["configurations"])) == len(shown["configurations"])
    first = shown["configurations"][shown["configuration"][0]]
    assert first == "q2 −90°, theta 0°, psi 0°"


@pytest.mark.slow
def test_a_law_that_is_not_known_is_null(campaign, reported):
    alone = campaign(settings=({"joint": 3, "psi_deg": 30.0},), directions=("+",), replicates=1)
    page = reported(alone.head(1)).page
    (joint,) = json.loads(page.scripts[0])["joints"]
    assert joint["repeatability"][1] is None
    assert len(joint["seen"]) == 1
    assert [each["label"] for each in joint["quantities"]] == ["hours in session"]


def test_of_very_many_traverses_the_drawn_the_furthest_and_some_others_are_kept():
    rng = np.random.default_rng(0)
    count = 40_000
    rows = pd.DataFrame(
        {"departure": rng.standard_normal(count), "session": np.repeat([f"day {k}" for k in range(80)], 500)}
    )
    shown = thin_traverses(rows)
    assert len(shown) == MAX_TRAVERSES
    assert shown.index.is_monotonic_increasing
    assert set(thin_rows(rows, FIT_MAX_POINTS).index) <= set(shown.index)
    assert set(select_recent(rows).index) <= set(shown.index)
    assert set(rows["departure"].abs().sort_values().index[-MAX_OUTLYING:]) <= set(shown.index)
    assert shown["session"].nunique() == 80
    assert thin_traverses(rows.head(MAX_TRAVERSES)).equals(rows.head(MAX_TRAVERSES))


def test_embedded_data_comes_back_and_cannot_end_its_element():
    text = '</script><!-- & \u2028\u2029 " \\ 日本'
    held = embed_json({"text": text, "none": None})
    assert json.loads(held) == {"text": text, "none": None}
    assert not set(held) & set("<>&\u2028\u2029")
    with pytest.raises(ValueError, match="not JSON compliant"):
        embed_json([float("nan")])


@pytest.mark.slow
def test_points_of_figures_are_the_traverses_they_say(campaign, fitted):
    """As high as the step size or its departure has it, and as many as drawn."""
    made = fitted(
        campaign(("2012-03-05",), [each for each in CALIBRATION if each["joint"] > 1], replicates=2)
    )
    rows = made.log.usable
    size = (rows["stop"] - rows["start"]).abs() / (rows["steps"] - 2.5)
    off = size / made.fit.si.predict(rows)["step_size"]
    source = report(made.log, calibration=made.calibration, fit=made.fit, sections=("figures",)).html
    groups = re.findall(r'<g [^>]*data-traverses="([\d.]+)"[^>]*>(.*?)</g></g>', source)
    assert len(groups) > 15
    for numbers, drawn in groups:
        height = [-float(y) for y in re.findall(r'<use [^>]*y="([^"]+)"', drawn)]
        shown = [int(number) for number in numbers.split(".")]
        assert len(height) == len(shown)
        assert rows.loc[shown, "joint"].nunique() == 1
        order = [spearmanr(height, each[shown]).statistic for each in (size, off) if len(shown) > 4]
        assert not order or max(order) > 0.98
