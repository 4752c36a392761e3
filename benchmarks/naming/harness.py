"""Rivals and ours on identical logs with known truth: answers, then a table.

``python -m benchmarks.naming --size small``; it makes the logs, asks each contender in a process of its own
in turn, and prints how right they were. What is there already is not done again; ``--again ours`` does.
Peers live in an environment of their own, whose interpreter is given as PEERS_PYTHON; it needs numpy,
statsmodels, scikit-learn, interpret-core, pygam and pysindy.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import gettempdir

from benchmarks.naming.answering import CONTENDERS, lines
from benchmarks.naming.logs import SIZES, make_logs
from benchmarks.naming.scores import table

ROOT = Path(__file__).parents[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", choices=list(SIZES), default="small")
    parser.add_argument("--folder", type=Path, help="of logs and answers; a temporary one without it")
    parser.add_argument("--contenders", nargs="*", choices=list(CONTENDERS), default=list(CONTENDERS))
    parser.add_argument("--again", nargs="*", choices=list(CONTENDERS), default=[])
    chosen = parser.parse_args()
    folder = chosen.folder or Path(gettempdir()) / f"naming-{chosen.size}"
    logs = make_logs(chosen.size, folder)
    for contender in chosen.again:
        lines(contender, folder).unlink(missing_ok=True)
    for contender in chosen.contenders:
        _ask(contender, folder, logs)
    print(f"{len(logs)} logs in {folder}")
    print(table(folder, logs, [lines(contender, folder) for contender in CONTENDERS]))


def _ask(contender: str, folder: Path, logs: Sequence[Path]) -> None:
    """Answers of a contender, in the environment that it needs."""
    python = sys.executable if contender == "ours" else os.environ.get("PEERS_PYTHON")
    if python is None:
        print(f"{contender}: left out, no PEERS_PYTHON is given")
        return
    command = [python, "-m", "benchmarks.naming.answering", contender, str(folder)]
    alone = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    subprocess.run([*command, *(log.stem for log in logs)], check=True, cwd=ROOT, env=alone)


if __name__ == "__main__":
    main()
