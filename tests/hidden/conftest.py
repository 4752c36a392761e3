from collections.abc import Callable

import pandas as pd
import pytest

from tests.hidden.generate import Hidden
from tests.hidden.reading import read_hidden


@pytest.fixture(scope="session")
def read() -> Callable[[Hidden], pd.DataFrame]:
    """The rows of a hidden log as the reader gives them."""
    return lambda hidden: read_hidden(hidden).rows
