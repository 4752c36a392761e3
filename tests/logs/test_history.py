"""History against a slow loop that was written from the format's words alone."""

import math
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad, solve_ivp

from stickslip_fit.logs import add_history, read_log
from stickslip_fit.logs.fading import previous_rows

SHARED = Path(__file__).parents[3] / "shared"
HISTORY = ["before_direction", "before_load", "steps_before", "session_seconds"]
OTHER_HISTORY = ["before_length", "before_gap", "joint_pause", "before_joint", "pause", "other_load"]
OTHER_HISTORY += ["other_pause", "tilt_age", "session_order", "time_of_day", "joint_travel"]
MINUTES = [5, 20, 80]
WHOSE = ("", "joint_", "other_", "net_", "joint_net_")
USE = [f"{whose}use_{minutes}min" for whose in WHOSE for minutes in MINUTES]
TRAVEL = {1: math.radians(240), 2: math.radians(240), 3: 0.012}


def load(row: dict[str, float], position: float) -> float:
    """The published load of causes.md with the moving joint at a position."""
    theta, psi = row["theta"], row["psi"]
    if row["joint"] == 3:
        return math.cos(psi - row["q2"]) * math.cos(theta)
    if row["joint"] == 2:
        return math.sin(psi - position) * math.cos(theta)
    return math.cos(theta) * math.sin(psi) * math.sin(position) + math.sin(theta) * math.cos(position)


def own_load(row: dict[str, float]) -> float:
    """The mean along a traverse."""
    total, _ = quad(lambda q: load(row, q), row["start"], row["stop"])
    return total / (row["stop"] - row["start"])


def slow_history(rows: list[dict]) -> list[tuple[str, float, int, float]]:
    """What a person with a pencil would write beside each row; the rows may stand in any order."""
    found = []
    for row in rows:
        earlier = [other for other in rows if other["time"] < row["time"] and other["joint"] == row["joint"]]
        same = [other for other in earlier if other["session"] == row["session"]]
        direction, before_load = "", 0.0
        if same:
            last = max(same, key=lambda other: other["time"])
            direction = last["direction"]
            before_load = own_load(last)
        began = min(other["time"] for other in rows if other["session"] == row["session"])
        steps = sum(other["steps"] for other in earlier)
        found.append((direction, before_load, steps, (row["time"] - began).total_seconds()))
    return found


def slow_other_history(rows: list[dict]) -> list[tuple[float, ...]]:
    """The rest of what stands beside each row; NaN where there was none before in the session."""
    found = []
    for row in rows:
        earlier = [one for one in rows if one["time"] < row["time"] and one["session"] == row["session"]]
        last = max(earlier, key=lambda one: one["time"], default=None)
        own = max((one for one in earlier if one["joint"] == row["joint"]), key=lambda one: one["time"],
                  default=None)  # fmt: skip
        travel, values = TRAVEL[row["joint"]], [math.nan] * 5
        if own is not None:
            values[0] = abs(own["stop"] - own["start"]) / travel
            values[1] = abs(row["start"] - own["stop"]) / travel
            values[2] = (row["time"] - own["time"]).total_seconds()
        if last is not None:
            values[3:] = last["joint"], (row["time"] - last["time"]).total_seconds()
        others = [one for one in earlier if one["joint"] != row["joint"]]
        other = max(others, key=lambda one: one["time"], default=None)
        values.append(math.nan if other is None else own_load(other))
        values.append(math.nan if other is None else (row["time"] - other["time"]).total_seconds())
        tilted = row["time"]
        for one in sorted(earlier, key=lambda one: one["time"], reverse=True):
            if (one["theta"], one["psi"]) != (row["theta"], row["psi"]):
                break
            tilted = one["time"]
        values.append((row["time"] - tilted).total_seconds())
        driven = [abs(one["stop"] - one["start"]) for one in earlier if one["joint"] == row["joint"]]
        moment = row["time"]
        of_day = 3600 * moment.hour + 60 * moment.minute + moment.second + moment.microsecond / 1e6
        found.append((*values, len(earlier), of_day, sum(driven) / travel))
    return found


