"""Tables in files as spreadsheets, loggers and instruments write them."""

import re
from functools import partial

import numpy as np
import pandas as pd
import pytest

import stickslip_fit as ssf
from stickslip_fit.diagnosis.table_rows import read_table
from stickslip_fit.errors import InputError

TABLE = pd.DataFrame({"t": [0.0, 0.5, 1.0], "force": [1.25, -2.5, 3.0], "run": ["a", "b", "c, d"]})
NUMBERS = pd.DataFrame({"t": [0.0, 0.5, 1.0], "force": [1250.25, -2.5, 3.0]})
HEADER, BODY = "t,force\n", "0.0,1250.25\n0.5,-2.5\n1.0,3.0\n"


def read(tmp_path, content, name="bench.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    frame, source = read_table(path)
    return frame, " ".join(source.get("notes", ()))


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ","), ("|", ".")]
)
def test_separators_and_decimal_commas_give_the_same_table(tmp_path, separator, decimal):
    path = tmp_path / "bench.csv"
    TABLE.to_csv(path, sep=separator, decimal=decimal, index=False)
    pd.testing.assert_frame_equal(read_table(path)[0].astype({"run": object}), TABLE.astype({"run": object}))


@pytest.mark.parametrize(
    ("content", "note"),
    [
        (HEADER + BODY, ""),
        (f"# rig 3\n# operator: me\n{HEADER}{BODY}# end\n", ""),
        (f"# t,force\n{BODY}", ""),
        (f"Axis1\nSamples,120\nSampling interval (ms),0.667,0\n{HEADER}{BODY}", "3 lines above the header"),
        (f"Rig: 3\nOperator: A, B\n\n{HEADER}s,mN\n{BODY}", "2 lines above the header left out; the row of"),
        (f"{HEADER}[s],[kg·m/s²]\n{BODY}", "header left out (t in s, force in kg·m/s²)"),
        ("t,force,,\n" + BODY.replace("\n", ",,\n") + ",,,\n", ""),
        (HEADER + BODY.replace("\n", ",\n"), ""),
        ("  t   force\n 0.0 1250.25\n 0.5   -2.5\n 1.0    3.0\n", "separated by blank space"),
        ("t force\n0,0 1250,25\n0,5 -2,5\n1,0 3,0\n", "decimals have commas"),
        ('t,force\n0,"1,250.25"\n0.5,-2.5\n1,3\n', "numbers of force have thousands separators"),
        ("t;force\n0;1.250,25\n0,5;-2,5\n1;3\n", "numbers of force have thousands separators"),
        ("sep=;\nt;force\n0;1250.25\n0.5;-2.5\n1;3\n", ""),
        ((HEADER + BODY).encode("utf-16"), ""),
        (("\ufeff" + HEADER + BODY).replace("\n", "\r\n").encode(), ""),
    ],
)
def test_what_laboratories_write_gives_the_same_table(tmp_path, content, note):
    frame, said = read(tmp_path, content)
    pd.testing.assert_frame_equal(frame, NUMBERS, check_dtype=False)
    assert note in said if note else not said


@pytest.mark.parametrize("above", ["", "Flow bench\nRoom 12\nOperator Kim\n"])
def test_times_with_a_blank_and_units_of_some_columns_only(tmp_path, above):
    """A blank in every row separates no cells where another separator gives each column its name."""
    header = "No.,Time,Pressure,Flow\n,,bar,L/min\n"
    body = "".join(f"{k},2024-05-31 09:0{k}:00,{k + 0.5},{k + 2}\n" for k in range(5))
    frame, said = read(tmp_path, above + header + body)
    assert list(frame) == ["No.", "Time", "Pressure", "Flow"]
    assert frame["Pressure"].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    assert "row of units" in said
    assert ("3 lines above the header" in said) == bool(above)


def test_text_that_is_no_utf_8_is_windows_1252(tmp_path):
    frame, said = read(tmp_path, "T_°C,µ\n1,2\n2,3\n".encode("latin-1"))
    assert list(frame) == ["T_°C", "µ"]
    assert "Windows-1252" in said


def test_row_names_of_r_are_a_column_without_a_name(tmp_path):
    frame, _ = read(tmp_path, '"t" "force"\n"1" 0 1250.25\n"2" 0.5 -2.5\n"3" 1 3\n')
    assert list(frame) == ["column 1", "t", "force"]
    assert frame["force"].tolist() == NUMBERS["force"].tolist()


def test_a_blank_within_each_cell_of_text_separates_nothing(tmp_path):
    """Beside row numbers without a name, as R and pandas write them."""
    body = "".join(f'"{k}","Frank No{k}",{k + 0.5}\n' for k in range(1, 6))
    frame, said = read(tmp_path, f'"","name","speed"\n{body}')
    assert list(frame) == ["column 1", "name", "speed"]
    assert frame["name"][1] == "Frank No2"
    assert not said


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "is empty"),
        ("0,1\n1,2\n2,3\n", "has no header"),
        ("t,force\n", "has a header and no rows"),
        (
            "a,b\n1,2\n# why\n3\n4,5\n",
            "line 4, value '3': has 1 cell where the header has 2; fill in what is missing, or add commas",
        ),
        (
            "t;force\n0,5;1.25\n",
            "column force, value '1.25': has a decimal point, and '0,5' in line 2, column t, a decimal comma",
        ),
        ("\x1f\x8b", "is packed with gzip"),
        (b"t,force\n\x00\x01", "zero byte"),
    ],
)
def test_what_is_no_table_has_one_clear_message(tmp_path, content, told):
    with pytest.raises(InputError) as caught:
        read(tmp_path, content if isinstance(content, bytes) else content.encode("latin-1"))
    assert told in str(caught.value)
    assert "save it as CSV" not in str(caught.value)


