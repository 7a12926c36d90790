"""Nested values in words: specifications, and rows of data sets."""

from __future__ import annotations

from typing import Any

from cli.quantities import bytes_text


def flat_lines(values: Any, path: str = "") -> list[str]:
    """Lay out nested values as lines of dotted names, in words."""
    if isinstance(values, dict) and values:
        inner = values.items()
    elif isinstance(values, list) and any(isinstance(value, (dict, list)) for value in values):
        inner = dict(enumerate(values, 1)).items()
    else:
        return [f"{path} = {_in_words(values)}"]
    return [line for key, value in inner for line in flat_lines(value, f"{path}.{key}".lstrip("."))]


def _in_words(value: Any) -> str:
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_in_words, value))
    if isinstance(value, bool):
        return {True: "yes", False: "no"}[value]
    return str(value)


# Values of a longer list that are named.
_SHOWN = 6


def stored_value(scalar: Any) -> Any:
    """Return a value of Arrow as one of Python, in Arrow's words where Python has none (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        return str(scalar)


def brief(value: Any) -> Any:
    """Return a value of JSON, with how many there are in place of many, and sizes in place of bytes."""
    if isinstance(value, dict):
        return {name: brief(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return f"{len(value):,} values"
    if isinstance(value, list):
        return [brief(each) for each in value]
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    return str(value)
