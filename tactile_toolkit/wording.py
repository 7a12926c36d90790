"""Numbers with what they count, in words."""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tactile_toolkit.errors import InputError

_LONGEST_COUNT = 18
"""Digits of a count: more may not fit into 64 bits, and ``int`` itself fails from 4,301 digits on."""

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


def is_whole(*values: object) -> bool:
    """Return whether all values are integers; True and False are not."""
    return all(isinstance(value, int) and not isinstance(value, bool) for value in values)


def is_count(text: str) -> bool:
    """Return whether a text is an integer of sensible length; a superscript is a digit, but no number."""
    return text.isdecimal() and len(text) <= _LONGEST_COUNT


def listed(text: str) -> list[str]:
    """Read words separated by commas."""
    return [part.strip() for part in text.split(",") if part.strip()]


def whole_number(value: object, name: str, least: int = 0, most: int | None = None) -> int:
    """Return an integer within bounds; InputError, which names it, for anything else."""
    number = plain_number(value)
    if not (is_whole(number) and least <= number and (most is None or number <= most)):
        bounds = f"from {least}" if most is None else f"from {least} to {most:,}"
        raise InputError(f"{name} is {value!r}; expected an integer {bounds}")
    return int(number)