def test_a_comma_that_may_be_either_mark_is_no_number(tmp_path):
    frame, _ = read(tmp_path, 't,force\n0,"1,250"\n1,"2,500"\n')
    assert frame["force"].tolist() == ["1,250", "2,500"]


def test_a_workbook_gives_the_same_table(tmp_path):
    path = tmp_path / "bench.xlsx"
    TABLE.to_excel(path, index=False)
    pd.testing.assert_frame_equal(read_table(path)[0], TABLE)


@pytest.mark.parametrize(
    ("sheet", "told"),
    [
        (None, r"sheet 'Notes' is empty; .*, or name 'Data' and 'Raw' as the sheet"),
        ("Raw", "has no header"),
        ("Day", "has no sheet 'Day', but 'Notes', 'Data' and 'Raw'; name one of these"),
    ],
)
def test_of_a_workbook_whose_sheet_is_no_table_the_other_sheets_are_named(tmp_path, sheet, told):
    path = tmp_path / "bench.xlsx"
    with pd.ExcelWriter(path) as workbook:
        pd.DataFrame().to_excel(workbook, sheet_name="Notes")
        NUMBERS.to_excel(workbook, sheet_name="Data", index=False)
        NUMBERS.to_excel(workbook, sheet_name="Raw", index=False, header=False)
    with pytest.raises(InputError, match=told):
        read_table(path, sheet=sheet)
    pd.testing.assert_frame_equal(read_table(path, sheet="Data")[0], NUMBERS)


def test_a_workbook_may_have_a_title_and_units(tmp_path):
    path = tmp_path / "bench.xlsx"
    rows = [["Rig 3", None], [None, None], ["t", "force"], ["s", "mN"], *NUMBERS.to_numpy().tolist()]
    pd.DataFrame(rows).to_excel(path, index=False, header=False)
    pd.testing.assert_frame_equal(read_table(path)[0], NUMBERS, check_dtype=False)


def test_beside_decimal_commas_the_cell_that_is_no_number_is_named_alone(tmp_path):
    path = tmp_path / "bench.csv"
    cells = [f"{1 + k / 8:.3f}".replace(".", ",") for k in range(12)]
    cells[7] = "???"
    path.write_text("x;y\n" + "".join(f"{k};{cell}\n" for k, cell in enumerate(cells)))
    with pytest.raises(InputError) as error:
        ssf.fit_table(path, "y ~ a + b*x")
    (problem,) = error.value.problems
    assert str(problem) == (
        f"{path}, line 9, column y, value '???': is no finite number; correct it, or leave out its row"
    )


@pytest.mark.parametrize("kind", ["csv", "xlsx", "parquet"])
def test_a_faulty_cell_of_a_file_is_told_with_its_place_there(tmp_path, kind):
    path = tmp_path / f"bench.{kind}"
    frame = pd.DataFrame(
        {"x": [float(k) for k in range(12)], "y": [*map(str, range(7)), "???", *map(str, range(8, 12))]}
    )
    if kind == "csv":
        path.write_text("# of March\n\n" + frame.to_csv(index=False).replace("3.0,3", ",\n3.0,3"))
        place = "line 12"
    elif kind == "xlsx":
        frame.to_excel(path, index=False, startrow=2, sheet_name="Log")
        place = "sheet 'Log', row 11"
    else:
        frame.to_parquet(path)
        place = "row 8"
    for call in (ssf.fit_table, partial(ssf.diagnose_table, gain=False)):
        with pytest.raises(InputError) as error:
            call(path, "y ~ a + b*x")
        (problem,) = error.value.problems
        assert str(problem).startswith(f"{path}, {place}, column y, value '???': is no finite number; ")
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}, column when: is named as the session, "):
        ssf.fit_table(path, "x ~ a", session="when")


def test_none_is_a_label_among_others_and_no_number(tmp_path):
    file = tmp_path / "doses.csv"
    file.write_text("drug,dose,y\nNone,none,1\nA,3,2\nNA,4,3\n")
    frame = read_table(file)[0]
    assert frame["drug"].fillna("").tolist() == ["None", "A", ""]
    assert frame["dose"].fillna(0.0).tolist() == [0.0, 3.0, 4.0]


@pytest.mark.parametrize("first", [2201, 2601, 99990])
def test_numbers_of_runs_are_no_years(tmp_path, first):
    """A year that nanoseconds do not reach had ended in a traceback."""
    x = np.arange(36.0)
    frame = pd.DataFrame({"run": first + np.arange(36) // 12, "x": x, "y": 2.0 * x + np.sin(7.0 * x)})
    frame.to_csv(file := tmp_path / "runs.csv", index=False)
    found = ssf.diagnose_table(file, "y ~ a + b*x", session="run", gain=False)
    assert found.table.unnamed_time == ""
