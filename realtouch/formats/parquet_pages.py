"""Sizes of Parquet pages: Arrow allocates what a header states, so headers of untrusted files are checked.

Facts of the format: a column of a row group is a sequence of pages. Each begins with a header in the compact
protocol of Thrift; its fields 2 and 3 are the sizes of the page, unpacked and stored.
"""

from __future__ import annotations

from typing import IO

_UNPACKED, _STORED = 2, 3  # fields of a header
_HEADER_BYTES = (1 << 10, 1 << 24)  # read at first, and for a long header; Arrow reads no longer ones
_MAX_PAGES = 1 << 20
_SPARE_BYTES = 100  # by which old writers understate the size of a column
_BOOLEANS, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _LISTS, _STRUCT = (1, 2), 3, (4, 5, 6), 7, 8, (9, 10), 12
_MAX_BITS = 63


def require_bounded_pages(stream: IO[bytes], start: int, stored_bytes: int, most_bytes: int) -> None:
    """Raise ValueError if a page in a range of a file states more bytes than it can have.

    ``most_bytes`` is the limit for an unpacked page.
    """
    at, end = start, start + stored_bytes
    for _ in range(_MAX_PAGES):
        if at >= end:
            return
        sizes, length = _header(stream, at)
        unpacked, stored = (sizes.get(field, -1) for field in (_UNPACKED, _STORED))
        at += length + stored
        if not (0 <= unpacked <= most_bytes and stored >= 0 and at <= end + _SPARE_BYTES):
            raise ValueError(
                f"a page of {unpacked:,} bytes, {stored:,} stored; "
                f"expected at most {most_bytes:,} in {stored_bytes:,}"
            )
    raise ValueError(f"more than {_MAX_PAGES:,} pages in {stored_bytes:,} bytes")


def _header(stream: IO[bytes], at: int) -> tuple[dict[int, int], int]:
    """Return the integers in the header of a page by their fields, and the length of the header."""
    for most in _HEADER_BYTES:
        stream.seek(at)
        data = stream.read(most)
        integers: dict[int, int] = {}
        try:
            return integers, _end_of_struct(data, 0, integers)
        except (IndexError, RecursionError):
            continue
    raise ValueError("a page without a whole header")


def _end_of_struct(data: bytes, at: int, integers: dict[int, int]) -> int:
    """Return the end of a struct; IndexError if that is beyond the data."""
    field = 0
    while data[at]:
        step, kind = data[at] >> 4, data[at] & 15
        at, field = at + 1, field + step
        if not step:
            field, at = _varint(data, at)
        start, at = at, _end_of_value(data, at, kind)
        if kind in _INTEGERS:
            value = _varint(data, start)[0]
            integers[field] = (value >> 1) ^ -(value & 1)
    return at + 1


def _end_of_value(data: bytes, at: int, kind: int) -> int:
    if kind in _INTEGERS:
        return _varint(data, at)[1]
    if kind == _STRUCT:
        return _end_of_struct(data, at, {})
    if kind == _BINARY:
        length, at = _varint(data, at)
        return at + length
    if kind in _LISTS:
        count, element, at = data[at] >> 4, data[at] & 15, at + 1
        if count == 15:
            count, at = _varint(data, at)
        if element in _BOOLEANS:
            element = _BYTE
        for _ in range(count):
            _ = data[at]  # raises IndexError at the end of the data
            at = _end_of_value(data, at, element)
        return at
    sizes = {**dict.fromkeys(_BOOLEANS, 0), _BYTE: 1, _DOUBLE: 8}
    if kind not in sizes:
        raise ValueError(f"a header of a page with a value of type {kind}")
    return at + sizes[kind]


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, _MAX_BITS + 1, 7):
        value |= (data[at] & 127) << shift
        at += 1
        if data[at - 1] < 128:
            return value, at
    raise ValueError("a header of a page with a number of more than 64 bits")
