"""Error rates of diagnose_table, those in `benchmarks/README.md`: ``python -m tests.table.study --help``."""

import argparse

from tests.table.test_search import count_alarms, name_rates


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", help="white, t5, 0.5, 0.9, 0.97 or rings")
    parser.add_argument("--tables", type=int, default=50)
    parser.add_argument("--sessions", type=int, default=1)
    parser.add_argument("--length", type=int, default=600, help="samples in each session")
    parser.add_argument("--hidden", help="a cause; nothing without it")
    parser.add_argument("--strength", type=float, default=12.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.hidden:
        right, wrong, oracle = name_rates(given.kind, given.hidden, given.strength, given.tables)
        print(f"in the answer {right:.2f}, another instead {wrong:.2f}, known noise {oracle:.2f}")
    else:
        alarms = count_alarms(given.kind, given.sessions, given.length, given.tables, given.seed)
        print(f"{alarms} alarms in {given.tables} tables")


if __name__ == "__main__":
    main()
