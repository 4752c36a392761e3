"""What goes into a drive and what comes out of it: VelocityInput, DriveState, HomingAdvice.

Input devices (keyboard, gamepad, page, script) return a `VelocityInput`; screens (terminal, page) show a
`DriveState`. The loop between them knows neither.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from stickslip_fit._typing import Array


@dataclass(frozen=True, eq=False)
class VelocityInput:
    """What a person wants at one moment. At most one of the first three is given; none means "stop".

    Attributes
    ----------
    tip_velocity : array, shape (3,), optional
        Base frame, m/s.
    joint_velocity : array, shape (3,), optional
        rad/s, rad/s, m/s; for one joint at a time, the others 0.
    home : int, optional
        The joint to bring to its nearest stop.
    valid_until : float
        s, by the loop's clock; nothing moves after that moment unless another input arrives.
    ends : bool
        The drive is over.
    """

    tip_velocity: Array | None = None
    joint_velocity: Array | None = None
    home: int | None = None
    valid_until: float = 0.0
    ends: bool = False


class InputDevice(Protocol):
    """Something by which a person commands velocities."""

    def read(self, now: float) -> VelocityInput:
        """What is wanted at this moment, s by the loop's clock; returns at once."""


@dataclass(frozen=True)
class HomingAdvice:
    """Go back to a stop before the tip's 95 % radius exceeds the tolerance.

    Attributes
    ----------
    joint : int
        The one that contributes most to the radius.
    direction : {'+', '-'}
        Towards its nearest stop.
    steps_to_stop : int
        Expected.
    steps_left : int
        Steps that this joint can still make at the present velocity before the tolerance is exceeded; 0 where
        it is.
    """

    joint: int
    direction: str
    steps_to_stop: int
    steps_left: int


@dataclass(frozen=True, eq=False)
class DriveState:
    """The drive after one tick.

    Attributes
    ----------
    time : float
        s since the drive began.
    status : {'idle', 'moving', 'homing', 'stopped'}
        ``stopped`` by the watchdog, a soft limit or a lost connection; `message` says which.
    q, q_error : array, shape (3,)
        Joint positions and their standard deviations, rad, rad, m.
    tip : array, shape (3,)
        Base frame, m.
    tip_covariance : array, shape (3, 3)
        m^2.
    tip_radius : float
        Radius that holds 95 % of the tip's errors, m.
    tolerance : float
        The largest `tip_radius` that the user accepts, m.
    wanted_velocity, tip_velocity : array, shape (3,)
        As asked for, and as commanded after all limits, base frame, m/s.
    steps : tuple of int
        Of each joint since the drive began, those in direction - taken off.
    limits : tuple of str
        Why the tip moves otherwise than wanted: e.g. "joint 2 is at its soft limit".
    advice : HomingAdvice or None
    message : str
        What happened last, for people; may be empty.
    """

    time: float
    status: str
    q: Array
    q_error: Array
    tip: Array
    tip_covariance: Array
    tip_radius: float
    tolerance: float
    wanted_velocity: Array
    tip_velocity: Array
    steps: tuple[int, int, int]
    limits: tuple[str, ...] = ()
    advice: HomingAdvice | None = None
    message: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers in SI units, for a page or a file."""
        content = {name: getattr(self, name) for name in self.__dataclass_fields__}
        arrays = ("q", "q_error", "tip", "tip_covariance", "wanted_velocity", "tip_velocity")
        content |= {name: content[name].tolist() for name in arrays}
        advice = self.advice
        return content | {"advice": asdict(advice) if advice else None}


class Screen(Protocol):
    """Something that shows a drive."""

    def show(self, state: DriveState) -> None:
        """Show the state; returns at once."""
