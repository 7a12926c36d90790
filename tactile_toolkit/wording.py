"""Texts: words of messages, texts of users, and text from data as it is shown to people.

Names of classes, files and splits may be any user's. A terminal obeys control characters, Markdown and pages
of a browser obey marks; some characters turn the direction of the text next to them. Here all of these become
visible and have no effect.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence

# Touches, meshes, classes and boxes; in all other plurals, the e is part of the singular.
_LONG_PLURALS = ("ches", "shes", "sses", "xes")
_IRREGULAR = {"vertices": "vertex", "entries": "entry", "bodies": "body", "copies": "copy"}
_MARKS = re.compile(r"([\\`*\[\]<>~&]|(?<![^\W_])_|_(?![^\W_]))")  # a _ inside a word is not markup
_WORDS_AND_NUMBERS = re.compile("([^0-9]*)([0-9]*)")
# More digits may not fit into 64 bits, and ``int`` fails from 4,301 digits on.
_LONGEST_COUNT = 18
BYTES = "bytes"
"""Unit of progress whose counts are shown as sizes."""


def with_count(count: int, nouns: str) -> str:
    """Return a number with its noun: ``1 file``, ``2,000 files``, ``1 touch``."""
    if count == 1:
        before, space, noun = nouns.rpartition(" ")
        noun = _IRREGULAR.get(noun, noun.removesuffix("es" if noun.endswith(_LONG_PLURALS) else "s"))
        nouns = f"{before}{space}{noun}"
    return f"{count:,} {nouns}"


def shortened(text: str, length: int) -> str:
    """Return a text, cut with ``...`` if it has more than ``length`` characters."""
    return text if len(text) <= length else f"{text[:length]}..."


def class_name(names: Sequence[str], label: int) -> str:
    """Return the name of a class, or its number if it has no name."""
    return names[label] if 0 <= label < len(names) else str(label)


def alternatives(words: Sequence[str]) -> str:
    """Return words as alternatives: ``"mjcf, urdf or usd"``."""
    return " or ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of a message with the most similar name: ``"; did you mean 'test'?"``, or ``""``."""
    import difflib  # takes 4 ms, and few commands need it

    lowered = {word.lower(): word for word in known}
    close = difflib.get_close_matches(name.lower(), lowered, n=1)
    return f"; did you mean {lowered[close[0]]!r}?" if close else ""


def printable(text: str, keep: str = "") -> str:
    """Return a text in which all invisible characters are escaped, except those in ``keep``."""
    if text.isprintable():
        return text
    return "".join(
        character
        if character in keep or character.isprintable()
        else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def printable_json(values: object, indent: int = 2) -> str:
    """Return the JSON text of some values, with invisible characters in JSON's own escapes."""
    text = json.dumps(values, indent=indent, ensure_ascii=False)
    # Outside of strings, JSON has only visible characters and line breaks.
    odd = {character for character in set(text) if not character.isprintable()} - {"\n"}
    if odd:
        return text.translate({ord(character): json.dumps(character)[1:-1] for character in odd})
    return text


def markdown_text(text: str) -> str:
    """Return a text that Markdown, and HTML in it, shows literally."""
    # A backslash does not escape the dollars of a formula.
    return _MARKS.sub(r"\\\1", printable(text)).replace("$", "&#36;")


def markdown_code(text: str) -> str:
    """Return a text as inline code of Markdown."""
    shown = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", shown)), default=0))
    if len(fence) == 1:
        return f"{fence}{shown}{fence}"
    return f"{fence} {shown} {fence}"


def counts(text: str, mark: str = ",") -> tuple[int, ...]:
    """Return the integers, of at most 18 decimal digits, that a mark separates; empty for another text."""
    words = [word.strip() for word in text.split(mark)]
    is_valid = all(word.isdecimal() and len(word) <= _LONGEST_COUNT for word in words)
    return tuple(map(int, words)) if is_valid else ()


def comma_separated(text: str) -> list[str]:
    """Return the words of a text that commas separate."""
    return [part.strip() for part in text.split(",") if part.strip()]


def natural_key(text: str) -> tuple[list[tuple[str, int, str]], str]:
    """Return a key that sorts texts as people count, 99999 before 100000."""
    # A number by its length and digits: texts may be any user's, and Python reads 4,300 digits at most.
    pairs = ((word, digits.lstrip("0")) for word, digits in _WORDS_AND_NUMBERS.findall(text))
    return [(word, len(digits), digits) for word, digits in pairs], text


def rate_text(done: int, elapsed_s: float, unit: str) -> str:
    """Return a rate as text: ``"12 digits/s"``, ``"3.0 pictures/min"``."""
    rate = done / max(elapsed_s, 1e-9)
    per = "s"
    if unit == BYTES:
        return f"{bytes_text(rate)}/s"
    for longer in ("min", "h"):
        if rate < 1:
            rate = 60 * rate
            per = longer
    # Two digits are enough, so there is no decimal from 9.95 on.
    digits = int(rate < 9.95)
    return f"{rate:,.{digits}f} {unit}/{per}"


def bytes_text(size: float) -> str:
    """Return a size as text: ``"12.3 MB"``."""
    if size < 999.5:
        return f"{size:.0f} B"
    for unit in ("kB", "MB"):
        size /= 1000
        if size < 999.95:  # larger sizes would round to 1000.0 and get the next unit
            return f"{size:.1f} {unit}"
    return f"{size / 1000:.1f} GB"


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"1 min 20 s"``."""
    minutes, seconds_left = divmod(round(seconds), 60)
    if not minutes:
        return f"{seconds_left} s"
    if minutes < 60:
        return f"{minutes} min {seconds_left} s"
    return f"{minutes // 60} h {minutes % 60} min"
