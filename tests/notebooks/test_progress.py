"""A progress bar is for somebody who watches, and for nobody else."""

from __future__ import annotations

import io

import pytest

from stickslip_fit._io import progress_bar


class Terminal(io.StringIO):
    """Somebody watches."""

    def isatty(self) -> bool:
        return True


def told(file, shown):
    with progress_bar(shown, total=4, unit=" campaigns", file=file, ncols=70, mininterval=0) as each:
        each.update(2)
        each.refresh()
    return file.getvalue()


def test_a_terminal_shows_it_and_is_left_clean():
    text = told(Terminal(), True)
    assert " 50%" in text
    assert "2/4" in text
    assert not text.rpartition("\r")[0].rpartition("\r")[2].strip()


@pytest.mark.parametrize(("file", "shown"), [(io.StringIO(), True), (Terminal(), False)])
def test_a_file_and_somebody_who_does_not_want_it_get_nothing(file, shown):
    assert told(file, shown) == ""
