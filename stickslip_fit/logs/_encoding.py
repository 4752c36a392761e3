"""Bytes of a text file as UTF-8: byte order marks, UTF-16 and UTF-32 with one, and Windows-1252.

What is read as another encoding than UTF-8 is said in a note. Bytes that no encoding explains are reported
line by line.
"""

from __future__ import annotations

import re

from stickslip_fit.logs._table import IssueCollector

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_WIDE = {  # UTF-32 first: its little-endian mark begins with that of UTF-16
    b"\xff\xfe\x00\x00": ("utf-32", "UTF-32"),
    b"\x00\x00\xfe\xff": ("utf-32", "UTF-32"),
    b"\xff\xfe": ("utf-16", "UTF-16"),
    b"\xfe\xff": ("utf-16", "UTF-16"),
}
_ADVICE = "save the file as UTF-8 (in a spreadsheet: 'CSV UTF-8')"
_MAX_SAMPLE = 40  # characters of a line before the first byte that is no UTF-8


def decode(raw: bytes, file: str, issues: IssueCollector) -> tuple[bytes | None, tuple[str, ...]]:
    """The text of a file as UTF-8 without a mark, None where it has none, and notes on how it was read.

    Examples
    --------
    >>> decode("5 µm".encode("cp1252"), "day.csv", IssueCollector())[0].decode()
    '5 µm'
    """
    for mark, (codec, name) in _WIDE.items():
        if raw.startswith(mark):
            try:
                return raw.decode(codec).encode(), (f"{file}: is {name}, and was read as such",)
            except UnicodeError:
                issues.add(file, f"begins as {name} and is damaged; {_ADVICE}", line=1)
                return None, ()
    position = raw.find(b"\0")
    if position >= 0:
        message = f"holds a zero byte, so it is damaged, or UTF-16, or no text at all; {_ADVICE}"
        issues.add(file, message, line=1 + count_lines(raw[:position]), value=r"\x00")
        return None, ()
    raw = raw.removeprefix(BYTE_ORDER_MARK)
    if raw.isascii():
        return raw, ()
    try:
        raw.decode()
    except UnicodeDecodeError:
        return _decode_windows(raw, file, issues)
    return raw, ()


def _decode_windows(raw: bytes, file: str, issues: IssueCollector) -> tuple[bytes, tuple[str, ...]]:
    """Text that is no UTF-8 as Windows-1252, unless some of it is UTF-8: then it is damaged."""
    replaced = raw.decode("utf-8", "replace")
    try:
        if not replaced.replace("\N{REPLACEMENT CHARACTER}", "").isascii():
            raise UnicodeError
        note = f"{file}: is not UTF-8, and was read as Windows-1252 (what Excel's plain 'CSV' is)"
        return raw.decode("cp1252").encode(), (note,)
    except UnicodeError:
        _report_invalid_bytes(raw, file, issues)
        return replaced.encode(), ()


def _report_invalid_bytes(raw: bytes, file: str, issues: IssueCollector) -> None:
    """Add an issue for the first byte of each line that is not UTF-8."""
    located = []
    lines = re.split(r"\r\n|\r|\n", raw.decode("utf-8", "surrogateescape"))
    for line, text in enumerate(lines, start=1):
        foreign = re.search("[\udc80-\udcff]", text)
        if foreign:
            before = text[max(foreign.start() - _MAX_SAMPLE, 0) : foreign.end()]
            value = before.encode("utf-8", "surrogateescape").decode("latin-1")
            message = f"byte 0x{ord(foreign[0]) - 0xDC00:02X} is not UTF-8, as other text here is; {_ADVICE}"
            located.append((line, None, value, message))
    issues.add_lines(file, located)


def count_lines(raw: bytes) -> int:
    """Number of line ends."""
    return raw.count(b"\n") + raw.count(b"\r") - raw.count(b"\r\n")
