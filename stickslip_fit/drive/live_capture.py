"""A capture on a page that can be looked at and nothing else: counts, sound level, residuals as they come.

`LiveOperator` passes everything on to the operator at the rig, and lets the page know. The page takes no
message: whatever happens to it, the capture goes on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from math import isfinite, nan
from typing import Any

from stickslip_fit._format import format_value
from stickslip_fit.capture.operator import (
    Operator,
    OperatorChoice,
    OperatorReply,
    PlannedDrive,
    RigSetting,
    TraverseReading,
    format_position,
    format_reading,
    format_setting,
)
from stickslip_fit.capture.protocols import Detection
from stickslip_fit.drive.page_server import PageContent, PageFiles, RefusalError, serve_page
from stickslip_fit.units import PRISMATIC

PERIOD = 0.1  # s between two events
MAX_LEVELS = 600  # checks: 30 s of motion with 5 steps of 10 ms
MAX_MESSAGES = 6
STALE_SECONDS = 3.0  # without an event
ASSETS = ("report.css", "live.css", "live.js", "live_capture.js")


@dataclass(frozen=True)
class ResidualPoint:
    """A reading beside its prediction.

    Attributes
    ----------
    direction : {'+', '-'}
    text : str
        Count and step size.
    residual : float
        Measured over predicted count - 1; NaN without a prediction.
    low, high : float
        The same with the ends of the prediction's 95 % interval; NaN where it has none.
    """

    joint: int
    direction: str
    text: str
    residual: float
    low: float = nan
    high: float = nan
    doubtful: bool = False
    kept: bool = True


def compare_reading(reading: TraverseReading, kept: bool = True) -> ResidualPoint:
    """A reading's residual; with a check every n steps, a stop is found n / 2 after it is met, on average."""
    row, expected = reading.drive.row, reading.drive.expected
    every = int(row["check_every"])
    count = reading.steps - every / 2 if every > 1 else float(reading.steps)
    size = format_value(reading.step_size, "nm" if row["joint"] == PRISMATIC else "µrad", 2)
    text = f"{reading.steps:,} steps, {size} a step"
    residual, low, high = (
        count / value - 1 if expected.known and isfinite(value) else nan
        for value in (expected.steps, expected.high, expected.low)
    )
    doubtful, joint = bool(reading.deviation), int(row["joint"])
    return ResidualPoint(joint, str(row["direction"]), text, residual, low, high, doubtful, kept)


class CapturePage(PageContent):
    """What the page shows of a capture."""

    def __init__(self) -> None:
        super().__init__()
        self._session = self._question = ""
        self._messages: deque[str] = deque(maxlen=MAX_MESSAGES)
        self._drive: PlannedDrive | None = None
        self._steps = 0
        self._moved = 0.0  # s of motion before this drive
        self._levels: deque[tuple[float, float, bool]] = deque(maxlen=MAX_LEVELS)
        self._residuals: list[ResidualPoint] = []

    def say(self, text: str) -> None:
        """A message."""
        with self._lock:
            self._messages.append(text.strip())

    @contextmanager
    def asking(self, question: str) -> Iterator[None]:
        """While a question is asked at the terminal."""
        with self._lock:
            self._question = question
        try:
            yield
        finally:
            with self._lock:
                self._question = ""

    def begin_session(self, label: str) -> None:
        """A session, whose residuals are shown from now on."""
        with self._lock:
            self._session, self._residuals = label, []

    def begin_drive(self, drive: PlannedDrive) -> None:
        """A drive."""
        with self._lock:
            if self._drive is not None:
                self._moved += self._steps * float(self._drive.row["step_period"])
            self._drive, self._steps = drive, 0

    def progress(self, drive: PlannedDrive, steps: int, detection: Detection) -> None:
        """A check of the end stop."""
        with self._lock:
            self._steps = steps
            moved = self._moved + steps * float(drive.row["step_period"])
            self._levels.append((round(moved, 3), round(detection.level, 2), detection.at_stop))

    def add(self, point: ResidualPoint) -> None:
        """A reading."""
        with self._lock:
            self._residuals.append(point)

    def replace(self, point: ResidualPoint) -> None:
        """The latest reading is doubted."""
        with self._lock:
            self._residuals[-1] = point

    def receive(self, message: bytes) -> None:
        """See `PageContent.receive`; refuses every message."""
        raise RefusalError(HTTPStatus.FORBIDDEN, "this page shows a capture, and does not control it")

    def content(self, client: str) -> dict[str, Any]:
        with self._lock:
            drive, steps = self._drive, self._steps
            content = {
                "session": self._session,
                "question": self._question,
                "messages": list(self._messages),
                "levels": list(self._levels),
                "residuals": [vars(point) for point in self._residuals],
            }
        return content | {"drive": _describe_drive(drive, steps) if drive else None}


