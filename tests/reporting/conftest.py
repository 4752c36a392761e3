"""Reports of made-up campaigns, and a reader of the page that knows nothing of how it was written."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from html.parser import HTMLParser

import pandas as pd
import pytest

from stickslip_fit.estimation import Result, fit_closed_form, fit_constant_step, fit_least_squares
from stickslip_fit.logs import Log
from stickslip_fit.reporting import report

VOID = {"br", "input", "meta"}


class Page(HTMLParser):
    """What a browser would find on the page: elements, texts, tables by caption."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: list[str] = []
        self.scripts: list[str] = []
        self.heads: dict[str, list[str]] = {}
        self.tables: dict[str, list[list[str]]] = {}
        self._open: list[str] = []
        self._rows: list[list[str]] = []
        self._caption = ""
        self.feed(html)
        self.close()
        assert not self._open, f"not closed: {self._open}"

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self._open.append(tag)
        if tag == "table":
            self._rows, self._caption = [], ""
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag
        if tag == "thead":
            self.heads[self._caption] = self._rows[-1]
            self._rows = []
        elif tag == "table":
            self.tables[self._caption] = self._rows

    def handle_data(self, data: str) -> None:
        if self._open[-1:] == ["script"]:
            self.scripts.append(data)
        elif not {"style", "svg"} & set(self._open):
            self.texts.append(data)
        if "caption" in self._open:
            self._caption += data
        elif {"td", "th"} & set(self._open):
            self._rows[-1][-1] += data.strip()

    def column(self, caption: str, head: str, which: int = 0) -> list[str]:
        """Cells of a table below a head and its unit; the first, second ... column of that head."""
        places = [index for index, found in enumerate(self.heads[caption]) if found == head]
        return [row[places[which]] for row in self.tables[caption]]


def hours_in_session(table: pd.DataFrame) -> pd.Series:
    """From each session's first traverse on, of a table in a log file's columns."""
    time = pd.to_datetime(table["time"])
    return (time - time.groupby(table["session"]).transform("min")).dt.total_seconds() / 3600.0


@pytest.fixture(scope="session")
def read_page() -> type[Page]:
    """The reader, for pages made elsewhere."""
    return Page


@dataclass(frozen=True)
class Fitted:
    """A log and its results."""

    log: Log
    calibration: Result
    constant: Result
    fit: Result

    @property
    def html(self) -> str:
        page = report(
            self.log, calibration=self.calibration, fit=self.fit, sections=(), command="stickslip-fit report"
        )
        return page.html


@dataclass(frozen=True)
class Reported(Fitted):
    """The same with the page made of them, once it is asked for."""

    @cached_property
    def source(self) -> str:
        return self.html

    @cached_property
    def page(self) -> Page:
        return Page(self.source)


@pytest.fixture(scope="session")
def fitted(read_table: Callable[..., Log]) -> Callable[..., Fitted]:
    """Fit a table in a log file's columns."""

    def make(table: pd.DataFrame, name: str = "log.csv") -> Fitted:
        log = read_table(table, name)
        calibration = fit_closed_form(log)
        return Fitted(log, calibration, fit_constant_step(log, calibration), fit_least_squares(log))

    return make


@pytest.fixture(scope="session")
def reported(fitted: Callable[..., Fitted]) -> Callable[..., Reported]:
    """Report a table in a log file's columns."""

    def make(table: pd.DataFrame, name: str = "log.csv") -> Reported:
        return Reported(**vars(fitted(table, name)))

    return make


@pytest.fixture(scope="session")
def whole(campaign: Callable[..., pd.DataFrame], reported: Callable[..., Reported]) -> Reported:
    """All joints, both directions, two sessions."""
    return reported(campaign())
