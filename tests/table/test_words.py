"""Words of a table's diagnosis: columns by their names, times by their size, and what it cannot tell."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.diagnosis._json import diagnosis_to_json
from stickslip_fit.diagnosis._summary import write_headline
from stickslip_fit.diagnosis._table_words import describe_independence, describe_table_carrier
from stickslip_fit.diagnosis._unknown_summary import name_finding


def text_of(diagnosis):
    return " ".join(str(diagnosis).split())


def test_a_frame_is_called_by_its_response(independent):
    assert "Diagnosis of F over 300 rows" in str(independent)
    fit = ssf.fit_table(pd.DataFrame({"x": np.arange(9.0), "y": np.arange(9.0) ** 2}), "y ~ a + b*x")
    assert "Law fitted to y over 9 rows" in str(fit)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("course", "said", "parameter"),
    [
        (lambda day: 3 * (1 - np.exp(-day / 100)), r"a time constant of 9\d\.\d days", "tau"),
        pytest.param(
            lambda day: 0.01 * day,
            r"rises steadily, by 0\.01\d* mm/day|by 0\.009\d* mm/day",
            "k",
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            lambda day: 2.0 * (day > 250),
            r"25\d\.\d days after the first row",
            "moment",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_times_of_dates_are_given_by_their_size(course, said, parameter):
    """In the text; the JSON has seconds."""
    day = 2.0 * np.arange(300)
    noise = 0.1 * np.random.default_rng(0).standard_normal(300)
    frame = pd.DataFrame({"t": pd.date_range("2020-01-01", periods=300, freq="2D"), "y": course(day) + noise})
    found = ssf.diagnose_table(frame, ssf.Law("y ~ a", units={"y": "mm"}), time="t", gain=False)
    assert re.search(said, text_of(found))
    assert not re.search(r"\d s\b", text_of(found))
    parameters = {one["name"]: one for one in diagnosis_to_json(found)["findings"][0]["parameters"]}
    assert parameters[parameter]["unit"] in ("s", "mm/s")


def test_of_two_columns_that_cannot_be_told_apart_both_are_named():
    rng = np.random.default_rng(8)
    x, one = rng.uniform(0, 10, 60), rng.uniform(0, 1, 60)
    frame = pd.DataFrame({"x": x, "one": one, "other": one + 0.001 * rng.standard_normal(60)})
    frame["y"] = x + 2 * one + 0.1 * rng.standard_normal(60)
    found = ssf.diagnose_table(frame, "y ~ a + b*x", gain=False)
    assert found.verdict == "cannot tell apart"
    for name in ("one", "other"):
        assert f"the response follows the column {name} (covariate:{name})" in text_of(found)


def test_carriers_have_the_names_that_the_table_has(independent):
    table = replace(independent.table, roles={"time": "t", "group": "Lot"})
    assert describe_table_carrier("group", table) == "differs between values of Lot"
    assert describe_table_carrier("covariate:t to some extent", table) == "follows t to some extent"
    assert describe_table_carrier("time", table) == "changes slowly with time"
    in_days = replace(table, roles={"time": "t", "session": "day"})
    assert describe_table_carrier("time", in_days).endswith("in each session in its own way")
    assert describe_table_carrier("timestep", table) == "follows timestep"


def test_what_carries_over_is_not_denied(independent):
    (finding,) = independent.findings
    memory = replace(finding, carrier="memory")
    timed = replace(independent.table, roles={"time": "t"})
    assert "shows no autocorrelation" in describe_independence(timed, [finding])
    assert "shows no autocorrelation" not in describe_independence(timed, [memory])


@pytest.mark.parametrize(("phi", "is_told"), [(0.0, False), (0.8, True)])
def test_without_a_time_rows_count_as_independent_and_neighbours_that_are_alike_are_told(phi, is_told):
    rng = np.random.default_rng(1)
    x, noise = rng.uniform(0, 10, 200), rng.standard_normal(200)
    for k in range(1, 200):
        noise[k] += phi * noise[k - 1]
    table = pd.DataFrame({"x": x, "y": 1 + 2 * x + noise})
    found = ssf.diagnose_table(table, "y ~ a + b*x", gain=False)
    text = text_of(found)
    assert "count as independent, as no column was named as the time" in text
    assert "no autocorrelation" not in text
    assert ("neighbouring rows is alike (correlation 0.7" in text) == is_told
    assert ("name 'order' as the time, which allows for" in text) == is_told
    table.insert(
        0, "measured", pd.Timestamp("2025-03-03 09:00") + pd.to_timedelta(np.arange(200), unit="min")
    )
    table["measured"] = table["measured"].dt.strftime("%d.%m.%Y %H:%M")
    table["remark"] = [1, "over", 3.5, None] * 50  # neither numbers nor texts
    dated = ssf.diagnose_table(table, "y ~ a + b*x", gain=False)
    assert ("name 'measured', which has times, as the time, which allows for" in text_of(dated)) == is_told
    assert dated.untestable["drift"].endswith("name 'measured' as it, which has times")


@pytest.mark.slow
def test_of_noise_that_persists_too_long_it_is_said_that_nothing_can_be_shown():
    """A random walk: its values tell as much as a few, whatever their number."""
    walk = np.cumsum(np.random.default_rng(1).standard_normal(400))
    found = ssf.diagnose_table(pd.DataFrame({"y": walk}), "y ~ a", time="order", gain=False)
    assert found.verdict == "nothing wrong"
    assert found.table.independent < 5.5
    first = found.summary().headline[0]
    assert first.startswith("This table cannot show whether anything is wrong")
    assert "as noise alone would" not in first


@pytest.mark.slow
def test_a_law_that_is_worse_than_the_mean_is_flagged_first(independent):
    table = independent.table
    for factor, flagged in ((0.9, False), (3.0, True)):
        poor = replace(independent, misfit=factor * table.response_sd)
        first = write_headline(poor)[0]
        assert first.startswith("The fitted law leaves") == flagged
    # In correlated noise the value of a constant law is not the mean.
    walk = np.cumsum(np.random.default_rng(3).standard_normal(400))
    found = ssf.diagnose_table(pd.DataFrame({"y": walk}), "y ~ a", time="order", gain=False)
    found = replace(found, misfit=3.0 * found.table.response_sd)
    wide = replace(found.table, independent=100.0)
    assert not write_headline(replace(found, table=wide))[0].startswith("The fitted law leaves")


@pytest.mark.nightly
def test_a_wave_with_a_wrong_start_is_flagged():
    """Of 8 swings the fit finds another period, with an amplitude near 0."""
    t = 0.05 * np.arange(165)
    noise = np.random.default_rng(4).standard_normal(165)
    frame = pd.DataFrame({"t": t, "y": 440 + 190 * np.cos(2 * np.pi * t / 1.42) + noise})
    law = ssf.Law("y ~ c + A*cos(2*pi*t/T + phi)", start={"T": 7.0})
    found = ssf.diagnose_table(frame, law, gain=False)
    right = ssf.diagnose_table(frame, ssf.Law(law.formula, start={"T": 1.42}), gain=False)
    flags = ["no better than its mean" in one.summary().headline[0] for one in (found, right)]
    assert right.misfit == pytest.approx(1.0, abs=0.15)
    assert flags == [True, False], (found.misfit, found.table.response_sd)


def test_a_wave_is_called_one(independent):
    (finding,) = independent.findings
    wave = replace(finding, cause="unknown", carrier="period of 12.0 h")
    assert name_finding(wave) == "unknown: wave"
    assert name_finding(replace(wave, carrier="T")) == "unknown: smooth function"


@pytest.mark.slow
def test_a_row_to_check_is_told_with_its_departure_from_what_the_rows_before_foretell():
    """Of a random walk that is its step, not its distance from the mean."""
    steps = np.random.default_rng(1).standard_normal(400)
    steps[200] = 6.0
    found = ssf.diagnose_table(pd.DataFrame({"y": np.cumsum(steps)}), "y ~ a", time="order", gain=False)
    assert found.verdict == "nothing wrong"
    (told,) = re.findall(r"row 201 \(\+([\d.]+)\)", " ".join(found.summary().headline))
    assert float(told) == pytest.approx(6.0, abs=0.7)
    assert "what the rows before foretell" in text_of(found)


@pytest.mark.parametrize("ways", [("loading", "unloading"), (-2.5, 0.0, 1.5)])
def test_an_offset_by_direction_says_which_way_the_response_is_higher(ways):
    """Words stand as they are; of numbers that are more than two the sign counts."""
    rng = np.random.default_rng(2)
    way, x = np.resize(np.array(ways, dtype=object), 120), rng.uniform(0.0, 1.0, 120)
    high = np.resize([-1.0, 1.0] if len(ways) == 2 else [1.0, 0.0, -1.0], 120)
    frame = pd.DataFrame({"x": x, "y": x + 0.5 * high + 0.1 * rng.standard_normal(120), "way": way})
    frame = frame.infer_objects()
    text = text_of(ssf.diagnose_table(frame, "y ~ a + b*x", direction="way", gain=False))
    said = re.findall(r"(higher|lower) by .+? where (?:way|it) is ([\w ]+)", text)
    names = ("unloading", "loading") if len(ways) == 2 else ("below 0", "above 0")
    assert dict(said) == dict(zip(("higher", "lower"), names, strict=True))


def test_a_response_that_is_computed_from_columns_is_told():
    rng = np.random.default_rng(1)
    frame = pd.DataFrame(
        {"x": rng.uniform(size=60), "first": rng.poisson(9, 60), "second": rng.poisson(5, 60)}
    )
    frame = frame.assign(both=frame["first"] + frame["second"])
    text = " ".join(str(ssf.diagnose_table(frame, "both ~ a + b*x", gain=False).summary()).split())
    assert "If both was computed from these columns, leave them out" in text
    assert "Check row" not in text


@pytest.mark.parametrize("far", [True, False])
def test_what_rests_on_few_rows_is_told_with_these(far):
    """Three rows at the end of x, which are no outliers there; or a curve of all rows."""
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 10.0, 64))
    effect = np.where(np.arange(64) > 60, -2.0, 0.0) if far else 0.05 * (x - 5.0) ** 2
    frame = pd.DataFrame({"x": x, "y": 1.0 + x + effect + 0.3 * rng.standard_normal(64)})
    found = ssf.diagnose_table(frame, "y ~ a + b*x", gain=False)
    text = " ".join(str(found.summary()).split())
    assert found.findings[0].cause == "unknown"
    assert ("is in 3 rows of 64 (62, 63 and 64): check these first" in text) == far
    assert ("check these first" in text) == far
