"""Tables in people's units beside those in SI, and plots that need no plumbing."""

import json
from dataclasses import replace

import numpy as np
import pytest

import stickslip_fit as ssf
from stickslip_fit import InputError
from stickslip_fit.causes import Drift, ThermalWarmUp

TO_UNIT = {"nm": 1e9, "µrad": 1e6, "µrad/mm": 1e3, "1": 1.0}


def test_parameters_are_in_the_unit_beside_them_as_in_the_saved_file(whole, tmp_path):
    table, si = whole.fit.parameters, whole.fit.si.parameters
    for name in ("estimate", "standard_error", "low", "high"):
        assert table[name].to_numpy() == pytest.approx(si[name].to_numpy() * table["unit"].map(TO_UNIT))
    assert table.query("joint == 3 and name == 'a'")["estimate"].between(700, 1200).all(), "nm"
    assert table.query("joint == 2 and name.str.startswith('gamma0')")["estimate"].between(50, 150).all()
    whole.fit.save(tmp_path / "fit.json")
    saved = json.loads((tmp_path / "fit.json").read_text("utf-8"))["parameters"]
    assert [row["estimate"] for row in saved] == table["estimate"].tolist()
    assert [row["unit"] for row in saved] == table["unit"].tolist()


def test_predictions_say_their_unit(whole):
    rows = whole.log.usable
    table, si = whole.fit.predict(rows), whole.fit.si.predict(rows)
    assert list(table) == ["steps", "low", "high", "step_size", "unit", "error_pct", "extrapolated_pct"]
    assert (table["unit"] == np.where(rows["joint"] == 3, "nm", "µrad")).all()
    assert table["step_size"].to_numpy() == pytest.approx(si["step_size"] * table["unit"].map(TO_UNIT))
    assert table["error_pct"].to_numpy() == pytest.approx(100 * si["relative_error"].to_numpy())
    joint_3 = (rows["joint"] == 3).to_numpy()
    assert 12e6 / table["steps"][joint_3].to_numpy() == pytest.approx(table["step_size"][joint_3].to_numpy())


def test_held_out_errors_are_predicted_less_measured(whole):
    errors = ssf.held_out_errors(whole.log, whole.calibration)
    table, rows = errors.table, whole.log.usable
    assert not whole.calibration.residuals["used"].loc[table.index].any()
    some = table[table["joint"] == 3].iloc[::7]
    travel, steps = 12e6, rows.loc[some.index, "steps"] - rows.loc[some.index, "check_every"] / 2
    assert some["measured"].to_numpy() == pytest.approx((travel / steps).to_numpy())
    assert some["q2_deg"].to_numpy() == pytest.approx(np.degrees(rows.loc[some.index, "q2"].to_numpy()))
    expected = 100 * (whole.calibration.predict(rows.loc[some.index])["step_size"] / some["measured"] - 1)
    assert some["law_error_pct"].to_numpy() == pytest.approx(expected.to_numpy())
    rms = np.sqrt((table.query("joint == 3 and direction == '+'")["constant_error_pct"] ** 2).mean())
    (shown,) = errors.summary().tables
    line = next(row for row in shown.rows if row[:2] == ("joint 3 (prismatic)", "+"))
    assert float(line[5]) == pytest.approx(rms, rel=0.05)


def test_plots_are_axes_with_the_data_in_them(whole):
    axes = ssf.held_out_errors(whole.log, whole.calibration).plot()
    assert [one.get_title().split(" (")[0] for one in axes] == ["joint 1", "joint 2", "joint 3"]
    panels = whole.log.plot("q2")
    rows = whole.log.usable
    third = rows[rows["joint"] == 3]
    drawn = np.concatenate([line.get_xydata() for line in panels[2].lines])
    assert len(drawn) == len(third)
    assert np.sort(drawn[:, 0]) == pytest.approx(np.sort(np.degrees(third["q2"])))
    assert panels[2].get_xlabel() == "q2 (°)"
    assert panels[2].get_ylabel() == "mean step size (nm)"
    moving = np.concatenate([line.get_xdata() for line in panels[1].lines])
    middle = np.degrees((rows["start"] + rows["stop"])[rows["joint"] == 2] / 2)
    assert np.sort(moving) == pytest.approx(np.sort(middle)), "of the moving joint the traverse's middle"


def test_an_unknown_column_is_refused_with_a_guess(whole):
    with pytest.raises(InputError, match=r"no column 'thetta' to draw against: .*; did you mean theta\?"):
        whole.log.plot("thetta")


@pytest.mark.slow
def test_a_diagnosis_draws_its_first_finding_or_all_residuals(whole):
    third = whole.log.select(whole.log.rows["joint"] == 3)
    quiet = ssf.diagnose(third, causes=[Drift(), ThermalWarmUp()], gain=False)
    assert quiet.verdict == "nothing wrong"
    assert len(quiet.plot()) > 3, "a panel for each quantity"
    rows = third.rows.copy()
    rows["steps"] = (rows["steps"] * (1 + 0.03 * rows["session_seconds"] / 3600)).round().astype(int)
    found = ssf.diagnose(replace(third, rows=rows), causes=[Drift(), ThermalWarmUp()], gain=False)
    assert {axes.get_xlabel() for axes in found.plot()} >= {"hours in session"}
    scales = found.parameters["unit"].map({"%": 100.0, "%/h": 360_000.0, "h": 1 / 3600, "min": 1 / 60})
    assert found.parameters["estimate"].to_numpy() == pytest.approx(found.si.parameters["estimate"] * scales)
