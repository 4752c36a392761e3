"""Effects of the traverse's own length, of two columns together and of what came before, put in by hand."""

import re
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.diagnosis import diagnose
from stickslip_fit.diagnosis.carriers import find_carriers
from stickslip_fit.diagnosis.problem import problem_from_log
from stickslip_fit.errors import InputError
from stickslip_fit.estimation import fit_least_squares
from stickslip_fit.logs import add_history
from stickslip_fit.moves.arm import calibrated_arm, parse_conditions
from stickslip_fit.moves.drives import fill_conditions
from tests.hidden.generate import CHECK_EVERY, hide
from tests.hidden.reading import drop_lab_columns, read_hidden


def own_length(table):
    """Of joint 3, in shares of its longest traverse."""
    length = (table["to_mm"].astype(float) - table["from_mm"].astype(float)).abs().to_numpy()
    return np.where(table["joint"] == 3, 0.03 * np.cos(np.pi * length / np.nanmax(length)), 0.0)


def two_columns(table):
    """Neither of which has an effect on the average over the other."""
    rng = np.random.default_rng(3)
    volts, warmth = rng.choice([-1.0, 1.0], (2, len(table)))
    table["supply_V"], table["temperature_C"] = 60.0 + 2.0 * volts, 22.0 + 1.5 * warmth
    return 0.01 * volts * warmth


def two_slow_columns(table):
    """The product of two columns that wander has memory itself."""
    order = np.argsort(np.argsort(pd.to_datetime(table["time"]), kind="stable"), kind="stable")
    walks = np.cumsum(np.random.default_rng(5).standard_normal((2, len(table))), axis=1)
    volts, warmth = ((walks - walks.mean(1, keepdims=True)) / walks.std(1, keepdims=True))[:, order]
    table["supply_V"], table["temperature_C"] = 60.0 + 2.0 * volts, 22.0 + 1.5 * warmth
    return 0.02 * volts * warmth


def faster_and_faster(table):
    """A wave whose period becomes shorter; its neighbours resemble each other as in noise with memory."""
    hours = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 3600.0
    return 0.006 * np.sin(10.0 * np.pi * (hours / hours.max()).to_numpy() ** 2)


def two_pumps(table):
    """Two waves that have nothing to do with each other."""
    minutes = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 60.0
    return 0.005 * (np.sin(2.0 * np.pi * minutes / 10.7) + np.sin(2.0 * np.pi * minutes / 8.6)).to_numpy()


def since(table, group):
    """Minutes since the first traverse of a session since when its group is what it is."""
    table["time"] = pd.to_datetime(table["time"])
    minutes, began = np.zeros(len(table)), {}
    for row in table["time"].argsort(kind="stable"):
        key, at = table["session"].iloc[row], table["time"].iloc[row]
        own, first = began.get(key, (None, at))
        began[key] = (group[row], first if own == group[row] else at)
        minutes[row] = (at - began[key][1]).total_seconds() / 60.0
    table["time"] = table["time"].dt.strftime("%Y-%m-%dT%H:%M:%S")
    return minutes


def creep_after_a_tilt(table):
    return 0.02 * np.exp(-since(table, list(zip(table["theta_deg"], table["psi_deg"], strict=True))) / 15.0)


def warmth(table, minutes=15.0):
    """Each traverse warms its joint, which cools in pauses; a break of an hour now and then."""
    rng = np.random.default_rng(8)
    table["time"] = pd.to_datetime(table["time"])
    breaks = np.where(rng.random(len(table)) < 0.05, rng.uniform(20.0, 70.0, len(table)), 0.0)
    order, level, since = table["time"].argsort(kind="stable"), {}, {}
    late, warm = dict.fromkeys(table["session"], 0.0), np.zeros(len(table))
    for row in order:
        session = table["session"].iloc[row]
        late[session] += breaks[row]
        at = table["time"].iloc[row] + pd.Timedelta(minutes=round(late[session]))
        table.loc[table.index[row], "time"] = at
        joint = session, table["joint"].iloc[row]
        age = (at - since.get(joint, at)).total_seconds() / 60.0
        warm[row] = level.get(joint, 0.0) * np.exp(-age / minutes)
        level[joint], since[joint] = warm[row] + float(table["steps"].iloc[row]), at
    table["time"] = table["time"].dt.strftime("%Y-%m-%dT%H:%M:%S")
    return 0.02 * warm / warm.max()


