"""Values of JSON files that anybody may have written or a disk may have changed, taken by kind and size."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

from tactile_toolkit.errors import IntegrityError

__all__ = ["LARGEST", "Fields", "all_digests", "json_fields"]

_DEEPEST = 32
"""Lists in lists that are followed; a manifest of ours has 6."""

LARGEST = (1 << 63) - 1
_DIGEST_LENGTH = 64
_DIGITS = re.compile("[0-9a-f]*")


def json_fields(text: str | bytes, where: str) -> Fields:
    """Parse a JSON object; IntegrityError, naming ``where`` it is from, for anything else."""
    try:
        text = text if isinstance(text, str) else text.decode()
        values = json.loads(text)
        if "\\u" in text:  # escapes can make half a surrogate pair, which is not text
            json.dumps(values, ensure_ascii=False).encode()
    except (ValueError, RecursionError) as error:  # bytes that are no text, too, and numbers of 5,000 digits
        message = f"{where!r} is damaged, a JSON object was expected ({type(error).__name__}: {error})"
        raise IntegrityError(message) from error
    return Fields(values, where)


def all_digests(values: Sequence[object]) -> TypeGuard[Sequence[str]]:
    """Tell whether all values are SHA-256 in hexadecimal."""
    texts = [value for value in values if isinstance(value, str) and len(value) == _DIGEST_LENGTH]
    return len(texts) == len(values) and _DIGITS.fullmatch("".join(texts)) is not None


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
        if not isinstance(value, str) or not all_digests([value]):
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

    def length(self, name: str) -> int:
        """Return how long a list is."""
        value = self.values.get(name)
        if not isinstance(value, list):
            raise self._wrong(name, value, "a list of JSON objects")
        return len(value)

    def objects(self, name: str, some: slice = slice(None)) -> list[Fields]:
        """Return a list of objects, or some of them."""
        numbers = range(self.length(name))[some]
        path = self._path(name)
        return [Fields(self.values[name][index], self.where, path, index) for index in numbers]

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
