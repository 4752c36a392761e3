"""The page of a drive: a `Screen` that shows it, and an `InputDevice` whose keys report their release.

Every message of the page says all that it wants (a direction, a speed, or a joint to home), so that none
depends on one before it. It sends one at each change, and while something is held one every `HEARTBEAT`.
What is wanted holds until the first of:

- a message without it arrives: the key was released, the page lost the focus, was hidden or left;
- the page's stream ends: it was closed, its browser crashed, the connection broke;
- `VALID_SECONDS` have passed since the page *sent* the last message, or `HOMING_VALID_SECONDS` for a joint
  that goes home: the page is frozen, or too slow.

After the last two, and after a stop, nothing moves until all keys are released and one is pressed anew: a
page that comes back to life must not go on with what was held before.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from stickslip_fit._format import MISSING, capitalize_first, format_number, format_value, keep_units
from stickslip_fit.drive.page_server import PageContent, PageFiles, RefusalError, serve_page
from stickslip_fit.drive.picture import ArmView, view_arm
from stickslip_fit.drive.screen import format_advice, format_count, format_joint
from stickslip_fit.drive.state import DriveState, InputDevice, VelocityInput
from stickslip_fit.machine import Machine
from stickslip_fit.moves.error_ellipsoid import error_ellipse
from stickslip_fit.units import JOINTS, from_si, to_si

HEARTBEAT = 0.05  # s between two messages of a page on which something is held
VALID_SECONDS = 0.2  # after which a message holds no longer: three heartbeats may be lost
# Of a joint on its way home, which takes a minute or two, looks for its stop, and ends there in any case.
HOMING_VALID_SECONDS = 1.0
PERIOD = 0.04  # s between two states that the page shows
STALE_SECONDS = 0.5  # after which the page says that nothing has come, and holds nothing
DEFAULT_MAX_SPEED = to_si(60.0, "µm")  # m/s

ASSETS = ("report.css", "live.css", "live.js", "drive.js")

Clock = Callable[[], float]
Sign = Annotated[int, Field(ge=-1, le=1)]


class PageMessage(BaseModel):
    """All that a page wants at one moment.

    Attributes
    ----------
    client : str
        The name that its stream gave it.
    number : int
        Of the message; a later one may arrive earlier, over another connection.
    sent : float
        s, by the page's clock.
    press : int
        Counts how often something was held after nothing was.
    direction : (int, int, int)
        Along x, y and z of the base: -1, 0 or 1; all 0 where nothing is held.
    speed : float
        m/s.
    home : int, optional
        The joint to bring to its nearest stop.
    stop, ends : bool
        The button for it was pressed.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    client: str
    number: Annotated[int, Field(ge=1)]
    sent: Annotated[float, Field(allow_inf_nan=False)]
    press: Annotated[int, Field(ge=0)]
    direction: tuple[Sign, Sign, Sign]
    speed: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    home: Annotated[int, Field(ge=1, le=3)] | None = None
    stop: bool = False
    ends: bool = False

    @property
    def wants(self) -> bool:
        """Whether anything is held."""
        return any(self.direction) or self.home is not None

    @property
    def valid_seconds(self) -> float:
        """How long it holds after it was sent."""
        return VALID_SECONDS if self.home is None else HOMING_VALID_SECONDS

    def velocity(self, max_speed: float) -> VelocityInput:
        """What is wanted, without its time."""
        if self.home is not None:
            return VelocityInput(home=self.home)
        direction = np.array(self.direction, float)
        speed = min(self.speed, max_speed)
        return VelocityInput(tip_velocity=speed * direction / np.linalg.norm(direction))


