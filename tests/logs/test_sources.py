"""What a log is read from: folders of which nothing is left out in silence, and files that are no logs."""

import gzip
import io
import os
import socket
import sys
import zipfile

import pandas as pd
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from stickslip_fit.cli._app import app
from stickslip_fit.errors import InputError
from stickslip_fit.logs import read_log, read_plan
from stickslip_fit.machine import load_machine

links = pytest.mark.skipif(sys.platform == "win32", reason="links and pipes are POSIX's")


@pytest.fixture
def folder(sheet, tmp_path):
    """A folder `logs` with one log, ``day.csv``."""
    place = tmp_path / "logs"
    place.mkdir()
    (place / "day.csv").write_text(sheet.text(), encoding="utf-8")
    return place


def refusal(source) -> str:
    with pytest.raises(InputError) as refused:
        read_log(source)
    (issue,) = refused.value.problems
    return str(issue)


def test_other_files_of_a_folder_are_named_in_the_log_and_by_the_command(folder):
    for name in ("day.ods", "day.csv.gz", "old/notes.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"content")
    for name in (".hidden.csv", ".git/x.csv", "day.csv~", "#day.csv#", "~$day.xlsx"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"no log")
    log = read_log(folder)
    assert len(log) == 6
    rest = os.path.join("old", "notes.txt")
    assert log.notes == (f"{folder}: 3 other files not read: day.csv.gz, day.ods and {rest}",)
    assert "day.csv.gz" in CliRunner().invoke(app, ["check", str(folder)], env={"COLUMNS": "500"}).output


def test_many_other_files_are_counted(folder):
    for number in range(30):
        (folder / f"{number}.txt").touch()
    (note,) = read_log(folder).notes
    assert "30 other files" in note
    assert note.endswith("and 20 more")


def test_a_folder_with_other_files_only_names_them(folder):
    (folder / "day.csv").rename(folder / "day.csv.gz")
    assert "folder without logs; neither is day.csv.gz" in refusal(folder)


@links
def test_a_file_or_folder_with_two_names_is_read_once_and_noted(folder):
    (folder / "again.csv").symlink_to(folder / "day.csv")
    os.link(folder / "day.csv", folder / "hard.csv")
    (folder / "loop").symlink_to(folder)
    log = read_log([folder, folder / "day.csv"])
    assert len(log) == 6
    first = folder / "again.csv"
    others = [folder / "day.csv", folder / "hard.csv", folder / "day.csv"]
    assert [note for note in log.notes if "loop" not in note] == [
        f"{other} is {first} under another name: read once" for other in others
    ]
    assert any(note.startswith(str(folder / "loop")) for note in log.notes)


@links
def test_links_are_followed(folder, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (folder / "day.csv").rename(tmp_path / "elsewhere" / "day.csv")
    (folder / "link").symlink_to(tmp_path / "elsewhere")
    assert len(read_log(folder)) == 6


@links
@pytest.mark.parametrize("target", ["gone.csv", "lost.csv"])
def test_a_link_that_leads_nowhere_is_an_error(folder, target):
    (folder / "lost.csv").symlink_to(target)
    assert f"it is a link to '{target}': mend or delete it" in refusal(folder)


def test_a_subfolder_that_cannot_be_read_is_an_error(folder, monkeypatch):
    (folder / "closed").mkdir()
    listdir = os.listdir

    def refuse(path):
        if path.name == "closed":
            raise PermissionError(13, "Permission denied")
        return listdir(path)

    monkeypatch.setattr(os, "listdir", refuse)
    assert "closed: cannot be read (Permission denied)" in refusal(folder)


@pytest.mark.parametrize("source", ["", [""], [], ["", "day.csv"]])
def test_an_empty_name_is_no_folder(folder, monkeypatch, source):
    monkeypatch.chdir(folder)
    assert refusal(source) == "no log was named; name a file or a folder"


@pytest.mark.parametrize("command", ["check", "fit", "anova", "diagnose", "plan", "report", "demo"])
def test_an_empty_argument_is_no_folder(folder, monkeypatch, command):
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, [command, ""])
    assert isinstance(result.exception, InputError)
    assert "empty text" in str(result.exception)


@pytest.mark.parametrize("source", ["day\0.csv", "x" * 5000, "nowhere.csv"])
def test_an_impossible_name_is_an_error(source):
    assert "cannot be read" in refusal(source)


def test_a_name_that_is_no_text_can_be_shown(folder):
    if sys.platform == "linux":
        name = os.fsdecode(os.fsencode(folder) + b"/\xff.csv")
        os.rename(folder / "day.csv", name)
        assert read_log(folder).sources[0][0].endswith(r"\xff.csv")


def zipped(**files: bytes) -> bytes:
    with io.BytesIO() as stream:
        with zipfile.ZipFile(stream, "w") as archive:
            for name, content in files.items():
                archive.writestr(name, content)
        return stream.getvalue()


FOREIGN = {
    "gzip": gzip.compress(b"session,time"),
    "zip archive": zipped(day=b"session,time"),
    "Excel workbook": zipped(**{"[Content_Types].xml": b"<xml/>", "xl/workbook.xml": b"<xml/>"}),
    "old or protected": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500),
    "OpenDocument": zipped(mimetype=b"application/vnd.oasis.opendocument.spreadsheet"),
    "PDF": b"%PDF-1.7\n1 0 obj",
    "web page": b"\n<!DOCTYPE html>\n<html><body>sign in</body></html>",
    "JSON": b"[" * 200_000,
    "UTF-16": "session,time\n".encode("utf-16-le"),
    "is empty": b"",
}


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet", ""])
@pytest.mark.parametrize("kind", FOREIGN)
def test_files_that_are_no_logs_are_told_for_what_they_are(tmp_path, kind, suffix):
    path = tmp_path / f"day{suffix}"
    path.write_bytes(FOREIGN[kind])
    if kind in ("UTF-16", "is empty") and suffix == ".parquet":
        kind = "no Parquet file"
    assert kind in refusal(path)


