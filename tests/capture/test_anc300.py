"""attocube's ANC300 behind the same interface, command by command."""

from contextlib import contextmanager

import pytest

from stickslip_fit.capture.devices import AXES, Anc300, open_anc300
from stickslip_fit.capture.protocols import ConnectionLost, ControllerError
from stickslip_fit.errors import InputError

pytest.importorskip("pymeasure", reason="pymeasure is not installed")

from pymeasure.instruments.attocube import ANC300Controller
from pymeasure.test import expected_protocol

LOGIN = [("secret", "******"), (None, "Authorization success"), ("echo off", "> echo off"), (None, "OK")]


@contextmanager
def anc300(pairs):
    with expected_protocol(
        ANC300Controller, LOGIN + pairs, axisnames=list(AXES.values()), passwd="secret", query_delay=0.0
    ) as unit:
        yield Anc300(unit)


def move(command, axis):
    asked = (f"getf {axis}", "frequency = 5000 Hz\n")
    return [(f"setm {axis} stp", "OK"), (command, "OK"), asked, (None, "OK"), (f"stepw {axis}", "OK")]


def test_every_joint_has_its_axis_and_every_direction_its_command():
    with anc300(move("stepu 1 5", 1) + move("stepd 3 500", 3)) as controller:
        controller.step(1, 5)
        controller.step(3, -500)


def test_no_steps_are_no_command():
    with anc300([]) as controller:
        controller.step(1, 0)


def test_a_refusal_is_raised_in_the_controllers_words():
    pairs = [("setm 2 stp", "Axis in wrong mode"), (None, "ERROR")]
    with anc300(pairs) as controller, pytest.raises(ControllerError, match=r"joint 2, \+5 .*wrong mode"):
        controller.step(2, 5)


def test_stop_stops_every_axis():
    with anc300([("stop 1", "OK"), ("stop 2", "OK"), ("stop 3", "OK")]) as controller:
        controller.stop()


def test_the_version_is_asked_for():
    with anc300([("ver", "attocube ANC300 controller version 1.1.0\n"), (None, "OK")]) as controller:
        assert controller.version().startswith("attocube ANC300")


def test_a_lost_connection_is_unplugged():
    from pyvisa.constants import StatusCode
    from pyvisa.errors import VisaIOError

    class Gone:
        @property
        def first(self):
            raise VisaIOError(StatusCode.error_connection_lost)

    with pytest.raises(ConnectionLost, match=r"joint 1, \+5 steps.*--resume"):
        Anc300(Gone()).step(1, 5)


def test_a_joint_that_is_none_is_refused():
    with anc300([]) as controller, pytest.raises(InputError, match="joint 0"):
        controller.step(0, 5)


def test_an_address_where_nobody_answers_is_told():
    with pytest.raises(ControllerError, match=r"cannot open the ANC300 'ASRL/dev/nothing::INSTR'"):
        open_anc300("ASRL/dev/nothing::INSTR", "secret")
