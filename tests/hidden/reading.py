"""Hidden logs as the package reads them, which what makes them does not know."""

from pathlib import Path
from tempfile import TemporaryDirectory

from stickslip_fit.logs import Log, read_log
from tests.hidden.generate import Hidden


def read_hidden(hidden: Hidden) -> Log:
    """A hidden log as a user's file."""
    with TemporaryDirectory() as folder:
        hidden.write(Path(folder) / "log.csv")
        return read_log(Path(folder) / "log.csv")
