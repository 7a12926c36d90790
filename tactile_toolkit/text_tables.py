"""Tables in text as programs write them: with commas, semicolons or tabs, in UTF-8 or marked UTF-16."""

from __future__ import annotations

import csv
import io
import re
from typing import Any

from tactile_toolkit.errors import InputError

TABLE_ENDINGS = (".csv", ".tsv")
"""How the names of such files end, in lower case."""

_QUOTED = re.compile(r'"[^"\n]*"')
_SEPARATORS = (",", ";", "\t")
# Spreadsheets write it before the header, and read it.
_SEPARATOR_LINE = re.compile(r"sep=([,;\t])\r?\n")
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def table_text(content: bytes, path: str) -> tuple[str, str]:
    """Return the text of a table, and what separates its columns.

    That is what a line ``sep=;`` before the header says, or else the most frequent in it of ``,``, ``;`` and
    tab. Raises InputError, which names ``path``, for what is not text.
    """
    encoding = "utf-16" if content.startswith(_UTF16_MARKS) else "utf-8-sig"
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
    """Return the columns and lines of a table; InputError, which names ``path``, where it cannot be read."""
    text, separator = table_text(content, path)
    # Blanks behind a separator are not of the value.
    stream = io.StringIO(text, newline="")
    lines = csv.DictReader(stream, delimiter=separator, strict=True, skipinitialspace=True)
    try:
        lines.fieldnames = [name.strip() for name in lines.fieldnames or ()]
        return list(lines.fieldnames), list(lines)
    except csv.Error as error:
        # Of a line that was not read it counts none; a quote that never ends reaches over all that follow.
        raise InputError(
            f"{path!r}, line {lines.line_num + 1}: {error}; expected a table with commas, semicolons or tabs"
        ) from error
