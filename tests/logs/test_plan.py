from datetime import datetime

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine

SESSIONS = "[sessions]\ndates = [2012-03-05, 2012-03-06]\n"
BACKWARDS = "[2012-03-06, 2012-03-05]"
SWEEP = "[[sweep]]\njoint = 3\nq2_deg = [-90, 0]\ntheta_deg = [-90, -30, 0]\n"


@pytest.fixture
def plan_of(tmp_path):
    def read(*parts):
        path = tmp_path / "plan.toml"
        path.write_text("\n".join(parts), encoding="utf-8")
        return read_plan(path, load_machine())

    return read


@pytest.fixture
def problems_of(plan_of):
    def read(*parts):
        with pytest.raises(InputError) as caught:
            plan_of(*parts)
        return caught.value.problems

    return read


def degrees(rows, *columns):
    return [tuple(row) for row in np.degrees(rows[list(columns)].to_numpy(float)).round(9)]


def test_a_sweep_is_the_product_of_its_lists_the_last_key_fastest_each_direction_in_turn(plan_of):
    first = plan_of(SESSIONS, SWEEP).rows().query("session == '2012-03-05'")
    wanted = [(q2, theta) for q2 in (-90, 0) for theta in (-90, -30, 0) for _ in "+-"]
    assert degrees(first, "q2", "theta") == wanted
    assert list(first["direction"]) == ["+", "-"] * 6
    assert (first["q3"].isna()).all()
    assert set(zip(first["direction"], first["start"], first["stop"], strict=True)) == {
        ("+", 0.0, 0.012),
        ("-", 0.012, 0.0),
    }


def test_the_order_of_the_keys_decides_what_varies_fastest(plan_of):
    rows = plan_of(SESSIONS, "[[sweep]]\njoint = 3\ntheta_deg = [-90, 0]\nq2_deg = [-60, -30]").rows()
    assert degrees(rows[:8:2], "q2", "theta") == [(-60, -90), (-30, -90), (-60, 0), (-30, 0)]


def test_partial_traverses_are_run_by_each_direction_its_own_way(plan_of):
    sweep = "[[sweep]]\njoint = 2\nq3_mm = 6\nranges_deg = [[0, -30], [-60, -30]]\ndirections = ['-', '+']"
    rows = plan_of(SESSIONS, sweep).rows()[:4]
    assert list(rows["direction"]) == ["-", "+", "-", "+"]
    assert degrees(rows, "start", "stop") == [(0, -30), (-30, 0), (-30, -60), (-60, -30)]
    assert (rows["q3"] == 0.006).all()


def test_replicates_of_a_sweep_follow_each_other_and_those_of_the_plan_start_over(plan_of):
    in_a_row = plan_of(SESSIONS, SWEEP, "replicates = 2").rows()[:24]
    assert degrees(in_a_row[:8], "theta") == [(-90,)] * 4 + [(-30,)] * 4
    over = plan_of("replicates = 2", SESSIONS, SWEEP).rows()[:24]
    assert degrees(over[:8], "theta") == [(-90,)] * 2 + [(-30,)] * 2 + [(0,)] * 2 + [(-90,)] * 2
    assert over[["q2", "theta", "direction"]][:12].equals(
        over[["q2", "theta", "direction"]][12:].reset_index(drop=True)
    )


def test_a_visit_lasts_while_nothing_needs_to_be_set(plan_of):
    sweep = "[[sweep]]\njoint = 2\nq3_mm = [0, 12]\nranges_deg = [[0, -30], [-30, -60]]\nreplicates = 2"
    visits = plan_of(SESSIONS, sweep).rows()["visit"]
    assert list(visits) == list(np.repeat(np.arange(visits[0], visits[0] + 8), 4))


def test_random_order_shuffles_each_session_anew_and_keeps_visits_together(plan_of):
    head = 'order = "random"\nseed = 3\nreplicates = 2\n'
    plan = plan_of(head, SESSIONS, SWEEP, "replicates = 2")
    listed = plan_of("replicates = 2", SESSIONS, SWEEP, "replicates = 2").rows()[:48]
    first, second = plan.rows()[:48], plan.rows()[48:]
    place = ["q2", "theta"]
    for shuffled in (first, second):
        assert sorted(degrees(shuffled, *place)) == sorted(degrees(listed, *place))
        assert degrees(shuffled, *place) != degrees(listed, *place)
        assert list(shuffled["direction"]) == ["+", "-"] * 24
        assert (shuffled.groupby("visit")[place].nunique() == 1).all(axis=None)
        assert (shuffled.groupby("visit").size() == 4).all()
    assert degrees(first, *place) != degrees(second, *place)


