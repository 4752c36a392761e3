"""Score rivals and ours; see `harness`."""

from benchmarks.cause_set.harness import main

main()
