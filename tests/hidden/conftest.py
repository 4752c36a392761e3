from collections.abc import Callable

import pandas as pd
import pytest

from stickslip_fit.logs import read_log
from tests.hidden.generate import Hidden


@pytest.fixture(scope="session")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Hidden], pd.DataFrame]:
    """The rows of a hidden log as the reader gives them."""

    def rows(hidden: Hidden) -> pd.DataFrame:
        path = tmp_path_factory.mktemp("hidden") / "log.csv"
        hidden.write(path)
        return read_log(path).rows

    return rows
