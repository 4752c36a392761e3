"""open_controller: the controllers by name, and attocube's ANC300 through pymeasure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from stickslip_fit.capture.nanocontrol import (
    NEW_BAUD_RATE,
    NEW_TERMINATOR,
    OLD_BAUD_RATE,
    OLD_TERMINATOR,
    LineTransport,
    NanoControl,
    OldNanoControl,
    open_serial,
)
from stickslip_fit.capture.protocols import (
    STEP_PERIOD,
    ConnectionLost,
    Controller,
    ControllerError,
    RealClock,
)
from stickslip_fit.errors import InputError, InputIssue

DIALECTS = ("new", "old", "anc300")


def open_controller(
    port: str,
    dialect: str,
    notify: Callable[[str], None],
    step_period: float = STEP_PERIOD,
    password: str = "",
) -> Controller:
    """Open the connection to a controller.

    Parameters
    ----------
    port : str
        A serial port; for ``anc300`` a VISA resource.
    dialect : {'new', 'old', 'anc300'}
        Of Kleindiek's NanoControl; or attocube's ANC300.
    notify : callable
        Called with each unsolicited message of the controller.
    step_period : float
        s; the controller's setting. An ANC300 has its own.
    password : str
        Of an ANC300's console.

    Raises
    ------
    InputError
        For another dialect, or if a library is not installed.
    ControllerError
        If the controller cannot be reached.
    """
    if dialect == "new":
        line = LineTransport(open_serial(port, NEW_BAUD_RATE), RealClock(), NEW_TERMINATOR)
        return NanoControl(line, notify, step_period)
    if dialect == "old":
        line = LineTransport(open_serial(port, OLD_BAUD_RATE), RealClock(), OLD_TERMINATOR)
        return OldNanoControl(line, step_period)
    if dialect == "anc300":
        return open_anc300(port, password)
    raise InputError(InputIssue(f"give one of {', '.join(DIALECTS)}", column="dialect", value=dialect))


AXES = {1: "first", 2: "second", 3: "third"}


class Anc300(Controller):
    """A `Controller` whose axes 1, 2 and 3 drive the joints of these numbers.

    `unit` is a pymeasure ``ANC300Controller`` with the axes of `AXES`; its step frequency is set at the unit.
    """

    def __init__(self, unit: Any) -> None:
        self._unit = unit

    def step(self, joint: int, steps: int) -> None:
        if joint not in AXES:
            raise InputError(f"joint {joint} is none of 1, 2, 3; correct the plan")
        if steps:
            with _translate_errors(f"joint {joint}, {steps:+d} steps"):
                getattr(self._unit, AXES[joint]).move(steps, gnd=False)

    def stop(self) -> None:
        with _translate_errors("stop"):
            # An unread reply of a move would be taken for that of the stop.
            self._unit.adapter.flush_read_buffer()
            self._unit.stop_all()

    def version(self) -> str:
        with _translate_errors("ver"):
            return str(self._unit.version).strip()

    def close(self) -> None:
        self._unit.adapter.close()


def open_anc300(resource: str, password: str) -> Anc300:
    """Open the connection to an ANC300 at a VISA resource, e.g. ``TCPIP::192.168.1.2::7230::SOCKET``.

    Raises
    ------
    InputError
        If pymeasure is not installed.
    ControllerError
        If it cannot be reached, or refuses the password.
    """
    try:
        from pymeasure.instruments.attocube import ANC300Controller
    except ImportError:
        raise InputError(
            "an ANC300 needs pymeasure; install it: pip install 'stickslip-fit[anc300]'"
        ) from None
    try:
        return Anc300(ANC300Controller(resource, axisnames=list(AXES.values()), passwd=password))
    except Exception as error:  # pymeasure raises a bare Exception for a wrong password
        raise ControllerError(
            f"cannot open the ANC300 {resource!r} ({error}); check its address and its password, and that "
            "it is on"
        ) from error


@contextmanager
def _translate_errors(command: str) -> Iterator[None]:
    """Raise errors of pymeasure and VISA as `ControllerError` and `ConnectionLost`."""
    from pyvisa.errors import Error as VisaError

    try:
        yield
    except ValueError as error:
        raise ControllerError(
            f"{command}: the ANC300 refuses: {error}; see its manual for what that means, put it right, then "
            "repeat the traverse"
        ) from error
    except (VisaError, OSError) as error:
        raise ConnectionLost(
            f"{command}: the connection to the ANC300 is lost ({error}); check its cable and that it is on, "
            "then capture again with --resume"
        ) from error
