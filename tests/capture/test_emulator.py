"""The emulated rig counts what `simulate` counts, and behaves like a controller and a machine."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.rig import EmulatedRig, emulate_rig
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Noise
from stickslip_fit.simulation import expected_counts, simulate
from tests.capture.truths import MACHINE, plan_of, truth_of

MISSED = 10_000


def drive_rows(rig: EmulatedRig, rows: pd.DataFrame) -> np.ndarray:
    """Make a log's traverses at their times, as its person and its driver did; the counts."""
    controller, ear, manipulator = rig.controller(pytest.fail), rig.ideal_detector(), rig.manipulator
    began, session, counts = rows["time"].iloc[0], None, []
    for row in rows.to_dict("records"):
        if row["session"] != session:
            session = row["session"]
            manipulator.begin_session(session)
        others = {f"q{joint}": row[f"q{joint}"] for joint in (1, 2, 3) if joint != row["joint"]}
        manipulator.set(theta=row["theta"], psi=row["psi"], **others, **{f"q{row['joint']}": row["start"]})
        rig.clock.sleep((row["time"] - began).total_seconds() - rig.clock.now())
        counts.append(counted(rig, controller, ear, row["joint"], row["direction"], row["check_every"]))
    return np.array(counts)


def counted(rig, controller, ear, joint, direction, check_every=5):
    """Steps of one traverse until the stop is heard."""
    ear.begin()
    for count in range(check_every, MISSED, check_every):
        controller.step(joint, check_every if direction == "+" else -check_every)
        if ear.check(check_every * rig.emulated_controller.period).at_stop:
            return count
    pytest.fail("no stop was met")


CAUSES = {
    "thermal-warm-up": 'A = "5 %"\ntau = "20 min"',
    "wear": 'k = "1 %"\nn0 = "2000 steps"',
    "reversal-loss": 'L = "40 steps"',
    "load-hysteresis": 'k = "4 %"',
    "end-stop-latency": 'L = "37 steps"',
    "psi-offset": 'delta = "4 deg"',
    "step-rate": 'k = "3 %"\nmedian = "20 ms"',
}


def hidden(*names):
    return "".join(f'\n[[cause]]\nname = "{name}"\n{CAUSES[name]}\n' for name in names)


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [pytest.param((), marks=pytest.mark.nightly), [*CAUSES][:4], [*CAUSES][4:]],
    ids=", ".join,
)
def test_without_noise_it_counts_exactly_what_simulate_counts(names, tmp_path):
    truth = truth_of(tmp_path, hidden(*names))
    rows = simulate(plan_of(tmp_path, replicates=1), truth.laws, MACHINE).rows
    assert np.array_equal(drive_rows(emulate_rig(truth), rows), rows["steps"])


def test_a_traverse_follows_the_one_before_it_and_not_its_own_beginning(tmp_path):
    """Two in a row differ by the steps lost in turning round, however they were commanded."""
    truth = truth_of(tmp_path, hidden("reversal-loss"))
    rig = emulate_rig(truth)
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()
    first = counted(rig, controller, ear, 3, "+")
    back = counted(rig, controller, ear, 3, "-")
    turned = counted(rig, controller, ear, 3, "+")
    assert turned - first == 40
    rig.manipulator.set(q3=0.0)
    assert counted(rig, controller, ear, 3, "+") == first
    assert back > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pytest.param("gaussian", marks=pytest.mark.nightly), "t5"])
def test_with_noise_the_counts_spread_about_simulates(kind, tmp_path):
    truth = truth_of(tmp_path, noise=0.02)
    truth = replace(truth, noise=replace(truth.noise, kind=kind))
    rig = emulate_rig(truth)
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()
    found = []
    for number in range(200):
        rig.manipulator.set(q3=0.012 * (number % 2))
        found.append(counted(rig, controller, ear, 3, "-" if number % 2 else "+", 25) - 12.5)
    row = {"q2": [-np.pi / 2], "theta": [0.0], "psi": [0.0], "start": [0.0], "stop": [0.012]}
    for direction, steps in (("+", found[::2]), ("-", found[1::2])):
        logs = np.log(steps)
        usual = expected_counts(truth.laws.laws[3], row, truth.laws.values[3, direction, None])[0]
        assert logs.mean() == pytest.approx(np.log(usual), abs=4 * 0.02 / np.sqrt(100))
        assert logs.std() == pytest.approx(0.02, rel=0.3)


