"""An emulated rig behind a pseudo-terminal: real bytes, real time, and a cable that can be pulled."""

import os
import pty
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import EmulatedRig, emulate_rig
from stickslip_fit.capture.protocols import STEP_PERIOD, RealClock, Samples
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values


class ServedRig:
    """Its controller is at `port`, served by a thread; it is an `AudioSource` too."""

    rate = Acoustics.rate

    def __init__(self, rig: EmulatedRig, acoustics: Acoustics) -> None:
        self._rig, self._microphone = rig, rig.microphone(acoustics)
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._unplugged, self._plug = os.pipe()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        controller = self._rig.emulated_controller
        while True:
            with self._lock:
                os.write(self._master, controller.send())
                due = controller.due()
            seconds = None if due is None else max(due - self._rig.clock.now(), 0.0)
            ready, _, _ = select.select([self._master, self._unplugged], [], [], seconds)
            if self._unplugged in ready:
                return
            if self._master in ready:
                with self._lock:
                    controller.receive(os.read(self._master, 65_536))

    def set(self, **quantities: float) -> None:
        with self._lock:
            self._rig.manipulator.set(**quantities)

    def set_stops(self, joint: int, low: float, high: float) -> None:
        with self._lock:
            self._rig.manipulator.set_stops(joint, low, high)

    def begin_session(self, label: str) -> None:
        with self._lock:
            self._rig.manipulator.begin_session(label)

    def position(self, joint: int) -> float:
        with self._lock:
            return self._rig.manipulator.position(joint)

    def read(self, seconds: float) -> Samples:
        with self._lock:
            return self._microphone.read(seconds)

    def close(self) -> None:
        """Pull the cable."""
        if self._thread.is_alive():
            os.write(self._plug, b"!")
            self._thread.join()
            for handle in (self._master, self._slave, self._unplugged, self._plug):
                os.close(handle)


@contextmanager
def serve(
    law: Path, dialect: str = "new", period: float = STEP_PERIOD, snr_db: float = 12.0
) -> Iterator[ServedRig]:
    """A rig that steps by a law file, every traverse alike."""
    truth = HiddenLaws(read_law_values(law, load_machine()), load_machine())
    rig = ServedRig(emulate_rig(truth, dialect, RealClock(), period), Acoustics(snr_db, period=period))
    try:
        yield rig
    finally:
        rig.close()