def slow_use(rows: list[dict]) -> list[list[float]]:
    """Full travels before each row in its session, of all joints, its own and the others; older ones less.

    Then of all joints and its own those in +, less those in -.
    """
    found = []
    for row in rows:
        before = [one for one in rows if one["time"] < row["time"] and one["session"] == row["session"]]
        own = [one for one in before if one["joint"] == row["joint"]]
        others = [one for one in before if one["joint"] != row["joint"]]
        found.append(
            [
                sum(
                    size(one["stop"] - one["start"]) / TRAVEL[one["joint"]]
                    * 2.718281828459045 ** -((row["time"] - one["time"]).total_seconds() / 60 / minutes)
                    for one in some
                )
                for some, size in (
                    (before, abs), (own, abs), (others, abs), (before, float), (own, float)
                )
                for minutes in MINUTES
            ]
        )  # fmt: skip
    return found


def campaign(seed: int, count: int = 120) -> pd.DataFrame:
    """A campaign in file columns: three sessions that overlap in time, all joints, all statuses."""
    rng = np.random.default_rng(seed)
    seconds = rng.choice(200_000, size=count, replace=False)
    joint = rng.integers(1, 4, count)
    direction = rng.choice(["+", "-"], count)
    ends = {1: (-120, 120), 2: (-210, 30), 3: (0, 12)}
    low_high = np.array(
        [np.sort(rng.choice(np.arange(ends[j][0], ends[j][1] + 1), 2, replace=False)) for j in joint]
    )
    start, stop = np.where((direction == "+")[:, None], low_high, low_high[:, ::-1]).T
    given = rng.random(count) < 0.5
    return pd.DataFrame(
        {
            "session": rng.choice(["001", "1", "NA"], count),
            "time": [(datetime(2012, 3, 5) + timedelta(seconds=int(s))).isoformat() for s in seconds],
            "joint": joint,
            "direction": direction,
            "steps": 5 * rng.integers(100, 4000, count),
            "q1_deg": rng.integers(-120, 121, count),
            "q2_deg": rng.integers(-210, 31, count),
            "q3_mm": rng.integers(0, 13, count),
            "theta_deg": rng.integers(-90, 91, count),
            "psi_deg": rng.integers(-90, 91, count),
            "from_deg": np.where(given & (joint < 3), start, np.nan),
            "to_deg": np.where(given & (joint < 3), stop, np.nan),
            "from_mm": np.where(given & (joint == 3), start, np.nan),
            "to_mm": np.where(given & (joint == 3), stop, np.nan),
            "status": rng.choice(["ok", "interrupted", "excluded", ""], count),
        }
    )


