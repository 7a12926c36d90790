"""Values of JSON files that anybody may have written or a disk may have changed, taken by kind and size."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any, TypeGuard

from tactile_toolkit.errors import IntegrityError

__all__ = ["LARGEST", "Fields", "is_digest", "json_fields"]

_DEEPEST = 32
"""Lists in lists that are followed; a manifest of ours has 6."""

LARGEST = (1 << 63) - 1
_DIGEST = re.compile("[0-9a-f]{64}")


def json_fields(text: str | bytes, where: str) -> Fields:
    """Parse a JSON object; IntegrityError, naming ``where`` it is from, for anything else."""
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:  # bytes that are no text, too, and numbers of 5,000 digits
        message = f"{where!r} is damaged, a JSON object was expected ({type(error).__name__}: {error})"
        raise IntegrityError(message) from error
    return Fields(values, where)


def is_digest(value: object) -> TypeGuard[str]:
    """Tell whether a value is a SHA-256 in hexadecimal."""
    return isinstance(value, str) and _DIGEST.fullmatch(value) is not None


class Fields:
    """A JSON object; each way to take a value raises IntegrityError that names the field when it is another.

    ``field`` is the path to the object inside the file, for messages; with an ``index``, in a list there.
    """

    __slots__ = ("_field", "_index", "values", "where")

    def __init__(self, values: object, where: str, field: str = "", index: int | None = None) -> None:
        self.where = where
        self._field = field
        self._index = index
        if not isinstance(values, dict):
            raise self._wrong(name="", value=values, expected="a JSON object")
        self.values: dict[str, Any] = values

    def has(self, name: str) -> bool:
        """Tell whether there is a value, and not null."""
        return self.values.get(name) is not None

    def number(self, name: str, least: int = 0, most: int = LARGEST) -> int:
        """Return a whole number."""
        value = self.values.get(name)
        if type(value) is not int or not least <= value <= most:
            raise self._wrong(name, value, f"a whole number from {least} to {most}")
        return value

    def text(self, name: str) -> str:
        """Return a string."""
        value = self.values.get(name)
        if not isinstance(value, str):
            raise self._wrong(name, value, "a text")
        return value

    def digest(self, name: str) -> str:
        """Return a SHA-256 in hexadecimal."""
        value = self.values.get(name)
        if not is_digest(value):
            raise self._wrong(name, value, "64 hexadecimal digits")
        return value

    def flag(self, name: str) -> bool:
        """Return true or false."""
        value = self.values.get(name)
        if not isinstance(value, bool):
            raise self._wrong(name, value, "true or false")
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list of strings."""
        value = self.values.get(name)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self._wrong(name, value, "a list of texts")
        return tuple(value)

    def objects(self, name: str) -> list[Fields]:
        """Return a list of objects."""
        value = self.values.get(name)
        if not isinstance(value, list):
            raise self._wrong(name, value, "a list of JSON objects")
        if not value:
            return []
        path = self._path(name)
        return [Fields(item, self.where, path, index) for index, item in enumerate(value)]

    def inside(self, name: str) -> Fields:
        """Return an object."""
        return Fields(self.values.get(name), self.where, self._path(name))

    def mapping(self, name: str) -> Mapping[str, Any]:
        """Return an object of whatever values, in not too many levels and with numbers of 64 bits."""
        value = self.inside(name).values
        waiting: list[tuple[Any, int]] = [(value, 1)]
        while waiting:
            item, depth = waiting.pop()
            if depth > _DEEPEST:
                raise self._wrong(name, value, f"at most {_DEEPEST} levels of lists and objects")
            if type(item) is int and not -LARGEST <= item <= LARGEST:
                raise self._wrong(name, item, f"numbers up to {LARGEST}")
            inner = item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()
            waiting += ((each, depth + 1) for each in inner)
        return value

    def wrong(self, name: str, problem: str) -> IntegrityError:
        """Return the error for a value that does not fit to the others."""
        place = self._path(name) or "all of it"
        message = (
            f"{self.where!r} is damaged, {place}: {problem}; next: download or generate the data set again"
        )
        return IntegrityError(message)

    def _wrong(self, name: str, value: object, expected: str) -> IntegrityError:
        if value is None:
            found = "nothing"
        else:
            scalar = isinstance(value, (str, int, float, bool))
            text = repr(value) if scalar else f"a value of kind {type(value).__name__}"
            found = text if len(text) <= 80 else f"{text[:80]}..."
        return self.wrong(name, f"found {found}, expected {expected}")

    def _path(self, name: str) -> str:
        field = self._field if self._index is None else f"{self._field}[{self._index}]"
        return ".".join(filter(None, (field, name)))
