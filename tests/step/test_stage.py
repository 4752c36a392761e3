"""Stages, their files and the command: regimes, sweeps, faults with their lines."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.step import (
    Contact,
    Drive,
    Foot,
    MaxwellCapacitor,
    PrandtlIshlinskii,
    Stage,
    StageDrift,
    analyse_stage,
    coulomb_motion,
    step_size,
    sweep_step,
)
from stickslip_fit.step.stage import GRAVITY
from stickslip_fit.step.stage_file import read_stage

EXAMPLE = files("stickslip_fit").joinpath("templates", "stage_example.toml").read_text("utf-8")
LIMITED = Stage("limited", 5e-3, Contact(0.2, 1.25), Drive(80.0, 30e-9, 1.4e-4, 5e-6, 2.25e-4))
REACHED = replace(LIMITED, drive=replace(LIMITED.drive, voltage=20.0))


def write(tmp_path, *changes):
    text = EXAMPLE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "stage.toml"
    path.write_text(text, "utf-8")
    return path


def test_the_step_is_that_of_the_closed_form():
    for stage in (LIMITED, REACHED, replace(LIMITED, load=12.0)):
        drive = stage.drive
        closed = step_size(
            0.25 / 5e-3, drive.ramp_time, drive.voltage * drive.gain, stage.load, drive.flyback_time
        )
        assert stage.step() == pytest.approx(float(closed), rel=1e-9)
        trace = stage.trace()
        assert trace.slider[-1] == pytest.approx(float(closed), rel=1e-9)
        assert np.abs(trace.friction).max() == pytest.approx(0.25, rel=1e-9)
    assert LIMITED.is_friction_limited
    assert not REACHED.is_friction_limited


@pytest.mark.slow
def test_what_the_step_depends_on_tells_the_regimes_apart():
    """Friction-limited: a_f T1^2, no voltage. Catching up: the voltage alone."""
    limited, reached = analyse_stage(LIMITED), analyse_stage(REACHED)
    for name, slopes in {"mass": (-1, 0), "voltage": (0, 1), "preload": (1, 0), "ramp time": (2, 0)}.items():
        assert limited.elasticities[name] == pytest.approx(slopes[0], abs=1e-3)
        assert reached.elasticities[name] == pytest.approx(slopes[1], abs=1e-3)
    r = GRAVITY / 50.0
    # (1 - r) / (1 + r): even part over odd part is r; none where the response is odd.
    assert limited.load_curvature == pytest.approx(r, rel=1e-9)
    assert reached.load_curvature == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_a_contact_with_stiff_bristles_gives_nearly_the_step_of_coulomb():
    contact = replace(LIMITED.contact, model="lugre", stiffness=2e8, damping=20.0)
    analysis = analyse_stage(replace(LIMITED, contact=contact))
    assert analysis.step == pytest.approx(LIMITED.step(), rel=0.01)
    assert analysis.coulomb_step == pytest.approx(LIMITED.step(), rel=1e-12)
    assert "With Coulomb friction" in str(analysis.summary())


@pytest.mark.slow
def test_steps_that_follow_too_fast_are_flagged():
    hurried = replace(LIMITED, drive=replace(LIMITED.drive, rest_time=2e-5))
    assert not hurried.rests_between_steps
    motion = hurried.drive.motion()
    position = [coulomb_motion(motion, 50.0, periods=60).at(n * motion.period) for n in (50, 51)]
    assert hurried.step() == pytest.approx(position[1] - position[0], rel=0.02)
    assert hurried.step() > 1.1 * LIMITED.step()
    analysis = analyse_stage(LIMITED)
    assert not analysis.summary().flags
    assert any("still moves" in flag for flag in replace(analysis, stage=hurried).summary().flags)


def test_wear_in_use_shows_by_the_distance_slid(tmp_path):
    """A friction-limited slider slides D less its own travel on the ramp and on the flyback, and coasts."""
    read = read_stage(
        write(tmp_path, ("# [drift]", "[drift]"), ("# wear_length_m = 500 ", "wear_length_m = 500 "))
    )
    assert read.drift == StageDrift(wear_length=500.0)
    ramp, flyback, coast = 2400 - 490, 2400 + 34.375, 490 - 34.375
    assert read.trace(4000).sliding == pytest.approx(1e-9 * (ramp + flyback + coast), rel=1e-3)
    analysis = analyse_stage(read)
    share = dict(analysis.in_use)[10_000_000] / read.step()
    assert share == pytest.approx(np.exp(-(ramp + flyback + coast) * 1e-9 * 1e7 / 500), rel=1e-3)
    assert "Step size in use" in analysis.summary().as_text()


@pytest.mark.nightly
def test_the_keys_of_hysteresis_are_read_and_answered(tmp_path):
    lines = ("weights_pct", "thresholds_V", "stiffnesses", "break_voltages_V")
    table = ("# [hysteresis]", "[hysteresis]")
    low = ("voltage_V = 80", "voltage_V = 20")
    plays, elements = ([(f"# {key}", key) for key in pair] for pair in (lines[:2], lines[2:]))
    read = read_stage(write(tmp_path, table, low, *plays))
    assert read.drive.hysteresis == PrandtlIshlinskii((0.1, 0.08, 0.08), (3.0, 9.0, 20.0))
    shown = str(analyse_stage(read).summary())
    # 2 (0.1 x 3 + 0.08 x 1) x 30 nm: of the second play, 20 V less 2 x 9 V is left.
    assert "opens a loop of 22.8 nm, 4.6 %" in " ".join(shown.split())
    assert "A linear piezo of the same travel would step 490.8 nm" in " ".join(shown.split())
    small = read_stage(write(tmp_path, table, ("voltage_V = 80", "voltage_V = 5"), *plays))
    assert "too small to open the loop" in str(analyse_stage(small).summary())
    read = read_stage(write(tmp_path, table, *elements))
    assert read.drive.hysteresis == MaxwellCapacitor((0.2, 0.15), (2.0, 4.0))


def test_a_sweep_has_gaps_where_friction_does_not_hold_the_load():
    sweep = sweep_step(LIMITED, "load", [0.0, 49.0, 51.0, -51.0])
    assert list(np.isnan(sweep.steps)) == [False, False, True, True]
    with pytest.raises(InputError, match="none of load"):
        sweep_step(LIMITED, "humidity", [1.0])


def test_the_example_of_a_stage_file_is_read(tmp_path):
    read = read_stage(write(tmp_path))
    assert (read.name, read.mass, read.contact) == ("Joint 3, outward", LIMITED.mass, LIMITED.contact)
    assert read.step() == pytest.approx(LIMITED.step(), rel=1e-12)
    table = [(f"{key}_ms = {value}\n", "") for key, value in (("rest_time", 0.225), ("flyback_time", 0.005))]
    head = 'waveform = "ramp"            # or "parabola", "s-curve"; or a table in place of all times:\n'
    changes = [
        (head, ""),
        ("ramp_time_ms = 0.14\n", ""),
        *table,
        ("# times", "times"),
        ("# shares", "shares"),
    ]
    assert read_stage(write(tmp_path, *changes)).step() == pytest.approx(LIMITED.step(), rel=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass_g = 5.0 ", "mass_g = -5.0 ", "line 6, column slider.mass_g, value '-5.0'"),
        ("gravity = 0.0 ", "gravity = 1.0\nforce_N = 3.0", "does not hold the load of 3.05 N"),
        ('"coulomb"', '"lugre"', "line 13, column contact.model, value 'lugre': give the bristles'"),
        ('"ramp"', '"saw"', "line 21, column drive.waveform, value 'saw': give one of 'ramp'"),
        ("ramp_time_ms = 0.14\n", "", "give a ramp time"),
        ("# shares", "shares", "give both times and shares"),
        ("# shares = [0, 1, 0, 0]", "times_ms = [0, 1, 2]\nshares = [0, 1, 0.5]", "end where it began"),
        ("# [base]", "[base]\nmass_g = 60 #", "give it under [foot]"),
        ("# [foot]", "[foot]\nresonance_kHz = 60 #", "give the foot's mass"),
        ("# [foot]", "[foot]\nmass_g = 1\nresonance_kHz = 60 #", "choose a model with bristles"),
        (
            'model = "coulomb"',
            'model = "elastoplastic"\nstiffness_N_per_um = 20\nelastic_share_pct = 120 #',
            "elastic_share_pct, value '120': give a number in %, 1 to 99.9",
        ),
        (
            "# [hysteresis]",
            "[hysteresis]\nweights_pct = [10, 20]\nthresholds_V = [3] #",
            "line 29, column hysteresis.weights_pct, value '[10, 20]': give 1 to 50 play operators",
        ),
        (
            "# [hysteresis]",
            "[hysteresis]\nweights_pct = [10]\nbreak_voltages_V = [3] #",
            "give weights and thresholds, or stiffnesses and break_voltages",
        ),
        ("# [hysteresis]", "[hysteresis]\nthresholds_V = 3 #", "give a list of numbers"),
        ("flyback_time_ms = 0.005", "flyback_time_ms = 0.0", ""),
    ],
)
def test_faults_of_a_stage_file_are_named_with_their_line(tmp_path, old, new, said):
    path = write(tmp_path, (old, new))
    if not said:
        assert read_stage(path).step() == pytest.approx(LIMITED.step(), rel=1e-9)
        return
    with pytest.raises(InputError) as raised:
        read_stage(path)
    assert said in str(raised.value)


def test_bristles_need_a_flyback_or_a_foot_that_takes_time(tmp_path):
    bristles = ('model = "coulomb"', 'model = "dahl"\nstiffness_N_per_um = 20 #')
    jump = ("flyback_time_ms = 0.005", "flyback_time_ms = 0.0")
    with pytest.raises(InputError, match="cannot follow a jump"):
        read_stage(write(tmp_path, bristles, jump))
    foot = ("# [foot]", "[foot]\nmass_g = 1\nresonance_kHz = 60 #")
    assert read_stage(write(tmp_path, bristles, jump, foot)).foot == Foot(1e-3, 60e3)


def test_coulomb_friction_with_a_base_or_a_resonance_is_refused():
    with pytest.raises(InputError, match="choose a contact model"):
        replace(LIMITED, foot=Foot(1e-3, 6e4)).step()
