"""Counts of drives of a machine that is no arm: one rotary joint, whose steps differ along its travel."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

import stickslip_fit as ssf
from stickslip_fit.causes.proposed import SmoothTerm
from stickslip_fit.errors import InputError

MACHINE = '[[joint]]\nkind = "rotary"\nname = "table"\nrange_deg = [0, 400]\n'
STEP_DEG = {"+": 0.06, "-": 0.05}
SCATTER = 0.002
FRIDAY = 1.1  # times Monday's steps


def step_deg(position, direction):
    """Step at a position in degrees: twice as large in one place as in another."""
    share = np.pi * (position - 20.0) / 300.0
    return STEP_DEG[direction] * np.exp(0.3 * np.cos(share) - 0.15 * np.cos(3.0 * share))


def true_count(start, stop, direction, session="Monday"):
    size = FRIDAY if session == "Friday" else 1.0
    return abs(quad(lambda x: 1.0 / (size * step_deg(x, direction)), start, stop)[0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A machine file, a log of short drives over 20 to 320 degrees in each session, and laws fitted to it."""
    folder, rng, rows = tmp_path_factory.mktemp("drives"), np.random.default_rng(7), []
    (folder / "stage.toml").write_text(MACHINE, encoding="utf-8")
    for session in ("Monday", "Friday"):
        for direction in "+-":
            low = np.r_[np.arange(20.0, 320.0, 20.0), rng.uniform(20.0, 290.0, 28)]
            for a, b in zip(low, low + np.r_[np.full(15, 20.0), rng.uniform(10.0, 30.0, 28)], strict=True):
                ends = (a, b) if direction == "+" else (b, a)
                count = true_count(*ends, direction, session) * np.exp(SCATTER * rng.standard_normal())
                rows.append((session, 1, direction, round(count), 1, *ends))
    names = ["session", "joint", "direction", "steps", "check_every", "from_deg", "to_deg"]
    pd.DataFrame(rows, columns=names).to_csv(folder / "log.csv", index=False)
    log = ssf.read_log(folder / "log.csv", machine=ssf.load_machine(folder / "stage.toml"))
    fit = ssf.fit(log)
    fit.save(folder / "constant.json")
    ssf.fit(log, causes=[ssf.causes.AlongTravel()]).save(folder / "law.json")
    return folder


def drives_file(tmp_path, text):
    path = tmp_path / "drives.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_counts_are_the_integral_of_the_law_that_was_fitted(folder, tmp_path, run):
    """The quadrature of 1 / step size, by the coefficients in the saved file; and the truth behind it."""
    text = "session,joint,direction,from_deg,to_deg\nMonday,1,+,50,170\nFriday,1,-,310.5,42\n"
    file = drives_file(tmp_path, text)
    status, out, err = run("predict", folder / "law.json", file, "-o", tmp_path / "counts.csv")
    assert status == 0, err
    counts = pd.read_csv(tmp_path / "counts.csv")
    law = ssf.load_result(folder / "law.json")
    ((_, low, high),) = law.joints[1].law.causes[0].travel
    saved = pd.DataFrame(json.loads((folder / "law.json").read_text())["parameters"])
    for row in counts.itertuples():
        own = saved[(saved["session"] == row.session) & (saved["direction"] == row.direction)]
        gamma = own["estimate"].item() * 1e-6
        c = saved.loc[saved["name"].str.startswith("along-travel"), "estimate"].to_numpy() / 100.0
        k = np.arange(1, len(c) + 1)

        def rate(q, gamma=gamma, c=c, k=k):
            share = np.pi * (q - low) / (high - low)
            return np.exp(-np.sum(c * np.cos(k * share)) + np.sum(c**2) / 4.0) / gamma

        integral = abs(quad(rate, np.radians(row.from_deg), np.radians(row.to_deg), epsrel=1e-10)[0])
        assert row.steps == round(integral)
        true = true_count(row.from_deg, row.to_deg, row.direction, row.session)
        assert row.low < true < row.high
        assert row.high / row.low < np.exp(2 * 2.2 * 2 * SCATTER)
        assert f"{row.steps:,}" in out
    assert (counts["extrapolated_pct"] == 0).all()
    assert "never" not in out


def test_a_drive_beyond_the_travel_has_the_count_of_the_law_which_is_constant_there(folder):
    """From stop to stop: where the profile ends its curvature jumps, which is no stall."""
    law = ssf.load_result(folder / "law.json")
    ends = np.radians([0.0, 20.0, 320.0, 400.0])
    drives = pd.DataFrame({"session": "Monday", "joint": 1, "direction": "+", "start": ends[[0, 0, 1, 2]]})
    whole, *parts = law.predict(drives.assign(stop=ends[[3, 1, 2, 3]]))["steps"]
    assert whole == pytest.approx(sum(parts), rel=1e-5)
    assert parts[0] == pytest.approx(20.0 / step_deg(20.0, "+"), rel=0.02)


