"""The report of a log of 100,000 traverses: how long it takes to make, how large it is, how fast it opens.

`python -m benchmarks.report quick` leaves out the diagnosis and the comparison of strategies.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from benchmarks.simulate_campaign import REFERENCE, enlarged
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate

TRAVERSES = 100_000
OPENED = 5
MOST_BYTES, MOST_SECONDS = 10e6, 2.0
READY = "() => performance.getEntriesByType('navigation')[0].loadEventEnd / 1000"
POINTED = "() => document.getElementById('said').textContent !== ''"


def main() -> None:
    """Print one line for the page without its slow sections, and one for the whole page."""
    kinds = {"without diagnosis and strategies": ("--no-diagnosis", "--no-strategies"), "whole": ()}
    if "quick" in sys.argv[1:]:
        del kinds["whole"]
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        rows = make_log(log, TRAVERSES)
        for name, options in kinds.items():
            page = log.with_suffix(".html")
            seconds = made(log, page, options)
            size = page.stat().st_size
            print(
                f"| report of {rows:,} traverses, {name} | made in {seconds:.0f} s | {size / 1e6:.1f} MB "
                f"(allowed: {MOST_BYTES / 1e6:g}) | {opening(page)} |",
                flush=True,
            )


def make_log(path: Path, traverses: int) -> int:
    """The reference campaign's plan, repeated on as many days as it takes; how many traverses that makes."""
    machine = load_machine()
    plan = enlarged(read_plan(REFERENCE / "plan.toml", machine), traverses)
    log = simulate(plan, read_law_values(REFERENCE / "law.toml", machine), machine)
    log.to_csv(path)
    return len(log)


def made(log: Path, page: Path, options: tuple[str, ...]) -> float:
    """Seconds that the verb takes."""
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "stickslip_fit", "report", log, "-o", page, *options],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return time.perf_counter() - began


def opening(page: Path) -> str:
    """How long a browser takes from the start of loading to the page, and to a point's answer."""
    try:
        from tests.browser.chromium import browser_here
    except ImportError:
        return "not opened: there is no browser to drive"
    loaded, answered = [], []
    with browser_here() as browser:
        for _ in range(OPENED):
            tab = browser.new_page()
            began = time.perf_counter()
            tab.goto(page.as_uri())
            tab.focus("#departures")
            tab.wait_for_function(POINTED)
            answered.append(time.perf_counter() - began)
            loaded.append(tab.evaluate(READY))
            tab.close()
    return (
        f"opens in {median(loaded):.2f} s, a point answers after {median(answered):.2f} s "
        f"(allowed: {MOST_SECONDS:g})"
    )


if __name__ == "__main__":
    main()