def test_another_session_changes_the_order_in_no_other_and_another_seed_does(plan_of):
    def order(seed, dates):
        head = f'order = "random"\nseed = {seed}\n[sessions]\ndates = [{dates}]'
        return degrees(plan_of(head, SWEEP).rows()[:12], "q2", "theta")

    assert order(3, "2012-03-05") == order(3, "2012-03-05, 2012-03-06")
    assert order(3, "2012-03-05") != order(4, "2012-03-05")


def test_sessions_by_first_date_and_count_with_labels_and_starts(plan_of):
    text = '[sessions]\nfirst_date = 2012-02-28\ncount = 3\nlabels = ["a", "NA", "001"]\n'
    plan = plan_of(text + 'start = ["08:30", "09:00", "23:59:30"]', SWEEP)
    assert [session.label for session in plan.sessions] == ["a", "NA", "001"]
    assert [session.begins for session in plan.sessions] == [
        datetime(2012, 2, 28, 8, 30),
        datetime(2012, 2, 29, 9, 0),
        datetime(2012, 3, 1, 23, 59, 30),
    ]


def test_quantities_in_any_unit_of_theirs(plan_of):
    timing = "[timing]\nstep_period_s = 0.02\npause_min = [1, 2]\n"
    noise = '[noise]\nkind = "t5"\nrepeatability_pct = {"3+" = 0.27, "3-" = 0.3}\n'
    plan = plan_of(SESSIONS, timing, noise, "[[sweep]]\njoint = 2\nq3_um = 6000\ntheta_rad = -1.5\n")
    assert (plan.rows()["q3"] == 0.006).all()
    assert (plan.rows()["theta"] == -1.5).all()
    assert plan.timing.step_period == 0.02
    assert plan.timing.pause == (60.0, 120.0)
    assert plan.noise.repeatability == {(3, "+"): pytest.approx(0.0027), (3, "-"): pytest.approx(0.003)}
    assert plan.noise.kind == "t5"