class HeldInput:
    """What is held on the page in control, and how long that holds; safe between threads.

    Parameters
    ----------
    max_speed : float
        Of the tip, m/s.
    clock : callable
        Time, s, of the arrival of messages; the loop may have another clock.
    """

    def __init__(self, max_speed: float, clock: Clock = time.monotonic) -> None:
        self.max_speed = max_speed
        self._clock = clock
        self._lock = threading.Lock()
        self._held: PageMessage | None = None
        self._sent = 0.0  # when it was, by this clock
        self._number = self._press = 0
        self._broken = 0  # the latest press that holds no longer
        self._sent_home = 0  # the latest press by which the loop was sent home
        self._offset = 0.0  # of this clock from the page's
        self._ended = False
        self._reason = ""

    def receive(self, message: PageMessage) -> None:
        """A message of the page in control."""
        with self._lock:
            if message.number <= self._number:
                return  # overtaken by a later one
            arrived = self._clock()
            offset = arrived - message.sent
            # The quickest message of a press tells the clocks' offset: what another took longer is its delay.
            # Anew for each press, since a page's clock may stand still while the computer sleeps.
            self._offset = offset if message.press != self._press else min(self._offset, offset)
            sent = message.sent + self._offset
            gap = sent - self._sent if self._held and message.press == self._press else 0.0
            self._number, self._press = message.number, message.press
            self._ended |= message.ends
            if message.stop or message.ends:
                self._break("stopped on the page")
            elif message.wants and max(gap, arrived - sent) > message.valid_seconds:
                self._break("the page was too slow; release all keys, then press again")
            elif message.wants and message.press > self._broken:
                self._held, self._sent, self._reason = message, sent, ""
            else:
                self._held = None

    def release(self, reason: str) -> None:
        """Nothing is held any more."""
        with self._lock:
            self._break(reason)

    def begin(self) -> None:
        """Nothing is held; another page may be in control, whose messages and presses count from 1."""
        with self._lock:
            self._held = None
            self._number = self._press = self._broken = self._sent_home = 0

    def read(self, now: float) -> VelocityInput:
        """See `InputDevice.read`; a joint is sent home once, since the loop reads on when it is there."""
        with self._lock:
            if self._ended:
                return VelocityInput(ends=True)
            left = self._left()
            if self._held is None:
                return VelocityInput()
            if self._held.home is not None and self._sent_home == self._press:
                self._break("")
                return VelocityInput()
            wanted = self._held.velocity(self.max_speed)
            if wanted.home is not None:
                self._sent_home = self._press
            return VelocityInput(wanted.tip_velocity, None, wanted.home, now + left)

    def wants_home(self) -> bool:
        """Whether a joint that was sent home is to go on."""
        with self._lock:
            return self._left() > 0.0 and self._held is not None and self._held.home is not None

    def _left(self) -> float:
        """Seconds for which what is held still holds; where there are none, nothing is held any more."""
        left = self._held.valid_seconds - (self._clock() - self._sent) if self._held else 0.0
        if self._held and left <= 0.0:
            self._break("nothing came from the page any more; release all keys, then press again")
        return left

    @property
    def broken(self) -> tuple[int, str]:
        """The latest press that holds no longer though it may still be held, and why."""
        with self._lock:
            return self._broken, self._reason

    def _break(self, reason: str) -> None:
        self._broken, self._held, self._reason = self._press, None, reason


class DrivePage(PageContent, InputDevice):
    """Shows a drive on a page, and takes its input; see `serve_drive_page`.

    The page that was opened first is in control; others show the same, and can only stop. When it is closed,
    the next one is in control.
    """

    def __init__(
        self, machine: Machine, max_speed: float = DEFAULT_MAX_SPEED, clock: Clock = time.monotonic
    ) -> None:
        super().__init__()
        self.machine = machine
        self.held = HeldInput(max_speed, clock)
        self._clock = clock
        self._clients: list[str] = []
        self._state: DriveState | None = None
        self._shown = 0.0

    def read(self, now: float) -> VelocityInput:
        return self.held.read(now)

    def interrupts(self, now: float) -> bool:
        """Whether a joint on its way home is to stop: the page does not want it any more, or is gone."""
        return not self.held.wants_home()

    def show(self, state: DriveState) -> None:
        """See `Screen.show`; the page takes it for stale if none comes for `STALE_SECONDS`."""
        self._state, self._shown = state, self._clock()

    def join(self, client: str) -> None:
        with self._lock:
            self._clients.append(client)
            if self._clients[0] == client:
                self.held.begin()

    def leave(self, client: str) -> None:
        with self._lock:
            in_control = self._clients[0] == client
            self._clients.remove(client)
            if in_control:
                self.held.begin()

    def content(self, client: str) -> dict[str, Any]:
        with self._lock:
            controls = self._clients[0] == client
        broken, reason = self.held.broken
        content: dict[str, Any] = {"controls": controls, "broken": broken, "reason": reason}
        state = self._state
        if state is not None:
            content |= {"age": self._clock() - self._shown, "drive": describe_drive(state, self.machine)}
        return content

    def receive(self, message: bytes) -> None:
        """See `PageContent.receive`; a page that is not in control can only stop."""
        try:
            wanted = PageMessage.model_validate_json(message)
        except ValidationError:
            raise RefusalError(HTTPStatus.BAD_REQUEST, "this is no message of the page") from None
        with self._lock:
            if wanted.client not in self._clients:
                raise RefusalError(HTTPStatus.CONFLICT, "the page was closed; load it again")
            if self._clients[0] == wanted.client:
                self.held.receive(wanted)
            elif wanted.stop:
                self.held.release("stopped on another page")
            else:
                raise RefusalError(HTTPStatus.CONFLICT, "another page is in control")


