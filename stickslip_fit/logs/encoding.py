"""Bytes into UTF-8 text, or into what is wrong with them."""

from __future__ import annotations

import re

from stickslip_fit.logs.faults import Faults
from stickslip_fit.logs.records import count_lines, split_cells

_FOREIGN_MARKS = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
_ADVICE = "save the file as UTF-8 (in a spreadsheet: 'CSV UTF-8')"


def is_text(raw: bytes, file: str, faults: Faults) -> bool:
    """Say whether bytes may be text of one byte for each ASCII character, and tell if they aren't."""
    for mark, encoding in _FOREIGN_MARKS.items():
        if raw.startswith(mark):
            faults.place(file, f"is {encoding}; {_ADVICE}", line=1)
            return False
    position = raw.find(b"\0")
    if position >= 0:
        message = f"holds a zero byte, so it is damaged, or UTF-16, or no text at all; {_ADVICE}"
        faults.place(file, message, line=1 + count_lines(raw[:position]), value=r"\x00")
    return position < 0


def as_utf8(raw: bytes) -> bytes:
    """Put stand-ins in the place of bytes that are not UTF-8, so that reading can go on."""
    if raw.isascii():
        return raw
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("utf-8", "replace").encode("utf-8")
    return raw


def complain_about_bytes(raw: bytes, names: tuple[str, ...], file: str, faults: Faults) -> None:
    """Tell of the first byte of each line that is not UTF-8."""
    found = []
    lines = re.split(r"\r\n|\r|\n", raw.decode("utf-8", "surrogateescape"))
    for line, text in enumerate(lines, start=1):
        foreign = re.search("[\udc80-\udcff]", text)
        if foreign:
            before = split_cells(text[: foreign.end()].encode("utf-8", "surrogateescape"))
            column = names[len(before) - 1] if line > 1 and len(before) <= len(names) else None
            cell = text[text.rfind(",", 0, foreign.start()) + 1 :].partition(",")[0]
            value = cell.encode("utf-8", "surrogateescape").decode("latin-1")
            message = f"byte 0x{ord(foreign[0]) - 0xDC00:02X} is not UTF-8; {_ADVICE}"
            found.append((line, column, value, message))
    faults.lines(file, found)
