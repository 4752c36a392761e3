"""What a traverse asks of whatever listens for the end stop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Heard:
    """What the sound of the steps just made says.

    Attributes
    ----------
    at_stop : bool
        The joint has run into its stop.
    level : float
        Power in the tuned band over the running baseline of this traverse, dB; NaN while there is none.
    fault : str
        Empty, or a sentence on why nothing can be said, which must end the move: sound was lost, the
        microphone clips or is dead.
    checks_late : int
        Where `at_stop`: how many checks ago the stop was first heard. A stop is believed once it is heard
        twice; a count that means the first check after the stop leaves out the steps of so many checks.
    """

    at_stop: bool
    level: float
    fault: str = ""
    checks_late: int = 0


class Ear(Protocol):
    """Listens to one traverse at a time."""

    def begin(self) -> None:
        """A new traverse: forget the one before."""

    def check(self, seconds: float) -> Heard:
        """What the last so many seconds of sound say, those of the steps made since the check before."""

    def close(self) -> None:
        """Let go of whatever the sound comes from."""
