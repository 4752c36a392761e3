"""An emulated rig in a process of its own: its controller behind a pseudo-terminal, as a port is.

`start_emulator` starts one and hands over what drives it by hand. The process prints the terminal's name, and
takes orders such as {"set": {"theta": 0.5}} (SI) from its standard input, one a line.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stickslip_fit.capture.emulator.acoustics import Acoustics
from stickslip_fit.capture.emulator.manipulator import HiddenLaws
from stickslip_fit.capture.emulator.rig import EmulatedRig, emulate_rig
from stickslip_fit.capture.protocols import AudioSource, RealClock, Samples
from stickslip_fit.errors import InputError
from stickslip_fit.logs.plan import Noise
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values

MAX_READ_BYTES = 65_536


def serve_rig(rig: EmulatedRig, microphone: AudioSource, orders: int, answer: Callable[[str], None]) -> None:
    """Serve a rig by the real clock behind a pseudo-terminal until the orders end.

    Parameters
    ----------
    rig : EmulatedRig
    microphone : AudioSource
    orders : int
        File descriptor of the operator's actions: one JSON object a line, see `execute_order`.
    answer : callable
        Called with a line for each order, and before them all with the pseudo-terminal's name:
        ``{"port": NAME}``.
    """
    import pty
    import tty

    master, slave = pty.openpty()
    try:
        tty.setraw(slave)
        answer(json.dumps({"port": os.ttyname(slave)}))
        _serve_loop(rig, microphone, master, orders, answer)
    finally:
        os.close(slave)
        os.close(master)


def _serve_loop(
    rig: EmulatedRig, microphone: AudioSource, master: int, orders: int, answer: Callable[[str], None]
) -> None:
    partial = b""
    while True:
        due = rig.emulated_controller.due()
        seconds = None if due is None else max(due - rig.clock.now(), 0.0)
        ready, _, _ = select.select([master, orders], [], [], seconds)
        if master in ready:
            rig.emulated_controller.receive(os.read(master, MAX_READ_BYTES))
        if orders in ready:
            data = os.read(orders, MAX_READ_BYTES)
            if not data:
                return
            *lines, partial = (partial + data).split(b"\n")
            for line in lines:
                answer(json.dumps(_answer_line(rig, microphone, line)))
        os.write(master, rig.emulated_controller.send())


def _answer_line(rig: EmulatedRig, microphone: AudioSource, line: bytes) -> dict[str, Any]:
    try:
        return execute_order(rig, microphone, json.loads(line))
    except (ValueError, TypeError) as error:
        return {"error": f"{line.decode('utf-8', 'replace')!r} is no order: {error}"}
    except InputError as error:
        return {"error": str(error)}


def execute_order(rig: EmulatedRig, microphone: AudioSource, order: dict[str, Any]) -> dict[str, Any]:
    """Execute an order; returns its answer.

    Parameters
    ----------
    rig : EmulatedRig
    microphone : AudioSource
    order : dict
        One of ``{"set": {"theta": ..., "q2": ...}}``, ``{"stops": [joint, low, high]}`` (SI),
        ``{"session": LABEL}``, ``{"listen": SECONDS}``, ``{"position": JOINT}``.

    Returns
    -------
    dict
        ``{"sound": ...}``, float32 in base 64; ``{"position": ...}``; or ``{}``.

    Raises
    ------
    InputError
        For anything else, or what cannot be done.
    """
    rig.emulated_controller.advance()
    match order:
        case {"set": dict(quantities)}:
            rig.manipulator.set(**{name: float(value) for name, value in quantities.items()})
        case {"stops": [joint, low, high]}:
            rig.manipulator.set_stops(int(joint), float(low), float(high))
        case {"session": str(label)}:
            rig.manipulator.begin_session(label)
        case {"listen": float(seconds) | int(seconds)}:
            return {"sound": base64.b64encode(microphone.read(seconds).values.tobytes()).decode("ascii")}
        case {"position": int(joint)}:
            return {"position": rig.manipulator.position(joint)}
        case _:
            raise InputError(f"no such order: {order}; give set, stops, session, listen or position")
    return {}


class EmulatedProcess:
    """An emulated rig in a process of its own, an `AudioSource` too; see `start_emulator`.

    `port` is the pseudo-terminal of its controller, for `open_controller`.
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
        """See `AudioSource.read`."""
        sound = base64.b64decode(self._order({"listen": seconds})["sound"])
        return Samples(np.frombuffer(sound, np.float32))

    def close(self) -> None:
        """End the process; its controller is unplugged then."""
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
def start_emulator(law: Path, *options: str) -> Iterator[EmulatedProcess]:
    """An emulated rig in a process of its own, by the real clock.

    Parameters
    ----------
    law : Path
        Law file by which it steps.
    *options : str
        Of `main`, e.g. ``--dialect``, ``old``.

    Raises
    ------
    InputError
        If it does not start; with its message.
    """
    command = [sys.executable, __file__, str(law), *options]
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


def main() -> None:
    """Serve until the standard input ends, or Ctrl-C."""
    parser = argparse.ArgumentParser()
    parser.add_argument("law")
    parser.add_argument("--dialect", default="new")
    parser.add_argument("--repeatability-pct", type=float, default=0.27)
    parser.add_argument("--step-period-ms", type=float, default=10.0)
    parser.add_argument("--snr-db", type=float, default=12.0)
    options, machine = parser.parse_args(), load_machine()
    try:
        laws = read_law_values(options.law, machine)
    except InputError as error:
        sys.exit(str(error))
    spread = {
        (joint, direction): options.repeatability_pct / 100 for joint in laws.laws for direction in "+-"
    }
    truth = HiddenLaws(laws, machine, Noise(spread), 0)
    rig = emulate_rig(truth, options.dialect, RealClock(), options.step_period_ms / 1000)
    microphone = rig.microphone(Acoustics(options.snr_db, period=rig.emulated_controller.period))
    with suppress(KeyboardInterrupt):
        serve_rig(rig, microphone, sys.stdin.fileno(), partial(print, flush=True))


if __name__ == "__main__":
    main()