def assert_history(rows: pd.DataFrame) -> None:
    slow = pd.DataFrame(slow_history(rows.to_dict("records")), columns=HISTORY)
    assert list(rows["before_direction"]) == list(slow["before_direction"])
    assert list(rows["steps_before"]) == list(slow["steps_before"])
    np.testing.assert_allclose(rows["before_load"], slow["before_load"], atol=1e-9)
    np.testing.assert_allclose(rows["session_seconds"], slow["session_seconds"], rtol=0, atol=1e-6)
    other = slow_other_history(rows.to_dict("records"))
    np.testing.assert_allclose(rows[OTHER_HISTORY], np.array(other), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(rows[USE], np.array(slow_use(rows.to_dict("records"))), atol=1e-6)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_history_is_what_a_slow_loop_finds(read, seed):
    assert_history(read(campaign(seed).to_csv(index=False)).rows)


@pytest.mark.parametrize(
    ("column", "minutes", "unit", "offset"),
    [("temperature_C", 40, 1.0, 273.15), ("payload_g", 10, 1e-3, 0.0)],
)
def test_what_a_condition_was_of_late_is_what_a_body_has_that_follows_it(read, column, minutes, unit, offset):
    """By a solver of differential equations; between rows the condition changes evenly."""
    rng, table = np.random.default_rng(8), campaign(8, 60)
    table["session"] = np.sort(rng.choice(["001", "1"], 60))
    table["time"] = [
        (datetime(2012, 3, 5) + timedelta(minutes=int(m))).isoformat()
        for m in np.cumsum(rng.integers(1, 30, 60))
    ]
    table[column] = rng.uniform(10.0, 30.0, 60).round(1)
    rows, name = read(table.to_csv(index=False)).rows, column.rsplit("_", 1)[0]
    for _, own in rows.groupby("session", observed=True):
        at, values = own["session_seconds"].to_numpy(), own[name].to_numpy()
        np.testing.assert_allclose(values, unit * table.loc[own.index, column] + offset)
        followed = [values[0]]
        for (begin, end), ends in zip(pairwise(at), pairwise(values), strict=True):
            law = lambda t, y, x=(begin, end), u=ends: (np.interp(t, x, u) - y) / (60.0 * minutes)  # noqa: E731
            solved = solve_ivp(law, (begin, end), followed[-1:], rtol=1e-9, atol=1e-9 * unit)
            followed.append(solved.y[0, -1])
        late = f"{name}_{minutes}min"
        np.testing.assert_allclose(own[f"{name}_change_{minutes}min"], values - followed, atol=1e-5 * unit)
        if late in own:
            np.testing.assert_allclose(own[late], followed, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("coordinate", "joint"), [("theta", 0), ("q2", 2), ("q3", 3)])
def test_how_a_coordinate_has_changed_is_unknown_where_its_joint_moves(read, coordinate, joint):
    """Of the others it is the coordinate less what a body has that follows it."""
    rows = read(campaign(8).to_csv(index=False)).rows
    own = (rows["joint"] == joint).to_numpy()
    change = rows[f"{coordinate}_change_10min"].to_numpy()
    np.testing.assert_array_equal(np.isnan(change), own)
    for _, part in rows.groupby("session", observed=True):
        at = part["session_seconds"].to_numpy()
        values = np.where(part["joint"] == joint, part["start"], part[coordinate])
        followed = [values[0]]
        for (begin, end), ends in zip(pairwise(at), pairwise(values), strict=True):
            law = lambda t, y, x=(begin, end), u=ends: (np.interp(t, x, u) - y) / 600.0  # noqa: E731
            followed.append(solve_ivp(law, (begin, end), followed[-1:], rtol=1e-9, atol=1e-12).y[0, -1])
        wanted = np.where(part["joint"] == joint, np.nan, values - followed)
        np.testing.assert_allclose(change[part.index], wanted, atol=1e-6)


@pytest.mark.slow
def test_history_of_a_real_campaign(tmp_path):
    path = SHARED / "data" / "campaigns" / "campaign-d.csv"
    if not path.exists():
        pytest.skip("the campaigns that come beside this checkout are not there")
    assert_history(read_log(path).rows.head(150))


def test_the_order_of_rows_in_the_file_means_nothing(read):
    log = campaign(4)
    expected = read(log.to_csv(index=False)).rows
    pd.testing.assert_frame_equal(read(log.sample(frac=1, random_state=0).to_csv(index=False)).rows, expected)
    assert expected["time"].is_monotonic_increasing


def test_selecting_rows_keeps_the_history_of_the_whole_log(read):
    log = read(campaign(5).to_csv(index=False))
    mask = (log.rows["joint"] == 3) & (log.rows["status"] == "ok")
    part = log.select(mask)
    pd.testing.assert_frame_equal(part.rows, log.rows[mask].reset_index(drop=True))
    assert part.rows["steps_before"].iloc[-1] > part.rows["steps"].iloc[:-1].sum()
    assert (part.machine, part.sha256) == (log.machine, log.sha256)


def test_history_can_be_added_to_rows_made_elsewhere(read):
    rows = read(campaign(6).to_csv(index=False)).rows
    again = add_history(rows.drop(columns=[*HISTORY, *OTHER_HISTORY]))
    pd.testing.assert_frame_equal(again[rows.columns], rows)


def test_traverses_of_one_moment_are_ordered_by_joint_and_session_however_the_file_has_them(sheet, read):
    for row in range(6):
        sheet.set(row, "time", "2012-03-05T09:00")
        sheet.set(row, "session", f"s{row}")
    expected = read(sheet).rows
    assert list(expected["joint"]) == [1, 2, 2, 3, 3, 3]
    assert list(expected["session"]) == ["s3", "s2", "s4", "s0", "s1", "s5"]
    sheet.rows.reverse()
    pd.testing.assert_frame_equal(read(sheet).rows, expected)


def test_the_row_before_is_that_of_the_same_group():
    assert previous_rows(np.array([3, 1, 1, 3, 3])).tolist() == [-1, -1, 1, 0, 3]
