"""Sessions over different stretches of a travel: the profile is taken out before they are compared."""

import re

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.causes.profile import AlongTravel
from stickslip_fit.cli import app
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.estimation.prediction import collect_traverses, control_chart
from stickslip_fit.estimation.profile import (
    compute_profiles,
    find_unlike_stretches,
    make_comparable,
    profile_factor,
)
from stickslip_fit.logs import read_log
from stickslip_fit.machine import load_machine
from stickslip_fit.plotting.profile import profile_pictures
from stickslip_fit.plotting.residuals import _own_position

MACHINE = '[[joint]]\nkind = "rotary"\nrange_deg = [0, 360]\n'
DAYS = 9


def true_factor(degrees):
    return 1.0 + 0.15 * np.sin(np.radians(degrees))


def write_campaign(folder, *, last=(180, 360), shift=1.0, profile=true_factor):
    """Nine days, the last over a stretch of its own and with steps `shift` times as large."""
    (folder / "machine.toml").write_text('name = "turntable"\n' + MACHINE, "utf-8")
    rng = np.random.default_rng(5)
    lines = ["session,time,joint,direction,steps,check_every,q1_deg,from_deg,to_deg"]
    for day in range(DAYS):
        level = 0.06 * np.exp(0.01 * rng.standard_normal()) * (shift if day == DAYS - 1 else 1.0)
        low, high = last if day == DAYS - 1 else (0, 360)
        for k in range(24):
            start = low + (high - 30 - low) * (k // 2 + 0.5) / 12
            places = start + 30 * (np.arange(200) + 0.5) / 200
            count = np.mean(1 / profile(places)) * 30 / level * np.exp(0.003 * rng.standard_normal())
            ends = (start, start + 30) if k % 2 else (start + 30, start)
            when = f"2012-03-{day + 1:02d}T10:{k:02d}:00Z"
            way = "+" if k % 2 else "-"
            lines.append(f"{when[:10]},{when},1,{way},{count:.0f},1,,{ends[0]:.4f},{ends[1]:.4f}")
    (folder / "log.csv").write_text("\n".join(lines), "utf-8")
    return read_log(folder / "log.csv", machine=load_machine(folder / "machine.toml"))


def alarms(fit):
    chart = control_chart(fit)
    return set(chart.loc[chart["surprising"].astype(bool), "session"])


@pytest.mark.slow
def test_another_stretch_is_no_alarm_but_a_change_still_is(tmp_path):
    log = write_campaign(tmp_path)
    plain = fit_least_squares(log)
    assert "2012-03-09" in alarms(plain)
    assert find_unlike_stretches(log) == (1,)
    comparable = make_comparable(log, plain)
    assert "2012-03-09" not in alarms(comparable.fit)
    assert "different stretches of joint 1" in comparable.note
    changed = write_campaign(tmp_path, shift=0.9)
    assert "2012-03-09" in alarms(make_comparable(changed, fit_least_squares(changed)).fit)


def test_what_a_diagnosis_named_is_taken_out_and_else_nothing_is(tmp_path):
    log = write_campaign(tmp_path, last=(0, 360))
    plain = fit_least_squares(log)
    assert find_unlike_stretches(log) == ()
    assert make_comparable(log, plain).fit is plain
    named = make_comparable(log, plain, [AlongTravel()])
    assert "along-travel, as the diagnosis has it" in named.note
    assert make_comparable(log, named.fit).fit is named.fit


def test_the_profile_is_the_one_that_was_put_in(tmp_path):
    log = write_campaign(tmp_path, last=(0, 360))
    fit = fit_least_squares(log, causes=[AlongTravel()])
    degrees = np.linspace(30, 330, 40)  # the ends of the travel are in one stretch only
    fitted = profile_factor(fit.joints[1], "+", np.radians(degrees))
    truth = true_factor(degrees)
    assert fitted / fitted.mean() == pytest.approx(truth / truth.mean(), abs=0.01)
    rows = collect_traverses(1, log, fit, fit)
    for one in compute_profiles(rows, fit):
        of_truth = true_factor(np.degrees(one.middle))
        assert one.mean == pytest.approx(
            of_truth / true_factor(np.degrees(one.position)).mean() - 1, abs=0.02
        )
    (picture,) = profile_pictures(rows, fit)
    sizes = [float(text) for text in re.findall(r"([\d.]+) % rms", picture.caption)]
    assert sizes == pytest.approx([100 * 0.15 / np.sqrt(2)] * 2, abs=0.6)
    places = [float(text) for text in re.findall(r"(\d+)°", picture.caption)]
    assert places == pytest.approx([90, 270] * 2, abs=15)


@pytest.mark.nightly
def test_the_command_and_the_report_say_that_the_profile_is_out(tmp_path):
    log, fit = write_campaign(tmp_path), CliRunner()
    done = fit.invoke(app, ["fit", str(tmp_path / "log.csv"), "--machine", str(tmp_path / "machine.toml")])
    text = " ".join(done.output.split())
    assert text.startswith(
        "Session 2012-03-09 lies where the sessions before it lead one to expect. Sessions drove"
    )
    assert [flag.joint for flag in ssf.fit(log).flags if flag.flag == "other_stretches"] == [1]
    page = ssf.report(log, sections=("figures",)).html
    assert "Step size along the travel, joint 1 (rotary)" in page
    assert "a profile along the travel that all share is taken out first" in page


def test_the_figure_of_a_cause_in_position_is_over_each_joints_own(tmp_path):
    write_campaign(tmp_path)
    machine = '[[joint]]\nkind = "rotary"\nrange_deg = [0, 360]\n' * 2
    (tmp_path / "two.toml").write_text(f'name = "two"\n{machine}', "utf-8")
    rows = pd.DataFrame({"joint": [1, 2, 2], "start": [0.0, 1.0, 2.0], "stop": [1.0, 2.0, 1.5]})
    label, values = _own_position(rows, np.ones(3, dtype=bool), load_machine(tmp_path / "two.toml"))
    assert label == "own position (°)"
    assert values == pytest.approx(np.degrees([0.5, 1.5, 1.75]))


def test_without_a_cause_in_position_the_means_alone_are_shown(tmp_path):
    log = write_campaign(tmp_path, last=(0, 360))
    fit = fit_least_squares(log)
    (picture,) = profile_pictures(collect_traverses(1, log, fit, fit), fit)
    assert "has no cause in position" in picture.caption
    whole = log.select(np.arange(len(log.rows)) == 0)
    assert profile_pictures(collect_traverses(1, whole, fit, fit), fit) == []
