"""A campaign made without the laws' code, as a log."""

import pytest

from stickslip_fit.logs import read_log


@pytest.fixture(scope="session")
def written(campaign, tmp_path_factory):
    """A maker of log files."""

    def write(table=None, **settings):
        path = tmp_path_factory.mktemp("strategies") / "campaign.csv"
        (campaign(**settings) if table is None else table).to_csv(path, index=False)
        return path

    return write


@pytest.fixture(scope="session")
def log(written):
    """Three sessions, joints 1 to 3, every configuration twice."""
    return read_log(written(sessions=("2012-03-05", "2012-03-06", "2012-03-07")))