def _describe_drive(drive: PlannedDrive, steps: int) -> dict[str, Any]:
    expected = drive.expected
    about = ""
    if expected.known:
        about = f"of about {expected.steps:,.0f}"
    if expected.known and isfinite(expected.low) and isfinite(expected.high):
        about += f" ({expected.low:,.0f} to {expected.high:,.0f} in 95 %)"
    title = f"{drive.title} ({drive.row['joint']}{drive.row['direction']})".replace("-)", "−)")
    prediction = {"expected": expected.steps, "low": expected.low, "high": expected.high}
    return {"title": title, "steps": steps, "count": f"{steps:,}", "about": about, **prediction}


class LiveOperator(Operator):
    """An `Operator` that passes everything on to another one, and lets a page know."""

    def __init__(self, operator: Operator, page: CapturePage) -> None:
        self.operator = operator
        self.page = page

    def show(self, text: str) -> None:
        self.page.say(text)
        self.operator.show(text)

    def begin_session(self, label: str) -> OperatorReply:
        self.page.begin_session(label)
        with self.page.asking(f"Session {label}: switch on and warm up."):
            return self.operator.begin_session(label)

    def set_up(self, wanted: RigSetting, before: RigSetting | None) -> OperatorReply:
        with self.page.asking(format_setting(wanted, before)):
            return self.operator.set_up(wanted, before)

    def bring_joint(self, joint: int, position: float) -> OperatorReply:
        with self.page.asking(f"Bring joint {joint} to {format_position(joint, position)} by hand."):
            return self.operator.bring_joint(joint, position)

    def begin_drive(self, drive: PlannedDrive) -> None:
        self.page.begin_drive(drive)
        self.operator.begin_drive(drive)

    def progress(self, drive: PlannedDrive, steps: int, detection: Detection) -> None:
        self.page.progress(drive, steps, detection)
        self.operator.progress(drive, steps, detection)

    def stop_wanted(self) -> bool:
        return self.operator.stop_wanted()

    def review(self, reading: TraverseReading) -> OperatorReply:
        self.page.add(compare_reading(reading))
        question = f"Doubtful: {reading.deviation}" if reading.deviation else ""
        if reading.deviation:
            self.page.say(f"{reading.drive.title}: {format_reading(reading).strip()}")
        with self.page.asking(question):
            reply = self.operator.review(reading)
        if reply.choice in (OperatorChoice.REPEAT, OperatorChoice.SKIP):
            self.page.replace(compare_reading(reading, kept=False))
        return reply

    def handle_failure(self, drive: PlannedDrive, reason: str) -> OperatorReply:
        self.page.say(f"{drive.title}: broken off, {reason}")
        with self.page.asking(f"Broken off: {reason}."):
            return self.operator.handle_failure(drive, reason)


@contextmanager
def serve_capture_page(title: str, port: int = 0) -> Iterator[CapturePage]:
    """Serve the page of a capture while the context lasts; parameters and errors as `serve_drive_page`."""
    values = {"title": title, "stale_ms": 1000 * STALE_SECONDS}
    page_files = PageFiles.load("live_capture.html.j2", *ASSETS, **values)
    with serve_page(page_files, CapturePage(), PERIOD, port) as page:
        yield page