def drifting_pump(table):
    """A wave whose phase wanders by more than a radian."""
    minutes = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 60.0
    turns = 2.0 * np.pi * minutes
    return 0.008 * np.sin(turns / 14.0 + 2.5 * np.sin(turns / minutes.max())).to_numpy()


def pump_by_load(table):
    """A wave that gravity makes larger: of either sign, and nothing without load."""
    minutes = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 60.0
    zeta, theta = np.radians(table["psi_deg"] - table["q2_deg"]), np.radians(table["theta_deg"])
    load = np.where(table["joint"] == 3, np.cos(zeta) * np.cos(theta), 0.0)
    return 0.02 * np.nan_to_num(load) * np.sin(2.0 * np.pi * minutes / 17.3).to_numpy()


def pump_of_one_joint(table):
    """In all joints' traverses together it is no wave, and that joint's noise seems three times as large."""
    minutes = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 60.0
    return np.where(table["joint"] == 2, 0.012 * np.sin(2.0 * np.pi * minutes / 13.0), 0.0)


def charge(table, minutes=12.0):
    """What one joint's steps in one direction put onto an amplifier that all joints share, and that leaks."""
    at, level, last, found = pd.to_datetime(table["time"]), {}, {}, np.zeros(len(table))
    for row in at.argsort(kind="stable"):
        session, sign = table["session"].iloc[row], 1.0 if table["direction"].iloc[row] == "+" else -1.0
        age = (at.iloc[row] - last.get(session, at.iloc[row])).total_seconds() / 60.0
        found[row] = level.get(session, 0.0) * np.exp(-age / minutes)
        level[session] = found[row] + sign * float(table["steps"].iloc[row])
        last[session] = at.iloc[row]
    return 0.02 * found / np.abs(found).max()


def settling(table, minutes=15.0):
    """Payloads are changed every 70 min or so; for a while after each change steps are longer or shorter."""
    at, rng = pd.to_datetime(table["time"]), np.random.default_rng(6)
    found, grams = np.zeros(len(table)), np.zeros(len(table))
    for session in dict.fromkeys(table["session"]):
        rows = np.flatnonzero(table["session"] == session)
        clock = ((at.iloc[rows] - at.iloc[rows].min()).dt.total_seconds() / 60.0).to_numpy()
        moments = 70.0 * np.arange(1, int(clock.max() / 70.0) + 1) + rng.uniform(-15.0, 15.0)
        masses = np.append(20.0, rng.choice([0.0, 10.0, 20.0, 30.0, 40.0], len(moments)))
        grams[rows] = masses[np.searchsorted(moments, clock)]
        for moment, change in zip(moments, np.diff(masses), strict=True):
            age = np.maximum(clock - moment, 0.0)
            found[rows] += change / 40.0 * (clock > moment) * np.exp(-age / minutes)
    table["payload_g"] = grams
    return 0.02 * found


def wandering(table, seed):
    """A column that wanders within its sessions, of standard deviation 1."""
    rng, found = np.random.default_rng(seed), np.zeros(len(table))
    order = pd.to_datetime(table["time"]).argsort(kind="stable").to_numpy()
    for session in dict.fromkeys(table["session"]):
        rows = order[table["session"].to_numpy()[order] == session]
        found[rows] = np.convolve(rng.standard_normal(len(rows) + 8), np.ones(9) / 3.0, "valid")
    return found


