"""Whether an actuator has changed: from logs to sentences, and the command."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

import stickslip_fit as ssf
from stickslip_fit.changes import detect_changes
from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError


def run(*arguments):
    result = CliRunner().invoke(app, ["changed", *map(str, arguments)])
    if isinstance(result.exception, InputError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def larger(make_log):
    """Three days in March, and three in June after `a` of direction + has grown by 5 %."""
    return make_log(3), make_log(3, month=6, seed=1, change=0.05)


@pytest.fixture(scope="module")
def found(larger):
    return detect_changes(*larger)


def test_a_change_is_named_by_drive_with_its_size_and_what_it_means_for_moves(found):
    assert {(one.joint, one.direction) for one in found.significant} == {(3, "+")}
    size = next(one for one in found.changes if one.name == "step size" and one.direction == "+")
    assert size.difference.low < 0.055 < size.difference.high
    assert size.difference.new / size.difference.old == pytest.approx(1 + size.difference.estimate)
    said = str(found)
    assert said.startswith("Changed: joint 3 +, 3 sessions (2012-03-05 to 2012-03-07) against 3 sessions")
    assert "Joint 3 +: steps are " in said
    # The estimate and both ends of its interval have the same decimals, and a unit in the sentence and below.
    told = re.search(r"steps are \d+(\.\d+)? % longer \(\d+(\.\d+)? to \d+(\.\d+)? %\)", said)
    assert len({len(part or "") for part in told.groups()}) == 1
    assert re.search(r"\d to \d+\.\d+ % ", said[told.end() :])
    assert "; a changed by +" in said
    assert len(said.splitlines()) <= 25


def test_where_nothing_changed_the_least_change_that_would_show_is_said(make_log):
    said = " ".join(str(detect_changes(make_log(3), make_log(4, month=6, seed=1))).split())
    assert said.startswith("No change shows")
    assert "A change of the step size by " in said
    assert "would have been detected with 80 % probability" in said


def test_a_scatter_that_is_hardly_known_gives_no_astronomic_percentages(make_log):
    said = " ".join(str(detect_changes(make_log(2, day_to_day=0.3), make_log(1, month=6, seed=1))).split())
    assert "by more than 1000 % would have been detected with 80 % probability. Measure more days." in said
    assert "to > 1000 %" in said
    assert not re.search(r"\d{5,} %", said)


def test_one_session_each_cannot_tell_a_change_from_a_day(make_log):
    changes = detect_changes(make_log(1), make_log(1, month=6, seed=1, change=0.05))
    assert not changes.significant
    said = " ".join(str(changes).split())
    assert said.startswith("Cannot tell a change from a day's scatter")
    assert "By more than traverses repeat within a day differ: joint 3 + step size" in said


def test_one_session_against_three_takes_their_scatter(make_log):
    said = " ".join(str(detect_changes(make_log(3), make_log(1, month=6, seed=1))).split())
    assert "The new log has a single session: the scatter from day to day is that of the old log." in said


@pytest.mark.slow
def test_a_date_splits_one_log_as_two_files_do(larger, tmp_path):
    old, new = tmp_path / "march.csv", tmp_path / "june.csv"
    for log, path in zip(larger, (old, new), strict=True):
        log.to_csv(path)
    both = tmp_path / "all.csv"
    both.write_text(old.read_text() + new.read_text().partition("\n")[2])
    apart, together = tmp_path / "apart.json", tmp_path / "together.json"
    said = run(old, new, "--json", apart)
    assert f"saved to {apart}" in said
    run(both, "--since", "2012-06-01", "--json", together)
    contents = [json.loads(path.read_text(encoding="utf-8")) for path in (apart, together)]
    assert contents[0]["changes"] == contents[1]["changes"]
    assert contents[0]["changed"] is True
    first = contents[0]["changes"][0]
    assert first["name"] == "step size"
    assert first["unit"] == "nm"
    assert 600 < first["old"] < 1100
    assert first["difference_unit"] == "%"
    assert first["estimate"] == pytest.approx(100 * (first["new"] / first["old"] - 1))


@pytest.mark.parametrize("arguments", [(), ("other.csv", "--since", "2012-06-01")])
def test_either_a_second_log_or_a_date_is_needed(larger, tmp_path, arguments):
    larger[0].to_csv(tmp_path / "march.csv")
    with pytest.raises(InputError, match="a second log, or the date of the change with --since"):
        run(tmp_path / "march.csv", *arguments)


def test_what_is_no_date_is_told_by_the_option_that_was_given(larger, tmp_path):
    larger[0].to_csv(tmp_path / "march.csv")
    with pytest.raises(InputError) as refused:
        run(tmp_path / "march.csv", "--since", "monday")
    assert refused.value.at_shell.startswith("--since, value 'monday': is no date or time")


def test_logs_that_share_traverses_are_refused(larger):
    with pytest.raises(InputError, match="traverses in common"):
        detect_changes(larger[0], larger[0])


def test_joints_of_one_log_only_are_named(larger):
    rows = larger[1].rows.assign(joint=2, q3=0.006, q2=np.nan, start=-3.0, stop=0.5)
    rows.loc[rows["direction"] == "-", ["start", "stop"]] = [0.5, -3.0]
    both = ssf.Log(pd.concat([larger[1].rows, rows], ignore_index=True), (), "", larger[1].machine)
    changes = detect_changes(larger[0], both)
    assert changes.not_compared == ("Joint 2 is in the new log only, and was not compared.",)
    assert "Joint 2 is in the new log only" in str(changes)


@pytest.mark.slow
def test_laws_of_one_s_own_are_compared_over_the_configurations_of_both_logs(larger):
    law = ssf.Law("gamma ~ s*(1 - k*abs(cos(q2)))", units={"s": "nm", "k": "1"})
    changes = detect_changes(*larger, laws={3: law})
    assert {one.name for one in changes.changes} == {"step size", "s", "k"}
    size = next(one for one in changes.changes if (one.name, one.direction) == ("step size", "+"))
    assert size.difference.estimate == pytest.approx(0.065, abs=0.015)


@pytest.mark.slow
@pytest.mark.parametrize("repetitions", [4, pytest.param(400, marks=pytest.mark.nightly)])
def test_logs_without_a_change_seldom_alarm(make_log, repetitions):
    alarms = sum(
        bool(
            detect_changes(
                make_log(3, seed=seed, day_to_day=0.015),
                make_log(3, month=6, seed=seed + 10_000, day_to_day=0.015),
            ).significant
        )
        for seed in range(repetitions)
    )
    assert alarms <= binom.ppf(0.999, repetitions, 0.01)
