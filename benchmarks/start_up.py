"""How long the command line takes to answer at all, beside an empty Python process."""

import subprocess
import sys
import time

import numpy as np

ROUNDS = 9


def main() -> None:
    """Print the median wall times."""
    commands = {
        "stickslip-fit --help": [sys.executable, "-m", "stickslip_fit", "--help"],
        "python -c pass": [sys.executable, "-c", "pass"],
    }
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(ROUNDS):
        for name, command in commands.items():
            began = time.perf_counter()
            subprocess.run(command, check=True, capture_output=True)
            seconds[name].append(time.perf_counter() - began)
    for name, found in seconds.items():
        print(f"{name}: {np.median(found):.2f} s")


if __name__ == "__main__":
    main()