def test_the_interval_holds_the_counts_of_new_drives_as_often_as_it_says(folder):
    """300 drives that were not fitted, their own scatter included."""
    law, rng = ssf.load_result(folder / "law.json"), np.random.default_rng(11)
    start = rng.uniform(30.0, 250.0, 300)
    drives = pd.DataFrame({"session": "Monday", "joint": 1, "direction": "+", "start": np.radians(start)})
    drives["stop"] = np.radians(start + 50.0)
    steps = np.array([true_count(a, a + 50.0, "+") for a in start])
    steps = np.round(steps * np.exp(SCATTER * rng.standard_normal(300)))
    predicted = ssf.predict(law, drives)
    inside = ((predicted["low"] <= steps) & (steps <= predicted["high"])).mean()
    assert 0.88 < inside <= 1.0


def test_a_drive_by_its_ends_is_that_of_the_file(folder, tmp_path, run):
    file = drives_file(tmp_path, "joint,direction,from_deg,to_deg\n1,-,200,80\n")
    law = folder / "law.json"
    by_file = run("predict", law, file, "-o", tmp_path / "file.csv")
    by_ends = run("predict", law, "--from", "200", "--to", "80", "-o", tmp_path / "ends.csv")
    assert by_file[0] == by_ends[0] == 0, by_ends
    assert (tmp_path / "file.csv").read_text() == (tmp_path / "ends.csv").read_text()
    said = " ".join(by_ends[1].split())
    assert "by the calibration of session Monday, the last by name: the log has no times" in said
    assert "by the calibrations of others, counts would be up to 9.1 % lower;" in said  # 1 - 1 / FRIDAY
    monday = run("predict", law, "--from", "200", "--to", "80", "--session", "Monday", "--joint", "1")
    assert "Sessions differ" not in monday[1]
    shown = int(re.search(r"200° to 80° +([\d,]+)", monday[1])[1].replace(",", ""))
    assert shown == pytest.approx(true_count(200, 80, "-"), rel=0.01)


def test_what_no_traverse_of_the_log_drove_is_said_in_text_file_and_python(folder, tmp_path, run):
    head = "session,joint,direction,from_deg,to_deg\n"
    file = drives_file(tmp_path, head + "Monday,1,+,300,340\nMonday,1,+,100,130\nMonday,1,-,21,1\n")
    for name in ("law.json", "constant.json"):
        status, out, err = run("predict", folder / name, file, "-o", tmp_path / "counts.csv")
        assert status == 0, err
        counts = pd.read_csv(tmp_path / "counts.csv", keep_default_na=False)
        assert counts["extrapolated_pct"].tolist() == [50.0, 0.0, 95.0]
        assert counts["never_driven"].tolist() == ["320 deg to 340 deg", "", "20 deg to 1 deg"]
        said = " ".join(out.split())
        assert "1 traverse of joint 1 in direction + goes where those of the fitted log never went" in said
        assert "320° to 340°" in said
        assert "they cover 20° to 320°" in said
    law = ssf.load_result(folder / "law.json")
    drives = ssf.read_drives(file, law)
    assert law.predict(drives)["extrapolated_pct"].to_numpy() == pytest.approx([50.0, 0.0, 95.0])
    assert law.si.predict(drives)["extrapolated"].to_numpy() == pytest.approx([0.5, 0.0, 0.95])


def test_a_stretch_that_only_the_other_direction_drove_counts_as_never_driven(folder, tmp_path):
    lines = (folder / "log.csv").read_text().splitlines()
    kept = [one for one in lines[1:] if not (one.split(",")[2] == "+" and float(one.split(",")[6]) > 200)]
    (tmp_path / "part.csv").write_text("\n".join([lines[0], *kept]), encoding="utf-8")
    log = ssf.read_log(tmp_path / "part.csv", machine=ssf.load_machine(folder / "stage.toml"))
    drives = pd.DataFrame({"session": "Monday", "joint": 1, "direction": ["+", "-"]})
    drives["start"], drives["stop"] = np.radians([250.0, 270.0]), np.radians([270.0, 250.0])
    assert ssf.fit(log).predict(drives)["extrapolated_pct"].tolist() == [100.0, 0.0]


