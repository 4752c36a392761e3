"""Sessions over different stretches of a travel: the profile is taken out before they are compared."""

from __future__ import annotations

import re

import numpy as np
import pytest

from stickslip_fit.causes.profile import AlongTravel
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


def test_without_a_cause_in_position_the_means_alone_are_shown(tmp_path):
    log = write_campaign(tmp_path, last=(0, 360))
    fit = fit_least_squares(log)
    (picture,) = profile_pictures(collect_traverses(1, log, fit, fit), fit)
    assert "has no cause in position" in picture.caption
    whole = log.select(np.arange(len(log.rows)) == 0)
    assert profile_pictures(collect_traverses(1, whole, fit, fit), fit) == []
