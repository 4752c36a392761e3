"""Speed beside peers, each pair measured in one run; results in README.md."""
