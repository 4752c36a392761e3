"""The emulated rig behind a pseudo-terminal: real bytes, real time, and a cable that can be pulled."""

import threading
import time

import pytest

from stickslip_fit.capture.devices import open_controller
from stickslip_fit.capture.protocols import ConnectionLost, ControllerError
from stickslip_fit.errors import InputError
from tests.capture.emulator_process import start_emulator
from tests.capture.truths import LAWS

pytest.importorskip("serial", reason="pyserial is not installed")
pytest.importorskip("pty", reason="this system has no pseudo-terminals")
STEP = 976e-8  # m
FAST = ("--step-period-ms", "1", "--repeatability-pct", "0")


@pytest.fixture(scope="module")
def law(tmp_path_factory):
    path = tmp_path_factory.mktemp("law") / "law.toml"
    path.write_text(LAWS.format(day_to_day=0), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def rig(law):
    with start_emulator(law, *FAST) as rig:
        yield rig


@pytest.fixture
def controller(rig):
    rig.set(q3=0.0)
    controller = open_controller(rig.port, "new", pytest.fail, step_period=0.001)
    yield controller
    controller.close()


@pytest.mark.slow
@pytest.mark.parametrize("dialect", ["new", "old"])
def test_a_rig_is_driven_until_its_cable_is_pulled(dialect, law):
    with start_emulator(law, *FAST, "--dialect", dialect) as rig:
        controller = open_controller(rig.port, dialect, pytest.fail, step_period=0.001)
        assert "emulated" in controller.version()
        began = time.monotonic()
        controller.step(3, 100)
        assert time.monotonic() - began >= 0.1
        time.sleep(0.5)  # the old dialect cannot tell when it is done
        assert rig.position(3) == pytest.approx(100 * STEP)
        threading.Timer(0.2, rig.close).start()
        began = time.monotonic()
        with pytest.raises(ConnectionLost, match="--resume"):
            controller.step(3, 5000)
        assert time.monotonic() - began < 2.0
        controller.close()


def test_hands_put_stops_and_a_microphone_hears(rig, controller):
    controller.step(3, 100)
    rig.set_stops(3, 0.0, 110 * STEP)
    controller.step(3, 50)
    assert rig.position(3) == pytest.approx(110 * STEP)
    rig.set_stops(3, 0.0, 0.012)
    assert rig.read(0.05).values.shape == (2400,)


@pytest.mark.parametrize("order", [lambda rig: rig.set(q3=1.0), lambda rig: rig.set(zeta=1.0)])
def test_hands_are_told_what_they_cannot_do(order, rig):
    with pytest.raises(InputError, match=r"beyond joint 3's stops|'zeta' cannot be set"):
        order(rig)


@pytest.mark.nightly
def test_a_faulty_law_file_is_told(tmp_path):
    with pytest.raises(InputError, match=r"missing\.toml"), start_emulator(tmp_path / "missing.toml"):
        pass


def test_a_move_is_stopped_from_another_thread(controller):
    key = threading.Timer(0.2, controller.stop)
    key.start()
    began = time.monotonic()
    with pytest.raises(ControllerError, match=r"joint 3, command 'coarse C 5000': .*stopped"):
        controller.step(3, 5000)
    assert time.monotonic() - began < 2.0
    key.join()
    controller.step(3, -10)


def test_a_move_that_was_left_waiting_is_stopped(rig, controller, monkeypatch):
    """As on Ctrl-C: nobody reads the reply to the move, and then it is stopped."""

    def press(seconds):
        if seconds:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(controller._line, "receive", press)
        with pytest.raises(KeyboardInterrupt):
            controller.step(3, 5000)
    began = time.monotonic()
    controller.stop()
    assert time.monotonic() - began < 1.0
    controller.step(3, -10)
    assert rig.position(3) < 1000 * STEP


def test_a_port_belongs_to_one_program(rig, controller):
    with pytest.raises(ControllerError, match="cannot open the port"):
        open_controller(rig.port, "new", pytest.fail)


def test_a_port_that_is_not_there_is_told():
    with pytest.raises(ControllerError, match=r"cannot open the port '/dev/nothing'.*there are"):
        open_controller("/dev/nothing", "new", pytest.fail)


def test_a_dialect_that_is_none_is_told():
    with pytest.raises(InputError, match="new, old, anc300"):
        open_controller("/dev/null", "klingon", pytest.fail)
