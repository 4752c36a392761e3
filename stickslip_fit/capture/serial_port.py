"""A serial port as a wire."""

from __future__ import annotations

from typing import Any

from stickslip_fit.capture.controller import ControllerError
from stickslip_fit.errors import InputError

WRITING = 2.0  # s; a few bytes take a millisecond


class SerialPort:
    """A wire over pyserial; see `open_serial`."""

    def __init__(self, port: Any) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        """See `Wire.write`."""
        self._port.write(data)

    def read(self, seconds: float) -> bytes:
        """See `Wire.read`."""
        self._port.timeout = seconds
        first = self._port.read(1)
        return first + self._port.read(self._port.in_waiting) if first else b""

    def close(self) -> None:
        """See `Wire.close`."""
        self._port.close()


def open_serial(port: str, baud: int) -> SerialPort:
    """Open a serial port, 8N1, for this program alone.

    Parameters
    ----------
    port : str
        Such as ``/dev/ttyUSB0`` or ``COM3``.
    baud : int

    Raises
    ------
    InputError
        If pyserial is not installed.
    ControllerError
        If there is no such port, or another program has it.
    """
    try:
        import serial
    except ImportError:
        raise InputError(
            "a serial port needs pyserial; install it: pip install 'stickslip-fit[capture]'"
        ) from None
    try:
        opened = serial.Serial(port, baud, timeout=0, write_timeout=WRITING, exclusive=True)
    except (OSError, ValueError) as error:
        raise ControllerError(
            f"cannot open the port {port!r} ({error}); plug the controller in, end other programs that use "
            f"the port, or choose another; there are {', '.join(_ports()) or 'none'}"
        ) from error
    return SerialPort(opened)


def _ports() -> list[str]:
    from serial.tools.list_ports import comports

    return [port.device for port in comports()]
