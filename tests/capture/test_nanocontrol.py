"""The NanoControl's two dialects, command by command."""

from functools import partial

import pytest

from stickslip_fit.capture import nanocontrol
from stickslip_fit.capture.nanocontrol import LineTransport, NanoControl, OldNanoControl
from stickslip_fit.capture.protocols import ConnectionLost, ControllerError, VirtualClock
from stickslip_fit.errors import InputError
from tests.capture.scripted import conversation

DONE = b"o\tdone\r"


@pytest.fixture
def told():
    return []


@pytest.fixture
def new(told):
    return partial(conversation, lambda line: NanoControl(line, told.append), nanocontrol.NEW_TERMINATOR)


@pytest.fixture
def old():
    return partial(conversation, OldNanoControl, nanocontrol.OLD_TERMINATOR)


def test_every_joint_has_its_channel_and_every_direction_its_sign(new):
    with new([(b"coarse A 5\r", DONE), (b"coarse B -7\r", DONE), (b"coarse C 9\r", DONE)]) as controller:
        for joint, steps in ((1, 5), (2, -7), (3, 9)):
            controller.step(joint, steps)


@pytest.mark.parametrize("at_once", [1, 2, 3, 5])
def test_a_reply_may_come_in_pieces(new, at_once):
    pairs = [(b"version\r", b"o\tNC4 01.70-180807\r"), (b"coarse C 5\r", DONE)]
    with new(pairs, at_once=at_once) as controller:
        assert controller.version() == "NC4 01.70-180807"
        controller.step(3, 5)


def test_lines_may_end_in_cr_and_lf_together(new):
    with new([(b"coarse C 5\r", b"o\tdone\r\n"), (b"coarse C 6\r", b"o\tdone\r\n")]) as controller:
        controller.step(3, 5)
        controller.step(3, 6)


def test_information_is_told_and_answers_nothing(new, told):
    pairs = [
        (None, b"i\tknob turned\r"),
        (b"coarse C 5\r", b"i\tvoltage breakdown\ri\tagain\r" + DONE),
        (b"version\r", b"o\tNC4\r"),
    ]
    with new(pairs) as controller:
        controller.step(3, 5)
        assert controller.version() == "NC4"
    assert told == ["knob turned", "voltage breakdown", "again"]


def test_a_long_move_goes_in_parts_that_a_command_can_hold(new):
    parts = [(b"coarse C -65535\r", DONE), (b"coarse C -65535\r", DONE), (b"coarse C -8930\r", DONE)]
    with new(parts) as controller:
        controller.step(3, -140_000)


def test_no_steps_are_no_command(new):
    with new([]) as controller:
        controller.step(3, 0)


def test_a_refusal_is_raised_in_the_controllers_words(new):
    with new([(b"coarse C 5\r", b"e\tpiezo overload\r"), (b"coarse C 5\r", DONE)]) as controller:
        with pytest.raises(ControllerError, match=r"joint 3, command 'coarse C 5': .*'piezo overload'"):
            controller.step(3, 5)
        controller.step(3, 5)


def test_what_is_no_reply_is_shown(new):
    with (
        new([(b"coarse C 5\r", b"\xff\x80coarse\r")]) as controller,
        pytest.raises(ControllerError, match=r"xff.*coarse.*choose the other one"),
    ):
        controller.step(3, 5)


def test_a_reply_to_nothing_stops_the_next_command(new):
    with new([(None, DONE)]) as controller, pytest.raises(ControllerError, match="to nothing that was sent"):
        controller.step(3, 5)


def test_silence_is_waited_out_for_longer_than_the_move_takes():
    clock = VirtualClock()

    class Silent:
        def write(self, data):
            pass

        def read(self, seconds):
            clock.sleep(seconds)
            return b""

        def close(self):
            pass

    controller = NanoControl(LineTransport(Silent(), clock, nanocontrol.NEW_TERMINATOR), print)
    with pytest.raises(ControllerError, match=r"joint 2, command 'coarse B 12000': nothing came"):
        controller.step(2, 12_000)
    assert 120 < clock.now() < 240
    with pytest.raises(ControllerError, match="has not yet answered 'coarse B 12000'"):
        controller.step(2, 5)


