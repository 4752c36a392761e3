"""Logs of a stage whose quantities change, against steps made one at a time and against hand computations."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log, write_log
from stickslip_fit.simulation import read_law_values, simulate
from stickslip_fit.step import Contact, Drive, Stage, coulomb_step
from stickslip_fit.studies import read_study
from tests.simulation.conftest import PLAN, USUAL

G = 9.80665
QUIET = {"repeatability": 0, "check_every": 1}
LENGTH, RAMP, MASS = 0.012, 1.4e-4, 5e-3
# Friction-limited, lambda = 2.45: a_f = 50 m/s^2, a_f T1^2 = 980 nm, D = 2.4 µm. At 10 V, lambda is 0.31.
STAGE = """
[slider]
mass_g = {mass}
[contact]
friction_coefficient = 0.2
preload_N = 1.25
{contact}
[drive]
voltage_V = {voltage}
gain_nm_per_V = 30
{drive}
flyback_time_ms = 0.005
rest_time_ms = {rest}
"""
TYPICAL = {"mass": 5, "contact": "", "voltage": 80, "rest": 1, "drive": "ramp_time_ms = 0.14"}
JOINT_3 = '[[stage]]\njoint = 3\nfile = "stage.toml"\nb = 0.25\n'
JOINT_2 = (
    '[[stage]]\njoint = 2\nfile = "stage.toml"\nradius_mm = 5\ninertia = 0.3\nr_q3_0 = 0.1\nr_q3_12 = 0.2\n'
)
JOINT_1 = (
    '[[stage]]\njoint = 1\nfile = "stage.toml"\nradius_mm = 0.2\ninertia = 0.2\nr_reach_0 = 0.05\n'
    "r_reach_full = 0.25\n"
)
HUMID = '[[column]]\nname = "humidity_pct"\nmean = "45 %"\nbetween_sessions = "5 %"\nwithin_session = "3 %"\n'


def schedule(quantity, change, **keys):
    lines = [f"{key} = {value if isinstance(value, int) else repr(value)}" for key, value in keys.items()]
    table = ["[[stage.schedule]]", f'quantity = "{quantity}"', f'change = "{change}"', *lines]
    return "\n".join(table) + "\n"


@pytest.fixture
def truth_of(tmp_path, machine):
    """A law file, with a stage file beside it."""

    def read(text, **stage):
        (tmp_path / "stage.toml").write_text(STAGE.format(**TYPICAL | stage), encoding="utf-8")
        (tmp_path / "law.toml").write_text(text, encoding="utf-8")
        return read_law_values(tmp_path / "law.toml", machine)

    return read


@pytest.fixture
def stage_rows(truth_of, plan_of, machine):
    """The rows of a log without noise."""

    def make(text, stage=(), **settings):
        return simulate(plan_of(**QUIET | settings), truth_of(text, **dict(stage)), machine).rows

    return make


def load_3(rows):
    """Of joint 3 against the motion, in weights; base level or on its side, psi = 0."""
    return np.where(rows["direction"] == "+", 1, -1) * np.cos(rows["q2"]) * np.cos(rows["theta"])


def friction_limited_3(rows, acceleration, ramp=RAMP):
    """Counts by the closed form of one regime, a_f T1^2 (1 - r)/(1 + r), less the recoil."""
    r = G * load_3(rows) / acceleration
    step = acceleration * ramp**2 * (1 - r) / (1 + r) * (1 - 0.25 * np.abs(np.cos(rows["q2"])))
    return LENGTH / step


def assert_counts(rows, expected):
    assert np.abs(rows["steps"] - expected).max() <= 0.5 + 1e-6 * rows["steps"].max()


@pytest.mark.parametrize("voltage", [80, 30, 10])
def test_joint_3_takes_the_steps_that_are_made_one_at_a_time(stage_rows, voltage):
    sweep = "q2_deg = [-90, -30, 0, -120]\ntheta_deg = [0, -40]\nranges_mm = [[0, 2]]"
    rows = stage_rows(JOINT_3, {"voltage": voltage}, sweep=sweep, dates="2012-03-05")
    motion = Drive(voltage, 30e-9, RAMP, 5e-6, 1e-3).motion()
    step = coulomb_step(motion, 50.0, G * load_3(rows)) * (1 - 0.25 * np.abs(np.cos(rows["q2"])))
    position, counts = np.zeros(len(rows)), np.zeros(len(rows))
    while (moving := position < 2e-3).any():
        position += np.where(moving, step, 0.0)
        counts += moving
    assert len(rows) == 16
    assert np.all(np.abs(rows["steps"] - counts) <= 1)


TURNS = "q2_deg = -90\n[[sweep]]\njoint = 2\nq3_mm = [0, 9]\ntheta_deg = [0, -60]\nranges_deg = [[-92, -88]]"
SWINGS = (
    "q2_deg = -90\n[[sweep]]\njoint = 1\nq2_deg = [-90, -30]\nq3_mm = 6\ntheta_deg = -90\n"
    "ranges_deg = [[-60, 60]]"
)
LOOSER = schedule("preload", "-5 %", session="2012-03-06")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "text", "sweep", "radius", "payload"),
    [(2, JOINT_2, TURNS, 5e-3, 2e-5), (1, JOINT_1, SWINGS, 2e-4, 1e-8)],
    ids=["joint 2", "joint 1"],
)
def test_a_rotary_joint_takes_the_steps_that_are_made_one_at_a_time(
    stage_rows, machine, joint, text, sweep, radius, payload
):
    """At 32.5 V lambda is 0.995: with and against the load, regimes differ and change on the way."""
    text += LOOSER + schedule("payload", f"{1e3 * payload:g} g", session="2012-03-06")
    rows = stage_rows(JOINT_3 + text, {"voltage": 32.5}, sweep=sweep, dates="2012-03-05, 2012-03-06")
    rows = rows[rows["joint"] == joint]
    arm_in, arm_out = machine.ranges[3]
    sign = np.where(rows["direction"] == "+", 1, -1)
    out = machine.l2 + rows["q3"].to_numpy()
    if joint == 2:
        centre = machine.links[2].com
        gained = (out - centre) ** 2 - (machine.l2 + arm_in - centre) ** 2
        gained /= (machine.l2 + arm_out - centre) ** 2 - (machine.l2 + arm_in - centre) ** 2
        mass, share, lever = MASS * (1 + 0.3 * gained), 0.1 + 0.1 * rows["q3"].to_numpy() / 12e-3, out
    else:
        rho = -out * np.sin(rows["q2"].to_numpy())
        relative = rho / (machine.l2 + arm_out)
        mass, share, lever = MASS * (1 + 0.2 * relative**2), 0.05 + 0.2 * relative, machine.a1 + rho
    later = (rows["session"] == "2012-03-06").to_numpy()
    payload, friction = np.where(later, payload, 0.0), np.where(later, 0.95 * 0.25, 0.25)
    mass = mass + payload * (lever / radius) ** 2
    force = share * 0.25 + payload * G * lever / radius
    motion = Drive(32.5, 30e-9, RAMP, 5e-6, 1e-3).motion()
    position, counts = rows["start"].to_numpy().copy(), np.zeros(len(rows))
    while (moving := sign * (rows["stop"].to_numpy() - position) > 0).any():
        if joint == 2:
            load = np.cos(rows["theta"]) * np.sin(-position)
        else:
            load = np.sin(rows["theta"]) * np.cos(position)
        step = coulomb_step(motion, friction / mass, force * sign * load / mass) / radius
        position += np.where(moving, sign * step, 0.0)
        counts += moving
    assert len(np.unique(counts)) >= 4
    assert np.all(np.abs(rows["steps"] - counts) <= 1)


def test_less_preload_shortens_steps_that_friction_limits_and_no_others(stage_rows):
    looser = JOINT_3 + schedule("preload", "-10 %", session="2012-03-06")
    rows = stage_rows(looser, sweep="q2_deg = -90")
    before, after = rows["session"] < "2012-03-06", rows["session"] >= "2012-03-06"
    assert after.sum() == 2 * before.sum() == 4
    assert_counts(rows, np.where(after, LENGTH / (0.9 * 980e-9), LENGTH / 980e-9))
    rows = stage_rows(looser, {"voltage": 10}, sweep="q2_deg = -90")
    assert_counts(rows, LENGTH / 300e-9)
    rows = stage_rows(looser)  # under load
    assert_counts(rows, friction_limited_3(rows, np.where(rows["session"] >= "2012-03-06", 45.0, 50.0)))


def test_friction_follows_a_column_of_the_log(stage_rows):
    text = JOINT_3 + schedule("friction", "-4 %", column="humidity_pct", at="45 %", per="10 %") + HUMID
    rows = stage_rows(text, sweep="q2_deg = [-90, -60, 0]")
    assert rows["humidity"].std() > 0.02
    assert rows.groupby("session")["humidity"].std().min() > 0.01
    assert_counts(rows, friction_limited_3(rows, 50 * (1 - 0.4 * (rows["humidity"] - 0.45))))


def test_travel_follows_the_supply_where_the_slider_catches_up(stage_rows):
    text = JOINT_3 + schedule("voltage", "1 V", column="supply_V", at="10 V", per="1 V")
    text += '[[column]]\nname = "supply_V"\nmean = "10 V"\nwithin_session = "0.5 V"\n'
    rows = stage_rows(text, {"voltage": 10}, sweep="q2_deg = -90")
    assert rows["supply"].std() > 0.2
    assert_counts(rows, LENGTH / (30e-9 * rows["supply"]))


def test_friction_wears_with_the_joints_own_steps(stage_rows):
    rows = stage_rows(JOINT_3 + schedule("friction", "-20 %", over="60000 steps"), replicates=2)
    made = np.cumsum(rows["steps"]) - rows["steps"]
    acceleration = 50 * (1 - 0.2 * (1 - np.exp(-made / 6e4)))
    assert acceleration.min() < 42
    assert_counts(rows, friction_limited_3(rows, acceleration))


def test_a_stage_warms_up_from_session_to_session(stage_rows):
    rows = stage_rows(JOINT_3 + schedule("preload", "5 %", over="10 min"), replicates=2)
    warm = 50 * (1 + 0.05 * (1 - np.exp(-rows["session_seconds"] / 600)))
    assert_counts(rows, friction_limited_3(rows, warm))


@pytest.mark.parametrize(
    ("keys", "late"),
    [
        ({"traverse": 6}, lambda rows: np.arange(len(rows)) >= 5),
        (
            {"session": "2012-03-06", "moment": "5 min"},
            lambda rows: (
                (rows["session"] > "2012-03-06")
                | ((rows["session"] == "2012-03-06") & (rows["session_seconds"] >= 300))
            ),
        ),
    ],
)
def test_a_payload_from_a_traverse_or_a_moment_on(stage_rows, keys, late):
    rows = stage_rows(JOINT_3 + schedule("payload", "1 g", **keys))
    assert 0 < late(rows).sum() < len(rows)
    assert late(rows)[rows["session"] == "2012-03-06"].any()
    assert_counts(rows, friction_limited_3(rows, np.where(late(rows), 0.25 / 6e-3, 50.0)))


def test_changes_of_one_quantity_add_up_and_then_multiply(stage_rows):
    changes = schedule("ramp time", "0.02 ms", traverse=1) + schedule("ramp time", "-5 %", traverse=1)
    rows = stage_rows(JOINT_3 + changes)
    assert_counts(rows, friction_limited_3(rows, 50.0, ramp=0.95 * 1.6e-4))


def test_each_direction_may_have_a_stage_of_its_own(stage_rows, tmp_path):
    (tmp_path / "back.toml").write_text(STAGE.format(**TYPICAL | {"mass": 6}))
    text = JOINT_3 + 'direction = "+"\n' + JOINT_3.replace("stage.toml", "back.toml") + 'direction = "-"\n'
    rows = stage_rows(text)
    assert_counts(rows, friction_limited_3(rows, np.where(rows["direction"] == "+", 50.0, 0.25 / 6e-3)))


@pytest.mark.parametrize(
    "changed",
    [
        {"drive": 'waveform = "s-curve"\nramp_time_ms = 0.14'},
        {"drive": "ramp_time_ms = 0.14", "rest": 0.0},  # the next ramp catches the slider moving
        pytest.param({"contact": 'model = "dahl"\nstiffness_N_per_um = 20'}, marks=pytest.mark.nightly),
    ],
)
def test_other_stages_step_as_the_stage_itself_says(stage_rows, changed):
    rows = stage_rows(JOINT_3, changed, sweep="q2_deg = [-90, 0]", dates="2012-03-05")
    drive = Drive(80.0, 30e-9, RAMP, 5e-6, 1e-3 * changed.get("rest", 1))
    stage = Stage("", MASS, Contact(0.2, 1.25), drive)
    if "contact" in changed:
        stage = replace(stage, contact=Contact(0.2, 1.25, "dahl", stiffness=20e6))
    elif "rest" not in changed:
        stage = replace(stage, drive=replace(drive, waveform="s-curve"))
    kept = 1 - 0.25 * np.abs(np.cos(rows["q2"]))
    loads, which = np.unique(np.round(load_3(rows), 12), return_inverse=True)
    steps = np.array([replace(stage, load=G * load).step() for load in loads])
    assert_counts(rows, LENGTH / kept / steps[which])


@pytest.mark.nightly
def test_bristles_meet_what_a_schedule_changes(stage_rows):
    later = {"session": "2012-03-06"}
    changes = schedule("preload", "-10 %", **later) + schedule("voltage", "-40 V", **later)
    changes += schedule("payload", "1 g", **later) + schedule("ramp time", "0.02 ms", **later)
    bristles = {"contact": 'model = "dahl"\nstiffness_N_per_um = 5'}
    rows = stage_rows(JOINT_3 + changes, bristles, sweep="q2_deg = -90", dates="2012-03-05, 2012-03-06")
    first = Stage("", MASS, Contact(0.2, 1.25, "dahl", stiffness=5e6), Drive(80, 30e-9, RAMP, 5e-6, 1e-3))
    last = Stage("", 6e-3, replace(first.contact, preload=1.125), Drive(40, 30e-9, 1.6e-4, 5e-6, 1e-3))
    assert_counts(rows, LENGTH / np.repeat([first.step(), last.step()], 2))


def test_causes_act_on_a_stage_as_on_a_law(stage_rows):
    late = '[[cause]]\nname = "end-stop-latency"\nL = "40 steps"\n'
    rows, with_cause = stage_rows(JOINT_3), stage_rows(JOINT_3 + late)
    assert np.abs(with_cause["steps"] - rows["steps"] - 40).max() <= 1


def test_a_log_records_the_columns_and_reads_back_the_same(truth_of, plan_of, machine, tmp_path):
    own = '[[column]]\nname = "pressure_hPa"\nmean = 860\nbetween_sessions = 5\n'
    text = JOINT_3 + schedule("friction", "1 %", column="pressure_hPa", at=860, per=10) + own + HUMID
    log = simulate(plan_of(), truth_of(text), machine)
    write_log(log, tmp_path / "log.csv")
    again = read_log(tmp_path / "log.csv").rows
    assert again["covariate:pressure_hPa"].nunique() == 3
    np.testing.assert_allclose(again["humidity"], log.rows["humidity"], rtol=1e-12)


FAULTS = [
    (JOINT_3 + JOINT_3, "stage 2 joint", "3", "an earlier [[stage]] has this joint and direction"),
    (JOINT_3.replace("b = 0.25", "radius_mm = 1"), "stage 1 radius_mm", "1", "is no key of this table"),
    (JOINT_2.replace("r_q3_0 = 0.1\n", ""), "stage 1 r_q3_0", None, "give a number, -0.9 to 0.9"),
    (JOINT_3 + schedule("preload", "-10 mm", traverse=2), "schedule 1 change", "-10 mm", "in % or N or mN"),
    (JOINT_3 + schedule("preload", "-10", traverse=2), "schedule 1 change", "-10", "in % or N or mN"),
    (JOINT_3 + schedule("payload", "5 %", traverse=2), "schedule 1 change", "5 %", "in g or kg"),
    (
        JOINT_3 + schedule("weight", "5 g", traverse=2),
        "schedule 1 quantity",
        "weight",
        "give one of 'preload'",
    ),
    (JOINT_3 + schedule("preload", "5 %"), "schedule 1 quantity", "preload", "give one of session, traverse"),
    (
        JOINT_3 + schedule("preload", "5 %", traverse=2, session="x"),
        "schedule 1 session",
        "x",
        "give one of session, traverse",
    ),
    (
        JOINT_3 + schedule("preload", "5 %", traverse=2, moment="1 min"),
        "schedule 1 moment",
        "1 min",
        "goes with session",
    ),
    (
        JOINT_3 + schedule("friction", "5 %", column="humidity_pct", at="45 %", per="5 K"),
        "schedule 1 per",
        "5 K",
        'such as "10 %"',
    ),
    (
        JOINT_3 + schedule("friction", "5 %", column="humidity", at="45 %", per="5 %"),
        "schedule 1 column",
        "humidity",
        "did you mean humidity_pct?",
    ),
    (
        JOINT_3 + schedule("friction", "5 %", column="humidity_pct"),
        "schedule 1 column",
        "humidity_pct",
        "give at too",
    ),
    (
        JOINT_3 + schedule("friction", "5 %", over="5 mm"),
        "schedule 1 over",
        "5 mm",
        "give steps or a time above 0",
    ),
    (
        JOINT_3 + '[[column]]\nname = "humidity_pct"\nmean = "45 K"\n',
        "column 1 mean",
        "45 K",
        'such as "10 %"',
    ),
    (JOINT_3 + '[[column]]\nname = "humidity_pct"\nmean = "wet"\n', "column 1 mean", "wet", 'such as "45 %"'),
    (JOINT_3 + '[[column]]\nname = "humidity_pct"\n', "column 1 mean", None, 'such as "45 %"'),
    (JOINT_3 + schedule("friction", "5 %", over="long"), "schedule 1 over", "long", "give steps or a time"),
    (JOINT_3 + HUMID + HUMID, "column 2 name", "humidity_pct", "an earlier [[column]] has this name"),
]


@pytest.mark.parametrize(("text", "place", "value", "message"), FAULTS)
def test_a_fault_is_told_with_its_place_and_what_to_write(truth_of, text, place, value, message):
    with pytest.raises(InputError) as caught:
        truth_of(text)
    (problem,) = caught.value.problems
    assert (problem.column, problem.value) == (
        place if place.startswith(("stage", "column")) else f"stage 1 {place}",
        value,
    )
    assert message in problem.message
    assert problem.line is not None


def test_a_joint_has_a_law_or_a_stage(law_of, tmp_path):
    (tmp_path / "stage.toml").write_text(STAGE.format(**TYPICAL))
    with pytest.raises(InputError, match=r"column stage 1 joint, value '3': joint 3 has a \[\[law\]\] too"):
        law_of(more=JOINT_3)


@pytest.mark.parametrize(
    ("text", "stage", "message"),
    [
        (JOINT_3, {"mass": "5\ngravity = 1"}, "stage 1 file, value 'stage.toml': has gravity or a force"),
        (JOINT_3, {"mass": -5}, "stage.toml, line 3, column slider.mass_g, value '-5'"),
        (JOINT_3.replace("stage.toml", "gone.toml"), {}, "gone.toml: cannot be read"),
        (JOINT_3, {"rest": "0.2\n[drift]\nwarm_up_K = 3"}, "has a .drift.; leave it out"),
    ],
)
def test_a_stage_file_that_cannot_be_one(truth_of, text, stage, message):
    with pytest.raises(InputError, match=message):
        truth_of(text, **stage)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            JOINT_3 + schedule("preload", "5 %", session="2012-3-06"),
            "'2012-3-06' on, which the plan does not have",
        ),
        (JOINT_3 + schedule("preload", "5 %", traverse=13), "from traverse 13 on, but the plan has 12"),
        (
            JOINT_3 + schedule("friction", "5 %", column="humidity_pct", at="45 %", per="5 %"),
            r"needs humidity_pct, which no \[\[column\]\] gives",
        ),
        (JOINT_3 + schedule("preload", "-2 N", traverse=2), "takes the preload of a stage to -0.75 N"),
        (JOINT_3 + 'direction = "+"\n', r"joint 3, direction - has no stage; add a \[\[stage\]\]"),
        (JOINT_3 + schedule("payload", "40 g", traverse=2), "joint 3 comes to a halt"),
        (
            JOINT_3 + '[[column]]\nname = "humidity_pct"\nmean = "10 %"\nbetween_sessions = "60 %"\n',
            "the column humidity comes out as",
        ),
    ],
)
def test_what_a_plan_cannot_have_is_refused(stage_rows, text, message):
    with pytest.raises(InputError, match=message):
        stage_rows(text)


def test_the_command_writes_the_truth_beside_the_log(run, refused, tmp_path):
    (tmp_path / "stage.toml").write_text(STAGE.format(**TYPICAL))
    (tmp_path / "law.toml").write_text(JOINT_3 + schedule("ramp time", "0.01 ms", session="2012-03-06"))
    (tmp_path / "plan.toml").write_text(PLAN.format(**USUAL | QUIET))
    paths = tmp_path / "plan.toml", "--law", tmp_path / "law.toml", "-o", tmp_path / "log.csv"
    status, printed, _ = run("simulate", *paths, "--true-steps", tmp_path / "truth.csv")
    assert status == 0
    assert "true steps written to" in printed
    rows, truth = read_log(tmp_path / "log.csv").rows, pd.read_csv(tmp_path / "truth.csv")
    later = rows["session"] >= "2012-03-06"
    np.testing.assert_allclose(truth["ramp_time_ms"], np.where(later, 0.15, 0.14))
    np.testing.assert_allclose(truth["preload_N"], 1.25)
    np.testing.assert_allclose(12e6 / truth["step_nm"], rows["steps"], atol=0.51)
    (tmp_path / "stage.toml").unlink()
    assert "stage.toml: cannot be read" in refused("simulate", *paths, "--force")


def test_a_study_takes_no_stages(truth_of, plan_of, machine, tmp_path):
    cause = '[[cause]]\nname = "end-stop-latency"\nL = "40 steps"\n'
    truth_of(JOINT_3 + cause)
    plan_of()
    study = 'plan = "plan.toml"\nlaw = "law.toml"\n[moves]\ncount = 0\n[[scenario]]\nname = "nothing"\n'
    (tmp_path / "study.toml").write_text(study)
    with pytest.raises(InputError, match=r"column law, value 'law.toml': has stages, which a study does not"):
        read_study(tmp_path / "study.toml", machine)