def giving_way(table, minutes=8.0):
    """Rubber feet give way to a tilt within minutes, and steps depend on what they have not yet."""
    at, tilt = pd.to_datetime(table["time"]), table["psi_deg"].to_numpy(float)
    order, left = at.argsort(kind="stable").to_numpy(), np.zeros(len(table))
    for before, row in pairwise(order):
        if table["session"].iloc[row] == table["session"].iloc[before]:
            kept = np.exp(-(at.iloc[row] - at.iloc[before]).total_seconds() / 60.0 / minutes)
            left[row] = left[before] * kept + tilt[row] - tilt[before]
    return 0.02 * left / 60.0


def late_by_supply(table, mean=0.0):
    """The stop is heard up to 60 steps later than it is on average, or earlier, by a column."""
    volts = wandering(table, 3)
    table["supply_V"] = (60.0 + volts).round(2)
    return table["steps"] / (table["steps"] + mean + 60.0 * np.tanh(2.0 * volts)) - 1.0


def later_by_supply(table):
    """Always late, by 20 to 140 steps."""
    return late_by_supply(table, 80.0)


def fast_pump(table):
    """A wave of one and a half traverses, which come at uneven intervals."""
    minutes = (pd.to_datetime(table["time"]) - pd.to_datetime(table["time"]).min()).dt.total_seconds() / 60.0
    spacing = minutes.sort_values().diff()
    return 0.006 * np.sin(2.0 * np.pi * minutes / (1.5 * spacing[spacing < 30.0].median())).to_numpy()


def neighbours(table):
    """Something in the building at half past ten each day, for half an hour or so."""
    at = pd.to_datetime(table["time"])
    hours = (at - at.dt.normalize()).dt.total_seconds() / 3600.0
    return 0.012 * np.exp(-0.5 * ((hours - 10.5) / 0.25) ** 2).to_numpy()


def draughts(table):
    """Now and then, about every 40 min, a draught rises and falls within a quarter of an hour."""
    at, rng, found = pd.to_datetime(table["time"]), np.random.default_rng(8), np.zeros(len(table))
    for session in dict.fromkeys(table["session"]):
        rows = np.flatnonzero(table["session"] == session)
        minutes = ((at.iloc[rows] - at.iloc[rows].min()).dt.total_seconds() / 60.0).to_numpy()
        for moment in rng.uniform(0.0, minutes.max(), int(minutes.max() / 40.0) + 1):
            found[rows] += np.exp(-0.5 * ((minutes - moment) / 7.0) ** 2)
    return 0.008 * found


def read_with(effect, design, joints, seed=4, replicate=0):
    hidden = hide(design, seed=seed, replicate=replicate)
    table = drop_lab_columns(hidden.table)
    steps = table["steps"] / (1.0 + effect(table))
    table["steps"] = (CHECK_EVERY * np.round(steps / CHECK_EVERY)).astype(int)
    return read_hidden(replace(hidden, table=table), joints)


def name_carriers(log):
    return {one.name for one in find_carriers(problem_from_log(log)[0].table)}


@cache
def diagnose_with(effect, design, joints):
    return diagnose(read_with(effect, design, joints), gain=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "design", "joints", "carriers"),
    [
        pytest.param(own_length, "many", (3,), {"own_length"}, marks=pytest.mark.nightly),
        (two_columns, "session", (2,), {"supply", "temperature"}),
        pytest.param(
            two_slow_columns, "session", (2, 3), {"supply", "temperature"}, marks=pytest.mark.nightly
        ),
        (creep_after_a_tilt, "session", (2,), {"tilt_age"}),
        (faster_and_faster, "session", (2, 3), {"session_seconds"}),
        (pump_by_load, "thesis", (2, 3), {"session_seconds", "load"}),
        (charge, "session", (2,), {"net_use_20min"}),
        (settling, "session", (2, 3), {"payload_change_10min"}),
        (giving_way, "thesis", (2, 3), {"psi_change_10min"}),
        pytest.param(warmth, "session", (2, 3), {"joint_use_20min"}, marks=pytest.mark.nightly),
        pytest.param(warmth, "many", (1, 2, 3), {"joint_use_20min"}, marks=pytest.mark.nightly),
    ],
)
def test_what_steps_follow_is_found(effect, design, joints, carriers):
    found = diagnose_with(effect, design, joints)
    assert [one.cause for one in found.findings] == ["unknown"]
    assert {*found.findings[0].version.carriers} == carriers, found.summary().headline