def test_half_a_reply_is_none_and_is_shown(new):
    with (
        new([(b"coarse C 5\r", b"o\tdo")]) as controller,
        pytest.raises(ControllerError, match=r"only 'o\\tdo' came"),
    ):
        controller.step(3, 5)


def test_a_late_reply_is_not_taken_for_the_next_commands(new):
    with new([(b"coarse C 5\r", None), (b"stop\r", DONE + DONE), (b"version\r", b"o\tNC4\r")]) as controller:
        with pytest.raises(ControllerError, match="nothing came"):
            controller.step(3, 5)
        controller.stop()
        assert controller.version() == "NC4"


def test_stop_takes_one_reply_where_nothing_moves(new):
    with new([(b"stop\r", DONE), (b"coarse C 5\r", DONE)]) as controller:
        controller.stop()
        controller.step(3, 5)


def test_stop_gets_over_a_reply_that_was_lost(new):
    with new([(b"coarse C 5\r", None), (b"stop\r", DONE), (b"coarse C 5\r", DONE)]) as controller:
        with pytest.raises(ControllerError, match="nothing came"):
            controller.step(3, 5)
        controller.stop()
        controller.step(3, 5)


def test_stop_says_so_when_nothing_answers(new):
    with (
        new([(b"stop\r", None)]) as controller,
        pytest.raises(ControllerError, match="command 'stop': nothing"),
    ):
        controller.stop()


def test_a_stop_from_another_thread_keeps_the_rest_of_a_move_from_being_sent(new):
    with new([(b"coarse C 65535\r", DONE), (b"stopnack\r", None), (b"coarse C 5\r", DONE)]) as controller:
        receive = controller._line.receive

        def receive_and_stop(seconds):
            if seconds:
                controller.stop()  # as another thread would, while this one waits
                controller._line.receive = receive
            return receive(seconds)

        controller._line.receive = receive_and_stop
        with pytest.raises(ControllerError, match="'coarse C 65535': stopped before it was done"):
            controller.step(3, 100_000)
        controller.step(3, 5)


@pytest.mark.parametrize("failing", ["write", "read"])
def test_a_lost_connection_is_unplugged(failing):
    def fail(*_):
        raise OSError(5, "Input/output error")

    wire = type("Gone", (), {"write": lambda *_: None, "read": lambda *_: b"", failing: fail})()
    controller = NanoControl(LineTransport(wire, VirtualClock(), nanocontrol.NEW_TERMINATOR), print)
    with pytest.raises(ConnectionLost, match=r"Input/output error.*--resume"):
        controller.step(3, 5)


def test_a_joint_that_is_none_is_refused(new, old):
    for dialect in (new, old):
        with dialect([]) as controller, pytest.raises(InputError, match="joint 4"):
            controller.step(4, 5)


def test_the_old_dialect_waits_until_the_move_must_be_over(old):
    with old([(b"coarse C +5;", None), (b"coarse A -3;", None)]) as controller:
        controller.step(3, 5)
        assert controller._line.clock.now() == pytest.approx(0.06)
        controller.step(1, -3)
        assert controller._line.clock.now() == pytest.approx(0.10)


def test_the_old_dialect_moves_no_further_at_once_than_a_person_can_bear(old):
    with old([(b"coarse B +50;", None), (b"coarse B +50;", None), (b"coarse B +20;", None)]) as controller:
        controller.step(2, 120)


def test_the_old_dialect_passes_over_what_it_cannot_read(old):
    pairs = [(b"coarse C +5;", b"ready\r\n"), (b"version;", b"NanoControl 2.1\r\n"), (b"coarse C +5;", None)]
    with old(pairs, at_once=1) as controller:
        controller.step(3, 5)
        assert controller.version() == "NanoControl 2.1"
        controller.step(3, 5)


def test_the_old_dialect_may_have_no_version(old):
    with old([(b"version;", None)]) as controller:
        assert controller.version() == ""
