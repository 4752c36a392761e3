"""An emulated rig in a process of its own, as this program sees it."""

from __future__ import annotations

import base64
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.source import Samples
from stickslip_fit.errors import InputError


class EmulatedProcess:
    """A rig to be driven over its port, set by hand and listened to; see `emulator_process`.

    It is a `Source` of the sound that its joints make.

    Attributes
    ----------
    port : str
        The pseudo-terminal behind which its controller is, for `open_controller`.
    rate : int
        Samples of sound per second.
    """

    rate = Acoustics.rate

    def __init__(self, process: subprocess.Popen[str], port: str) -> None:
        self.port = port
        self._process = process

    def set(self, **quantities: float) -> None:
        """See `Manipulator.set`."""
        self._order({"set": quantities})

    def set_stops(self, joint: int, low: float, high: float) -> None:
        """See `Manipulator.set_stops`."""
        self._order({"stops": [joint, low, high]})

    def begin_session(self, label: str) -> None:
        """See `Manipulator.begin_session`."""
        self._order({"session": label})

    def position(self, joint: int) -> float:
        """See `Manipulator.position`."""
        return float(self._order({"position": joint})["position"])

    def read(self, seconds: float) -> Samples:
        """See `Source.read`."""
        sound = base64.b64decode(self._order({"listen": seconds})["sound"])
        return Samples(np.frombuffer(sound, np.float32))

    def close(self) -> None:
        """End the process; for its controller that is being unplugged."""
        self._process.kill()
        self._process.wait()

    def _order(self, order: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            print(json.dumps(order), file=self._process.stdin, flush=True)
            answer = self._process.stdout.readline()
        except OSError:
            answer = ""
        if not answer:
            raise InputError("the emulator has ended; start it again")
        answered = json.loads(answer)
        if "error" in answered:
            raise InputError(answered["error"])
        return answered


@contextmanager
def emulator_process(law: Path, *options: str) -> Iterator[EmulatedProcess]:
    """An emulated rig in a process of its own, by the real clock.

    Parameters
    ----------
    law : Path
        Law file by which it steps.
    *options : str
        Of ``python -m stickslip_fit.capture.emulator``, e.g. ``--dialect``, ``old``.

    Raises
    ------
    InputError
        If it does not come up; with what it says.
    """
    command = [sys.executable, "-m", "stickslip_fit.capture.emulator", str(law), *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        if not first:
            raise InputError(process.communicate()[1].strip())
        rig = EmulatedProcess(process, json.loads(first)["port"])
        try:
            yield rig
        finally:
            rig.close()
