"""An emulated rig as a process: its controller behind a pseudo-terminal, its person at the standard input."""

from __future__ import annotations

import base64
import json
import os
import select
from collections.abc import Callable
from typing import Any

from stickslip_fit.capture.emulator.emulator import Emulator
from stickslip_fit.capture.source import Source
from stickslip_fit.errors import InputError

MOST_BYTES = 65_536


def serve(rig: Emulator, microphone: Source, orders: int, answer: Callable[[str], None]) -> None:
    """Serve until the orders end.

    Parameters
    ----------
    rig : Emulator
        By the real clock.
    microphone : Source
    orders : int
        File descriptor of what the person does: one JSON object a line, see `obeyed`.
    answer : callable
        Is given a line for each order, and before them all the pseudo-terminal's name: ``{"port": NAME}``.
    """
    import pty
    import tty

    master, slave = pty.openpty()
    try:
        tty.setraw(slave)
        answer(json.dumps({"port": os.ttyname(slave)}))
        _serve(rig, microphone, master, orders, answer)
    finally:
        os.close(slave)
        os.close(master)


def _serve(
    rig: Emulator, microphone: Source, master: int, orders: int, answer: Callable[[str], None]
) -> None:
    begun = b""
    while True:
        due = rig.unit.due()
        seconds = None if due is None else max(due - rig.clock.now(), 0.0)
        ready, _, _ = select.select([master, orders], [], [], seconds)
        if master in ready:
            rig.unit.take(os.read(master, MOST_BYTES))
        if orders in ready:
            come = os.read(orders, MOST_BYTES)
            if not come:
                return
            *lines, begun = (begun + come).split(b"\n")
            for line in lines:
                answer(json.dumps(_answer(rig, microphone, line)))
        os.write(master, rig.unit.give())


def _answer(rig: Emulator, microphone: Source, line: bytes) -> dict[str, Any]:
    try:
        return obeyed(rig, microphone, json.loads(line))
    except (ValueError, TypeError) as error:
        return {"error": f"{line.decode('utf-8', 'replace')!r} is no order: {error}"}
    except InputError as error:
        return {"error": str(error)}


def obeyed(rig: Emulator, microphone: Source, order: dict[str, Any]) -> dict[str, Any]:
    """Carry out an order, and answer it.

    Parameters
    ----------
    rig : Emulator
    microphone : Source
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
    rig.unit.advance()
    match order:
        case {"set": dict(quantities)}:
            rig.hands.set(**{name: float(value) for name, value in quantities.items()})
        case {"stops": [joint, low, high]}:
            rig.hands.set_stops(int(joint), float(low), float(high))
        case {"session": str(label)}:
            rig.hands.begin_session(label)
        case {"listen": float(seconds) | int(seconds)}:
            return {"sound": base64.b64encode(microphone.read(seconds).values.tobytes()).decode("ascii")}
        case {"position": int(joint)}:
            return {"position": rig.hands.position(joint)}
        case _:
            raise InputError(f"no such order: {order}; give set, stops, session, listen or position")
    return {}