@pytest.mark.slow
def test_a_payload_that_is_kept_is_a_condition_of_a_law_that_follows_its_changes():
    law = diagnose_with(settling, "session", (2, 3)).extended_law()
    conditions = parse_conditions(["payload_g=20"], law, "--condition")
    assert conditions == {"payload": pytest.approx(0.02)}
    filled = fill_conditions(pd.DataFrame({"joint": [2, 3]}), conditions)
    assert (filled[["payload_change_10min", "payload_change_40min"]] == 0.0).all(axis=None)
    with pytest.raises(InputError, match="this law depends on payload_g; leave supply_V out"):
        parse_conditions(["supply_V=60"], law, "--condition")


@pytest.mark.slow
def test_a_tilt_is_no_condition_of_a_law_that_follows_its_changes():
    law = diagnose_with(giving_way, "thesis", (2, 3)).extended_law()
    with pytest.raises(InputError, match="nothing beside positions and angles; leave psi_deg out"):
        parse_conditions(["psi_deg=0"], law, "--condition")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "beside"), [(late_by_supply, ()), (later_by_supply, ("end-stop-latency",))]
)
def test_steps_that_a_column_adds_to_counts_are_told_from_a_step_size_that_follows_it(effect, beside):
    log, fresh = (read_with(effect, "many", (3,), 4, replicate) for replicate in (0, 1))
    found = diagnose(log, gain=False)
    finding, *others = found.findings
    assert (finding.cause, finding.carrier) == ("unknown", "steps added by supply")
    assert tuple(one.cause for one in others) == beside
    text = " ".join(found.summary().headline)
    assert "Joint 3's counts have steps more or less that follow supply" in text
    assert re.search(r"at supply 6\d\.\d V \(6\d steps more\)", text)
    assert not others or "the end stop is heard 80 steps late" in text
    error = np.log(fresh.rows["steps"] / found.extended_law().predict(fresh.rows)["steps"])
    assert np.sqrt(np.mean(error**2)) < 0.004


@pytest.mark.slow
def test_what_happens_at_a_time_of_day_is_found_and_predicted_on_a_day_that_begins_at_another():
    """Sessions begin up to an hour and a half apart; of one session it would be a function of its time."""
    log, fresh = (read_with(neighbours, "many", (2, 3), 4, replicate) for replicate in (0, 1))
    found = diagnose(log, gain=False)
    (finding,) = found.findings
    assert (finding.cause, finding.version.carriers) == ("unknown", ("time_of_day",))
    text = " ".join(found.summary().headline)
    assert "follow the time of day" in text
    assert re.search(r"at the time of day 10:[23]\d", text)
    before, after = (read_with(lambda table: 0.0, "many", (2, 3), 4, replicate) for replicate in (0, 1))
    laws = (found.extended_law(), fresh), (fit_least_squares(log), fresh), (fit_least_squares(before), after)
    error, published, best = (
        np.sqrt(np.mean(np.log(one.rows["steps"] / law.predict(one.rows)["steps"]) ** 2)) for law, one in laws
    )
    assert error < published - 0.9 * (published - best)  # best: as if nothing happened in either log
    given = parse_conditions(["time_of_day_h=10.5"], found.extended_law(), "--condition")
    assert given == {"time_of_day": 37_800.0}
    for wrong in (-1, 25):
        with pytest.raises(InputError, match="from midnight to midnight; give 0 to 24 h"):
            parse_conditions([f"time_of_day_h={wrong}"], found.extended_law(), "--condition")
        with pytest.raises(InputError, match="from midnight to midnight; give 0 to 24 h"):
            calibrated_arm(found.extended_law(), conditions={"time_of_day": wrong * 3600.0})


