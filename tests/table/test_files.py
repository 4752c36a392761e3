"""Tables in files as spreadsheets write them."""

from __future__ import annotations

import pandas as pd
import pytest

from stickslip_fit.diagnosis.table import read_table
from stickslip_fit.errors import InputError

TABLE = pd.DataFrame({"t": [0.0, 0.5, 1.0], "force": [1.25, -2.5, 3.0], "run": ["a", "b", "c, d"]})


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("|", ".")]
)
def test_separators_and_decimal_commas_give_the_same_table(tmp_path, separator, decimal):
    path = tmp_path / "bench.csv"
    TABLE.to_csv(path, sep=separator, decimal=decimal, index=False)
    pd.testing.assert_frame_equal(read_table(path)[0].astype({"run": object}), TABLE.astype({"run": object}))


def test_a_workbook_gives_the_same_table(tmp_path):
    pytest.importorskip("openpyxl")
    path = tmp_path / "bench.xlsx"
    TABLE.to_excel(path, index=False)
    pd.testing.assert_frame_equal(read_table(path)[0], TABLE)


def test_both_decimal_marks_in_one_file_are_one_message(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("t;force\n0,5;1.25\n", encoding="utf-8")
    with pytest.raises(InputError, match="with decimal commas, as '0,5', and with points, as '1\\.25'"):
        read_table(path)
