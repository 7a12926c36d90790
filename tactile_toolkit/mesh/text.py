"""Text of mesh files: its encoding, and numbers in it."""

from __future__ import annotations

import codecs
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from tactile_toolkit.errors import InputError

_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}
ANY_ENCODING = "latin-1"
"""Names and comments may have any encoding; all else is ASCII."""

# Padding that old systems write after the end of a text.
_PADDING = "\0\x1a"
_Number = TypeVar("_Number", float, int)


def plain_text(data: bytes) -> str:
    """Return text without byte order mark and padding; lines end with newlines."""
    encoding = ANY_ENCODING
    for mark, stated in _MARKS.items():
        if data.startswith(mark):
            data, encoding = data[len(mark) :], stated
    text = data.decode(encoding, "replace").rstrip(_PADDING)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def numbers_of(words: Sequence[str], kind: Callable[[str], _Number]) -> list[_Number]:
    """Convert words to numbers; InputError names the first that is not a number.

    Python also accepts ``1_000`` and digits of other scripts, which mesh formats do not.
    """
    try:
        found = list(map(kind, words))
        joined = "".join(words)
        if "_" in joined or not joined.isascii():
            raise ValueError
    except ValueError:
        wrong = next(word for word in words if not _is_number(word, kind))
        expected = "one such as -1.5 or 2e-3" if kind is float else "an integer"
        raise InputError(f"{wrong[:40]!r} is not a number; expected {expected}") from None
    return found


def _is_number(word: str, kind: Callable[[str], _Number]) -> bool:
    with suppress(ValueError):
        kind(word)
        return word.isascii() and "_" not in word
    return False
