"""Progress: a bar at a terminal, lines in a file, nothing where it is not wanted."""

import io

from stickslip_fit import _progress
from stickslip_fit._progress import progress_bar


class Terminal(io.StringIO):
    """Somebody watches."""

    def isatty(self) -> bool:
        return True


def written_to(file, shown=True):
    options = {"total": 4, "unit": " campaigns", "file": file, "ncols": 70, "mininterval": 0, "miniters": 0}
    with progress_bar(shown, "{n_fmt} of {total_fmt}{unit}", **options) as bar:
        bar.update(2)
    return file.getvalue()


def test_a_terminal_shows_it_and_is_left_clean():
    text = written_to(Terminal())
    assert " 50%" in text
    assert "2/4" in text
    assert not text.rpartition("\r")[0].rpartition("\r")[2].strip()


def test_a_file_gets_lines(monkeypatch):
    monkeypatch.setattr(_progress, "LINE_EVERY", 0.0)
    assert written_to(io.StringIO()).splitlines() == ["0 of 4 campaigns", "2 of 4 campaigns"]


def test_a_file_gets_nothing_of_what_is_done_at_once():
    assert written_to(io.StringIO()) == ""


def test_somebody_who_does_not_want_it_gets_nothing():
    assert written_to(Terminal(), shown=False) == ""
