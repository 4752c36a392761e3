"""One diagnosis of the bench for all tests that only look at it."""

import pytest

import stickslip_fit as ssf
from tests.table.bench import BY_DIRECTION, CUBIC, LAW, bench


def diagnosed(frame, **options):
    causes = [BY_DIRECTION, CUBIC]
    return ssf.diagnose_table(frame, LAW, time="t", causes=causes, **{"generic_causes": (), **options})


@pytest.fixture(scope="session")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "bench.csv"
    bench(1, phi=0.6).to_csv(path, index=False)
    return path


@pytest.fixture(scope="session")
def named(file):
    """Of a file, with autocorrelated noise."""
    return diagnosed(file)


@pytest.fixture(scope="session")
def independent():
    """Without a time: rows in any order."""
    return ssf.diagnose_table(bench(1), LAW, causes=[BY_DIRECTION, CUBIC], generic_causes=())


@pytest.fixture(scope="session")
def nothing():
    return diagnosed(bench(2, difference=0.0))
