"""The files that the pages talk about, small: docs/howto/index.md lists them."""

from pathlib import Path

from stickslip_fit.logs import write_log
from stickslip_fit.logs.plan_reader import read_plan
from stickslip_fit.machine import load_machine
from stickslip_fit.simulation import read_law_values, simulate
from tests.docs.commands import ROOT
from tests.docs.fences import fences

TUTORIAL = ROOT / "docs" / "tutorial.md"
TODAY = ("2026-03-02, 2026-03-03, 2026-03-04", "2026-03-05")


def make_files(folder: Path) -> None:
    """The tutorial's plan and law, a log of them, and a day more."""
    shown = {fence.shows: fence.text for fence in fences(TUTORIAL) if fence.shows}
    plan, law = folder / "my-plan.toml", folder / "my-law.toml"
    plan.write_text(shown["my-plan.toml"])
    law.write_text((ROOT / "data/reference/law.toml").read_text() + "\n" + shown["my-warm-up.toml"])
    _simulated(plan, law, folder / "my-log.csv")
    later = folder / "later.toml"
    later.write_text(shown["my-plan.toml"].replace(*TODAY))
    _simulated(later, law, folder / "today.csv")
    later.unlink()
    (folder / "data").symlink_to(ROOT / "data")


def _simulated(plan: Path, law: Path, log: Path) -> None:
    machine = load_machine()
    write_log(simulate(read_plan(plan, machine), read_law_values(law, machine), machine), log)
