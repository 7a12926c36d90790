"""Numbers with what they count, in words; and text from data as it is shown to people.

Names of classes, files and splits may be any user's. A terminal obeys control characters, Markdown and pages
of a browser obey marks; some characters turn the direction of what stands next to them. What such text holds
is seen here, and is not obeyed.
"""

from __future__ import annotations

import json
import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

_MARKS = re.compile(r"([\\`*\[\]<>~&]|(?<![^\W_])_|_(?![^\W_]))")  # a _ inside of a word marks nothing
_NUMBERS = re.compile("([0-9]+)")
# Digits of a count: more may not fit into 64 bits, and ``int`` itself fails from 4,301 digits on.
_LONGEST_COUNT = 18

# Touches, meshes, classes and boxes; in anything else the e belongs to the word.
_LONG_PLURALS = ("ches", "shes", "sses", "xes")


def counted(count: int, things: str) -> str:
    """Write a number with what it counts: ``1 file``, ``2,000 files``, ``1 touch``."""
    if count == 1:
        things = things.removesuffix("es" if things.endswith(_LONG_PLURALS) else "s")
    return f"{count:,} {things}"


def class_name(names: Sequence[str], label: int) -> str:
    """Return the name of a class; its number where no name is stated for it."""
    return names[label] if 0 <= label < len(names) else str(label)


def natural_key(text: str) -> tuple[list[Any], str]:
    """Return what sorts texts as people count, 99999 before 100000: text and numbers by turns."""
    parts: list[Any] = _NUMBERS.split(text)
    # The length of a number and its digits: texts may be any user's, and Python reads 4,300 digits at most.
    numbers = (part.lstrip("0") for part in parts[1::2])
    parts[1::2] = [(len(digits), digits) for digits in numbers]
    return parts, text


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Name what was probably meant, to stand behind a message: ``"; did you mean 'test'?"``, or ``""``."""
    # Here: it takes 3 ms, and few runs need it.
    import difflib

    lowered = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), lowered, n=1)
    return f"; did you mean {lowered[close[0]]!r}?" if close else ""


def plain(value: Any, kind: type[int] | type[float] = int) -> Any:
    """Return a value with tuples for all that can be iterated over and Python's numbers for all numbers.

    ``kind`` is ``float`` where integers mean measures; ``int`` leaves each number of its own kind. What
    is neither a number nor a collection of them comes back as it is, for the checks that follow.
    """
    if isinstance(value, (str, bytes, Mapping)):
        return value
    # An array without dimensions is a number, although its type can be iterated over.
    if isinstance(value, Iterable) and getattr(value, "ndim", None) != 0:
        return tuple(plain(entry, kind) for entry in value)
    return plain_number(value, kind)


def plain_number(value: Any, kind: type[int] | type[float] = int) -> Any:
    """Return one number as Python's own; see :func:`plain`."""
    if getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return value
    if kind is not float and isinstance(value, numbers.Integral):
        return int(value)
    try:
        return float(value)
    except OverflowError:
        return value


def plain_pairs(values: Any) -> Any:
    """Return pairs of a name and a number, given as such or as a mapping, as a tuple of tuples."""
    return plain(values.items() if isinstance(values, Mapping) else values)


def is_integer(*values: object) -> bool:
    """Return whether all values are integers; True and False are not."""
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)


def is_count(text: str) -> bool:
    """Return whether a text is an integer of sensible length; a superscript is a digit, but no number."""
    return text.isdecimal() and len(text) <= _LONGEST_COUNT


def listed(text: str) -> list[str]:
    """Read words separated by commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def printable(text: str, keep: str = "") -> str:
    """Return a text in which control characters, and all others that cannot be seen, are written as escapes.

    ``keep`` are some that may stay, such as the ends of lines.
    """
    if text.isprintable():
        return text
    return "".join(
        each if each in keep or each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


def printable_json(values: Any, indent: int = 2) -> str:
    """Return JSON of some values; what cannot be seen stands there in JSON's own escapes."""
    text = json.dumps(values, indent=indent, ensure_ascii=False)
    # Outside of strings JSON has no other characters than those that can be seen, and ends of lines.
    odd = {each for each in set(text) if not each.isprintable()} - {"\n"}
    return text.translate({ord(each): json.dumps(each)[1:-1] for each in odd}) if odd else text


def markdown_text(text: str) -> str:
    """Return a text so that Markdown, and HTML in it, shows it as it is."""
    # Formulas stand between dollars, and a backslash does not stop them.
    return _MARKS.sub(r"\\\1", printable(text)).replace("$", "&#36;")


def markdown_code(text: str) -> str:
    """Return a text as a span of code in Markdown."""
    shown = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", shown)), default=0))
    return f"{fence}{shown}{fence}" if len(fence) == 1 else f"{fence} {shown} {fence}"
