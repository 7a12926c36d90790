"""Tables in text files: separated by commas, semicolons or tabs, in UTF-8, or UTF-16 with a mark."""

from __future__ import annotations

import csv
import io
import re
from typing import Any

from tactile_toolkit.errors import InputError

TABLE_ENDINGS = (".csv", ".tsv")
"""Endings of such files, in lower case."""

_QUOTED = re.compile(r'"[^"\n]*"')
_SEPARATORS = (",", ";", "\t")
# A line before the header, by which spreadsheets state the separator.
_SEPARATOR_LINE = re.compile(r"sep=([,;\t])\r?\n")
UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


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


def table_lines(content: bytes, path: str) -> tuple[list[str], list[dict[str, Any]]]:
    """Return columns and lines of a table; InputError, which names ``path``, for an unreadable one."""
    text, separator = table_text(content, path)
    # Spaces after a separator are not part of the value.
    stream = io.StringIO(text, newline="")
    lines = csv.DictReader(stream, delimiter=separator, strict=True, skipinitialspace=True)
    try:
        lines.fieldnames = [name.strip() for name in lines.fieldnames or ()]
        return list(lines.fieldnames), list(lines)
    except csv.Error as error:
        # The reader does not count an unreadable line; an unclosed quote extends to the end.
        raise InputError(
            f"{path!r}, line {lines.line_num + 1}: {error}; expected a table with commas, semicolons or tabs"
        ) from error
