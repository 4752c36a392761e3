"""What drives the joints: an open-loop controller that makes coarse steps."""

from __future__ import annotations

from typing import Protocol

from stickslip_fit.errors import InputError


class ControllerError(InputError):
    """The controller refused or did not answer; says which joint, which command, its words, what to do."""


class Unplugged(ControllerError):
    """The connection to the controller is lost."""


class Controller(Protocol):
    """An open-loop controller of a few joints."""

    def step(self, joint: int, steps: int) -> None:
        """Make coarse steps, and return when they are made.

        Parameters
        ----------
        joint : int
            1, 2 or 3.
        steps : int
            More than 0 in direction ``+``, less in ``-``.

        Raises
        ------
        ControllerError
            If the controller refuses, or doesn't answer in time.
        Unplugged
            If the connection is lost.
        """
        ...

    def stop(self) -> None:
        """Stop whatever moves, at once."""
        ...

    def version(self) -> str:
        """The controller's name for itself and its firmware; empty where it has none."""
        ...

    def close(self) -> None:
        """Give the connection back."""
        ...