def test_a_gap_within_the_travel_is_never_driven_and_a_crack_is_none(folder, tmp_path):
    text = "session,joint,direction,steps,check_every,from_deg,to_deg\n"
    text += "A,1,+,1000,1,0,60\nA,1,+,1010,1,61,120\nA,1,+,980,1,160,220\n"
    (tmp_path / "gaps.csv").write_text(text, encoding="utf-8")
    log = ssf.read_log(tmp_path / "gaps.csv", machine=ssf.load_machine(folder / "stage.toml"))
    drives = pd.DataFrame({"session": "A", "joint": 1, "direction": "+", "start": [0.0, np.radians(100.0)]})
    drives["stop"] = np.radians([120.0, 180.0])
    assert ssf.fit(log).predict(drives)["extrapolated_pct"].to_numpy() == pytest.approx([0.0, 50.0])


def test_a_law_of_an_earlier_version_is_read_and_said_not_to_know(folder, tmp_path, run):
    content = json.loads((folder / "law.json").read_text())
    for joint in content["joints"]:
        del joint["travel"]
    del content["checksum"]
    (tmp_path / "old.json").write_text(json.dumps(content), encoding="utf-8")
    file = drives_file(tmp_path, "joint,direction\n1,+\n")
    status, out, err = run("predict", tmp_path / "old.json", file)
    assert status == 0, err
    assert "does not say where the log's traverses went" in " ".join(out.split())
    old = ssf.load_result(tmp_path / "old.json")
    assert old.predict(ssf.read_drives(file, old).assign(session="Monday"))["extrapolated_pct"].isna().all()
    content["joints"][0]["travel"] = {"+": [[2.0, 1.0]]}
    (tmp_path / "old.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match="travel of joint 1"):
        ssf.load_result(tmp_path / "old.json")


FAULTS = {
    "session,joint,direction\nSunday,1,+\n": "line 2, column session, value 'Sunday': was not fitted; "
    "the law knows Friday and Monday; an empty cell stands for a session to come",
    "joint,direction\n2,+\n": "line 2, column joint, value '2': is no joint; write 1 (rotary)",
    "joint,from_deg,to_deg\n1,3,4\n": "line 1, column direction: is missing; every list of drives needs it",
    "joint,direction,from_deg\n1,+,north\n": "line 2, column from_deg, value 'north': is no number",
    "joint,direction,from_deg,to_deg\n1,+,30,20\n": "column direction, value '+': disagrees with from_deg",
    "joint,direction,to_deg\n1,+,500\n": "column to_deg, value '500': is outside joint 1's range, 0 to 400",
}


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_wrong_with_a_file_of_drives_is_told_with_its_place(folder, tmp_path, run, text):
    file = drives_file(tmp_path, text)
    status, out, err = run("predict", folder / "law.json", file)
    assert (status, out) == (2, "")
    assert f"{file}, " in err
    assert FAULTS[text] in err
    assert "Traceback" not in err


ARGUMENTS = {
    "": "name a plan (TOML) or a file of drives (CSV), or give one drive by --joint",
    "--from 10": "give --direction, or by --from and --to two different ends",
    "--from 10 --to 20 --direction -": "--direction, value '-': disagrees with the drive's ends, 10 to",
    "--from -5 --direction +": "--from, value '-5': is outside joint 1's range, 0 to 400 deg",
    "--joint 2 --direction +": "joint 2 was not fitted",
    "--direction + --session Sunday": "session 'Sunday' was not fitted; sessions fitted: Friday, Monday",
    "--direction + --condition temperature_C=20": "this law depends on nothing beside positions",
}


@pytest.mark.parametrize("options", ARGUMENTS)
def test_what_is_wrong_with_a_drive_by_its_ends_is_told(folder, run, options):
    status, out, err = run("predict", folder / "constant.json", *options.split())
    assert (status, out) == (2, "")
    assert ARGUMENTS[options] in err


def test_a_law_that_follows_the_time_asks_for_it_by_column(folder, tmp_path):
    """Steps grow by a tenth within 5 hours: drives say when they are, or how long the session has run."""
    rng, begin = np.random.default_rng(5), pd.Timestamp("2026-03-02T08:00:00")
    hours = np.arange(40) * 0.125
    steps = 1e6 * np.exp(-0.02 * hours + 1e-4 * rng.standard_normal(40))
    log = pd.DataFrame({"session": "A", "time": [(begin + pd.Timedelta(hours=h)).isoformat() for h in hours]})
    log = log.assign(joint=1, direction="+", steps=steps.round().astype(int), check_every=1)
    log.to_csv(tmp_path / "log.csv", index=False)
    read = ssf.read_log(tmp_path / "log.csv", machine=ssf.load_machine(folder / "stage.toml"))
    drift = next(cause for cause in ssf.causes.library() if cause.name == "drift")
    law = ssf.fit(read, causes=[drift])
    plain = "session,joint,direction\nA,1,+\n"
    with pytest.raises(InputError, match=r"drives\.csv, column session_min: the law depends on how long"):
        ssf.read_drives(drives_file(tmp_path, plain), law)
    minutes = "session,joint,direction,session_min\nA,1,+,0\nA,1,+,240\n"
    times = "session,time,joint,direction\nA,2026-03-09T12:00:00,1,+\nA,2026-03-09T08:00:00,1,+\n"
    for text, late in ((minutes, 1), (times, 0)):
        counts = ssf.predict(law, ssf.read_drives(drives_file(tmp_path, text), law))["steps"]
        assert counts[late] / counts[1 - late] == pytest.approx(np.exp(-0.08), rel=2e-3)


def test_a_column_of_the_lab_s_own_has_to_be_numbers_where_the_law_depends_on_it(folder, tmp_path):
    rng = np.random.default_rng(3)
    preload = rng.uniform(1.0, 3.0, 60)
    log = pd.DataFrame({"session": "A", "joint": 1, "direction": "+", "check_every": 1, "preload_N": preload})
    log["steps"] = np.round(1e5 / (1.0 + 0.05 * (preload - 2.0))).astype(int)
    log.to_csv(tmp_path / "log.csv", index=False)
    read = ssf.read_log(tmp_path / "log.csv", machine=ssf.load_machine(folder / "stage.toml"))
    law = ssf.fit(read, causes=ssf.causes.covariates(read.usable))
    head = "session,joint,direction,preload_N\n"
    file = drives_file(tmp_path, head + "A,1,+,1.0\nA,1,+,3.0\n")
    counts = ssf.predict(law, ssf.read_drives(file, law))["steps"]
    assert counts[1] / counts[0] == pytest.approx(0.95 / 1.05, rel=5e-3)
    with pytest.raises(InputError, match=r"line 3, column preload_N, value 'firm': is no number"):
        ssf.read_drives(drives_file(tmp_path, head + "A,1,+,1.0\nA,1,+,firm\n"), law)


def test_a_law_that_follows_recent_use_predicts_it_where_drives_have_times(folder, tmp_path, run):
    """What was driven before warms the joint; without times that nothing is known of it is said."""
    begin, rng = pd.Timestamp("2026-03-02T08:00:00"), np.random.default_rng(5)
    minutes = np.cumsum(rng.integers(1, 40, 90)).astype(float)
    ages = np.subtract.outer(minutes, minutes)
    warmth = np.sum(np.exp(-np.maximum(ages, 0.0) / 20.0), axis=1, where=ages > 0)
    log = pd.DataFrame(
        {
            "session": "A",
            "time": [(begin + pd.Timedelta(minutes=m)).isoformat() for m in minutes],
            "joint": 1,
            "direction": "+",
            "steps": np.round(1e5 * np.exp(-0.03 * warmth)).astype(int),
            "check_every": 1,
        }
    )
    log.to_csv(tmp_path / "log.csv", index=False)
    read = ssf.read_log(tmp_path / "log.csv", machine=ssf.load_machine(folder / "stage.toml"))
    orders = tuple((k,) for k in range(1, 7))
    term = SmoothTerm(("joint_use_20min",), ((0.0, warmth.max()),), orders, (0.1,) * len(orders))
    ssf.fit(read, causes=[term]).save(tmp_path / "law.json")
    head = "session,time,joint,direction\n"
    timed = head + "".join(f"A,2026-03-09T08:{minute:02d}:00,1,+\n" for minute in (0, 10, 20))
    counts, told = {}, {}
    for name, text in (("timed", timed), ("bare", "session,joint,direction\nA,1,+\n")):
        file = drives_file(tmp_path, text)
        status, told[name], err = run("predict", tmp_path / "law.json", file, "-o", tmp_path / "counts.csv")
        assert status == 0, err
        counts[name] = pd.read_csv(tmp_path / "counts.csv")["steps"].to_numpy()
    # The log hardly has a cold joint, as is the first of the drives.
    warm = np.array([np.exp(-0.5), np.exp(-0.5) + np.exp(-1.0)])
    first, last = counts["timed"][1:]
    assert last / first == pytest.approx(np.exp(-0.03 * np.diff(warm)).item(), rel=1e-3)
    assert "Give each its time" not in told["timed"]
    assert "Give each its time" in " ".join(told["bare"].split())
