"""Hysteresis of the piezo: both models against each other, their loops and a step against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from stickslip_fit.errors import InputError
from stickslip_fit.step import (
    Contact,
    Drive,
    Foot,
    FootMotion,
    MaxwellCapacitor,
    PrandtlIshlinskii,
    Stage,
    coulomb_step,
    make_motion,
    motion_from_table,
)

PLAYS = PrandtlIshlinskii((0.1, 0.08, 0.05), (3.0, 9.0, 20.0))
ELEMENTS = MaxwellCapacitor((0.2, 0.15, 0.3), (2.0, 4.0, 15.0))
MODELS = pytest.mark.parametrize("model", [PLAYS, ELEMENTS], ids=["plays", "elements"])
GAIN = 30e-9


def voltage_for(elements, path):
    """What relaxed elements show on a path of responses: each a spring that slides at its limit."""
    stiffness, limit = np.array(elements.stiffnesses), np.array(elements.break_voltages)
    force, voltages = np.zeros(len(limit)), []
    for value, move in zip(path, np.diff(path, prepend=0.0), strict=True):
        force = np.clip(force + stiffness * move, -limit, limit)
        voltages.append(value + force.sum())
    return np.array(voltages)


def test_plays_are_the_inverse_of_maxwells_elements():
    voltage = np.random.default_rng(1).normal(0, 25, 300)
    np.testing.assert_allclose(voltage_for(ELEMENTS, ELEMENTS.respond(voltage)), voltage, atol=1e-12)
    same = MaxwellCapacitor((0.1, 0.1, 0.15, 0.3), (1.0, 1.0, 4.0, 15.0))  # two that slide together
    np.testing.assert_allclose(same.respond(voltage), ELEMENTS.respond(voltage), atol=1e-12)


@MODELS
def test_a_reversed_branch_is_the_first_at_twice_the_size(model):
    rises = np.linspace(0, 30, 61)
    first = model.respond(rises)
    back = [model.respond([30.0, 30.0 - 2 * rise])[-1] for rise in rises]
    np.testing.assert_allclose(first[-1] - back, 2 * first, atol=1e-12)
    assert first[1] < 0.95 * first[-1] / 60  # it rises slowly at first


@MODELS
def test_a_loop_that_closes_is_forgotten(model):
    inner = model.respond([40.0, 10.0, 25.0, 10.0, -40.0, -20.0, 40.0])
    outer = model.respond([40.0, 10.0, -40.0, 40.0])
    np.testing.assert_allclose(inner[[1, 3, 4, 6]], outer[[1, 1, 2, 3]], atol=1e-12)
    assert abs(model.respond([50.0, 20.0])[-1] - model.respond([40.0, 20.0])[-1]) > 0.1


@MODELS
@pytest.mark.parametrize("swing", [4.0, 30.0, 80.0])
def test_the_settled_loop_has_its_height_and_opening(model, swing):
    source = make_motion("ramp", swing, 1e-4, 1e-4)
    settled = model.apply(source, 1.0)
    assert np.ptp(settled.at(source.duration.cumsum())) == pytest.approx(model.span(swing), rel=1e-12)
    rising, falling = settled.at([0.5e-4, 1.5e-4])
    assert falling - rising == pytest.approx(model.opening(swing), abs=1e-12)
    cycle = np.concatenate([np.linspace(0, swing, 9), np.linspace(swing, 0, 9)])
    later = model.respond(np.tile(cycle, 3))[-18:]  # a relaxed piezo settles to the same loop
    times = np.concatenate([np.linspace(0, 1e-4, 9), np.linspace(1e-4, 2e-4, 9)])
    np.testing.assert_allclose(settled.at(times), later - later[0], atol=1e-12)


@MODELS
def test_travel_depends_on_the_path_alone_not_on_its_pace(model):
    """The same voltages by other waveforms and by a table that dawdles."""
    voltages = np.linspace(0, 80, 33)
    ramp, parabola = (model.apply(make_motion(name, 80.0, 1.0, 0.5), 1.0) for name in ("ramp", "parabola"))
    np.testing.assert_allclose(ramp.at(voltages / 80), parabola.at(np.sqrt(voltages / 80)), atol=1e-10)
    curve = model.apply(make_motion("s-curve", 80.0, 1.0, 0.5), 1.0)
    np.testing.assert_allclose(
        ramp.at(voltages / 80),
        curve.at(
            np.where(voltages < 40, np.sqrt(voltages / 160), 1 - np.sqrt(np.maximum(80 - voltages, 0) / 160))
        ),
        atol=1e-10,
    )
    table = model.apply(motion_from_table([0, 3, 4, 4, 5, 6], [0, 10, 80, 30, 80, 0]), 1.0)
    assert table.at(3.0) == pytest.approx(ramp.at(0.125), abs=1e-12)
    later = model.respond(np.tile([0.0, 80.0, 30.0, 76.0, 80.0], 3))[-5:]  # after a jump, back
    assert table.at(4.92) == pytest.approx(later[3] - later[0], abs=1e-12)


@MODELS
def test_a_reversal_within_a_piece_is_seen(model):
    """A throw, up and down by one parabola, against voltages one by one."""
    thrown = FootMotion(np.array([1.0]), np.zeros(1), np.array([320.0]), np.array([-640.0]))
    settled = model.apply(thrown, 1.0)
    times = np.linspace(0, 1, 41)
    later = model.respond(np.tile(thrown.at(times), 3))[-41:]
    np.testing.assert_allclose(settled.at(times), later - later[0], atol=1e-10)
    np.testing.assert_allclose(settled.ends, np.roll(settled.position, -1), atol=1e-10)


def two_piece_ramp(first, second, change, end, friction, load):
    """Step over a ramp of speed `first` until `change`, then `second` until `end`, and a jump back."""
    gaining, slowing = friction - load, friction + load
    travel = first * change + second * (end - change)
    if first / gaining < change:  # it catches up before the change, and is left behind again
        lag, since = first**2 / (2 * gaining), change + (second - first) / gaining
        lag += (second - first) ** 2 / (2 * gaining)
    else:
        since = second / gaining
        lag = first * change + second * (since - change) - second**2 / (2 * gaining)
    if since < end:
        return travel - lag + second**2 / (2 * slowing)
    return gaining * end**2 / 2 * (1 + gaining / slowing)


@pytest.mark.parametrize(
    ("weight", "ramp_time"), [(0.3, 3e-4), (0.3, 1.2e-4), (0.05, 3e-4), (0.3, 5e-5)], ids=str
)
@pytest.mark.parametrize("load", [0.0, 9.81, -9.81])
def test_a_step_is_that_of_a_ramp_of_two_pieces(weight, ramp_time, load):
    model, voltage, friction = PrandtlIshlinskii((weight,), (4.0,)), 20.0, 50.0
    speed = GAIN * voltage / ramp_time
    change = 8.0 / voltage * ramp_time
    expected = two_piece_ramp((1 - weight) * speed, speed, change, ramp_time, friction, load)
    drive = Drive(voltage, GAIN, ramp_time, 0.0, 1e-3, hysteresis=model)
    assert coulomb_step(drive.motion(), friction, load) == pytest.approx(expected, rel=1e-12)
    stage = Stage("hysteretic", 5e-3, Contact(0.2, 1.25), drive, load)
    assert stage.step() == pytest.approx(expected, rel=1e-9)
    assert drive.amplitude == pytest.approx(GAIN * (voltage - 8 * weight))
    assert not stage.has_ramp
    assert drive.without_hysteresis().motion().position.max() == pytest.approx(drive.amplitude)


@pytest.mark.slow
def test_hysteresis_acts_before_the_foots_dynamics():
    """A stiff foot tends to the hysteretic waveform, with bristles too."""
    contact = Contact(0.2, 1.25, "lugre", stiffness=2e8, damping=20.0)
    drive = Drive(80.0, GAIN, 4e-4, 5e-6, 2.25e-4, hysteresis=ELEMENTS)
    rigid = Stage("rigid", 5e-3, contact, drive)
    coulomb = replace(rigid, contact=replace(contact, model="coulomb")).step()
    assert rigid.step() == pytest.approx(coulomb, rel=0.01)
    linear = replace(rigid, drive=drive.without_hysteresis())
    assert abs(linear.step() / rigid.step() - 1) > 0.02
    assert replace(rigid, foot=Foot(1e-3, 500e3, 0.7)).step() == pytest.approx(rigid.step(), rel=0.02)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PrandtlIshlinskii((0.5, 0.5), (1.0, 2.0)), "below 1 together, not 1"),
        (lambda: PrandtlIshlinskii((0.5,), (1.0, 2.0)), "each with weight and threshold"),
        (lambda: PrandtlIshlinskii((-0.5,), (1.0,)), "above 0"),
        (lambda: MaxwellCapacitor((), ()), "1 to 50 elements"),
        (lambda: MaxwellCapacitor((1.0,), (float("nan"),)), "above 0"),
        (lambda: PLAYS.apply(make_motion("ramp", [1.0, 2.0], 1.0), 1.0), "one motion"),
    ],
)
def test_what_is_no_hysteresis_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
