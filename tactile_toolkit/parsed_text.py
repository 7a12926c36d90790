"""Texts of users: counts, lists of words, and the natural sort order."""

from __future__ import annotations

import re

_WORDS_AND_NUMBERS = re.compile("([^0-9]*)([0-9]*)")
# More digits may not fit into 64 bits, and ``int`` fails from 4,301 digits on.
_LONGEST_COUNT = 18


def is_count(text: str) -> bool:
    """Return whether a text is a decimal integer of at most 18 digits."""
    return text.isdecimal() and len(text) <= _LONGEST_COUNT


def comma_separated(text: str) -> list[str]:
    """Return the words of a text that commas separate."""
    return [part.strip() for part in text.split(",") if part.strip()]


def natural_key(text: str) -> tuple[list[tuple[str, int, str]], str]:
    """Return a key that sorts texts as people count, 99999 before 100000."""
    # A number by its length and digits: texts may be any user's, and Python reads 4,300 digits at most.
    pairs = ((word, digits.lstrip("0")) for word, digits in _WORDS_AND_NUMBERS.findall(text))
    return [(word, len(digits), digits) for word, digits in pairs], text