@links
def test_pipes_devices_and_sockets_are_refused_before_they_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    with socket.socket(socket.AF_UNIX) as bound:
        here = os.open(tmp_path, os.O_RDONLY)
        bound.bind(
            f"/proc/self/fd/{here}/socket.csv" if sys.platform == "linux" else str(tmp_path / "socket.csv")
        )
        os.close(here)
    for path, kind in ((tmp_path / "pipe.csv", "a pipe"), (tmp_path / "socket.csv", "a socket")):
        assert f"is {kind}, no file" in refusal(path)
        assert f"is {kind}, no file" in refusal(tmp_path / ".." / tmp_path.name / path.name)
    assert "is a device" in refusal("/dev/zero")
    for read in (load_machine, lambda path: read_plan(path, load_machine())):
        with pytest.raises(InputError, match="is a pipe, no file"):
            read(tmp_path / "pipe.csv")


def test_a_file_larger_than_any_log_is_refused_unread(tmp_path):
    path = tmp_path / "sparse.csv"
    with path.open("wb") as stream:
        stream.truncate(10 * 2**30)
    assert "has 10,240.0 MiB, and no more than 512.0 MiB" in refusal(path)
    with pytest.raises(InputError, match=r"no more than 0\.5 MiB"):
        load_machine(path)


@pytest.mark.parametrize(
    ("raw", "said"),
    [
        (b"x" * 2**25, "more than 16 MiB"),
        (b"," * 1_000_000 + b"\n1\n", "1,000,001 columns, and no more than 2,000"),
        (b"session,time\n" + b"1,2,3\n" * 20_000, "more than 10,000 rows have another number of cells"),
        (b"session,time\n" + b"\n" * 500_000, "a header and no rows"),
    ],
)
def test_a_file_of_no_sensible_shape_is_one_message(tmp_path, raw, said):
    path = tmp_path / "day.csv"
    path.write_bytes(raw)
    assert said in refusal(path)


@pytest.mark.slow
def test_a_thousand_columns_of_one_s_own_are_read(sheet, read):
    for number in range(1000):
        sheet.add(f"x{number}", [str(number + row) for row in range(6)])
    assert sum(name.startswith("covariate:x") for name in read(sheet).rows) == 1000


def test_a_parquet_file_of_too_many_rows_is_refused_unread(tmp_path):
    path = tmp_path / "day.parquet"
    zeros = pa.nulls(6_000_000, pa.bool_())
    parquet.write_table(pa.table({"session": zeros}), path)
    assert "has 6,000,000 rows, and no more than 5,000,000" in refusal(path)


WRONG_TYPES = {
    "duration": pa.array([12540 * 10**6] * 6, pa.duration("us")),
    "timestamp": pa.array([12540] * 6, pa.timestamp("s")),
    "date32": pa.array([12540] * 6, pa.date32()),
    "time64": pa.array([12540] * 6, pa.time64("us")),
    "bool": pa.array([True] * 6),
    "list": pa.array([[12540]] * 6),
    "struct": pa.array([{"a": 12540}] * 6),
}


@pytest.mark.parametrize("kind", WRONG_TYPES)
@pytest.mark.parametrize("column", ["steps", "joint", "theta_deg", "check_every", "temperature_C"])
def test_a_number_of_a_type_that_is_none_is_refused_by_its_column(sheet, tmp_path, column, kind):
    columns = {name: [row[place] for row in sheet.rows] for place, name in enumerate(sheet.header)}
    path = tmp_path / "day.parquet"
    parquet.write_table(pa.table({**columns, column: WRONG_TYPES[kind]}), path)
    said = refusal(path)
    assert f"column {column}: holds {kind}" in said
    assert said.endswith("save it as numbers")


@pytest.mark.parametrize("column", ["session", "time", "note", "pressure_hPa"])
def test_a_duration_is_refused_in_every_column(sheet, tmp_path, column):
    columns = {name: [row[place] for row in sheet.rows] for place, name in enumerate(sheet.header)}
    path = tmp_path / "day.parquet"
    parquet.write_table(pa.table({**columns, column: WRONG_TYPES["duration"]}), path)
    assert f"column {column}: holds duration[us]; save it as numbers or text" in refusal(path)


def test_a_count_beyond_64_bits_is_no_count(sheet, tmp_path):
    columns = {name: [row[place] for row in sheet.rows] for place, name in enumerate(sheet.header)}
    path = tmp_path / "day.parquet"
    counts = pa.array([2**64 - 5, *range(5, 30, 5)], pa.uint64())
    frame = pd.DataFrame(columns).assign(steps=counts.to_pandas(), check_every="1")
    frame.to_parquet(path)
    assert "column steps, value '18446744073709551611': is no positive integer" in refusal(path)
