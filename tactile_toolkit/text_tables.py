"""Tables in text files: separated by commas, semicolons or tabs, in UTF-8, or UTF-16 with a BOM."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from tactile_toolkit.errors import InputError

TABLE_ENDINGS = (".csv", ".tsv")
"""Endings of such files, in lower case."""

_QUOTED = re.compile(r'"[^"\n]*"')
_SEPARATORS = (",", ";", "\t")
# A line before the header, by which spreadsheets state the separator.
_SEPARATOR_LINE = re.compile(r"sep=([,;\t])\r?\n")
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
"""Byte order marks of UTF-16."""


def table_text(content: bytes, path: str) -> tuple[str, str]:
    """Return the text of a table and its separator.

    The separator is stated by a line ``sep=;`` before the header, or else the most frequent of ``,``, ``;``
    and tab in the header. Raises InputError, which names ``path``, for content that is not text.
    """
    encoding = "utf-16" if content.startswith(UTF16_MARKS) else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path!r} cannot be read as UTF-8 text (byte {error.start:,}); expected a table with commas, "
            "semicolons or tabs",
            next="save it as UTF-8",
        ) from error
    stated = _SEPARATOR_LINE.match(text)
    if stated is not None:
        return text[stated.end() :], stated[1]
    header = _QUOTED.sub("", text.lstrip().partition("\n")[0])
    return text, max(_SEPARATORS, key=header.count)


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of text, as it was read.

    Attributes
    ----------
    names : list of str
        Names of the columns, in order; they may have duplicates.
    rows : list of list of str
        Values of each row that is not empty; a row may have more or fewer values than there are columns.
    separator : str
        Character between values.
    """

    names: list[str]
    rows: list[list[str]]
    separator: str

    def columns(self) -> list[tuple[str | None, ...]]:
        """Return the values of each column; None in rows that are too short."""
        width = len(self.names)
        is_even = all(len(row) == width for row in self.rows)
        rows: Sequence[Sequence[str | None]] = self.rows
        if not is_even:
            rows = [[*row, *[None] * (width - len(row))][:width] for row in self.rows]
        return list(zip(*rows, strict=True)) or [()] * width

    def too_long(self) -> list[int]:
        """Return the numbers of rows with more values than there are columns."""
        return [number for number, row in enumerate(self.rows) if len(row) > len(self.names)]


def read_text_table(content: bytes, path: str) -> TextTable:
    """Read a table; InputError, which names ``path``, for an unreadable one."""
    text, separator = table_text(content, path)
    # Spaces after a separator are not part of the value.
    stream = io.StringIO(text, newline="")
    # The text is in memory already, and a field may hold thousands of numbers.
    csv.field_size_limit(max(csv.field_size_limit(), len(text)))
    lines = csv.reader(stream, delimiter=separator, strict=True, skipinitialspace=True)
    rows, read = list[list[str]](), 0
    try:
        for row in lines:
            read = lines.line_num
            if row:
                rows.append(row)
    except csv.Error as error:  # an unclosed quote extends to the end
        raise InputError(
            f"{path!r}, line {read + 1}: {error}; expected a table with commas, semicolons or tabs"
        ) from error
    names = [name.strip() for name in next(iter(rows), [])]
    return TextTable(names, rows[1:], separator)