ONE_SWEEP = "[[sweep]]\njoint = 3\nq2_deg = 0\n"
FAULTS = [
    (["seed = -1", SESSIONS, SWEEP], "seed", "-1", "whole number from 0"),
    (["seed = true", SESSIONS, SWEEP], "seed", "true", "whole number"),
    (["check_every = 0", SESSIONS, SWEEP], "check_every", "0", "whole number from 1"),
    (["replicates = 2.5", SESSIONS, SWEEP], "replicates", "2.5", "whole number from 1"),
    (['order = "shuffled"', SESSIONS, SWEEP], "order", "shuffled", "'as-written', 'random'"),
    (["sed = 4", SESSIONS, SWEEP], "sed", "4", "which may have name, seed"),
    ([SWEEP], "sessions.dates", None, "give dates, such as"),
    (["[sessions]\ndates = ['5 March']", SWEEP], "sessions.dates", "[5 March]", "give dates, such as"),
    (["[sessions]\ndates = [20120305]", SWEEP], "sessions.dates", "[20120305]", "give dates"),
    (["[sessions]\ndates = [3012-03-05]", SWEEP], "sessions.dates", "[3012-03-05]", "give dates"),
    ([f"[sessions]\ndates = {BACKWARDS}", SWEEP], "sessions.dates", BACKWARDS, "put them in order"),
    ([SESSIONS, 'start = "half past eight"', SWEEP], "sessions.start", "half past eight", "time of day"),
    ([SESSIONS, 'labels = ["a"]', SWEEP], "sessions.labels", "[a]", "1 labels, 2 starts, 2 dates"),
    ([SESSIONS, 'labels = ["a", "a"]', SWEEP], "sessions.labels", "[a, a]", "labels that differ"),
    ([SESSIONS, "[timing]\nstep_period_ms = 0", SWEEP], "timing.step_period_ms", "0", "in ms, 0.01 to"),
    ([SESSIONS, "[timing]\npause_s = [240, 60]", SWEEP], "timing.pause_s", "[240, 60]", "[lowest, highest]"),
    ([SESSIONS, "[timing]\nturn_s = [6, 9]\nturn_min = [1, 2]", SWEEP], "timing.turn_min", "[1, 2]", "keep"),
    ([SESSIONS, "[noise]\nrepeatability_pct = 27", SWEEP], "noise.repeatability_pct", "27", "from 0 to 20"),
    ([SESSIONS, "[noise]\nrepeatability_pct = {4 = 2}", SWEEP], "noise.repeatability_pct", "{'4'", '{"3+" '),
    ([SESSIONS, "[noise]\nkind = 't5'", SWEEP], "noise.repeatability_pct", None, "give a percentage"),
    ([SESSIONS], "sweep", None, "give at least one table [[sweep]]"),
    ([SESSIONS, ONE_SWEEP.replace("3", "4")], "sweep 1 joint", "4", "give one of 1, 2, 3"),
    ([SESSIONS, SWEEP, "[[sweep]]\njoint = 3"], "sweep 2 q2_deg", None, "give a number in deg, -210 to 30"),
    ([SESSIONS, ONE_SWEEP.replace("= 0", "= [0, 31]")], "sweep 1 q2_deg", "[0, 31]", "-210 to 30"),
    ([SESSIONS, ONE_SWEEP, "psi_deg = 'level'"], "sweep 1 psi_deg", "level", "give a number in deg"),
    ([SESSIONS, ONE_SWEEP, "theta_deg = -1e308"], "sweep 1 theta_deg", "-1e+308", "in deg, -360 to 360"),
    ([SESSIONS, ONE_SWEEP, "psi_deg = nan"], "sweep 1 psi_deg", "nan", "give a number in deg"),
    ([SESSIONS, ONE_SWEEP, "psi = 30"], "sweep 1 psi", "30", "is no key of this table"),
    ([SESSIONS, ONE_SWEEP, "q3_mm = 6"], "sweep 1 q3_mm", "6", "is no key of this table"),
    ([SESSIONS, ONE_SWEEP, "directions = ['up']"], "sweep 1 directions", "[up]", 'give ["+", "-"]'),
    ([SESSIONS, ONE_SWEEP, "ranges_deg = [[0, 1]]"], "sweep 1 ranges_deg", "[[0, 1]]", "is no key"),
    ([SESSIONS, ONE_SWEEP, "ranges_mm = [[0, 13]]"], "sweep 1 ranges_mm", "[[0, 13]]", "in mm, 0 to 12"),
    ([SESSIONS, ONE_SWEEP, "ranges_mm = [[6, 6]]"], "sweep 1 ranges_mm", "[[6, 6]]", "two different ends"),
    ([SESSIONS, ONE_SWEEP, "ranges_mm = [0, 6]"], "sweep 1 ranges_mm", "[0, 6]", "a list of [from, to]"),
    ([SESSIONS, ONE_SWEEP, f"psi_deg = {list(range(350))}\ntheta_deg = {list(range(350))}"],
     "sweep 1 name", None, "makes 122,500 configurations"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "column", "value", "message"), FAULTS, ids=lambda part: str(part)[:30])
def test_a_fault_is_named_with_its_key_and_value(problems_of, parts, column, value, message):
    (problem,) = problems_of(*parts)
    assert problem.file.endswith("plan.toml")
    assert problem.column == column
    assert message in problem.message
    assert problem.value is None if value is None else value in problem.value


def test_all_faults_are_told_together(problems_of):
    found = problems_of("seed = 'x'\nchek_every = 5", "[sessions]\ndates = []", ONE_SWEEP.replace("0", "99"))
    assert {problem.column for problem in found} == {"seed", "chek_every", "sessions.dates", "sweep 1 q2_deg"}


@pytest.mark.parametrize(
    "raw", [b"name = ", b"\xff\xfe", b"a = " + b"[" * 100_000], ids=["cut", "bytes", "deep"]
)
def test_what_is_no_toml_says_so(tmp_path, raw):
    path = tmp_path / "plan.toml"
    path.write_bytes(raw)
    with pytest.raises(InputError, match=r"plan\.toml: is no TOML file"):
        read_plan(path, load_machine())


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml: cannot be read \(No such file"):
        read_plan(tmp_path / "nowhere.toml", load_machine())
