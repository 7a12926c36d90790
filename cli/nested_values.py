"""Specifications and rows of data sets as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.wording import bytes_text, with_count

if TYPE_CHECKING:
    import pyarrow as pa

# Length of the longest list whose values are shown.
_SHOWN = 6


def flat_lines(values: JsonValue, path: str = "") -> list[str]:
    """Return nested values as lines such as ``solid.profile = round``."""
    if isinstance(values, dict) and values:
        inner = values.items()
    elif isinstance(values, list) and any(isinstance(value, (dict, list)) for value in values):
        inner = dict(enumerate(values, 1)).items()
    else:
        return [f"{path} = {_value_text(values)}"]
    return [line for key, value in inner for line in flat_lines(value, f"{path}.{key}".lstrip("."))]


def _value_text(value: JsonValue) -> str:
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_value_text, value))
    if isinstance(value, bool):
        return {True: "yes", False: "no"}[value]
    return str(value)


def stored_value(scalar: pa.Scalar) -> object:
    """Convert a scalar of Arrow to Python, or to text if Python has no such type (nanoseconds)."""
    try:
        return scalar.as_py()
    except ValueError:
        # Its text needs pandas, which no command imports.
        if isinstance(scalar, Mapping):
            return {name: stored_value(each) for name, each in scalar.items()}
        if isinstance(scalar, Iterable):
            return list(map(stored_value, scalar))
        return scalar.cast("string").as_py()


def brief(value: object) -> JsonValue:
    """Shorten a value for JSON: a long list becomes its number of values, bytes become their size."""
    if isinstance(value, dict):
        return {name: brief(each) for name, each in value.items()}
    if isinstance(value, bytes):
        return bytes_text(len(value))
    if isinstance(value, list) and len(value) > _SHOWN:
        return with_count(len(value), "values")
    if isinstance(value, list):
        return [brief(each) for each in value]
    if isinstance(value, (bool, int, float, str, type(None))):
        return value
    return str(value)
