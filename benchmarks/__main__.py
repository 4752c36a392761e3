"""Run every benchmark; each prints its figures."""

from benchmarks import (
    drive,
    end_stop,
    fit_groups,
    nist,
    nist_anova,
    read_log,
    simulate_campaign,
    start_up,
    step,
    study,
)

for benchmark in (
    start_up,
    read_log,
    simulate_campaign,
    fit_groups,
    nist,
    nist_anova,
    study,
    end_stop,
    step,
    drive,
):
    print(f"--- {benchmark.__name__}: {(benchmark.__doc__ or '').splitlines()[0]}", flush=True)
    benchmark.main()
