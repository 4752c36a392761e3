"""What a diagnosis says of logs in which nothing is hidden but gross errors, or nothing at all.

Counts are doubled or halved at a rate, at least one in each log; at the rate 0 the same logs are left as they
are.
"""

from argparse import ArgumentParser
from collections import Counter

from joblib import Parallel, delayed

from stickslip_fit.diagnosis import diagnose
from tests.hidden.gross import SIZES, make_gross
from tests.hidden.reading import read_hidden

MISFIRE, UNKNOWN = "end-stop-misfire", "unknown"


def find_causes(size: str, rate: float, seed: int, gain: bool) -> tuple[str, ...]:
    """The causes that are named in one log."""
    hidden, _ = make_gross(size, rate, seed)
    return tuple(finding.cause for finding in diagnose(read_hidden(hidden), seed=seed, gain=gain).findings)


def main() -> None:
    """Print in how many logs gross errors alone are named, and in how many a physical cause."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first log")
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--rates", nargs="+", type=float, default=[0.01, 0.0025])
    parser.add_argument("--gain", action="store_true", help="measure the gain, which may withdraw a name")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.logs)
    for size in options.sizes:
        for rate in options.rates:
            tasks = (delayed(find_causes)(size, rate, seed, options.gain) for seed in seeds)
            answers = Counter(Parallel(n_jobs=-1)(tasks))
            right = answers[()] + answers[(MISFIRE,)]
            physical = sum(n for causes, n in answers.items() if set(causes) - {MISFIRE, UNKNOWN})
            print(f"{size}, {rate:.2%}: {right} of {len(seeds)} right, {physical} with a physical cause")
            for causes, n in answers.most_common():
                print(f"  {n:4} {', '.join(causes) or 'nothing wrong'}")


if __name__ == "__main__":
    main()
