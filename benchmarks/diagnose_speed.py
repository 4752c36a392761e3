"""CPU time of whole commands, in an older version of the package and in this one.

`python -m benchmarks.diagnose_speed OLDER LOG...`, OLDER a checkout of the older version, e.g. made by
`git worktree add --detach ../older 62652d8`. The commands take turns, after one turn to compile; user and
system time of all their processes counts, imports included. `--decide` also has 10,000 simulated traverses
decided, without gain; `--page` and `--report` have pages made.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.report import make_log
from benchmarks.simulate_campaign import REFERENCE

NEWER = Path(__file__).parents[1]
TRAVERSES = 10_000
# Deciding had another name in older versions, and no option of its own on the command line.
DECIDE = """
import sys
from stickslip_fit.logs import read_log
try:
    from stickslip_fit.diagnosis import diagnose
    print(diagnose(read_log(sys.argv[1]), gain=False).verdict)
except ImportError:
    from stickslip_fit.diagnose.diagnose import decide
    print(decide(read_log(sys.argv[1])).verdict)
"""


def main() -> None:
    """Print a row of a table for each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("older", type=Path)
    parser.add_argument("logs", type=Path, nargs="*")
    parser.add_argument("--turns", type=int, default=3)
    for option in ("decide", "page", "report"):
        parser.add_argument(f"--{option}", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page, commands = Path(folder) / "page.html", {}
        verb = [sys.executable, "-m", "stickslip_fit"]
        for log in map(Path.resolve, options.logs):
            commands[f"diagnose {log.name}"] = [*verb, "diagnose", log]
            if options.page:
                commands[f"diagnose {log.name} --report"] = [*verb, "diagnose", log, "--report", page]
            if options.report:
                commands[f"report {log.name}"] = [*verb, "report", log, "-o", page]
        if options.decide:
            log = Path(folder) / "log.csv"
            number = make_log(log, TRAVERSES)
            commands[f"decide {number:,} traverses"] = [sys.executable, "-c", DECIDE, log]
        for tree in (options.older.resolve(), NEWER):
            cpu_seconds(
                [*verb, "report", REFERENCE / "campaign.csv", "-o", page, "--no-diagnosis"], tree, folder
            )
        print("| command | older | this | ratio | from | to |\n| --- | --- | --- | --- | --- | --- |")
        for name, command in commands.items():
            seconds = np.array(
                [[cpu_seconds(command, tree, folder) for tree in (options.older.resolve(), NEWER)]
                 for _ in range(options.turns)]
            )  # fmt: skip
            older, newer = np.median(seconds, axis=0)
            ratios = seconds[:, 0] / seconds[:, 1]
            print(
                f"| {name} | {older:.1f} s | {newer:.1f} s | {older / newer:.1f} | {ratios.min():.1f} | "
                f"{ratios.max():.1f} |",
                flush=True,
            )


def cpu_seconds(command: Sequence[str | Path], tree: Path, folder: str) -> float:
    """User and system time of a command and its children, with the package of a tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONPYCACHEPREFIX": f"{folder}/compiled"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = os.times()
    subprocess.run(command, check=True, env=environment, cwd=folder, stdout=subprocess.DEVNULL)
    after = os.times()
    return (after.children_user - before.children_user) + (after.children_system - before.children_system)


if __name__ == "__main__":
    main()
