"""Cells into numbers, times and choices, a column at a time; nothing here complains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_NUMBER = r"^[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?$"
_TIME = r"^[0-9]{4}-[0-9]{2}-[0-9]{2}[T ][0-9]{2}:[0-9]{2}(:[0-9]{2}([.][0-9]{1,9})?)?"
_ZONE = r"(Z|[+-][0-9]{2}(:?[0-9]{2})?)"
_SHORTEST_TIME = len("2012-03-05T09:41")
_NANOSECONDS = pa.timestamp("ns")
_UTC = pa.timestamp("ns", "UTC")


@dataclass(frozen=True)
class Numbers:
    """Numbers, not finite where the cell is empty or bad."""

    values: Floats
    empty: Bools

    @property
    def bad(self) -> Bools:
        """Where a cell that is not empty holds no finite number."""
        return ~(np.isfinite(self.values) | self.empty)


@dataclass(frozen=True)
class Times:
    """Nanoseconds since 1970, UTC where zoned; 0 where the cell is empty or bad."""

    values: Ints
    zoned: Bools
    empty: Bools
    bad: Bools


def parse_numbers(cells: pa.Array) -> Numbers:
    """Read plain decimal numbers: ASCII digits, a point, an exponent, spaces around.

    Examples
    --------
    >>> parse_numbers(pa.array(["12540.0", " -1e-3 ", "", "1,5", "0x10"])).values
    array([ 1.254e+04, -1.000e-03,        nan,        nan,        nan])
    """
    if pa.types.is_timestamp(cells.type):
        cells = text_of(cells)
    if not _is_text(cells):
        return Numbers(_floats(cells.cast(pa.float64(), safe=False)), _mask(cells.is_null()))
    # Most columns repeat a few values; each is read once.
    encoded = cells.dictionary_encode()
    texts = pc.ascii_trim(encoded.dictionary, " \t")
    well_formed = pc.match_substring_regex(texts, _NUMBER)
    values = _floats(pc.if_else(well_formed, texts, None).cast(pa.float64()))
    blank = np.append(_mask(pc.equal(texts, "")), True)
    place = _places(encoded.indices, len(texts))
    return Numbers(np.append(values, np.nan)[place], blank[place])


def parse_times(cells: pa.Array) -> Times:
    """Read ISO 8601 dates with a time of day, with or without a zone.

    Examples
    --------
    >>> times = parse_times(pa.array(["1970-01-01T00:00:01", "1970-01-01 02:00+02:00", "1970-01-01"]))
    >>> times.values, times.zoned, times.bad
    (array([1000000000,          0,          0]), array([False,  True, False]), array([False, False,  True]))
    """
    if not pa.types.is_timestamp(cells.type):
        return _parse_written_times(text_of(cells))
    read = _cast(cells.cast(pa.timestamp(cells.type.unit)), _NANOSECONDS)
    return _times(read, np.full(len(cells), cells.type.tz is not None), _mask(cells.is_null()))


def _parse_written_times(texts: pa.Array) -> Times:
    nowhere = np.zeros(len(texts), np.bool_)
    try:
        # What is read at one go and is this long has minutes and no zone.
        if len(texts) and pc.min(pc.binary_length(texts)).as_py() >= _SHORTEST_TIME:
            return _times(texts.cast(_NANOSECONDS), nowhere, nowhere)
    except pa.ArrowInvalid:
        pass
    texts = pc.ascii_trim(texts, " \t")
    local = pc.match_substring_regex(texts, _TIME + "$")
    universal = pc.match_substring_regex(texts, _TIME + _ZONE + "$")
    read = pc.coalesce(
        _cast(pc.if_else(local, texts, None), _NANOSECONDS),
        _cast(pc.if_else(universal, texts, None), _UTC).cast(_NANOSECONDS),
    )
    return _times(read, _mask(universal), _mask(pc.equal(texts, "")))


def _times(read: pa.Array, zoned: Bools, empty: Bools) -> Times:
    unread = _mask(read.is_null())
    values = read.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False)
    return Times(values, zoned & ~unread, empty, unread & ~empty)


def parse_choices(cells: pa.Array, choices: tuple[str, ...]) -> npt.NDArray[np.int8]:
    """Say which of `choices` stands in each cell (spaces around are accepted), -1 for none of them.

    Examples
    --------
    >>> parse_choices(pa.array(["+", " - ", "up"]), ("+", "-"))
    array([ 0,  1, -1], dtype=int8)
    """
    texts = text_of(cells)
    known = pa.array(choices, texts.type)
    found = pc.index_in(texts, known)
    if found.null_count:
        found = pc.index_in(pc.ascii_trim(texts, " \t"), known)
    return found.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int8)


def filled(cells: pa.Array) -> Bools:
    """Where a cell holds more than spaces."""
    if not _is_text(cells):
        return _mask(cells.is_valid())
    return _mask(pc.not_equal(pc.ascii_trim(text_of(cells), " \t"), ""))


def labelled(codes: npt.NDArray[np.integer], labels: tuple[str, ...]) -> pd.Series:
    """Text from its place among `labels`; empty for -1."""
    return pa.array(["", *labels], pa.large_string()).take(pa.array(codes + 1)).to_pandas()


def text_of(cells: pa.Array) -> pa.Array:
    """Cells as text; empty for null."""
    return cells.cast(pa.large_string()).fill_null("")


def _places(indices: pa.Array, of_null: int) -> Ints:
    return indices.fill_null(of_null).to_numpy(zero_copy_only=False)


def _is_text(cells: pa.Array) -> bool:
    return pa.types.is_large_string(cells.type) or pa.types.is_string(cells.type)


def _cast(cells: pa.Array, kind: pa.DataType) -> pa.Array:
    """Cast what can be; 30 February can't, and becomes null. Halving finds the few among many."""
    try:
        return cells.cast(kind)
    except pa.ArrowInvalid:
        if len(cells) == 1:
            return pa.nulls(1, kind)
        half = len(cells) // 2
        return pa.concat_arrays([_cast(cells[:half], kind), _cast(cells[half:], kind)])


def _floats(cells: pa.Array) -> Floats:
    return cells.fill_null(np.nan).to_numpy(zero_copy_only=False)


def _mask(cells: pa.Array) -> Bools:
    return cells.to_numpy(zero_copy_only=False)
