"""Score rivals and ours; see `harness`."""

from benchmarks.naming.harness import main

main()