@contextmanager
def serve_drive_page(
    machine: Machine, title: str, max_speed: float = DEFAULT_MAX_SPEED, port: int = 0
) -> Iterator[DrivePage]:
    """Serve the page of a drive while the context lasts.

    Parameters
    ----------
    title : str
        What is driven, e.g. the law's file.
    max_speed : float
        The highest speed of the tip that the page offers, m/s.
    port : int
        On the loopback address; any free one by default.

    Yields
    ------
    DrivePage
        An `InputDevice` and a `Screen`, with the `address` to open.

    Raises
    ------
    InputError
        If the machine has no published geometry, or the port cannot be had.
    """
    machine.require_geometry("a page of the drive")
    limits = {
        "heartbeat_ms": from_si(HEARTBEAT, "ms"),
        "stale_ms": from_si(STALE_SECONDS, "ms"),
        "max_speed": from_si(max_speed, "µm"),
    }
    page_files = PageFiles.load("drive.html.j2", *ASSETS, title=title, **limits)
    with serve_page(page_files, DrivePage(machine, max_speed), PERIOD, port) as page:
        yield page


def describe_drive(state: DriveState, machine: Machine) -> dict[str, Any]:
    """What the page shows of a state: texts for people, lengths of the arm in mm and of its errors in µm."""
    views = view_arm(state, machine)
    radius, tolerance = (from_si(value, "µm") for value in (state.tip_radius, state.tolerance))
    return {
        "status": state.status,
        "message": capitalize_first(state.message) if state.message else "",
        "limits": [capitalize_first(limit) for limit in state.limits],
        "advice": format_advice(state),
        "joints": [
            {
                "name": f"q{joint}",
                "position": format_joint(state, joint),
                "steps": format_count(state.steps[joint - 1]),
            }
            for joint in JOINTS
        ],
        "tip": [format_number(value, "mm", 4) for value in state.tip],
        "wanted": _write_velocity(state.wanted_velocity),
        "velocity": _write_velocity(state.tip_velocity),
        "tip_mm": [from_si(float(value), "mm") for value in state.tip],
        "radius": {"text": _write_length(state.tip_radius), "um": radius},
        "tolerance": {"text": _write_length(state.tolerance), "um": tolerance},
        "views": [_describe_view(view) for view in views],
    }


def _write_length(length: float) -> str:
    return keep_units(format_value(length, "µm", 2 if length < to_si(10.0, "µm") else 1))


def _write_velocity(velocity: Any) -> str:
    if not np.all(np.isfinite(velocity)):
        return MISSING
    return ", ".join(format_number(float(value), "µm", 1) for value in velocity)


def _describe_view(view: ArmView) -> dict[str, Any]:
    def in_mm(values: Any) -> Any:
        return from_si(np.asarray(values, float), "mm").tolist()

    return {
        "title": view.title,
        "axes": view.axes,
        "extent": in_mm(view.extent),
        **{name: in_mm(getattr(view, name)) for name in ("base", "elbow", "tip", "near", "far")},
        "projection": view.projection.tolist(),
        "ellipse": _describe_ellipse(view),
    }


def _describe_ellipse(view: ArmView) -> dict[str, float] | None:
    ellipse = error_ellipse(view.covariance)
    if ellipse is None:
        return None
    longer, shorter = (from_si(value, "µm") for value in (ellipse.longer, ellipse.shorter))
    return {"longer": longer, "shorter": shorter, "angle": from_si(ellipse.angle, "deg")}
