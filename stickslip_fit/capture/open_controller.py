"""The controllers by the names that people give them."""

from __future__ import annotations

from collections.abc import Callable

from stickslip_fit.capture import nanocontrol, nanocontrol_old
from stickslip_fit.capture.clock import RealClock
from stickslip_fit.capture.coarse import STEP_PERIOD
from stickslip_fit.capture.controller import Controller
from stickslip_fit.capture.line import Line
from stickslip_fit.capture.nanocontrol import NanoControl
from stickslip_fit.capture.nanocontrol_old import OldNanoControl
from stickslip_fit.capture.serial_port import open_serial
from stickslip_fit.errors import InputError, Problem

DIALECTS = ("new", "old", "anc300")


def open_controller(
    port: str,
    dialect: str,
    tell: Callable[[str], None],
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
    tell : callable
        Is given whatever the controller says of its own accord.
    step_period : float
        s; what the controller is set to. An ANC300 is asked for its own.
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
        line = Line(open_serial(port, nanocontrol.BAUD), RealClock(), nanocontrol.END)
        return NanoControl(line, tell, step_period)
    if dialect == "old":
        line = Line(open_serial(port, nanocontrol_old.BAUD), RealClock(), nanocontrol_old.END)
        return OldNanoControl(line, step_period)
    if dialect == "anc300":
        from stickslip_fit.capture.anc300 import open_anc300

        return open_anc300(port, password)
    raise InputError(Problem(f"give one of {', '.join(DIALECTS)}", column="dialect", value=dialect))
