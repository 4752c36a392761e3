"""The documentation built as `make docs` builds it, once for all tests of a run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.commands import ROOT

NEEDED = ("sphinx", "myst_nb", "numpydoc", "furo", "latex2mathml")


def built_site(factory: pytest.TempPathFactory) -> Path:
    """The folder of the site's pages; the first to ask builds it, the others wait."""
    for package in NEEDED:
        pytest.importorskip(package, reason=f"{package} is not installed: pip install 'stickslip-fit[docs]'")
    fcntl = pytest.importorskip("fcntl", reason="the site is built where files can be locked")
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "site"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "said").exists():
            (folder / "said").write_text(_build(folder), "utf-8")
    said = (folder / "said").read_text("utf-8")
    assert not said, said
    return folder / "html"


def _build(folder: Path) -> str:
    """Build, and return what went wrong."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    where = ["-d", str(folder / "doctrees"), str(ROOT / "docs"), str(folder / "html")]
    built = subprocess.run([*command, *where], capture_output=True, text=True, check=False)
    return built.stderr or "the build failed" if built.returncode else ""
