"""Pages as a person has them before them: in a real browser, whose every complaint and request is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Dialog, Page

RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]
LOCAL = ("file:", "data:", "blob:", "about:")


@dataclass
class Visit:
    """A page in a tab, and what it said and asked for since it was opened.

    Attributes
    ----------
    page : Page
    console : list of str
        Everything that was printed there or went wrong, and every dialog.
    requests : list of str
        Addresses of everything that was fetched.
    """

    page: Page
    console: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def dismiss(self, dialog: Dialog) -> None:
        """Note that a dialog opened, and close it."""
        self.console.append(f"dialog: {dialog.message}")
        dialog.dismiss()

    @property
    def left(self) -> list[str]:
        """Requests that left the machine's files."""
        return [address for address in self.requests if not address.startswith(LOCAL)]

    def open(self, path: Path) -> Page:
        """Go to a file and wait until it is loaded."""
        self.page.goto(path.resolve().as_uri(), wait_until="load")
        return self.page


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One browser for all tests."""
    pytest.importorskip("playwright", reason="playwright is not installed: the extra browser")
    from tests.browser.chromium import CHROMIUM, browser_here

    if CHROMIUM is None:
        pytest.skip("chromium is not installed (apt-get install chromium)")
    with browser_here() as opened:
        yield opened


@pytest.fixture
def visit(browser: Browser) -> Iterator[Callable[..., Visit]]:
    """Open a tab, with options of the browser's contexts, e.g. ``java_script_enabled=False``."""
    contexts: list[BrowserContext] = []

    def begin(**options: Any) -> Visit:
        contexts.append(browser.new_context(**({"viewport": {"width": 1100, "height": 900}} | options)))
        seen = Visit(contexts[-1].new_page())
        seen.page.on("console", lambda message: seen.console.append(f"{message.type}: {message.text}"))
        seen.page.on("pageerror", lambda error: seen.console.append(f"error: {error}"))
        seen.page.on("request", lambda request: seen.requests.append(request.url))
        seen.page.on("dialog", seen.dismiss)
        return seen

    yield begin
    for context in contexts:
        context.close()


@pytest.fixture
def page(visit: Callable[..., Visit]) -> Iterator[Page]:
    """A tab; in the end nothing must have been complained about, and nothing fetched from elsewhere."""
    seen = visit()
    yield seen.page
    assert seen.console == []
    assert seen.left == []


@pytest.fixture(scope="session")
def axe() -> Callable[..., list[str]]:
    """What axe-core finds wrong with a page: rule, how many places, the first of them.

    Pictures that screen readers are not shown are emptied first: axe would walk each of their points.
    """
    pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")
    source = files("axe_playwright_python").joinpath("axe.min.js").read_text("utf-8")

    def violations(page: Page) -> list[str]:
        page.locator("svg[aria-hidden=true]").evaluate_all("all => all.forEach(svg => svg.replaceChildren())")
        # Set by the debugger, not by the page: the page's own policy would refuse it.
        page.evaluate(source)
        options = {"runOnly": RULES, "resultTypes": ["violations"], "preload": False}
        found = page.evaluate("options => axe.run(document, options)", options)["violations"]
        return [
            f"{each['id']} ({len(each['nodes'])}): {each['help']}; {each['nodes'][0]['html'][:200]}"
            for each in found
        ]

    return violations