@pytest.mark.slow
def test_days_differ_as_the_law_file_says_and_stay_themselves(tmp_path):
    truth = truth_of(tmp_path, day_to_day=3.0)
    rig = emulate_rig(truth)
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()

    def count(day):
        rig.manipulator.begin_session(f"day {day}")
        rig.manipulator.set(q3=0.0)
        return counted(rig, controller, ear, 3, "+")

    counts = np.array([count(day) for day in range(60)])
    assert np.log(counts).std() == pytest.approx(0.03, rel=0.35)
    assert count(7) == counts[7]


def test_a_joint_at_its_stop_stays_there_while_the_steps_go_on(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    controller = rig.controller(pytest.fail)
    controller.step(3, 20_000)
    assert rig.manipulator.position(3) == MACHINE.ranges[3][1]
    controller.step(3, 500)
    assert rig.manipulator.position(3) == MACHINE.ranges[3][1]
    assert rig.manipulator.total_steps(3) == 20_500
    assert rig.emulated_controller.step_counts["C"] == 20_500
    controller.step(3, -1000)
    assert rig.manipulator.position(3) == pytest.approx(0.012 - 1000 * 903e-8, rel=1e-9)


def test_positions_and_counts_agree_on_where_a_traverse_ends(tmp_path):
    """Whatever a day, noise and lost steps make of it; the arm is level, and all steps are alike."""
    rig = emulate_rig(truth_of(tmp_path, hidden("reversal-loss"), day_to_day=3.0, noise=0.05))
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()
    for number in range(6):
        way, stop = (1, 0.012) if number % 2 == 0 else (-1, 0.0)
        controller.step(3, 400 * way)
        at_first = rig.manipulator.position(3)
        controller.step(3, 400 * way)
        here = rig.manipulator.position(3)
        left = abs(stop - here) / (abs(here - at_first) / 400)
        assert counted(rig, controller, ear, 3, "-+"[way > 0], 1) == np.ceil(left)
        assert rig.manipulator.position(3) == stop


def test_stops_can_be_put_closer_and_taken_away(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()
    whole = counted(rig, controller, ear, 3, "+")
    rig.manipulator.set_stops(3, 0.003, 0.006)
    assert rig.manipulator.position(3) == 0.006
    rig.manipulator.set(q3=0.003)
    assert counted(rig, controller, ear, 3, "+") == pytest.approx(whole / 4, abs=5)
    rig.manipulator.set_stops(3, *MACHINE.ranges[3])
    rig.manipulator.set(q3=0.0)
    assert counted(rig, controller, ear, 3, "+") == whole


@pytest.mark.parametrize(
    ("quantities", "message"),
    [({"q3": 0.013}, "beyond joint 3's stops"), ({"zeta": 0.1}, "'zeta' cannot be set; choose among q1")],
)
def test_hands_cannot_do_what_is_impossible(quantities, message, tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    with pytest.raises(InputError, match=message):
        rig.manipulator.set(**quantities)


@pytest.mark.parametrize(("dialect", "on_the_way"), [("new", 0.0), ("old", 0.010)])
def test_time_passes_as_the_steps_do(dialect, on_the_way, tmp_path):
    rig = emulate_rig(truth_of(tmp_path), dialect, period=0.004)
    controller = rig.controller(pytest.fail)
    controller.step(3, 5)
    assert rig.clock.now() == pytest.approx(0.020 + on_the_way)
    controller.step(3, -250)
    assert rig.clock.now() == pytest.approx(1.020 + 6 * on_the_way)
    assert rig.emulated_controller.step_counts["C"] == -245
    assert "emulated" in controller.version()


def test_a_move_stopped_half_way_has_made_half_its_steps(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    rig.emulated_controller.receive(b"coarse C 1000\r")
    rig.clock.sleep(5.001)
    assert rig.emulated_controller.send() == b""
    rig.emulated_controller.receive(b"stop\r")
    assert rig.emulated_controller.send() == b"e\tstopped\ro\tstop\r"
    assert rig.emulated_controller.step_counts["C"] == rig.manipulator.total_steps(3) == 500
    rig.emulated_controller.receive(b"stopnack\r")
    assert rig.emulated_controller.send() == b""
    rig.emulated_controller.receive(b"coarse C ?\rcoarsereset C\rcoarse ?\r")
    assert rig.emulated_controller.send() == b"o\t500\ro\tcoarsereset\ro\t0 0 0 0\r"


def test_a_stop_right_behind_a_move_stops_it(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    rig.emulated_controller.receive(b"coarse C 1000\rstop\r")
    assert rig.emulated_controller.send() == b"e\tstopped\ro\tstop\r"
    assert rig.emulated_controller.due() is None


def test_commands_wait_for_each_other_and_may_come_in_pieces(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    for byte in b"coarse C 100\rcoarse B -100\r":
        rig.emulated_controller.receive(bytes([byte]))
    rig.clock.sleep(1.5)
    assert rig.emulated_controller.send() == b"o\tcoarse\r"
    rig.clock.sleep(0.5)
    assert rig.emulated_controller.send() == b"o\tcoarse\r"
    assert rig.emulated_controller.step_counts == {"A": 0, "B": -100, "C": 100, "D": 0}


@pytest.mark.parametrize("command", ["coarse E 5", "coarse C 70000", "coarse C five", "fly"])
def test_the_new_dialect_refuses_what_it_cannot_do(command, tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    rig.emulated_controller.receive(command.encode() + b"\r")
    assert rig.emulated_controller.send().startswith(b"e\t")
    assert rig.emulated_controller.due() is None


def in_band(sound, acoustics):
    """Power of a sound in the band of the stop."""
    spectrum = np.abs(np.fft.rfft(sound)) ** 2
    frequencies = np.fft.rfftfreq(len(sound), 1 / acoustics.rate)
    return spectrum[np.abs(frequencies - acoustics.peak) < 1000].mean()


def test_the_microphone_hears_the_stop_as_loud_as_it_is_said_to_be(tmp_path):
    """Its power in the stop's band, over that of a joint that moves, is the signal-to-noise ratio plus 1."""
    rig, acoustics = emulate_rig(truth_of(tmp_path)), Acoustics(snr_db=10.0)
    controller, microphone = rig.controller(pytest.fail), rig.microphone(acoustics)
    power = []
    for joint_at_stop in (False, True):
        rig.manipulator.set(q3=0.012 * joint_at_stop)
        controller.step(3, 100)
        heard = microphone.read(1.0).values
        assert len(heard) == acoustics.rate
        power.append(in_band(heard, acoustics))
    assert power[1] / power[0] == pytest.approx(11, rel=0.2)


def test_the_microphone_hears_the_stop_at_the_very_step_that_meets_it(tmp_path):
    rig, acoustics = emulate_rig(truth_of(tmp_path)), Acoustics(snr_db=30.0)
    controller, microphone = rig.controller(pytest.fail), rig.microphone(acoustics)
    count = counted(rig, controller, rig.ideal_detector(), 3, "+", 1)
    rig.manipulator.set(q3=0.0)
    controller.step(3, count - 100)
    controller.step(3, 150)
    steps = microphone.read(1.5).values.reshape(150, -1)
    power = np.array([in_band(step, acoustics) for step in steps])
    loud = power > 30 * np.median(power[:90])
    assert np.array_equal(loud, np.arange(150) >= 99)


def test_the_microphone_waits_for_what_it_has_not_heard(tmp_path):
    rig = emulate_rig(truth_of(tmp_path))
    microphone = rig.microphone(Acoustics())
    assert len(microphone.read(1.0).values) == 48_000
    assert rig.clock.now() == pytest.approx(1.0)


def test_noise_needs_no_joint_that_has_none(tmp_path):
    truth = replace(truth_of(tmp_path), noise=Noise({(3, "+"): 0.01}))
    rig = emulate_rig(truth)
    controller, ear = rig.controller(pytest.fail), rig.ideal_detector()
    out = [counted(rig, controller, ear, 3, way) for way in "+-+-+"]
    assert len({*out[::2]}) > 1
    assert out[1] == out[3]