def test_where_sessions_begin_alike_the_time_of_day_is_that_in_the_session():
    log = read_with(neighbours, "many", (2, 3))
    assert "time_of_day" in name_carriers(log)
    begins = log.rows.groupby("session")["time"].transform("min")
    alike = log.rows.assign(time=begins.dt.normalize() + pd.Timedelta("9h") + (log.rows["time"] - begins))
    assert "time_of_day" not in name_carriers(replace(log, rows=add_history(alike)))


@pytest.mark.slow
def test_a_wave_faster_than_two_traverses_is_found_where_they_come_at_uneven_intervals():
    found = diagnose_with(fast_pump, "many", (2, 3))
    assert [one.carrier for one in found.findings] == ["period of 3.0 min"]


@pytest.mark.nightly
def test_what_comes_and_goes_within_minutes_is_a_function_of_time_and_not_memory():
    """Of what draughts do a law of memory has next to nothing in a replicate."""
    log, fresh = (read_with(draughts, "many", (1, 2, 3), 4, replicate) for replicate in (0, 1))
    found = diagnose(log, gain=False)
    (finding,) = found.findings
    assert (finding.cause, finding.carrier, finding.version.carriers) == (
        "unknown",
        "time",
        ("session_seconds",),
    )
    error = np.log(fresh.rows["steps"] / found.extended_law().predict(fresh.rows)["steps"])
    assert np.sqrt(np.mean(error**2)) < 0.004  # of 0.0029 of noise; by memory 0.0048


@pytest.mark.slow
def test_two_waves_are_found_in_one_session():
    found = diagnose_with(two_pumps, "session", (2, 3))
    assert {one.carrier for one in found.findings} == {"period of 10.7 min", "period of 8.6 min"}


@pytest.mark.slow
def test_a_wave_may_change_its_size_and_phase():
    """Of 0.63 % rms a wave of one phase, with a second one beside it, leaves 0.45, of noise 0.31."""
    log, fresh = (read_with(drifting_pump, "session", (2, 3), 7, replicate) for replicate in (0, 1))
    found = diagnose(log, gain=False)
    assert "a wave, whose size and phase change, is proposed" in " ".join(str(found).split())
    # Over a phase that wanders it would be smeared.
    assert {axis.get_xlabel() for axis in found.plot().flat} <= {"effect of the proposal (%)", ""}
    error = np.log(fresh.rows["steps"] / found.extended_law().predict(fresh.rows)["steps"])
    assert np.sqrt(np.mean(error**2)) < 0.0039


@pytest.mark.slow
def test_a_wave_by_load_is_that_of_the_joint_that_has_it():
    found = diagnose_with(pump_by_load, "thesis", (2, 3))
    (finding,) = found.findings
    assert (finding.joints, finding.version.n_slow, len(finding.version.orders)) == ((3,), 0, 2)
    text = " ".join(found.summary().headline)
    assert "Joint 3's steps come and go with a period of 17.3 min in proportion to the load" in text


@pytest.mark.slow
def test_a_wave_of_one_joint_is_found_in_what_seems_its_noise():
    found = diagnose_with(pump_of_one_joint, "session", (2, 3))
    (finding,) = found.findings
    assert (finding.joints, finding.carrier) == ((2,), "period of 13.0 min, joint 2")
    assert "minutes into a period of 13" in {axis.get_xlabel() for axis in found.plot().flat}


@pytest.mark.slow
def test_recent_use_is_told_as_warmth():
    found = diagnose_with(warmth, "session", (2,))
    text = " ".join(found.summary().headline)
    assert "follow the joint's own travel in the last 20 min or so" in text
    assert "full travels of its own in the last 20 min" in text
    assert "find out whether it is warmth from driving" in text
    labels = {axis.get_xlabel() for axis in found.plot().flat}
    assert "own full travels in 20 min" in labels
